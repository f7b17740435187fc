"""Commands of the simulation side: `demo`, `sim`."""

from __future__ import annotations

from pathlib import Path

import typer

app = typer.Typer()


@app.command("demo")
def demo(
    out: Path = typer.Option(Path("demo"), "-o", "--out", help="Folder for the recordings, result.json, report.html."),
    robot: str = typer.Option("ur5e", "--robot", help="UR arm: built-in, or a robot file with a truth section."),
    duration: float = typer.Option(30.0, "--duration", help="Length of the identification motion [s]."),
    seed: int = typer.Option(1, "--seed", help="Of the motion and of the noise."),
    as_json: bool = typer.Option(False, "--json", help="One JSON object on standard output, nothing else there."),
) -> None:
    """Excite and record a simulated UR arm over RTDE, identify, validate, compare with the truth, write the report.

    Example: dynid demo --out demo
    """
    from daq.console import progress_line
    from sim_drivers.demo import print_demo, run_demo

    with progress_line(quiet=as_json) as progress:
        shown = run_demo(out, robot, duration, seed, progress)
    print_demo(shown, as_json)


@app.command("sim")
def sim(
    robot: str = typer.Argument(help="Built-in robot or robot file with a truth section."),
    wire: str = typer.Option("rtde", "--wire", help="What to simulate: rtde."),
    host: str = typer.Option("127.0.0.1", "--host", help="Address to listen on; several arms: 127.0.0.2, 127.0.0.3."),
    version: str = typer.Option("5.22", "--version", help="Of the controller: 3.15 (125 Hz), 5.22, 5.23, 10.10."),
    seed: int = typer.Option(1, "--seed", help="Of the noise."),
    no_ui: bool = typer.Option(False, "--no-ui", help="No live line on standard error."),
) -> None:
    """Serve a simulated arm until Ctrl-C; type a fault, such as: drop 10, freeze 3, cut, block 2.

    Example: dynid sim ur5e
    """
    from sim_drivers.serve import simulate

    simulate(robot, wire, host, version, seed, live=not no_ui)
