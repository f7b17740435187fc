"""The dynamic model, experiments and estimate stored in a result.json, rebuilt and checked."""

from __future__ import annotations

from dataclasses import dataclass, replace

from daq.robot.loader import RobotFile, parse_robot
from drivers.core.errors import ResultFileError
from ident.model.base_parameters import BaseParameters
from ident.model.dynamic_model import DynamicModel, build_model
from ident.model.joint_columns import quantity_of
from ident.model.parameters import INERTIAL
from ident.regression.estimate import Estimate
from ident.regression.observability import Experiment, experiment_base, whole_arm
from ident.result.estimate import AGAIN
from ident.result.schema import Result


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
    experiments = tuple(
        stored.restored(model, f"experiments.{index}") for index, stored in enumerate(result.experiments)
    )
    experiments = experiments or (whole_arm(model),)
    base = experiment_base(model, experiments)
    if {parameter.name for parameter in result.base_parameters} != set(base.names):
        raise ResultFileError("the base parameters do not belong to the robot file beside them", hint=AGAIN)
    return StoredModel(robot_file, model, experiments, base)


def stored_estimate(result: Result, of: StoredModel) -> Estimate:
    """The estimate of a result, with its covariance.

    Raises:
        ResultFileError: there is none, or its parts do not belong together.
    """
    if result.estimate is None:
        raise ResultFileError("holds no covariance: it was written by an earlier dynid", hint=AGAIN)
    values = {entry.name: entry.value for entry in result.base_parameters}
    return result.estimate.restored(values, of.base, of.model)
