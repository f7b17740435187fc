"""Commands of the simulation side: `demo`, `sim`."""

from __future__ import annotations

from pathlib import Path

import typer

from daq.commands.completion import COMPLETIONS
from daq.commands.help_text import CommandApp
from daq.commands.options import FORCE, JSON, REALTIME, VERBOSE, takes
from sim_drivers.options import DemoOptions

app = CommandApp("Simulate")


@app.command("demo")
@takes(DemoOptions)
def demo(*, options: DemoOptions, verbose: bool = VERBOSE, force: bool = FORCE, as_json: bool = JSON) -> None:
    """Record and identify a simulated UR arm; show truth beside estimate.

    Example: dynid demo --out demo
    """
    from daq.commands.console import progress_line
    from sim_drivers.demo import print_demo, run_demo

    with progress_line(quiet=as_json) as progress:
        shown = run_demo(options, overwrite=force, progress=progress)
    print_demo(shown, as_json, verbose=verbose)


@app.command("sim")
def sim(
    robot: str = typer.Argument(
        help="Built-in robot or robot file with a truth section.", autocompletion=COMPLETIONS["robot"]
    ),
    wire: str | None = typer.Option(
        None, "--wire", help="rtde, canopen, slcan (CANopen), can, thermometer; default: as its robot file says."
    ),
    host: str = typer.Option("127.0.0.1", "--host", help="Address to listen on; several arms: 127.0.0.2, 127.0.0.3."),
    version: str = typer.Option("5.22", "--version", help="Of the controller: 3.15 (125 Hz), 5.22, 5.23, 10.10."),
    interface: str | None = typer.Option(None, "--interface", help="CAN interface; default: the robot file's."),
    channel: str | None = typer.Option(None, "--channel", help="CAN channel; default: the robot file's."),
    swap: str | None = typer.Option(None, "--swap", help="Two joints, j1,j2, whose drives have swapped node ids."),
    worst_stuffing: bool = typer.Option(False, "--worst-stuffing", help="Stuff every CAN frame to the maximum."),
    thermometer: bool = typer.Option(False, "--thermometer", help="Serve its serial thermometer, too."),
    payload: str | None = typer.Option(None, "--payload", help="MASS@X,Y,Z: kg, and m in the flange frame."),
    position: str | None = typer.Option(
        None, "--position", help="Where it stands at first, joint after joint, rad or m; default: mid-range."
    ),
    seed: int = typer.Option(1, "--seed", help="Of the noise."),
    play: Path | None = typer.Option(None, "--play", help="Of servo arms: motion to play and record, not to serve."),
    out: Path | None = typer.Option(None, "-o", "--out", help="With --play: recording to write (.h5)."),
    force: bool = FORCE,
    realtime: bool = REALTIME,
    no_ui: bool = typer.Option(False, "--no-ui", help="No status line on standard error."),
    as_json: bool = typer.Option(False, "--json", help="As --no-ui; ports and pid are printed as JSON in any case."),
) -> None:
    """Serve a simulated arm over RTDE or CAN until Ctrl-C; or play a motion on a simulated servo arm.

    Type a fault while it runs, such as: drop 10, freeze 3, cut, block 2, power-cycle 3.

    Example: dynid sim ur5e --wire canopen
    """
    if play is not None or out is not None:
        from sim_drivers.synthetic.servo import play_and_record

        play_and_record(robot, play, out, seed, overwrite=force)
        return
    from daq.session.realtime import ask_for_realtime
    from sim_drivers.serving.serve import simulate
    from sim_drivers.serving.served import BusOptions

    if realtime:
        ask_for_realtime()
    bus = BusOptions(interface, channel, swap, worst_stuffing, thermometer)
    simulate(robot, wire, host, version, seed, live=not (no_ui or as_json), bus=bus, payload=payload, position=position)
