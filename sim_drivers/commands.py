"""Commands of the simulation side: `demo`."""

from __future__ import annotations

from pathlib import Path

import typer

app = typer.Typer()


@app.command("demo")
def demo(
    out: Path = typer.Option(Path("demo"), "-o", "--out", help="Folder for the recordings, result.json, report.html."),
    robot: str = typer.Option("ur5e", "--robot", help="Built-in robot or robot file with a truth section."),
    duration: float = typer.Option(45.0, "--duration", help="Length of the identification recording [s]."),
    seed: int = typer.Option(1, "--seed", help="Of the motion and of the noise."),
    as_json: bool = typer.Option(False, "--json", help="One JSON object on standard output, nothing else there."),
) -> None:
    """Identify a simulated arm: record it with noise, identify, validate, compare with the truth, write the report.

    Example: dynid demo --out demo
    """
    from sim_drivers.demo import print_demo, run_demo

    shown = run_demo(out, robot, duration, seed)
    print_demo(shown, as_json)
