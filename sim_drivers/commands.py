"""Commands of the simulation side: `demo`, `sim`."""

from __future__ import annotations

import typer

from daq.commands.help_text import CommandApp
from daq.commands.options import FORCE, JSON, REALTIME, VERBOSE, takes
from sim_drivers.options import DemoOptions, SimOptions

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
@takes(SimOptions)
def sim(
    *,
    options: SimOptions,
    force: bool = FORCE,
    realtime: bool = REALTIME,
    no_ui: bool = typer.Option(False, "--no-ui", help="No status line on standard error."),
    as_json: bool = typer.Option(False, "--json", help="As --no-ui; ports and pid are printed as JSON in any case."),
) -> None:
    """Serve a simulated arm over RTDE or CAN until Ctrl-C; or play a motion on a simulated servo arm.

    Type a fault while it runs, such as: drop 10, freeze 3, cut, block 2, power-cycle 3.

    Example: dynid sim ur5e --wire canopen
    """
    if options.play is not None or options.out is not None:
        from sim_drivers.synthetic.servo import play_and_record

        play_and_record(options.robot, options.play, options.out, options.seed, overwrite=force)
        return
    from daq.session.realtime import ask_for_realtime
    from sim_drivers.serving.serve import simulate

    if realtime:
        ask_for_realtime()
    simulate(options, live=not (no_ui or as_json))
