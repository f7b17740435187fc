"""The command `dynid check`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NoReturn

import typer

from daq.commands.help_text import CommandApp
from daq.commands.options import HOST, JSON, ROBOT, VERBOSE
from drivers.core.errors import InputError

app = CommandApp("Robot")


@app.command("check")
def check(
    robot: str = ROBOT,
    connect: bool = typer.Option(False, "--connect", help="Open the connection and listen; nothing is enabled."),
    wire: str = typer.Option(None, "--wire", help="Connection to open; the first one if absent."),
    host: str = HOST,
    reset_faults: bool = typer.Option(False, "--reset-faults", help="Reset faults of CiA 402 drives; enables nothing."),
    verbose: bool = VERBOSE,
    as_json: bool = JSON,
) -> None:
    """Check a robot file: kinematics, connections, load of the buses.

    All problems are reported at once; what was assumed is listed, and where the tool is at named poses.

    Example: dynid check my_arm.yaml --connect
    """
    from dataclasses import asdict

    from daq.commands.console import print_json
    from daq.robot.loader import load_robot
    from drivers.core.clock import SYSTEM_CLOCK
    from drivers.core.errors import RobotFileError, UsageError
    from ident.checks.connection_check import check_connections
    from ident.checks.robot_check import budget_object, check_robot
    from ident.checks.robot_description import description, inertial_count
    from ident.commands.printing.checks import print_budget, print_connection, print_poses
    from ident.model.base_parameters import base_parameters
    from ident.model.dynamic_model import build_model

    if not connect and (wire is not None or host is not None or reset_faults):
        raise UsageError("--wire, --host and --reset-faults apply to --connect only", hint="add --connect")
    try:
        robot_file = load_robot(robot)
    except RobotFileError as error:
        _refuse(error.problems or (error,), robot, as_json)
    found = check_robot(robot_file)
    if found.problems:
        _refuse(found.problems, robot_file.where, as_json)
    name = robot_file.robot.name
    if not as_json:
        count = base_parameters(build_model(robot_file)).count
        print(f"{name}: the file is valid, {robot_file.robot.dof} joints")
        print(f"  base parameters: {count}, {inertial_count(robot_file)} of them inertial")
        for connection, budget in found.budgets.items():
            print_budget(connection, budget, verbose=verbose)
        for assumption in found.assumed:
            print(f"  assumed: {assumption}")
        for warning in found.warnings:
            print(f"  warning: {warning}")
        print_poses(found.poses)
    connections = check_connections(robot_file, wire, host, SYSTEM_CLOCK, reset_faults=reset_faults) if connect else []
    if not as_json:
        for checked in connections:
            print_connection(checked, verbose=verbose)
        return
    content = {"robot": name, "ok": True, "warnings": found.warnings, "assumed": found.assumed}
    content |= description(robot_file)
    content["poses"] = [asdict(pose) for pose in found.poses]
    content["budgets"] = {connection: budget_object(budget) for connection, budget in found.budgets.items()}
    if connect:
        content["connections"] = [asdict(checked) for checked in connections]
    print_json(content)


def _refuse(problems: Sequence[InputError], where: str, as_json: bool) -> NoReturn:
    """Tell all problems of a robot file: one as any error, several as a list before the error that counts them."""
    from daq.commands.console import print_json
    from daq.robot.validation import STILL_TODO, TODO

    count = f"{len(problems)} problems"
    if as_json:
        listed = [{"error": one.message, "where": one.where, "hint": one.hint} for one in problems]
        summary = listed[0] if len(listed) == 1 else {"error": count, "where": where, "hint": ""}
        print_json({**summary, "problems": listed})
        raise typer.Exit(InputError.exit_status)
    if len(problems) == 1:
        raise problems[0]
    unfilled: dict[str, dict[str, None]] = {}
    for problem in problems:
        entry, _, key = str(problem.where).rpartition("].")
        if STILL_TODO in problem.message and entry:
            unfilled.setdefault(f"{entry}]", {})[key.partition("[")[0]] = None
        else:
            print(problem)
    for entry, keys in unfilled.items():
        print(f"{entry}: {', '.join(keys)}: still to be filled in ({TODO})")
    raise InputError(count, where=where)
