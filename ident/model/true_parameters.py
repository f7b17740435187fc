"""The true standard parameters of a simulated arm, from its robot file."""

from __future__ import annotations

import numpy as np

from daq.robot.loader import RobotFile
from drivers.errors import RobotFileError
from drivers.streams import FloatArray
from ident.model.dynamic_model import build_model
from ident.model.parameters import INERTIAL, PAIR_FIELDS, link_parameters


def truth_vector(robot_file: RobotFile) -> FloatArray:
    """True standard parameters (p,) of a simulated arm, in column order.

    Raises:
        RobotFileError: the file's truth names no link for some joint.
    """
    robot = robot_file.robot
    model = build_model(robot_file)
    missing = [name for name in model.link_names if name not in robot.truth.links]
    if missing:
        where = f"{robot_file.where}: truth.links"
        raise RobotFileError(f"no true link for joint(s) {', '.join(missing)}", where=where)
    values = {}
    for index, name in enumerate(model.link_names):
        link = robot.truth.links[name]
        for symbol, value in zip(INERTIAL, link_parameters(link.mass, link.com, link.inertia), strict=True):
            values[f"{symbol}{index + 1}"] = value
    for parameter in model.parameters:
        joint = robot.truth.joints.get(model.link_names[parameter.joint])
        if parameter.kind == "coupling":
            field = PAIR_FIELDS[parameter.symbol]
        elif parameter.kind != "inertial":
            field = parameter.kind
        else:
            continue
        values[parameter.name] = getattr(joint, field) if joint is not None else 0.0
    return np.array([values[parameter.name] for parameter in model.parameters])
