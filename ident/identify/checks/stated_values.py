"""What a robot file states of bodies and joints against the arm's size, its URDF, its limits and the data."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from daq.robot.loader import RobotFile
from daq.robot.prior import TOTAL_MASS
from drivers.core.arrays import FloatArray
from drivers.core.text import rounded
from ident.assessment.arm_mass import mass_of_size, travel
from ident.assessment.torque_level import full_length
from ident.estimators.feasible.consistent import found_consistent
from ident.model.base_parameters import BaseParameters
from ident.model.dynamic_model import DynamicModel
from ident.model.kinematics.urdf import urdf_inertias
from ident.model.parameters import LINK_SIZE, MASS, StandardParameter
from ident.regression.estimate import Estimate
from ident.result.units import parameter_unit
from ident.verdict.catalogue import raised
from ident.verdict.check import Check

TOTAL, LIGHTER, HEAVIER = 5.0, 20.0, 10.0
"""Mass of an arm over that of the data, of its size and of its URDF, all three, or the reverse; and of a link. In 38
simulated arms true ones are up to 1.9 times the largest and 0.97 times the least of these; links 5.9 and 0.28 times."""

MOMENT, SECOND_MOMENT, AWAY = 1.5, 0.5, 1.0
"""First and second moments over the largest mass that is likely for the link times the arm's length, and its square,
and the distance of a centre over that length: 0.27, 0.08 and 0.22 at most of the same arms."""

OF_LIMIT = 3.0
"""Torque of friction at the joint's limit of velocity, and of motor inertia at that of acceleration, over the torque
limit: 0.45 and 0.63 at most of the same arms."""


@dataclass(frozen=True)
class Stated:
    """What a key of the robot file says of a value, and where it may lie in an arm of this size."""

    key: str
    least: float
    most: float
    low: float
    high: float
    unit: str

    def __str__(self) -> str:
        value = self.least if np.isfinite(self.least) else self.most
        return f"{self.key} = {value:.4g} {self.unit} (plausible: {rounded(self.low)} to {rounded(self.high)})"


def stated_value_checks(
    model: DynamicModel, robot_file: RobotFile, base: BaseParameters, estimate: Estimate, contradicted: Sequence[str]
) -> list[Check]:
    """Check values of `known` and bodies of `prior` that no arm of this size has, whatever the data leave open.

    Args:
        model: the arm.
        robot_file: its file.
        base: base parameters of the experiment.
        estimate: of them.
        contradicted: what the data deny of the file, each text with its key first.
    """
    robot, size = robot_file.robot, mass_of_size(model)
    prior = robot.prior.model_copy(update={"links": {}})
    free = robot_file.model_copy(update={"robot": robot.model_copy(update={"known": {}, "prior": prior})})
    if not (robot.known or robot.prior.links) or size is None:
        return []
    found = found_consistent(model, base, estimate, free)
    if found is None:
        return []
    masses = found.values[MASS : LINK_SIZE * len(model.joints) : LINK_SIZE]
    bodies = urdf_inertias(robot_file, model.link_names)
    by_urdf = [mass if body is None else body[0] for mass, body in zip(masses, bodies, strict=True)]
    likely = np.array([masses, np.full(len(masses), masses.mean()), np.full(len(masses), size.expected / len(masses))])
    likely = np.vstack([likely, by_urdf])
    totals = [float(masses.sum()), size.expected, float(np.sum(by_urdf))]
    denied = {text.split(" ")[0] for text in contradicted}
    wrong = [
        stated
        for stated in _all_stated(model, robot_file, likely, totals)
        if stated.key not in denied and (stated.least > stated.high or stated.most < stated.low)
    ]
    if not wrong:
        return []
    text = f"no arm of this size has what the robot file states: {', '.join(map(str, wrong))}; correct it"
    return [raised("known-implausible", text)]


def _all_stated(
    model: DynamicModel, robot_file: RobotFile, likely: FloatArray, totals: Sequence[float]
) -> Iterator[Stated]:
    """All that the file states; `likely`, `totals`: masses of the links (m, k) and of the arm, estimated in m ways."""
    robot, length = robot_file.robot, full_length(model) + travel(model)
    low, high = likely.min(axis=0) / LIGHTER, likely.max(axis=0) * HEAVIER
    columns = {parameter.name: index for index, parameter in enumerate(model.parameters)}
    for name, known in robot.known.items():
        least = known.value if known.value is not None else -np.inf if known.min is None else known.min
        most = known.value if known.value is not None else np.inf if known.max is None else known.max
        key, unit = f"known.{name}", "kg"
        if name == TOTAL_MASS:
            yield Stated(key, least, most, min(totals) / TOTAL, max(totals) * TOTAL, unit)
            continue
        parameter, unit = model.parameters[columns[name]], parameter_unit(model, columns[name])
        if parameter.kind != "inertial":
            bound = _joint_bound(robot_file, model, parameter)
        elif parameter.symbol == "M":
            yield Stated(key, least, most, low[parameter.joint], high[parameter.joint], unit)
            continue
        else:
            first = parameter.symbol.startswith("M")
            share = MOMENT * length if first else SECOND_MOMENT * length**2
            bound = share * float(likely[:, parameter.joint].max())
        yield Stated(key, least, most, -bound, bound, unit)
    for name, link in robot.prior.links.items():
        place = model.link_names.index(name)
        if link.mass is not None:
            yield Stated(f"prior.links.{name}.mass", link.mass, link.mass, low[place], high[place], "kg")
        for coordinate in link.com or ():
            bound = AWAY * length
            yield Stated(f"prior.links.{name}.com", coordinate, coordinate, -bound, bound, "m")


def _joint_bound(robot_file: RobotFile, model: DynamicModel, parameter: StandardParameter) -> float:
    """Value of a joint's parameter at which it takes `OF_LIMIT` of the torque limit; infinite where none is stated."""
    stated = {joint.name: joint for joint in robot_file.robot.joints}.get(model.link_names[parameter.joint])
    if stated is None:
        return np.inf
    signals = {"coulomb": 1.0, "offset": 1.0, "viscous": stated.velocity, "motor_inertia": stated.acceleration}
    signal = signals.get(parameter.kind)
    return OF_LIMIT * stated.torque / signal if stated.torque and signal else np.inf
