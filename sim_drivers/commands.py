"""Commands of the simulation side: `demo`, `sim`, `driver new`."""

from __future__ import annotations

import typer

from daq.commands.help_text import CommandApp, GroupedCommands
from daq.commands.options import FORCE, JSON, REALTIME, VERBOSE, takes
from sim_drivers.served import DemoOptions, SimOptions

app = CommandApp("Simulate")
driver_app = CommandApp("Simulate", cls=GroupedCommands, invoke_without_command=True)
app.add_typer(driver_app, name="driver", rich_help_panel="Simulate")


@app.command("demo")
@takes(DemoOptions)
def demo(*, options: DemoOptions, verbose: bool = VERBOSE, force: bool = FORCE, as_json: bool = JSON) -> None:
    """Record and identify a simulated UR arm; show truth beside estimate.

    Example: dynid demo --out demo
    """
    from daq.commands.console import progress_line
    from sim_drivers.rtde.demo import print_demo, run_demo

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
    no_ui: bool = typer.Option(False, "--no-ui", help="Print no status line on standard error."),
    as_json: bool = typer.Option(False, "--json", help="As --no-ui; ports and pid are printed as JSON in any case."),
) -> None:
    """Serve a simulated arm over RTDE or CAN until Ctrl-C; or play a motion on a simulated servo arm.

    Type a fault while it runs, such as: drop 10, freeze 3, cut, block 2, power-cycle 3; or a contact, such as
    push elbow_joint 0 0 30 for 0.5.

    Example: dynid sim ur5e --wire canopen
    """
    if options.play is not None or options.out is not None:
        from sim_drivers.synthetic.servo import play_and_record

        play_and_record(options.robot, options.play, options.out, options.seed, overwrite=force)
        return
    from daq.session.realtime import ask_for_realtime
    from sim_drivers.serving import simulate

    if realtime:
        ask_for_realtime()
    simulate(options, live=not (no_ui or as_json))


@driver_app.callback()
def drivers(context: typer.Context, as_json: bool = JSON) -> None:
    """List the installed drivers and their simulated buses; write the package of a new one.

    Example: dynid driver
    """
    from daq.commands.console import print_json, print_table
    from drivers.core.errors import UsageError
    from drivers.declaration import declared, installed_drivers

    if context.invoked_subcommand is not None:
        return
    rows = []
    for name, entry in sorted(installed_drivers().items()):
        try:
            wires = [back_end.wire for back_end in declared(name).simulated]
        except UsageError as error:
            wires = [str(error)]
        rows.append((name, ", ".join(wires), entry.value))
    if as_json:
        print_json({"drivers": [dict(zip(("name", "simulated", "declaration"), row, strict=True)) for row in rows]})
        return
    print_table("Drivers", ("name", "dynid sim --wire", "declared in"), rows)


@driver_app.command("new")
def new(name: str = typer.Argument(metavar="NAME", help="Name of the driver and its package, such as my_bus.")) -> None:
    """Write the package of a driver into a new folder: driver, simulated back end, and tests that it passes.

    It speaks a toy bus; docs/drivers.md goes through it.

    Example: dynid driver new my_bus
    """
    from pathlib import Path

    from sim_drivers.new_driver.write import new_driver

    written = new_driver(name, Path())
    print("\n".join(map(str, written)))
    folder = written[0].parent
    print(f"Next: pip install -e {folder}; python -m pytest {folder}")
