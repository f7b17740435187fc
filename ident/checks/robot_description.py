"""A robot file and the base parameters of its arm as one JSON object (`dynid robot show --json`)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from daq.robot.loader import RobotFile
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.symbols import symbolic_expressions


def description(robot_file: RobotFile) -> dict[str, Any]:
    """The JSON object of a robot file."""
    robot, model = robot_file.robot, build_model(robot_file)
    base = base_parameters(model)
    expressions = symbolic_expressions(robot_file, model, base)
    return {
        "name": robot.name,
        "description": robot.description,
        "dof": robot.dof,
        "joints": [joint.model_dump(mode="json") for joint in robot.joints],
        "base_parameters": [
            {"name": name, "expression": expression, "kind": kind}
            for name, expression, kind in zip(base.names, expressions, base.kinds, strict=True)
        ],
        "inertial_base_count": inertial_count(robot_file),
        "base_count": base.count,
        "no_effect": list(base.no_effect),
        "rank_margin": base.margin,
        "sources": robot.sources,
    }


def inertial_count(robot_file: RobotFile) -> int:
    """Number of inertial base parameters, motor inertia left out of the model."""
    model = build_model(robot_file)
    bare = base_parameters(replace(model, motor_inertia=(False,) * model.dof))
    return sum(kind == "inertial" for kind in bare.kinds)
