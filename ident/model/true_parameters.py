"""The true standard parameters of a simulated arm, from its robot file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from daq.robot.loader import RobotFile
from daq.robot.schema import TruthJoint
from drivers.core.arrays import FloatArray
from drivers.core.errors import RobotFileError
from ident.friction.table import SHAPED, TEMPERATURE_KINDS, root_coefficients
from ident.friction.terms import LoadTorque, friction_terms
from ident.model.dynamic_model import DynamicModel, build_model
from ident.model.parameters import INERTIAL, PAIR_FIELDS, link_parameters

TRUE_SHAPES = {"exponent": "alpha", "stribeck_velocity": "stribeck_velocity"}
"""Keys of shapes in a robot file's truth."""


def true_model(robot_file: RobotFile) -> DynamicModel:
    """The model of a simulated arm with the friction terms that its file asks for, in their true shapes.

    Raises:
        RobotFileError: the file's truth names no link for some joint.
    """
    model, robot = build_model(robot_file), robot_file.robot
    terms = friction_terms(robot.friction, robot.joint_names)
    if terms.plain:
        return model
    for motor, name in enumerate(robot.joint_names):
        joint = robot.truth.joints.get(name, TruthJoint())
        for shape, key in TRUE_SHAPES.items():
            if shape in terms.shapes and terms.bent(shape, motor):
                terms = terms.with_shape(shape, motor, getattr(joint, key), free=terms.is_free(shape, motor))
    if terms.loaded:
        inertial = truth_vector(robot_file)[: len(INERTIAL) * len(model.joints)]
        terms = replace(terms, load_torque=LoadTorque(tuple(range(len(inertial))), tuple(inertial.tolist())))
    return replace(model, terms=terms)


def truth_vector(robot_file: RobotFile, model: DynamicModel | None = None) -> FloatArray:
    """True standard parameters (p,) of a simulated arm, in the column order of `model` (of `build_model` where None).

    Raises:
        RobotFileError: the file's truth names no link for some joint.
    """
    robot = robot_file.robot
    model = build_model(robot_file) if model is None else model
    missing = [name for name in model.link_names if name not in robot.truth.links]
    if missing:
        where = f"{robot_file.where}: truth.links"
        raise RobotFileError(f"no true link for {', '.join(missing)}", where=where)
    values = {}
    for index, name in enumerate(model.link_names):
        link = robot.truth.links[name]
        for symbol, value in zip(INERTIAL, link_parameters(link.mass, link.com, link.inertia), strict=True):
            values[f"{symbol}{index + 1}"] = value
    for parameter in model.parameters:
        if parameter.kind == "inertial":
            continue
        joint = robot.truth.joints.get(model.link_names[parameter.joint], TruthJoint())
        if parameter.kind == "coupling":
            values[parameter.name] = getattr(joint, PAIR_FIELDS[parameter.symbol])
        elif parameter.kind in TEMPERATURE_KINDS:
            roots = root_coefficients(*joint.temperature)
            values[parameter.name] = roots[TEMPERATURE_KINDS.index(parameter.kind)]
        elif parameter.kind in SHAPED:
            values[parameter.name] = 0.0
        else:
            values[parameter.name] = joint.terms.get(parameter.kind) or getattr(joint, parameter.kind, 0.0)
    return np.array([values[parameter.name] for parameter in model.parameters])
