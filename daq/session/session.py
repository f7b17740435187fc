"""The session: reads a driver, feeds recorder and supervisor, plays a motion, and stops the arm on every exit path."""

from __future__ import annotations

import gc
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import FrameType

import numpy as np

from daq.motion.player import MotionSequence, Player, Punctuality, dry_run
from daq.recording.quality.clocks import ClockLog
from daq.recording.recording import STOPPED
from daq.robot.schema import Robot
from daq.session.connections import connection_keys, connection_names, driver_settings, errors_of_connection
from daq.session.course import RECENT, Course, View
from daq.session.guiding import Guiding, lead_by_hand
from daq.session.play import (
    Play,
    follow_motion,
    motion_rate,
    permitted_approach,
    prepare,
    unreported_safety,
    wait_for_position,
)
from daq.session.realtime import awake_processor
from daq.session.retract import retract
from daq.session.sources import Sources
from daq.session.stuck_channels import LOOK_EVERY, UNMOVED_EVERY
from daq.session.supervisor import Supervisor
from daq.session.unrecorded import SampleKeeper
from daq.session.watch import Watch
from drivers.base import Attributing, Driver, Notice
from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.errors import DynidError, MotionRefusedError, SafetyStopError, WorkError
from drivers.declaration import declared

READ_TIMEOUT = 0.01
LOSS_LIMIT = 0.01
"""Share of a stream's samples that may be lost before a recording counts as failed."""
SWITCH_INTERVAL = 2e-4
"""Longest time [s] that a thread holds the interpreter while another one waits for it."""
INTERRUPTED = "interrupted"
"""`stopped_by` after Ctrl-C (SIGINT)."""
ENDED_BY: dict[signal.Signals, str] = {
    signal.Signals[name]: words
    for name, words in {
        "SIGINT": INTERRUPTED,
        "SIGTERM": "terminated",
        "SIGHUP": "the terminal was closed",
        "SIGQUIT": "quit by a signal",
    }.items()
    if hasattr(signal, name)  # Windows has two of them
}
"""Signals that end a session, and its `stopped_by` after them."""
_PLAYER_PATIENCE = 0.1
_PLAYER_LIMIT = 10.0


@dataclass(frozen=True)
class SessionReport:
    """How a session went."""

    samples: Mapping[str, int]  # stream → samples handed to the recorder
    lost: Mapping[str, int]  # stream → samples that the source reports as missing
    overflow: int  # samples that were dropped because the disk did not keep up
    stopped_by: str | None  # why it ended before its end, in words; None where it ran to its end
    punctuality: Punctuality | None  # of the motion; None without one
    # that ended it, for the exit status; None where it ran to its end or was interrupted
    error: DynidError | None = None
    # which streams lost more than `LOSS_LIMIT` of their samples, and why, in words; empty where none did
    heavy_loss: str = ""
    light_loss: str = ""  # which streams lost fewer, and why; empty where none did, or the cause is unknown
    # the recording; None where the motion was refused or interrupted before it began: there is none then
    file: Path | None = None


def load_driver(
    robot: Robot,
    wire: str | None = None,
    host: str | None = None,
    folder: Path | None = None,
    clock: Clock = SYSTEM_CLOCK,
    place: str = "",
    *,
    moves: bool = True,
) -> Driver:
    """The driver of a robot's connection, not yet open.

    A connection's key `with` names others that are recorded in the same session; the driver is then one for all. They
    are only recorded, whatever their keys say.

    Args:
        robot: names the connections.
        wire: which of them; the first where None.
        host: in place of the connection's own.
        folder: of the robot file, where relative paths among a connection's keys start; None for the current one.
        clock: the host's.
        place: the robot file in messages; its name where empty.
        moves: whether the arm is to be moved; else nothing is prepared for it.

    Raises:
        UsageError: no such connection, or no such driver is installed.
    """
    place = place or robot.name
    name, *others = connection_names(robot, wire, place)
    main = _make_driver(robot, name, folder, clock, place, host, moves=moves)
    beside = {other: _make_driver(robot, other, folder, clock, place, moves=False) for other in others}
    return Sources(name, main, beside) if beside else main


def _make_driver(
    robot: Robot, name: str, folder: Path | None, clock: Clock, place: str, host: str | None = None, *, moves: bool
) -> Driver:
    declaration = declared(robot.connections[name].driver, f"{place}: connections.{name}.driver")
    keys = connection_keys(robot, name, moves=moves)
    if host is not None:
        keys["host"] = host
    with errors_of_connection(place, name):
        return declaration.make(replace(driver_settings(robot, keys, folder), clock=clock))


def record(  # noqa: C901, PLR0912, PLR0915 — the steps, in their order
    driver: Driver,
    recorder: SampleKeeper,
    supervisor: Supervisor,
    play: Play | None = None,
    duration: float | None = None,
    view: View | None = None,
    clock: Clock = SYSTEM_CLOCK,
    watch: Watch | None = None,
    guiding: Guiding | None = None,
    *,
    retracts: bool = False,
) -> SessionReport:
    """Record until the motion is over, `duration` [s] has passed, or something stops it.

    The driver must be open; it is stopped on every exit path, then the recording is closed with the reason as an event,
    at the time of its cause. The signals of `ENDED_BY` end the session in the same way, and are ignored while the arm
    is being stopped.

    Args:
        driver: open.
        recorder: of the driver's streams.
        supervisor: of the arm's limits.
        play: the motion; None where something else moves the arm.
        duration: [s]; None for as long as the motion lasts.
        view: shows every batch and the progress of the session.
        clock: the host's; the driver's and the recorder's, too.
        watch: of contacts; what it notices becomes an event, and ends a motion where it says so.
        guiding: how the arm is led by hand, in place of a motion.
        retracts: whether the arm goes a short way back after a contact that ended its motion.
    """
    course = Course(clock, ClockLog(clock), view=view, watch=watch)
    cycle = partial(_cycle, driver, recorder, supervisor, course)
    player: Player | None = None
    error: DynidError | None = None
    awake = awake_processor() if clock is SYSTEM_CLOCK else nullcontext()
    with _signals_noted(course), _undisturbed(), awake:
        try:
            driver.start()
            begun = clock.now()
            if play is not None:
                rate = motion_rate(driver)
                unreported_safety(driver, play.without_safety_status)
                dry_run(rate, clock)
                wait_for_position(cycle, course)
                approach = permitted_approach(driver, cycle, course, play)
                if approach is not None:
                    path = MotionSequence([approach, play.motion], rate)
                    player = prepare(driver, supervisor, recorder, play, course, path)
                    supervisor.restart_ages(clock.now())
                    course.moves = True
                    player.start()
                    follow_motion(cycle, recorder, course, player, path, play.robot)
            if guiding is not None:
                lead_by_hand(driver, cycle, course, recorder, guiding, duration)
            elif player is None:
                _follow(cycle, course, begun, duration)
        except KeyboardInterrupt:
            course.interrupted = INTERRUPTED
        except DynidError as caught:
            error = caught
        except Exception as caught:  # a bug of a driver must not leave the arm moving or the file open
            error = WorkError(f"the session failed: {type(caught).__name__}: {caught}")
        finally:
            noticed, interrupted = course.source_time(), course.interrupted
            _stop(driver, player)
        if retracts and course.touched and player is not None and play is not None:
            retract(driver, cycle, course, supervisor, recorder, player, path, play.robot, _stop)
        _note_clocks(recorder, course)
        stopped_by = str(error) if error is not None else interrupted
        if stopped_by is not None:
            when = course.breach_time if np.isfinite(course.breach_time) else noticed
            recorder.event(when, "error" if error else "warning", "session", f"{STOPPED}{stopped_by}")
        with suppress(DynidError):
            unhalted = _note(driver.notices(), recorder)  # an error now says that the arm could not be stopped in order
            if course.moves and unhalted is None:
                recorder.event(course.source_time(), "info", "driver", "arm halted")
        heavy_loss, light_loss = (_losses(driver, course, heavy=heavy) for heavy in (True, False))
        if heavy_loss:
            recorder.event(course.source_time(), "warning", "session", heavy_loss)
        # It would show an arm at rest, and be in the way of the next attempt.
        refused = isinstance(error, MotionRefusedError) or stopped_by == INTERRUPTED
        unwanted = (play is not None or guiding is not None) and not course.moves and refused
        try:
            if unwanted:
                recorder.discard()
            else:
                recorder.close(complete=stopped_by is None)
        except DynidError as caught:
            error, stopped_by = error or caught, stopped_by or str(caught)
    return SessionReport(
        course.samples,
        course.lost,
        recorder.overflow,
        stopped_by,
        player.punctuality() if player else None,
        error,
        heavy_loss,
        light_loss,
        None if unwanted else recorder.file,
    )


def _note_clocks(recorder: SampleKeeper, course: Course) -> None:
    for breakdown in course.clock.breakdowns():
        recorder.event(course.source_time(), "error", "session", str(breakdown))
    for message in course.clocks.messages():
        recorder.event(course.source_time(), "info", "clocks", message)


def _losses(driver: Driver, course: Course, *, heavy: bool) -> str:
    """Return which streams lost more than `LOSS_LIMIT`, or fewer for a cause that the driver knows, in words."""
    said = []
    for stream, lost in course.lost.items():
        total = course.samples[stream] + lost
        cause = driver.losses(stream) if lost and isinstance(driver, Attributing) else ""
        if lost > LOSS_LIMIT * total if heavy else cause and lost <= LOSS_LIMIT * total:
            said.append(f"{lost} of {total} samples of {stream} were lost{f' ({cause})' if cause else ''}")
    return "; ".join(said)


def _silence(driver: Driver, clock: Clock, stream: str, limit: float) -> str:
    now = clock.now()
    if clock.stalled(now - limit) > 0.5 * limit:
        return f"this computer stalled for {clock.stalled(now - RECENT):.2f} s"
    return driver.silence(stream, limit) if isinstance(driver, Attributing) else ""


def _follow(cycle: Callable[[], None], course: Course, begun: float, duration: float | None) -> None:
    """Until the recording has lasted for as long as wanted."""
    while course.interrupted is None:
        cycle()
        recorded = course.clock.now() - begun
        if duration is not None and recorded >= duration:
            return
        if course.view is not None:
            course.view.show("recording", recorded, duration or 0.0)


def _cycle(  # noqa: C901, PLR0912 — the steps, in their order
    driver: Driver, recorder: SampleKeeper, supervisor: Supervisor, course: Course, looked_twice: bool = False
) -> None:
    """One cycle: samples, notices, limits, ages, the disk."""
    before = course.clock.now()
    batches = driver.read(READ_TIMEOUT)
    for batch in batches:
        recorder.put(batch)  # first of all, so that the recording shows what stopped it
        course.add(batch)
        if batch.lost:
            when = course.joints_time(float(batch.time[0]), batch.stream) if len(batch.time) else float("nan")
            recorder.event(when, "warning", batch.stream, f"{batch.lost} samples lost")
    for breakdown in course.clock.breakdowns():
        raise WorkError(str(breakdown))
    _heed(course, recorder)
    now = course.clock.now()
    breach = None
    for batch in batches:
        exceeded = supervisor.check(batch, now) if len(batch.time) else None
        if exceeded is not None and breach is None:
            breach = replace(exceeded, time=course.joints_time(exceeded.time, batch.stream))
        for stuck in supervisor.stuck(batch, LOOK_EVERY if course.moves else UNMOVED_EVERY) if len(batch.time) else ():
            stuck = replace(stuck, time=course.joints_time(stuck.time, batch.stream))
            if course.moves and stuck.supervised and breach is None:
                breach = stuck
            if (stuck.what, stuck.joint) not in course.stuck:
                course.stuck.add((stuck.what, stuck.joint))
                recorder.event(stuck.time, "warning", batch.stream, str(stuck))
    if course.moves and course.untrusted:
        raise SafetyStopError(course.untrusted)
    notice = _note(driver.notices(), recorder)
    if notice is not None and not (breach is not None and breach.time < notice.time):
        # Braking after a protective stop may itself pass a limit: what came first is the reason.
        course.breach_time = notice.time
        raise SafetyStopError(notice.message, hint=notice.hint)
    if breach is not None:
        course.breach_time = breach.time
        raise SafetyStopError(str(breach), hint=course.cure(breach))
    if recorder.failure is not None:
        raise recorder.failure
    for message in course.clocks.due():
        recorder.event(course.source_time(), "info", "clocks", message)
    if (breach := supervisor.check_ages(now, partial(_silence, driver, course.clock))) is not None:
        if now - before > 2.0 * READ_TIMEOUT and not looked_twice:
            # This process may have been stalled itself: what came meanwhile is in the next read, if anything came.
            _cycle(driver, recorder, supervisor, course, looked_twice=True)
            return
        if course.moves:
            raise SafetyStopError(str(breach), hint=course.cure(breach))
        # Not in motion: the recording goes on until the driver gives the connection up.
        if breach.joint not in course.silent:
            recorder.event(course.source_time(), "warning", "session", str(breach))
            course.silent.add(breach.joint)
        supervisor.restart_ages(now)


def _heed(course: Course, recorder: SampleKeeper) -> None:
    """What a watch has noticed."""
    if course.watch is None:
        return
    noticed = float("nan")
    for noticed, said in course.watch.events():
        recorder.event(noticed, "warning", "monitor", said)
    # Going back, the contact that ended the motion lasts at first; only another one ends the way back.
    anew = not course.retracting or np.isfinite(noticed)
    if course.moves and anew and (reason := course.watch.stop_reason()):
        course.breach_time, course.touched = noticed, True
        raise SafetyStopError(reason, hint="see what the arm touched; it does not start again by itself")


def _note(notices: Sequence[Notice], recorder: SampleKeeper) -> Notice | None:
    """Make notices events; the first error among them."""
    for notice in notices:
        recorder.event(notice.time, notice.level, "driver", notice.message)
    return next((notice for notice in notices if notice.level == "error"), None)


def _stop(driver: Driver, player: Player | None) -> None:
    """Halt the arm: no command after the stop, and the stop even where a command hangs."""
    ended = player is None or player.stop(_PLAYER_PATIENCE)
    with suppress(Exception):  # the contract says that it never raises; the file must be closed nevertheless
        driver.stop()
    if not ended and player is not None:
        player.stop(_PLAYER_LIMIT)
        with suppress(Exception):
            driver.stop()


@contextmanager
def _signals_noted(course: Course) -> Iterator[None]:
    """Signals that end a session are noted only; as exceptions they could cut the stop itself short."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def note(signal_number: int, _frame: FrameType | None) -> None:
        course.interrupted = course.interrupted or ENDED_BY[signal.Signals(signal_number)]

    before = {handled: signal.getsignal(handled) for handled in ENDED_BY}
    for handled in before:
        signal.signal(handled, note)
    try:
        yield
    finally:
        for handled, handler in before.items():
            signal.signal(handled, handler)


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Shorten the pauses of threads during a recording.

    The garbage collector skips existing objects: a full collection stops every thread for up to 0.1 s. And a
    computing thread releases the interpreter within `SWITCH_INTERVAL`: the default of 5 ms is two periods.
    """
    interval = sys.getswitchinterval()
    gc.collect()
    gc.freeze()
    sys.setswitchinterval(SWITCH_INTERVAL)
    try:
        yield
    finally:
        sys.setswitchinterval(interval)
        gc.unfreeze()
