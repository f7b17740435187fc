"""The command `dynid record`: what it was asked for, what will move where, the session, how it ended."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

import typer

from daq.commands.help_text import CommandApp
from daq.commands.options import FORCE, JSON, NO_UI, REALTIME, ROBOT_ARGUMENT, host_option, takes
from drivers.core.errors import MotionRefusedError, UsageError
from drivers.core.options import Options, option, required
from drivers.core.ranges import RECORDING_TIME
from drivers.core.text import percent_text

if TYPE_CHECKING:
    from daq.commands.confirmation import Confirmation
    from daq.commands.hand_guiding import KeyAtTerminal
    from daq.motion.motion_check import MotionFigures
    from daq.motion.trajectories import Motion
    from daq.robot.loader import RobotFile
    from daq.session.guiding import Guiding
    from daq.session.session import SessionReport
    from daq.session.watch import Watch
    from drivers.base import Driver
    from drivers.core.clock import Clock

app = CommandApp("Record")


@dataclass(frozen=True, kw_only=True)
class SessionOptions(Options):
    """Options of a session: a trajectory to play, or how long to watch what moves by itself."""

    robot: str = field(metadata=ROBOT_ARGUMENT)
    wire: str | None = option(None, "Connection of the robot file; default: its first.")
    host: str | None = host_option()
    trajectory: Path | None = option(None, "Trajectory file to play; the arm will move.")
    speed_scale: float = option(1.0, "Fraction of the trajectory's speed, such as 0.2 for a first run; at most 1.")
    yes: bool = option(False, "Move the arm without asking.", short="-y")
    without_safety_status: bool = option(False, "Move a UR arm whose controller does not report its stops.")
    prior: Path | None = option(None, "Model folder or result.json whose parameters predict the torque.")
    duration: float | None = option(
        None, "Record for this many seconds without moving the arm.", allowed=RECORDING_TIME
    )
    comment: str = option("", "Comment, kept in the recording.")

    def __post_init__(self) -> None:
        """Check every option, and that they go together."""
        if self.trajectory is not None and self.duration is not None:
            raise UsageError("give either --trajectory or --duration")
        super().__post_init__()
        if self.trajectory is None and (self.speed_scale != 1.0 or self.prior is not None):
            raise UsageError("--speed-scale and --prior need --trajectory")
        if self.trajectory is None and self.without_safety_status:
            raise UsageError("--without-safety-status needs --trajectory")


@dataclass(frozen=True, kw_only=True)
class RecordOptions(SessionOptions):
    """Options of `record`: a session, and its file."""

    out: Path = field(metadata=required("Recording to write (.h5).", short="-o"))
    hand_guided: bool = option(False, "Release the arm while you hold a key, and record how you lead it by hand.")
    model: Path | None = option(None, "Model folder or result.json that carries the arm's weight while you lead it.")

    def __post_init__(self) -> None:
        """Check every option, and that there is one thing to do."""
        if self.hand_guided and self.trajectory is not None:
            raise UsageError("give either --trajectory or --hand-guided")
        if self.model is not None and not self.hand_guided:
            raise UsageError("--model needs --hand-guided", hint="a motion's torques are predicted with --prior")
        if self.trajectory is None and self.duration is None and not self.hand_guided:
            raise UsageError("give either --trajectory or --duration, or --hand-guided")
        super().__post_init__()


@dataclass(frozen=True)
class _PlannedMotion:
    """A motion that passed its check; text of its file."""

    motion: Motion
    text: str
    figures: MotionFigures
    confirmation: Confirmation


@dataclass(frozen=True)
class SessionPlan:
    """All that is known before the bus is touched; `screen` is for people, None for nowhere."""

    robot_file: RobotFile
    driver: Driver
    played: _PlannedMotion | None
    warnings: list[str]
    screen: TextIO | None


@app.command("record")
@takes(RecordOptions)
def record_command(
    *,
    options: RecordOptions,
    force: bool = FORCE,
    realtime: bool = REALTIME,
    browser: bool = typer.Option(False, "--browser", help="Show the joints live on a web page of this computer."),
    no_ui: bool = NO_UI,
    as_json: bool = JSON,
) -> None:
    """Play a trajectory and record it, or record whatever moves the arm, or lead it by hand.

    Before anything moves the whole motion is checked, what will move where is printed, and you are asked.

    Example: dynid record ur5e --trajectory traj.yaml --speed-scale 0.2 -o slow.h5
    """
    from contextlib import nullcontext

    from daq.live.page import require_browser
    from daq.session.realtime import ask_for_realtime
    from drivers.core.clock import SYSTEM_CLOCK

    clock = SYSTEM_CLOCK  # chosen here alone: all that this command starts is given it
    if browser:
        require_browser()
    plan = planned(options, options.out, clock, overwrite=force, as_json=as_json, guided=options.hand_guided)
    if realtime:
        ask_for_realtime()
    for warning in plan.warnings:
        print(f"dynid: warning: {warning}", file=sys.stderr)
    live = not (no_ui or as_json)
    with _key(options, clock) if options.hand_guided else nullcontext() as hand:
        guiding = None if hand is None else _guiding(plan, hand, options.model)
        report = recorded(
            plan, options, options.out, clock, overwrite=force, live=live, browser=browser, guiding=guiding
        )
    if report.file is None:
        raise report.error or KeyboardInterrupt
    played = plan.played
    motions = {} if played is None else {"motion": played.figures, "approach": played.confirmation.figures}
    report_session(report.file, report, as_json, motions)
    end_session(report, options.out)


def _key(options: RecordOptions, clock: Clock) -> KeyAtTerminal:
    """The key that a person holds while they lead the arm."""
    from daq.commands.confirmation import terminal
    from daq.commands.hand_guiding import KeyAtTerminal

    place = terminal()
    if place is None:
        raise UsageError("--hand-guided needs a terminal: the arm is released only while a key is held there")
    return KeyAtTerminal(place, clock, asks=not options.yes)


def _guiding(plan: SessionPlan, hand: KeyAtTerminal, model: Path | None) -> Guiding:
    """Return how the arm is led; the model that carries it is read."""
    from daq.session.guiding import Guiding, load_compensation

    return Guiding(plan.robot_file.robot, hand, None if model is None else load_compensation(plan.robot_file, model))


def planned(
    options: SessionOptions, out: Path | None, clock: Clock, *, overwrite: bool, as_json: bool, guided: bool = False
) -> SessionPlan:
    """Refuse what cannot be recorded or must not move, and tell what will move where.

    None as `out` keeps no recording.

    Raises:
        DynidError: says why not.
    """
    from daq.commands.confirmation import Confirmation, motion_lines, tell, terminal, unchecked_lines
    from daq.motion.approach import TimeScaled
    from daq.motion.motion_check import load_motion_check
    from daq.motion.trajectory_file import load_trajectory
    from daq.output_files import check_outputs
    from daq.recording.recorder import require_room
    from daq.robot.assumptions import assumed_limits
    from daq.robot.loader import changed_since, load_robot
    from daq.session.connections import session_warnings
    from daq.session.session import load_driver

    robot_file, trajectory = load_robot(options.robot), options.trajectory
    robot = robot_file.robot
    loaded = load_trajectory(trajectory, robot) if trajectory is not None else None
    motion = TimeScaled(loaded.motion, options.speed_scale) if loaded is not None else None
    moves = motion is not None or guided
    question = None if options.yes else terminal()
    if motion is not None and question is None and not options.yes:
        raise UsageError("the arm will move, and there is no terminal to ask on", hint="--yes moves it without asking")
    driver = load_driver(robot, options.wire, options.host, robot_file.folder, clock, robot_file.where, moves=moves)
    warnings = session_warnings(robot_file, options.wire, moves=moves)
    if moves:
        warnings += [f"assumed: {limit}" for limit in assumed_limits(robot_file)]
    designed_for = loaded.trajectory.designed_for if loaded is not None else {}
    changed = changed_since(designed_for, robot, robot_file.urdf_text)
    warnings += [changed] if changed else []
    samples = loaded.samples if loaded is not None else None
    check_outputs([out], [*robot_file.files, trajectory, samples, options.prior], overwrite=overwrite)
    if out is not None:
        require_room(out)
    screen = sys.stdout if not as_json else sys.stderr if question is not None else None
    played = None
    if loaded is not None and motion is not None:
        check = load_motion_check(robot_file, options.prior)
        try:
            figures = check.trajectory(motion, str(trajectory))
        except MotionRefusedError as error:
            error.hint = changed or error.hint
            raise
        played = _PlannedMotion(
            motion, loaded.text, figures, Confirmation(motion, robot.joints, check, question, screen)
        )
        if screen is not None:
            title = _title(str(trajectory), robot.name, options.speed_scale, figures.duration)
            tell(title, [*motion_lines(figures), *unchecked_lines(figures)], screen)
    return SessionPlan(robot_file, driver, played, warnings, screen)


def recorded(
    plan: SessionPlan,
    options: SessionOptions,
    out: Path | None,
    clock: Clock,
    *,
    overwrite: bool,
    live: bool,
    browser: bool = False,
    watch: Watch | None = None,
    guiding: Guiding | None = None,
    retracts: bool = False,
) -> SessionReport:
    """Open the driver, make the file, and record until the end.

    None as `out` keeps no recording.

    Raises:
        DynidError: the connection fails, or the file cannot be made; later errors are in the report.
    """
    import math
    from contextlib import closing, nullcontext

    from daq.live.page import page_view
    from daq.live.terminal_view import SECONDS_BETWEEN_LINES, live_view
    from daq.recording.recorder import Recorder
    from daq.recording.serial_numbers import SERIAL_EVENT
    from daq.session.arm_lock import only_mover
    from daq.session.device_limits import require_same_arm, serial_number
    from daq.session.play import Play
    from daq.session.retract import RETRACTING
    from daq.session.session import record
    from daq.session.supervisor import Limits, Supervisor
    from daq.session.unrecorded import SampleKeeper, Unrecorded

    robot, played = plan.robot_file.robot, plan.played
    moves = played is not None or guiding is not None
    lock = only_mover(robot, options.wire, options.host) if moves else nullcontext()
    with lock, closing(plan.driver) as driver:  # only now is the bus touched
        driver.open()
        require_same_arm(plan.robot_file, driver)
        layouts, to_mind, play = driver.streams(), [], None
        if watch is not None:
            watch.begin(layouts)
        if played is not None:
            to_mind = _to_mind(plan.robot_file, driver, without_safety_status=options.without_safety_status)
            to_mind += [RETRACTING] if retracts else []
            played.confirmation.to_mind = to_mind
            play = Play(played.motion, robot, played.confirmation, options.without_safety_status)
        if guiding is not None:
            to_mind = _to_mind_by_hand(driver, guiding)
        if out is None:
            recorder: SampleKeeper = Unrecorded()
        else:
            recorder = Recorder(
                out,
                plan.robot_file,
                layouts,
                trajectory=played.text if played is not None else "",
                speed_scale=options.speed_scale,
                comment=options.comment,
                overwrite=overwrite,
                clock=clock,
            )
            if plan.screen is not None:
                into = f"recording into {recorder.file}, which becomes {out} when it is closed"
                print(into, file=plan.screen, flush=True)
        if number := serial_number(driver):
            recorder.event(math.nan, "info", "driver", f"{SERIAL_EVENT}{number}")
        for warning in (*plan.warnings, *to_mind):
            recorder.event(math.nan, "warning", "session", warning)
        if options.speed_scale != 1.0:
            slower = f"the trajectory is played at {options.speed_scale:g} of its speed"
            recorder.event(math.nan, "info", "player", slower)
        limits = Limits.of_robot(robot)
        supervisor = Supervisor(limits, layouts)
        expected = options.duration if played is None else played.figures.duration
        shown = live and (sys.stderr.isatty() or expected is None or expected > SECONDS_BETWEEN_LINES)
        with (
            live_view(shown=shown, limits=limits, recorder=recorder, clock=clock, watch=watch) as terminal_view,
            page_view(plan.robot_file, layouts, shown=browser, beside=terminal_view) as view,
        ):
            return record(
                driver, recorder, supervisor, play, options.duration, view, clock, watch, guiding, retracts=retracts
            )


def _to_mind(robot_file: RobotFile, driver: Driver, *, without_safety_status: bool) -> list[str]:
    """Return what is shown of an opened arm before it moves; refused before a file is made."""
    from daq.session.device_limits import before_a_motion
    from daq.session.play import motion_rate, unreported_safety

    motion_rate(driver)
    unreported = unreported_safety(driver, without_safety_status)
    to_mind = before_a_motion(robot_file.robot, driver)
    if unreported:
        print(f"dynid: warning: {unreported}", file=sys.stderr)
        return [unreported, *to_mind]
    return to_mind


def _to_mind_by_hand(driver: Driver, guiding: Guiding) -> list[str]:
    """Return what is shown of an opened arm before it is let go; refused before a file is made."""
    from daq.session.guiding import require_guidable
    from daq.session.play import motion_rate

    motion_rate(driver)
    cautions = require_guidable(driver, guiding).guiding_cautions(pushed=guiding.compensation is not None)
    guiding.hand.mind(cautions)
    return list(cautions)


def end_session(report: SessionReport, out: Path | None) -> None:
    """Say why a session ended before its time, and exit with its status.

    Raises:
        Exit: the status is not 0.
    """
    import signal

    from daq.session.session import ENDED_BY

    status = 1 if report.heavy_loss else 0
    if report.error is not None:
        print(f"dynid: {report.error}", file=sys.stderr)
        if out is not None and report.file != out and out.exists():
            print(f"dynid: {out} is as it was; what was recorded is {report.file}", file=sys.stderr)
        status = report.error.exit_status
    else:
        ending = next((number for number, words in ENDED_BY.items() if words == report.stopped_by), None)
        if ending is not None:
            status = 128 + ending  # as shells have it
            if ending != signal.SIGINT:
                print(f"dynid: {report.stopped_by}", file=sys.stderr)
    if report.heavy_loss:
        print(f"dynid: {report.heavy_loss}: end other programs, or use --realtime", file=sys.stderr)
    if status:
        raise typer.Exit(status)


def _title(trajectory: str, robot: str, speed_scale: float, duration: float) -> str:
    slowly = f" at {percent_text(speed_scale)} of its speed" if speed_scale != 1.0 else ""
    return f"{trajectory} moves {robot} for {duration:.1f} s{slowly}"


def report_session(
    out: Path, report: SessionReport, as_json: bool, motions: Mapping[str, MotionFigures | None]
) -> None:
    """Print what a recording holds, and how punctually the motion was played.

    Raises:
        RecordingError: it cannot be read.
    """
    from daq.commands.console import print_json
    from daq.recording.quality.stream_quality import StreamQuality, stream_quality
    from daq.recording.reader import read_stamps
    from drivers.core.errors import RecordingError

    qualities: dict[str, StreamQuality] = {}
    try:
        qualities = {name: stream_quality(time) for name, time in read_stamps(out).items()}
    except RecordingError:
        if report.error is None:  # otherwise that error is what to tell
            raise
    if as_json:
        losses = {"heavy_loss": report.heavy_loss, "light_loss": report.light_loss, "overflow": report.overflow}
        print_json(
            {"file": out, "streams": qualities, "stopped_by": report.stopped_by, **losses}
            | {"punctuality": report.punctuality, **motions}
        )
        return
    for name, quality in qualities.items():
        print(f"{out}: {name}: {quality.samples} samples at {quality.rate_hz:.4g} Hz, {quality.lost} lost")
    if report.light_loss:
        print(report.light_loss)
    if report.punctuality is not None:
        late = report.punctuality
        if late.sent:
            figures = f"{late.p50_ms:.2f} ms (median), {late.p99_ms:.2f} (99 %), {late.max_ms:.2f} (most)"
            print(f"positions sent late by {figures}")
        if report.punctuality.delayed_ms > 0:
            print(f"the motion was resumed after stalls of this computer: {report.punctuality.delayed_ms:.0f} ms later")
