"""The command `dynid check`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NoReturn

import typer

from daq.commands.help_text import CommandApp
from daq.commands.options import JSON, ROBOT_ARGUMENT, VERBOSE, host_option, takes
from drivers.core.errors import InputError, UsageError
from drivers.core.options import Options, option

app = CommandApp("Robot")


@dataclass(frozen=True, kw_only=True)
class CheckOptions(Options):
    """Options of `check`: an arm, and whether its connection is opened, too."""

    robot: str = field(metadata=ROBOT_ARGUMENT)
    connect: bool = option(False, "Open the connection and listen; nothing is enabled.")
    wire: str | None = option(None, "Connection to open; default: the first.")
    host: str | None = host_option()
    reset_faults: bool = option(False, "Reset faults of drives or CAN motors; enables nothing.")
    configure: bool = option(
        False, "Write mode, return delay and calibration into the servos' EEPROM; torque is switched off: hold the arm."
    )

    def __post_init__(self) -> None:
        """Check that options of a connection come with one; a UsageError before anything is opened."""
        super().__post_init__()
        if not self.connect and (self.wire is not None or self.host is not None or self.reset_faults or self.configure):
            raise UsageError(
                "--wire, --host, --reset-faults and --configure apply to --connect only", hint="add --connect"
            )


@app.command("check")
@takes(CheckOptions)
def check(*, options: CheckOptions, verbose: bool = VERBOSE, as_json: bool = JSON) -> None:
    """Check a robot file: kinematics, connections, load of the buses.

    All problems are reported at once; what was assumed is listed, and where the tool is at named poses.

    Example: dynid check my_arm.yaml --connect
    """
    from daq.commands.console import print_json
    from daq.robot.loader import load_robot
    from drivers.core.clock import SYSTEM_CLOCK
    from drivers.core.errors import RobotFileError
    from ident.checks.connection_check import check_connections
    from ident.checks.robot_check import budget_object, check_robot
    from ident.checks.robot_description import description, inertial_count
    from ident.commands.printing.checks import print_budget, print_connection, print_poses
    from ident.model.base_parameters import base_parameters
    from ident.model.dynamic_model import build_model

    try:
        robot_file = load_robot(options.robot)
    except RobotFileError as error:
        _refuse(error.problems or (error,), options.robot, as_json)
    checked = check_robot(robot_file)
    if checked.problems:
        _refuse(checked.problems, robot_file.where, as_json)
    name = robot_file.robot.name
    if not as_json:
        count = base_parameters(build_model(robot_file)).count
        print(f"{name}: the file is valid, {robot_file.robot.dof} joints")
        print(f"  base parameters: {count}, {inertial_count(robot_file)} of them inertial")
        for bus, budget in checked.budgets.items():
            print_budget(bus, budget, verbose=verbose)
        for assumption in checked.assumed:
            print(f"  assumed: {assumption}")
        for warning in checked.warnings:
            print(f"  warning: {warning}")
        print_poses(checked.poses)
    connections = []
    if options.connect:
        connections = check_connections(
            robot_file,
            options.wire,
            options.host,
            SYSTEM_CLOCK,
            reset_faults=options.reset_faults,
            configure=options.configure,
        )
    if not as_json:
        for connection in connections:
            print_connection(connection, verbose=verbose)
        return
    content = {"robot": name, "ok": True, "warnings": checked.warnings, "assumed": checked.assumed}
    content |= description(robot_file)
    content["poses"] = checked.poses
    content["budgets"] = {bus: budget_object(budget) for bus, budget in checked.budgets.items()}
    if options.connect:
        content["connections"] = connections
    print_json(content)


def _refuse(problems: Sequence[InputError], where: str, as_json: bool) -> NoReturn:
    """Tell all problems of a robot file: one as any error, several as a list before the error that counts them."""
    from daq.commands.console import print_json
    from daq.robot.validation import STILL_TODO, TODO

    count = f"{len(problems)} problems"
    if as_json:
        listed = [{"error": problem.message, "where": problem.where, "hint": problem.hint} for problem in problems]
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
