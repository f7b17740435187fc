"""The command `dynid record`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from daq.commands.completion import COMPLETIONS
from daq.commands.help_text import CommandApp
from daq.commands.options import FORCE, HOST, JSON, REALTIME, ROBOT
from drivers.core.text import percent_text

if TYPE_CHECKING:
    from daq.motion.motion_check import MotionFigures
    from daq.session.session import SessionReport

app = CommandApp("Record")


@app.command("record")
def record_command(  # noqa: C901, PLR0912, PLR0915 — the steps, in their order
    robot: str = ROBOT,
    wire: str = typer.Option(None, "--wire", help="Connection of the robot file; its first one if absent."),
    host: str = HOST,
    trajectory: Path = typer.Option(
        None,
        "--trajectory",
        help="Trajectory file to play; the arm will move.",
        autocompletion=COMPLETIONS["trajectory"],
    ),
    speed_scale: float = typer.Option(
        1.0, "--speed-scale", help="Share of the trajectory's speed, such as 0.2 for a first run; at most 1."
    ),
    yes: bool = typer.Option(False, "--yes", "-y", help="Move the arm without asking."),
    without_safety_status: bool = typer.Option(
        False, "--without-safety-status", help="Move a UR arm whose controller does not tell of its stops."
    ),
    prior: Path = typer.Option(
        None, "--prior", help="Model folder or result.json whose parameters predict the torque."
    ),
    duration: float = typer.Option(None, "--duration", help="Record for so many seconds without moving the arm."),
    out: Path = typer.Option(..., "-o", "--out", help="Recording to write (.h5)."),
    comment: str = typer.Option("", "--comment", help="Your words, kept in the recording."),
    force: bool = FORCE,
    realtime: bool = REALTIME,
    no_ui: bool = typer.Option(False, "--no-ui", help="No live status on stderr."),
    as_json: bool = JSON,
) -> None:
    """Play a trajectory and record it, or record whatever moves the arm.

    Before anything moves the whole motion is checked, what will move where is printed, and you are asked.

    Example: dynid record ur5e --trajectory traj.yaml --speed-scale 0.2 -o slow.h5
    """
    import math
    import signal
    import sys
    from contextlib import closing, nullcontext

    from daq.commands.confirmation import Confirmation, motion_lines, tell, terminal
    from daq.live.terminal_view import live_view
    from daq.motion.motion_check import load_motion_check
    from daq.motion.time_scaled import TimeScaled
    from daq.motion.trajectory_file import load_trajectory
    from daq.output_files import check_outputs
    from daq.recording.recorder import Recorder, require_room
    from daq.robot.assumptions import assumed_limits
    from daq.robot.loader import load_robot
    from daq.session.arm_lock import only_mover
    from daq.session.bus_room import session_warnings
    from daq.session.device_limits import before_a_motion, require_same_arm
    from daq.session.play import Play, motion_rate, unreported_safety
    from daq.session.realtime import ask_for_realtime
    from daq.session.session import ENDED_BY, load_driver, record
    from daq.session.supervisor import Limits, Supervisor
    from drivers.core.clock import SYSTEM_CLOCK
    from drivers.core.errors import UsageError
    from drivers.core.ranges import RECORDING_TIME, check_option

    if (trajectory is None) == (duration is None):
        raise UsageError("give either --trajectory or --duration")
    if duration is not None:
        check_option("--duration", duration, RECORDING_TIME)
    if trajectory is None and (speed_scale != 1.0 or prior is not None):
        raise UsageError("--speed-scale and --prior need --trajectory")
    if trajectory is None and without_safety_status:
        raise UsageError("--without-safety-status needs --trajectory")
    robot_file = load_robot(robot)
    played = load_trajectory(trajectory, robot_file.robot) if trajectory is not None else None
    motion = TimeScaled(played.motion, speed_scale) if played is not None else None
    question = None if yes else terminal()
    if motion is not None and question is None and not yes:
        raise UsageError("the arm will move, and there is no terminal to ask on", hint="--yes moves it without asking")
    clock = SYSTEM_CLOCK  # chosen here alone: all that this command starts is given it
    moves = motion is not None
    driver = load_driver(robot_file.robot, wire, host, robot_file.folder, clock, robot_file.where, moves=moves)
    warnings = session_warnings(robot_file, wire, moves=moves)
    if trajectory is not None:
        warnings += [f"assumed: {limit}" for limit in assumed_limits(robot_file)]
    samples = played.samples if played is not None else None
    check_outputs([out], [*robot_file.files, trajectory, samples, prior], overwrite=force)
    require_room(out)
    screen = sys.stdout if not as_json else sys.stderr if question is not None else None
    confirmation = figures = None
    if motion is not None:
        check = load_motion_check(robot_file, prior)
        figures = check.trajectory(motion, str(trajectory))
        confirmation = Confirmation(motion, robot_file.robot.joints, check, question, screen)
        if screen is not None:
            tell(
                _title(str(trajectory), robot_file.robot.name, speed_scale, figures.duration),
                motion_lines(figures),
                screen,
            )
    if realtime:
        ask_for_realtime()
    for warning in warnings:
        print(f"dynid: warning: {warning}", file=sys.stderr)
    lock = only_mover(robot_file.robot, wire, host) if motion is not None else nullcontext()
    with lock, closing(driver):  # only now is the bus touched
        driver.open()
        require_same_arm(robot_file, driver)
        layouts = driver.streams()
        if motion is not None:
            motion_rate(driver)  # refused before a file is made
        unreported = unreported_safety(driver, without_safety_status) if motion is not None else ""
        to_mind = before_a_motion(robot_file.robot, driver) if moves else []
        if unreported:
            to_mind = [unreported, *to_mind]
            print(f"dynid: warning: {unreported}", file=sys.stderr)
        if confirmation is not None:
            confirmation.to_mind = to_mind
        recorder = Recorder(
            out,
            robot_file,
            layouts,
            trajectory=played.text if played is not None else "",
            speed_scale=speed_scale,
            comment=comment,
            overwrite=force,
            clock=clock,
        )
        if screen is not None:
            print(f"recording into {recorder.file}, which becomes {out} when it is closed", file=screen, flush=True)
        for warning in (*warnings, *to_mind):
            recorder.event(math.nan, "warning", "session", warning)
        if speed_scale != 1.0:
            recorder.event(math.nan, "info", "player", f"the trajectory is played at {speed_scale:g} of its speed")
        limits = Limits.of_robot(robot_file.robot)
        supervisor = Supervisor(limits, layouts)
        play = None
        if motion is not None and confirmation is not None:
            play = Play(motion, robot_file.robot, confirmation, without_safety_status)
        shown = sys.stderr.isatty() and not (no_ui or as_json)
        with live_view(shown=shown, limits=limits, recorder=recorder, clock=clock) as view:
            report = record(driver, recorder, supervisor, play, duration, view, clock)
    if report.file is None:
        raise report.error or KeyboardInterrupt
    approach = confirmation.figures if confirmation is not None else None
    _report_session(
        report.file, report, as_json, {"motion": figures, "approach": approach} if figures is not None else {}
    )
    status = 1 if report.heavy_loss else 0
    if report.error is not None:
        print(f"dynid: {report.error}", file=sys.stderr)
        if report.file != out and out.exists():
            print(f"dynid: {out} is as it was; what was recorded is {report.file}", file=sys.stderr)
        status = report.error.exit_status
    else:
        ending = next((number for number, words in ENDED_BY.items() if words == report.stopped_by), None)
        if ending is not None:
            status = 128 + ending  # as shells have it
            if ending != signal.SIGINT:
                print(f"dynid: {report.stopped_by}", file=sys.stderr)
    if report.heavy_loss:
        print(f"dynid: {report.heavy_loss}", file=sys.stderr)
    if status:
        raise typer.Exit(status)


def _title(trajectory: str, robot: str, speed_scale: float, duration: float) -> str:
    slowly = f" at {percent_text(speed_scale)} of its speed" if speed_scale != 1.0 else ""
    return f"{trajectory} moves {robot} for {duration:.1f} s{slowly}"


def _report_session(
    out: Path, report: SessionReport, as_json: bool, motions: Mapping[str, MotionFigures | None]
) -> None:
    from dataclasses import asdict

    from daq.commands.console import print_json
    from daq.recording.quality.stream_quality import StreamQuality, stream_quality
    from daq.recording.reader import read_recording
    from drivers.core.errors import RecordingError

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
        ended = {"stopped_by": report.stopped_by, "heavy_loss": report.heavy_loss, "overflow": report.overflow}
        moved = {name: asdict(figures) if figures is not None else None for name, figures in motions.items()}
        print_json({"file": str(out), "streams": streams, **ended, "punctuality": punctuality, **moved})
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
