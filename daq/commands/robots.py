"""The command `dynid robots`."""

from __future__ import annotations

import typer

from daq.commands.options import JSON

app = typer.Typer()


@app.command("robots")
def robots(as_json: bool = JSON) -> None:
    """List the built-in robots.

    Example: dynid robots
    """
    from daq.commands.console import print_json, print_table
    from daq.robot.loader import builtin_robots, load_robot

    known = [load_robot(name).robot for name in builtin_robots()]
    if as_json:
        print_json({"robots": [{"name": r.name, "dof": r.dof, "description": r.description} for r in known]})
        return
    print_table("Built-in robots", ("name", "joints", "description"), [(r.name, r.dof, r.description) for r in known])
