"""Commands of the acquisition side: `robots`, `import`, `record`, `recover`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from daq.session import SessionReport

app = typer.Typer()

TERMINATED_STATUS = 128 + 15
"""Exit status after SIGTERM, as shells have it; the arm is stopped and the file closed first."""

JSON = typer.Option(False, "--json", help="One JSON object on standard output, nothing else there.")


@app.command("robots")
def robots(as_json: bool = JSON) -> None:
    """List the built-in robots.

    Example: dynid robots
    """
    from daq.console import print_json, print_table
    from daq.robot import builtin_robots, load_robot

    known = [load_robot(name).robot for name in builtin_robots()]
    if as_json:
        print_json({"robots": [{"name": r.name, "dof": r.dof, "description": r.description} for r in known]})
        return
    print_table("Built-in robots", ("name", "joints", "description"), [(r.name, r.dof, r.description) for r in known])


@app.command("import")
def import_recording(
    file: Path = typer.Argument(help="CSV, npz, mat, ROS 2 bag (folder or .db3) or MCAP."),
    robot: str = typer.Option(..., "--robot", help="Built-in robot or robot file."),
    out: Path = typer.Option(..., "-o", "--out", help="Recording to write (.h5)."),
    column: list[str] = typer.Option([], "--column", help="NAME=COLUMN, such as q1=JointPos1; once for each."),
    degrees: bool = typer.Option(False, "--degrees", help="Positions and velocities of the file are in degrees."),
    effort: str = typer.Option(None, "--effort", help="What JointState.effort is: torque or current."),
    topic: str = typer.Option(None, "--topic", help="Topic of a bag with several JointState topics."),
    rate: float = typer.Option(None, "--rate", help="Rate [Hz] of a file without a time column."),
    time_unit: str = typer.Option(None, "--time-unit", help="Unit of the time column: s, ms, us or ns."),
    repair: list[str] = typer.Option([], "--repair", help="Repair to make: drop-nan, drop-duplicates, sort."),
    by_order: bool = typer.Option(False, "--by-order", help="Match joints by their order, whatever their names."),
    comment: str = typer.Option("", "--comment", help="Your words, kept in the recording."),
    force: bool = typer.Option(False, "--force", help="Overwrite the output file."),
    as_json: bool = JSON,
) -> None:
    """Take over a recording made by something else.

    Example: dynid import run.csv --robot ur5e --degrees -o run.h5
    """
    from dataclasses import asdict, replace

    from daq.console import print_json
    from daq.importers import import_file
    from daq.importers.choices import ImportChoices
    from daq.recording import write_recording
    from daq.robot import load_robot
    from daq.stream_quality import stream_quality

    choices = ImportChoices(
        columns=_column_mapping(column),
        degrees=degrees,
        effort=effort,  # type: ignore[arg-type]  # ImportChoices checks it
        topic=topic,
        rate=rate,
        repair=frozenset(repair),
        by_order=by_order,
        time_unit=time_unit,  # type: ignore[arg-type]
    )
    recording = import_file(file, load_robot(robot), choices)
    if comment:
        recording = replace(recording, comment=f"{comment} ({recording.comment})")
    write_recording(out, recording, overwrite=force)
    qualities = {name: stream_quality(stream.time) for name, stream in recording.streams.items()}
    if as_json:
        print_json(
            {
                "file": str(out),
                "streams": {name: asdict(quality) for name, quality in qualities.items()},
                "events": [asdict(event) for event in recording.events],
            }
        )
        return
    for name, stream in recording.streams.items():
        quality = qualities[name]
        print(f"{out}: {quality.samples} samples of {', '.join(stream.channels)} at {quality.rate_hz:.4g} Hz")
    for event in recording.events:
        print(f"  {event.level}: {event.message}")


@app.command("record")
def record_command(
    robot: str = typer.Argument(help="Built-in robot or robot file."),
    wire: str = typer.Option(None, "--wire", help="Connection of the robot file; its first one if absent."),
    host: str = typer.Option(None, "--host", help="Address in place of the connection's own."),
    trajectory: Path = typer.Option(None, "--trajectory", help="Trajectory file to play; the arm will move."),
    duration: float = typer.Option(None, "--duration", help="Record for so many seconds without moving the arm."),
    out: Path = typer.Option(..., "-o", "--out", help="Recording to write (.h5)."),
    comment: str = typer.Option("", "--comment", help="Your words, kept in the recording."),
    force: bool = typer.Option(False, "--force", help="Overwrite the output file."),
    realtime: bool = typer.Option(False, "--realtime", help="Real-time priority (Linux; needs the right to it)."),
    no_ui: bool = typer.Option(False, "--no-ui", help="No live status on stderr."),
    as_json: bool = JSON,
) -> None:
    """Play a trajectory and record it, or record whatever moves the arm.

    Example: dynid record ur5e --trajectory traj.yaml -o run.h5
    """
    import math
    import sys

    from daq.bus_room import session_warnings
    from daq.live_view import live_view
    from daq.realtime import ask_for_realtime
    from daq.recorder import Recorder, require_room
    from daq.recording_writer import require_writable
    from daq.robot import load_robot
    from daq.safety import Limits, Supervisor
    from daq.session import INTERRUPTED, TERMINATED, Play, load_driver, record
    from daq.trajectory_file import load_trajectory
    from drivers.clock import SYSTEM_CLOCK
    from drivers.errors import INTERRUPTED_STATUS, UsageError

    if (trajectory is None) == (duration is None):
        raise UsageError("give either --trajectory or --duration")
    if duration is not None and not 0 < duration < float("inf"):
        raise UsageError(f"--duration {duration:g} is not a positive number of seconds")
    robot_file = load_robot(robot)
    played = load_trajectory(trajectory, robot_file.robot) if trajectory is not None else None
    clock = SYSTEM_CLOCK  # chosen here alone: all that this command starts is given it
    driver, rate = load_driver(robot_file.robot, wire, host, robot_file.folder, clock)
    warnings = session_warnings(robot_file, wire)
    require_writable(out, overwrite=force)
    require_room(out)
    if realtime:
        ask_for_realtime()
    for warning in warnings:
        print(f"dynid: warning: {warning}", file=sys.stderr)
    try:  # only now is the wire touched
        driver.open()
        layouts = driver.streams()
        rate = next((layout.rate for layout in layouts if layout.name == "joints" and layout.rate > 0), rate)
        if played is not None and rate <= 0:
            raise UsageError("the connection has no 'rate', so no motion can be played", where=robot)
        recorder = Recorder(
            out,
            robot_file,
            layouts,
            trajectory=played.text if played is not None else "",
            comment=comment,
            overwrite=force,
            clock=clock,
        )
        for warning in warnings:
            recorder.event(math.nan, "warning", "session", warning)
        limits = Limits.of_robot(robot_file.robot)
        supervisor = Supervisor(limits, layouts)
        play = Play(played.motion, robot_file.robot, rate) if played is not None else None
        shown = sys.stderr.isatty() and not (no_ui or as_json)
        with live_view(shown=shown, limits=limits, recorder=recorder, clock=clock) as view:
            report = record(driver, recorder, supervisor, play, duration, view, clock)
    finally:
        driver.close()
    _report_session(out, report, as_json)
    if report.error is None and report.stopped_by == INTERRUPTED:
        raise typer.Exit(INTERRUPTED_STATUS)
    if report.error is None and report.stopped_by == TERMINATED:
        print("dynid: terminated", file=sys.stderr)
        raise typer.Exit(TERMINATED_STATUS)
    if report.error is not None:
        print(f"dynid: {report.error}", file=sys.stderr)
        raise typer.Exit(report.error.exit_status)


def _report_session(out: Path, report: SessionReport, as_json: bool) -> None:
    from dataclasses import asdict

    from daq.console import print_json
    from daq.recording import read_recording
    from daq.stream_quality import StreamQuality, stream_quality
    from drivers.errors import RecordingError

    qualities: dict[str, StreamQuality] = {}
    try:
        recording = read_recording(out)
        qualities = {name: stream_quality(stream.time) for name, stream in recording.streams.items()}
    except RecordingError:
        if report.error is None:  # otherwise that error is what to tell
            raise
    punctuality = asdict(report.punctuality) if report.punctuality is not None else None
    if as_json:
        streams = {name: asdict(quality) for name, quality in qualities.items()}
        stopped = {"file": str(out), "streams": streams, "stopped_by": report.stopped_by}
        print_json({**stopped, "overflow": report.overflow, "punctuality": punctuality})
        return
    for name, quality in qualities.items():
        print(f"{out}: {name}: {quality.samples} samples at {quality.rate_hz:.4g} Hz, {quality.lost} lost")
    if report.punctuality is not None:
        late = report.punctuality
        print(
            f"positions sent late by {late.p50_ms:.2f} ms (median), {late.p99_ms:.2f} (99 %), {late.max_ms:.2f} (most)"
        )
        if report.punctuality.delayed_ms > 0:
            print(f"the motion was resumed after stalls of this computer: {report.punctuality.delayed_ms:.0f} ms later")


@app.command("recover")
def recover_command(
    file: Path = typer.Argument(help="Recording whose writer died."),
    out: Path = typer.Option(None, "-o", "--out", help="Recording to write; FILE-recovered.h5 if absent."),
    force: bool = typer.Option(False, "--force", help="Overwrite the output file."),
    as_json: bool = JSON,
) -> None:
    """Rescue what was flushed of a recording that was never closed.

    Example: dynid recover run.h5
    """
    from dataclasses import asdict

    from daq.console import print_json
    from daq.recover import recover
    from daq.stream_quality import stream_quality

    target = out if out is not None else file.with_name(f"{file.stem}-recovered.h5")
    found = recover(file, target, overwrite=force)
    qualities = {name: stream_quality(stream.time) for name, stream in found.recording.streams.items()}
    if as_json:
        streams = {name: asdict(quality) for name, quality in qualities.items()}
        print_json({"file": str(target), "streams": streams, "cut": dict(found.cut)})
        return
    for name, quality in qualities.items():
        print(f"{target}: {name}: {quality.samples} samples rescued, {found.cut[name]} announced but not written")


def _column_mapping(pairs: list[str]) -> dict[str, str]:
    from drivers.errors import UsageError

    mapping: dict[str, str] = {}
    for pair in pairs:
        name, equals, column = pair.partition("=")
        if not (name.strip() and equals and column.strip()):
            raise UsageError(f"--column {pair} is not NAME=COLUMN", hint="for example --column q1=JointPos1")
        if name.strip() in mapping:
            raise UsageError(f"--column gives '{name.strip()}' twice")
        mapping[name.strip()] = column.strip()
    return mapping
