"""The dynamic model, experiments and estimate stored in a result.json, rebuilt and checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from daq.robot.loader import RobotFile, parse_robot
from drivers.core.arrays import FloatArray
from drivers.core.errors import ResultFileError
from ident.model.base_parameters import BaseParameters
from ident.model.dynamic_model import DynamicModel, build_model
from ident.model.joint_columns import quantity_of
from ident.model.parameters import INERTIAL
from ident.regression.estimate import Estimate
from ident.regression.observability import Experiment, experiment_base, whole_arm
from ident.result.schema import ExperimentResult, Result

AGAIN = "identify again"


@dataclass(frozen=True)
class StoredModel:
    """The dynamic model that a result's parameters belong to.

    Attributes:
        robot_file: stored beside them.
        model: with the columns that were identified.
        experiments: what the recordings make identifiable.
        base: the base parameters of these experiments together.
    """

    robot_file: RobotFile
    model: DynamicModel
    experiments: tuple[Experiment, ...]
    base: BaseParameters


def stored_model(result: Result) -> StoredModel:
    """The model of a result.

    Raises:
        ResultFileError: its parts do not belong together.
    """
    robot_file = parse_robot(
        result.robot_file, where="the result's robot file", folder=None, urdf_text=result.urdf or None
    )
    options = result.model_options
    for name in ("motor_inertia", "viscous", "coulomb", "offset"):
        if len(getattr(options, name)) != robot_file.robot.dof:
            raise ResultFileError(
                f"{len(getattr(options, name))} flags for {robot_file.robot.dof} joints",
                where=f"model_options.{name}",
                hint=AGAIN,
            )
    model = replace(
        build_model(robot_file),
        motor_inertia=tuple(options.motor_inertia),
        viscous=tuple(options.viscous),
        coulomb=tuple(options.coulomb),
        offset=tuple(options.offset),
        smoothing=options.smoothing,
        terms=options.terms,
        presliding=() if result.presliding is None else tuple(result.presliding.by_parameter.items()),
    )
    link_free = [parameter for parameter in model.parameters if parameter.kind != "inertial"]
    rubbing = {parameter.name for parameter in link_free if quantity_of(parameter) == "coulomb"}
    if not rubbing.issuperset(name for name, _ in model.presliding):
        raise ResultFileError("names no Coulomb parameter of this model", where="presliding.travels", hint=AGAIN)
    load = options.terms.load_torque
    if load is not None and not all(0 <= column < len(INERTIAL) * len(model.joints) for column in load.columns):
        raise ResultFileError("names columns that are no link's", where="model_options.terms.load_torque", hint=AGAIN)
    experiments = tuple(_experiment(model, stored, index) for index, stored in enumerate(result.experiments))
    experiments = experiments or (whole_arm(model),)
    base = experiment_base(model, experiments)
    if {parameter.name for parameter in result.base_parameters} != set(base.names):
        raise ResultFileError("the base parameters do not belong to the robot file beside them", hint=AGAIN)
    return StoredModel(robot_file, model, experiments, base)


def stored_estimate(result: Result, base: BaseParameters) -> Estimate:
    """The estimate of a result, with its covariance.

    Raises:
        ResultFileError: there is none, or its parts do not belong together.
    """
    stored = result.estimate
    if stored is None:
        raise ResultFileError("holds no covariance: it was written by an earlier dynid", hint=AGAIN)
    values = {parameter.name: parameter.value for parameter in result.base_parameters}
    count = len(stored.parameters)
    if len(set(stored.parameters)) != count or any(values.get(name) is None for name in stored.parameters):
        raise ResultFileError("names parameters that have no value", where="estimate.parameters", hint=AGAIN)
    active = tuple(base.names.index(name) for name in stored.parameters)
    others = [base.names[column] for column in range(base.count) if column not in active]
    taken_up = np.zeros((count, len(others)))
    for name, shares in stored.taken_up.items():
        if name not in others or len(shares) != count or not np.all(np.isfinite(shares)):
            raise ResultFileError("does not fit the parameters", where=f"estimate.taken_up.{name}", hint=AGAIN)
        taken_up[:, others.index(name)] = shares
    return Estimate(
        active=active,
        values=np.array([values[name] for name in stored.parameters], dtype=np.float64),
        root=_matrix(stored.root, count),
        covariance=_matrix(stored.covariance, count),
        taken_up=taken_up,
        blocks=stored.blocks,
        within=None if stored.within is None else _matrix(stored.within, count),
    )


def _matrix(rows: Sequence[Sequence[float | None]], size: int) -> FloatArray:
    """A square of numbers; a variance that is not known is null in JSON."""
    values = [[np.inf if value is None else value for value in row] for row in rows]
    return np.array(values, dtype=np.float64).reshape(size, size)


def _experiment(model: DynamicModel, stored: ExperimentResult, index: int) -> Experiment:
    where = f"experiments.{index}"
    names = model.joint_names
    unknown = [name for name in (*stored.locked, *stored.torques_of) if name not in names]
    if unknown:
        raise ResultFileError(f"names joints that the robot has not: {', '.join(unknown)}", where=where, hint=AGAIN)
    if len({len(positions) for positions in stored.locked.values()}) > 1:
        raise ResultFileError("holds different numbers of positions", where=f"{where}.locked", hint=AGAIN)
    if not stored.torques_of or not all(np.all(np.isfinite(positions)) for positions in stored.locked.values()):
        raise ResultFileError("lacks torques or positions", where=where, hint=AGAIN)
    locked = sorted(stored.locked, key=names.index)
    poses = tuple(zip(*(stored.locked[name] for name in locked), strict=True)) if locked else ((),)
    return Experiment(
        locked=tuple(names.index(name) for name in locked),
        poses=poses,
        torques=tuple(sorted(names.index(name) for name in stored.torques_of)),
    )
