"""The command `dynid monitor`: contacts in a recording, or live."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from daq.commands.help_text import CommandApp
from daq.commands.options import FORCE, JSON, NO_UI, REALTIME, page_option, takes
from daq.commands.record import SessionOptions
from drivers.core.errors import UsageError
from drivers.core.options import argument, flag_of, option, same_named
from ident.tasks.options import MODEL_HELP, DetectionOptions

if TYPE_CHECKING:
    from ident.result.tables import Table

app = CommandApp("Use")

SHOWN = 15
"""Contacts that are printed at most, the strongest."""
REPLAY = "Replay"
NO_SAFETY = "this is no safety function: it detects contacts above the forces below, after the delay below or later"


@dataclass(frozen=True, kw_only=True)
class LiveOptions(SessionOptions):
    """What is watched live; without an arm, a recording is."""

    PANEL = "Live"

    robot: str | None = field(
        default=None, metadata=argument("robot", "Built-in robot or robot file, to monitor live.")
    )  # type: ignore[assignment]
    record: Path | None = option(None, "Recording to write (.h5).")
    browser: bool = option(False, "Show external torque and arm live on a web page of this computer.")
    stop_on_contact: bool = option(False, "End the motion of --trajectory when a contact is detected.")
    retract: bool = option(False, "After that stop, retract slowly a short way along the path; then hold.")

    def __post_init__(self) -> None:
        """Check every option, and that they go together; a UsageError names the options."""
        super().__post_init__()
        if self.stop_on_contact and self.trajectory is None:
            raise UsageError(
                "--stop-on-contact ends only a motion that dynid plays: other motions are not stopped",
                hint="give --trajectory, too",
            )
        if self.retract and not self.stop_on_contact:
            raise UsageError("--retract needs a contact that ends the motion", hint="give --stop-on-contact")


@dataclass(frozen=True, kw_only=True)
class WatchOptions(DetectionOptions, LiveOptions):
    """All that the command takes beside its files."""


@app.command("monitor")
@takes(WatchOptions)
def monitor_command(
    *,
    options: WatchOptions,
    model: Path = typer.Option(..., "--model", help=MODEL_HELP),
    replay: Path = typer.Option(None, "--replay", help="Recording (.h5) to analyse.", rich_help_panel=REPLAY),
    contacts: Path = typer.Option(
        None, "--contacts", help="CSV (start,end in seconds) of labelled contacts.", rich_help_panel=REPLAY
    ),
    page: Path = page_option(panel=REPLAY),
    force: bool = FORCE,
    realtime: bool = REALTIME,
    no_ui: bool = NO_UI,
    as_json: bool = JSON,
) -> None:
    """Find contacts by the external torque on every joint, live or in a recording. No safety function.

    Example: dynid monitor --replay run.h5 --model model --page contacts.html
    """
    if (options.robot is None) == (replay is None):
        raise UsageError("give either a robot, to monitor it live, or --replay RECORDING")
    detection = same_named(options, DetectionOptions)
    if options.robot is None:
        for of in fields(LiveOptions):
            if getattr(options, of.name) != of.default:
                raise UsageError(f"{flag_of(of)} is for live monitoring", hint="name the robot")
        _replay(model, replay, contacts, detection, page, force=force, as_json=as_json)
        return
    if contacts is not None or page is not None:
        raise UsageError("--contacts and --page need --replay")
    _live(model, options, detection, force=force, realtime=realtime, shown=not (no_ui or as_json), as_json=as_json)


def _live(
    model_path: Path,
    options: WatchOptions,
    detection: DetectionOptions,
    *,
    force: bool,
    realtime: bool,
    shown: bool,
    as_json: bool,
) -> None:
    """Watch an arm until its motion or the time is over, or Ctrl-C."""
    import sys
    from contextlib import nullcontext

    from daq.commands.console import print_json, progress_line
    from daq.commands.record import end_session, planned, recorded
    from daq.live.page import Alarm, browser_page, require_browser
    from daq.session.realtime import ask_for_realtime
    from daq.session.session import INTERRUPTED
    from drivers.core.clock import SYSTEM_CLOCK
    from drivers.core.text import counted
    from ident.model.another_arm import another_arm
    from ident.monitor.live import LiveMonitor, contact_text, page_channels
    from ident.tasks.monitoring import explanation, forces_noticed, learnt_thresholds, sensitivity_table
    from ident.tasks.prediction import model_of

    if options.browser:
        require_browser()
    clock = SYSTEM_CLOCK  # chosen here alone: all that this command starts is given it
    plan = planned(options, options.record, clock, overwrite=force, as_json=as_json)
    model = model_of(model_path, None, "the external torque")
    if said := another_arm(model.stored.robot_file, plan.robot_file):
        raise UsageError(f"the robot file {said}", where=str(model_path), hint="give the model of this arm")
    with progress_line(quiet=as_json) as progress:
        progress("thresholds")
        thresholds, poses = learnt_thresholds(model, detection)
    watch = LiveMonitor(model, thresholds, stops=options.stop_on_contact)
    smallest = forces_noticed(model, thresholds, poses)
    if not as_json:
        print(NO_SAFETY)
        _print(sensitivity_table(smallest))
        print("\n".join(explanation(thresholds, watch.delay)), flush=True)
    if realtime:
        ask_for_realtime()
    for warning in plan.warnings:
        print(f"dynid: warning: {warning}", file=sys.stderr)
    with browser_page(plan.robot_file, page_channels(model)) if options.browser else nullcontext() as page:
        if page is not None:
            watch.page = page
            watch.alarm = lambda time, text, joint: page.alarm(Alarm(time, text, joint))
        report = recorded(
            *(plan, options, options.record, clock), overwrite=force, live=shown, watch=watch, retracts=options.retract
        )
    contacts = watch.monitor.contacts
    load = watch.monitor.load
    if as_json:
        print_json(
            {
                "contacts": contacts,
                "load": None if load is None else {"mass": load.mass, "margin": load.margin},
                "file": None if options.record is None else report.file,
                "stopped_by": report.stopped_by,
                "samples": report.samples,
                "lost": report.lost,
            }
        )
    else:
        for contact in contacts[-SHOWN:]:
            print(f"{contact.time:.3f} s: {contact_text(contact)}")
        print(counted(len(contacts), "contact") + ("" if options.record is None else f"; {report.file}"))
    if report.error is None and report.stopped_by == INTERRUPTED and options.trajectory is None:
        return  # the ordinary end of watching
    end_session(report, options.record)


def _replay(
    model: Path,
    replay: Path,
    contacts: Path | None,
    options: DetectionOptions,
    page: Path | None,
    *,
    force: bool,
    as_json: bool,
) -> None:
    """Watch a recording."""
    from daq.commands.console import print_json, progress_line
    from daq.output_files import check_outputs
    from drivers.core.text import counted
    from ident.result.models.model import result_path
    from ident.tasks.arguments import paths_of
    from ident.tasks.monitoring import monitor

    check_outputs([page], [replay, result_path(model), contacts, *paths_of(options.quiet or ())], overwrite=force)
    with progress_line(quiet=as_json) as progress:
        progress("thresholds and external torque")
        watched = monitor(model, replay, contacts=contacts, **vars(options))
        if page is not None:
            progress("page")
            watched.page(page, overwrite=force)
    if as_json:
        print_json({**watched.to_dict(), "page": page})
        return
    strongest = sorted(watched.contacts, key=lambda contact: -contact.ratio)[:SHOWN]
    _print(watched.summary, [index for index, contact in enumerate(watched.contacts) if contact in strongest])
    if len(watched.contacts) > SHOWN:
        print(f"the strongest {SHOWN} of {len(watched.contacts)} contacts; --json has all")
    elif not watched.contacts:
        print(f"no contact in {counted(len(watched.time), 'sample')} of {watched.label}")
    for table in (watched.comparison, watched.sensitivity):
        if table is not None:
            print()
            _print(table)
    print()
    print("\n".join(watched.explanation))
    if page is not None:
        print(f"\n{page}")


def _print(table: Table, rows: list[int] | None = None) -> None:
    from daq.commands.console import print_table

    chosen = [list(row.values()) for row in table]
    if rows is not None:
        chosen = [chosen[index] for index in rows]
    if chosen:
        print_table(table.title, [column.heading.replace("_", " ") for column in table.columns], chosen)
