"""The base parameters of an arm, from its robot file."""

from __future__ import annotations

from pathlib import Path

from daq.robot.loader import RobotFile, load_robot
from ident.model import base_parameters as numeric
from ident.model.dynamic_model import build_model
from ident.model.symbols import symbolic_expressions
from ident.result.tables import Table, table_of_rows
from ident.result.units import parameter_unit


def base_parameters(robot: str | Path | RobotFile) -> Table:
    """The base parameters of an arm: the fewest combinations of standard parameters that fix the torque (SR400 .3.2).

    Args:
        robot: built-in name, robot file, URDF, or the result of `load_robot`.

    Returns:
        One row per parameter: name, kind, joint, unit (kg·m², kg·m, …) and its expression.

    Raises:
        RobotFileError: no such robot, or its geometry cannot be used.
        IdentificationError: the rank cannot be decided.

    Example:
        >>> import dynid
        >>> table = dynid.base_parameters("ur5e")
        >>> len(table), table.row("ZZR1")["unit"]
        (58, 'kg·m²')
    """
    robot_file = load_robot(robot)
    model = build_model(robot_file)
    base = numeric.base_parameters(model)
    rows = [
        (name, kind, model.link_names[joint], parameter_unit(model, column), expression)
        for name, kind, joint, column, expression in zip(
            base.names,
            base.kinds,
            base.joints,
            base.columns,
            symbolic_expressions(robot_file, model, base),
            strict=True,
        )
    ]
    headings = [(name, "") for name in ("name", "kind", "joint", "unit", "expression")]
    return table_of_rows(f"Base parameters of {model.name}", headings, rows)
