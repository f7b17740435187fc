"""The command `dynid check`."""

from __future__ import annotations

import typer

from ident.commands.options import JSON, ROBOT

app = typer.Typer()


@app.command("check")
def check(
    robot: str = ROBOT,
    connect: bool = typer.Option(False, "--connect", help="Open the connection and listen; nothing is enabled."),
    wire: str = typer.Option(None, "--wire", help="Connection to open; the first one if absent."),
    host: str = typer.Option(None, "--host", help="Address in place of the connection's own."),
    as_json: bool = JSON,
) -> None:
    """Validate a robot file: its keys, kinematics, base parameters, connections and the load of their CAN buses.

    Example: dynid check my_arm.yaml --connect
    """
    from dataclasses import asdict

    from daq.commands.console import print_json
    from daq.robot.loader import load_robot
    from drivers.clock import SYSTEM_CLOCK
    from drivers.errors import UsageError
    from ident.checks.connection_check import check_connections, print_connection
    from ident.checks.robot_check import budget_object, bus_budgets, check_robot, print_budget
    from ident.checks.robot_description import description

    if not connect and (wire is not None or host is not None):
        raise UsageError("--wire and --host apply to --connect only", hint="add --connect")
    robot_file = load_robot(robot)
    findings = check_robot(robot_file)
    budgets = bus_budgets(robot_file)
    name = robot_file.robot.name
    if not as_json:
        print(f"{name}: the file is valid, {robot_file.robot.dof} joints")
        for connection, budget in budgets.items():
            print_budget(connection, budget)
        for finding in findings:
            print(f"  warning: {finding}")
    connections = check_connections(robot_file, wire, host, SYSTEM_CLOCK) if connect else []
    if not as_json:
        for checked in connections:
            print_connection(checked)
        return
    content = {"robot": name, "ok": True, "warnings": findings, **description(robot_file)}
    content["budgets"] = {connection: budget_object(budget) for connection, budget in budgets.items()}
    if connect:
        content["connections"] = [asdict(checked) for checked in connections]
    print_json(content)
