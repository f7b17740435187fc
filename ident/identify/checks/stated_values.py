"""What a robot file states of bodies and joints against the arm's size, its URDF, its limits and the data."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

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


def stated_value_checks(
    model: DynamicModel, robot_file: RobotFile, base: BaseParameters, estimate: Estimate, contradicted: Sequence[str]
) -> list[Check]:
    """Check values of `known` and bodies of `prior` that no arm of this size has, whatever the data leave open.

    `contradicted` is what the data deny of the file, each text with its key first: named already.
    """
    robot, size = robot_file.robot, mass_of_size(model)
    if not (robot.known or robot.prior.links) or size is None:
        return []
    prior = robot.prior.model_copy(update={"links": {}})
    free = robot_file.model_copy(update={"robot": robot.model_copy(update={"known": {}, "prior": prior})})
    found = found_consistent(model, base, estimate, free)
    if found is None:
        return []
    masses = found.values[MASS : LINK_SIZE * len(model.joints) : LINK_SIZE]
    bodies = urdf_inertias(robot_file, model.link_names)
    stated = [mass if body is None else body[0] for mass, body in zip(masses, bodies, strict=True)]
    even = np.ones(len(masses)) / len(masses)
    likely = np.array([masses, masses.sum() * even, size.expected * even, stated])
    denied = {text.split(" ")[0] for text in contradicted}
    wrong = [
        f"{key} {'=' if least == most else 'is at least' if least > high else 'is at most'} "
        f"{least if least > high else most:.4g} {unit} (plausible: {rounded(low)} to {rounded(high)})"
        for key, unit, (least, most), (low, high) in _stated(model, robot_file, likely)
        if key not in denied and (least > high or most < low)
    ]
    text = f"no arm of this size has what the robot file states: {', '.join(wrong)}; correct it"
    return [raised("known-implausible", text)] if wrong else []


def _stated(
    model: DynamicModel, robot_file: RobotFile, likely: FloatArray
) -> Iterator[tuple[str, str, tuple[float, float], tuple[float, float]]]:
    """Key and unit of all that the file states, its range, and a plausible one; `likely`: four masses (4, k) a link."""
    robot, length, totals = robot_file.robot, full_length(model) + travel(model), likely.sum(axis=1)
    light, heavy = likely.min(axis=0) / LIGHTER, likely.max(axis=0) * HEAVIER
    columns = {parameter.name: index for index, parameter in enumerate(model.parameters)}
    for name, known in robot.known.items():
        limits = (-np.inf if known.min is None else known.min, np.inf if known.max is None else known.max)
        key, between = f"known.{name}", limits if known.value is None else (known.value, known.value)
        if name == TOTAL_MASS:
            yield key, "kg", between, (totals.min() / TOTAL, totals.max() * TOTAL)
            continue
        parameter = model.parameters[columns[name]]
        link, unit = parameter.joint, parameter_unit(model, columns[name])
        if parameter.symbol == "M":
            yield key, unit, between, (light[link], heavy[link])
            continue
        share = MOMENT * length if parameter.symbol.startswith("M") else SECOND_MOMENT * length**2
        bound = share * likely[:, link].max() if parameter.kind == "inertial" else _joint_bound(model, parameter)
        yield key, unit, between, (-bound, bound)
    for name, body in robot.prior.links.items():
        link = model.link_names.index(name)
        if body.mass is not None:
            yield f"prior.links.{name}.mass", "kg", (body.mass, body.mass), (light[link], heavy[link])
        for place in body.com or ():
            yield f"prior.links.{name}.com", "m", (place, place), (-AWAY * length, AWAY * length)


def _joint_bound(model: DynamicModel, parameter: StandardParameter) -> float:
    """Value of a joint's parameter at which it takes `OF_LIMIT` of the torque limit; infinite where none is."""
    if parameter.joint not in model.active:
        return np.inf
    limits = model.limits[model.active.index(parameter.joint)]
    signals = {"coulomb": 1.0, "offset": 1.0, "viscous": limits.velocity, "motor_inertia": limits.acceleration}
    return OF_LIMIT * (limits.torque or np.inf) / signals[parameter.kind] if parameter.kind in signals else np.inf
