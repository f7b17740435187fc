"""The command `dynid lint`."""

from __future__ import annotations

import typer

from daq.commands.help_text import CommandApp
from daq.commands.options import JSON, ROBOT

app = CommandApp("Robot")


@app.command("lint")
def lint(robot: str = ROBOT, as_json: bool = JSON) -> None:
    """Look for wrong masses, inertias and limits in a URDF or robot file.

    A line for each finding: link, what, why it matters, what to do. Exit status 1 where there are errors.

    Example: dynid lint arm.urdf
    """
    from daq.commands.console import print_json
    from drivers.core.text import counted
    from ident.checks.inertia_lint import lint as look

    report = look(robot)
    errors = sum(finding.severity == "error" for finding in report.findings)
    if as_json:
        figures = {"links": report.links, "untrusted": report.untrusted, "findings": report.findings}
        print_json({"robot": report.name, **figures})
    else:
        for finding in report.findings:
            print(finding)
        found = f"{counted(errors, 'error')}, {counted(len(report.findings) - errors, 'note')}"
        print(f"{report.name}: {counted(report.links, 'moving link')}: {found}")
        if report.untrusted:
            print(f"no controller can trust: {', '.join(report.untrusted)}")
    if errors:
        raise typer.Exit(1)
