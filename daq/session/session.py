"""The session: reads a driver, feeds recorder and supervisor, plays a motion, and stops the arm on every exit path."""

from __future__ import annotations

import gc
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from importlib.metadata import entry_points
from pathlib import Path
from types import FrameType
from typing import Protocol

import numpy as np

from daq.motion.limits import check_limits
from daq.motion.player import Path as MotionPath
from daq.motion.player import Player, Punctuality, dry_run
from daq.motion.trajectories import Motion
from daq.recording.recorder import Recorder
from daq.recording.recording import JOINTS_STREAM
from daq.robot.schema import Robot
from daq.session.clocks import ClockLog
from daq.session.command_gate import COMMAND_RATE, CommandGate, GateLimits
from daq.session.connections import connection_keys, connection_names, driver_settings, errors_of_connection
from daq.session.permission import Permission
from daq.session.sources import Sources
from daq.session.supervisor import Supervisor
from drivers.base import DRIVERS_GROUP, Attributing, Driver, DriverSettings, Notice
from drivers.clock import SYSTEM_CLOCK, Clock
from drivers.errors import ConnectionLostError, DynidError, MotionRefusedError, SafetyStopError, UsageError, WorkError
from drivers.standstill import StandstillWatch
from drivers.streams import Batch, FloatArray

READ_TIMEOUT = 0.01
LOSS_LIMIT = 0.01
"""Share of a stream's samples that may be lost before a recording counts as failed."""
FIRST_SAMPLE_LIMIT = 5.0
"""Time limit [s] for the first samples."""
SWITCH_INTERVAL = 2e-4
"""Longest time [s] that a thread holds the interpreter while another one waits for it."""
MOVED_MEANWHILE = 0.02
"""A joint that moved this far [rad or m] while the answer was awaited is somewhere else than the person saw."""
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
REST_TIME = 0.5
"""How long [s] an arm, and what its controller aims at, must have been at rest before control of it is taken."""
REST_LIMIT = 2.0
"""How long [s] is waited for that."""
ARRIVAL_LIMIT = 3.0
"""How long [s] an arm may take to come to rest after the last command of a motion."""
ARRIVAL_ERROR = 0.02
"""Distance [rad or m] from the end of the motion at which an arm at rest is said not to have reached it."""
_GAP = 0.1
"""Samples [s] apart in which an arm may have moved and come back."""
_PLAYER_PATIENCE = 0.1
_PLAYER_LIMIT = 10.0


@dataclass(frozen=True)
class SessionReport:
    """How a session went.

    Attributes:
        samples: stream → samples handed to the recorder.
        lost: stream → samples that the source reports as missing.
        overflow: samples that were dropped because the disk did not keep up.
        stopped_by: why it ended before its end, in words; None where it ran to its end.
        punctuality: of the motion; None without one.
        error: that ended it, for the exit status; None where it ran to its end or was interrupted.
        heavy_loss: which streams lost more than `LOSS_LIMIT` of their samples, and why, in words; empty where none did.
        file: the recording; None where the motion was refused or interrupted before it began: there is none then.
    """

    samples: Mapping[str, int]
    lost: Mapping[str, int]
    overflow: int
    stopped_by: str | None
    punctuality: Punctuality | None
    error: DynidError | None = None
    heavy_loss: str = ""
    file: Path | None = None


@dataclass(frozen=True)
class Play:
    """A motion that a session is to play.

    Attributes:
        motion: from rest to rest.
        robot: whose limits every command keeps.
        permission: to move, with the approach to the motion's start.
    """

    motion: Motion
    robot: Robot
    permission: Permission


class View(Protocol):
    """Display of a running session; it must neither block nor raise."""

    def add(self, batch: Batch) -> None:
        """Note a batch."""

    def show(self, state: str, elapsed: float, total: float) -> None:
        """Show the state; `elapsed` of `total` [s]."""


@dataclass
class _Course:
    """State of a running session.

    `breach_time` [s, the source's clock] is that of what stopped it, where it has one; `silent` are the streams whose
    silence is an event already; `host_ahead` is by stream the host's clock less the source's at its last sample [s];
    `heard` is the host's time of the newest position, `rest` watches it and what the controller aims at.
    """

    clock: Clock
    clocks: ClockLog
    samples: dict[str, int] = field(default_factory=dict)
    lost: dict[str, int] = field(default_factory=dict)
    position: FloatArray | None = None
    heard: float = float("-inf")
    rest: StandstillWatch = field(default_factory=lambda: StandstillWatch(_GAP, REST_TIME))
    gate: CommandGate | None = None
    source_minus_host: float = float("nan")
    view: View | None = None
    moves: bool = False
    interrupted: str | None = None
    breach_time: float = float("nan")
    silent: set[str] = field(default_factory=set)
    host_ahead: dict[str, float] = field(default_factory=dict)

    def add(self, batch: Batch) -> None:
        self.samples[batch.stream] = self.samples.get(batch.stream, 0) + len(batch.time)
        self.lost[batch.stream] = self.lost.get(batch.stream, 0) + batch.lost
        self.silent.discard(f"stream {batch.stream}")
        self.clocks.add(batch)
        if len(batch.time):
            self.host_ahead[batch.stream] = float(batch.host_time[-1] - batch.time[-1])
        if batch.stream == JOINTS_STREAM and len(batch.time):
            self.position = batch.values["position"][-1].copy()
            self.heard = float(batch.host_time[-1])
            watched = [batch.values[name] for name in ("position", "target_position") if name in batch.values]
            for host_time, row in zip(batch.host_time.tolist(), np.hstack(watched), strict=True):
                self.rest.add(host_time, row)
            if self.gate is not None:
                self.gate.measured(self.clock.now(), self.position)
            self.source_minus_host = float(batch.time[-1] - batch.host_time[-1])
        if self.view is not None:
            self.view.add(batch)

    def source_time(self) -> float:
        """Now, in the clock of the joints' stream [s]."""
        return self.clock.now() + self.source_minus_host

    def joints_time(self, when: float, stream: str) -> float:
        """A time of a stream's clock, in the clock of the joints' stream [s]."""
        if stream == JOINTS_STREAM or JOINTS_STREAM not in self.host_ahead:
            return when
        return when + self.host_ahead[stream] + self.source_minus_host


def load_driver(
    robot: Robot,
    wire: str | None = None,
    host: str | None = None,
    folder: Path | None = None,
    clock: Clock = SYSTEM_CLOCK,
    place: str = "",
) -> Driver:
    """The driver of a robot's connection, not yet open.

    A connection's key `with` names others that are recorded in the same session; the driver is then one for all.

    Args:
        robot: names the connections.
        wire: which of them; the first where None.
        host: in place of the connection's own.
        folder: of the robot file, where relative paths among a connection's keys start; None for the current one.
        clock: the host's.
        place: the robot file in messages; its name where empty.

    Raises:
        UsageError: no such connection, or no such driver is installed.
    """
    place = place or robot.name
    name, *others = connection_names(robot, wire, place)
    keys = connection_keys(robot, name)
    if host is not None:
        keys["host"] = host
    main = _make_driver(robot, name, keys, folder, clock, place)
    beside = {
        other: _make_driver(robot, other, connection_keys(robot, other), folder, clock, place) for other in others
    }
    return Sources(name, main, beside) if beside else main


def _make_driver(
    robot: Robot, name: str, keys: Mapping[str, object], folder: Path | None, clock: Clock, place: str
) -> Driver:
    driver = robot.connections[name].driver
    drivers = {entry.name: entry for entry in entry_points(group=DRIVERS_GROUP)}
    if driver not in drivers:
        raise UsageError(
            f"no driver is called '{driver}'",
            where=f"{place}: connections.{name}.driver",
            hint=f"installed: {', '.join(sorted(drivers)) or 'none'}",
        )
    make: Callable[[DriverSettings], Driver] = drivers[driver].load()
    with errors_of_connection(place, name):
        return make(replace(driver_settings(robot, keys, folder), clock=clock))


def record(
    driver: Driver,
    recorder: Recorder,
    supervisor: Supervisor,
    play: Play | None = None,
    duration: float | None = None,
    view: View | None = None,
    clock: Clock = SYSTEM_CLOCK,
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
    """
    course = _Course(clock, ClockLog(clock), view=view)
    player: Player | None = None
    error: DynidError | None = None
    with _signals_noted(course), _undisturbed():
        try:
            driver.start()
            begun = clock.now()
            if play is not None:
                rate = motion_rate(driver)
                dry_run(rate, clock)
                cycle = partial(_cycle, driver, recorder, supervisor, course)
                _wait_for_position(cycle, course)
                approach = _permitted_approach(driver, cycle, course, play)
                if approach is not None:
                    path = MotionPath([approach, play.motion], rate)
                    player = _prepare(driver, supervisor, recorder, play, course, path)
                    supervisor.restart_ages(clock.now())
                    course.moves = True
                    player.start()
                    _follow_motion(cycle, recorder, course, player, path)
            if player is None:
                _follow(partial(_cycle, driver, recorder, supervisor, course), course, begun, duration)
        except KeyboardInterrupt:
            course.interrupted = INTERRUPTED
        except DynidError as caught:
            error = caught
        except Exception as caught:  # a bug of a driver must not leave the arm moving or the file open
            error = WorkError(f"the session failed: {type(caught).__name__}: {caught}")
        finally:
            noticed, interrupted = course.source_time(), course.interrupted
            _stop(driver, player)
        for breakdown in clock.breakdowns():
            recorder.event(course.source_time(), "error", "session", str(breakdown))
        for message in course.clocks.messages():
            recorder.event(course.source_time(), "info", "clocks", message)
        stopped_by = str(error) if error is not None else interrupted
        if stopped_by is not None:
            when = course.breach_time if np.isfinite(course.breach_time) else noticed
            recorder.event(when, "error" if error else "warning", "session", f"stopped: {stopped_by}")
        with suppress(DynidError):
            unhalted = _note(driver.notices(), recorder)  # an error now says that the arm could not be stopped in order
            if player is not None and unhalted is None:
                recorder.event(course.source_time(), "info", "driver", "arm halted")
        heavy_loss = _heavy_loss(driver, course)
        if heavy_loss:
            recorder.event(course.source_time(), "warning", "session", heavy_loss)
        # It would show an arm at rest, and be in the way of the next attempt.
        unwanted = play is not None and player is None
        unwanted = unwanted and (isinstance(error, MotionRefusedError) or stopped_by == INTERRUPTED)
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
        None if unwanted else recorder.file,
    )


def _heavy_loss(driver: Driver, course: _Course) -> str:
    said = []
    for stream, lost in course.lost.items():
        total = course.samples[stream] + lost
        if lost > LOSS_LIMIT * total:
            cause = driver.losses(stream) if isinstance(driver, Attributing) else ""
            said.append(f"{lost} of {total} samples of {stream} were lost{f' ({cause})' if cause else ''}")
    return "; ".join(said)


def motion_rate(driver: Driver) -> float:
    """The rate [Hz] at which a driver that is open takes positions.

    Raises:
        UsageError: it moves no arm, or positions are sent or measured too slowly for a motion to be supervised.
    """
    rate = driver.command_rate()
    measured = next((layout.rate for layout in driver.streams() if layout.name == JOINTS_STREAM), 0.0)
    if rate <= 0.0:
        raise UsageError("this connection cannot move the arm; it only records")
    for what, value in (("positions would be sent", rate), ("positions are measured", measured)):
        if value < COMMAND_RATE:
            raise UsageError(
                f"{what} at {value:g} Hz, and a motion needs {COMMAND_RATE:g} Hz",
                hint=f"set the connection's rate (sync_rate) to {COMMAND_RATE:g} Hz or more; recording works as it is",
            )
    return rate


def _wait_for_position(cycle: Callable[[], None], course: _Course) -> None:
    limit = course.clock.now() + FIRST_SAMPLE_LIMIT
    while course.position is None and course.interrupted is None:
        cycle()
        if course.clock.now() > limit:
            raise ConnectionLostError(f"no joint position within {FIRST_SAMPLE_LIMIT:g} s")


def _wait_for_rest(cycle: Callable[[], None], course: _Course) -> None:
    limit = course.clock.now() + REST_LIMIT
    while not course.rest.at_rest and course.interrupted is None:
        cycle()
        if course.clock.now() > limit:
            raise MotionRefusedError(
                f"the arm, or what its controller aims at, was not at rest for {REST_TIME:g} s",
                hint="something else moves it: end that first",
            )


def _permitted_approach(driver: Driver, cycle: Callable[[], None], course: _Course, play: Play) -> Motion | None:
    """The approach to the start pose, once the arm may move and is in control; None where interrupted before."""
    check_limits(play.motion, play.robot.joints, "the trajectory")
    _wait_for_rest(cycle, course)
    shown = course.position
    if shown is None or course.interrupted is not None:
        return None
    play.permission.approach(shown)
    play.permission.ask()
    while (answer := play.permission.answer()) is None:
        cycle()
        if course.interrupted is not None:
            return None
    if not answer:
        raise MotionRefusedError("not confirmed, so nothing was moved")
    _wait_for_rest(cycle, course)
    _require_unmoved(course, shown, "before the motion was confirmed")
    _take_control(driver, cycle, course)
    _wait_for_rest(cycle, course)
    if course.interrupted is not None:
        return None
    here = _require_unmoved(course, shown, "while control of it was taken")
    return play.permission.approach(here)


def _require_unmoved(course: _Course, shown: FloatArray, when: str) -> FloatArray:
    """Where the arm is, which must be about where it was shown to be.

    Raises:
        MotionRefusedError: it is not.
    """
    here = shown if course.position is None else course.position
    if np.max(np.abs(here - shown)) > MOVED_MEANWHILE:
        raise MotionRefusedError(f"the arm moved {when}", hint="start again when it is at rest")
    return here


def _take_control(driver: Driver, cycle: Callable[[], None], course: _Course) -> None:
    """Take control of the arm, which may last seconds, while samples are read; then wait for a newer position.

    Raises:
        DynidError: the driver's.
    """
    failures: list[DynidError] = []

    def take() -> None:
        try:
            driver.take_control()
        except DynidError as error:
            failures.append(error)

    thread = course.clock.thread(take, "taking control")
    thread.start()
    while thread.is_alive() and course.interrupted is None:
        cycle()
    if failures:
        raise failures[0]
    taken = course.clock.now()
    while course.heard <= taken and course.interrupted is None:
        cycle()  # ends by stale data where nothing comes


def _prepare(
    driver: Driver, supervisor: Supervisor, recorder: Recorder, play: Play, course: _Course, path: MotionPath
) -> Player:
    """The player of a path, with the command gate between it and the driver."""
    limits = GateLimits.of_joints(play.robot.joints)
    approach = float(path.starts[1])
    recorder.event(course.source_time(), "info", "player", f"approach to the start pose, {approach:.2f} s")
    course.gate = CommandGate(driver.command, supervisor.commanded, limits, 1.0 / path.rate, course.clock)
    if course.position is not None:
        course.gate.measured(course.clock.now(), course.position)
    return Player(course.gate.command, path, limits.acceleration, course.clock)


def _follow_motion(
    cycle: Callable[[], None], recorder: Recorder, course: _Course, player: Player, path: MotionPath
) -> None:
    """Until the arm has arrived at the end of the motion."""
    begun = False
    while not player.done and course.interrupted is None:
        cycle()
        _raise_failure(cycle, player)
        if not begun and player.elapsed > path.starts[1] + 1e-9:
            begun = True
            recorder.event(course.source_time(), "info", "player", "motion begins")
        if course.view is not None:
            state = "motion" if begun else "approach to the start pose"
            course.view.show(state, player.elapsed, player.duration)
    course.rest, limit = StandstillWatch(_GAP), course.clock.now() + ARRIVAL_LIMIT
    while not course.rest.at_rest and course.interrupted is None:
        cycle()
        _raise_failure(cycle, player)
        if course.clock.now() > limit:
            raise WorkError(f"the arm did not come to rest within {ARRIVAL_LIMIT:g} s of the motion's last command")
    if course.interrupted is None and course.position is not None:
        short = np.abs(course.position - path.positions(np.array([path.duration]))[0])
        if np.max(short) > ARRIVAL_ERROR:
            said = f"the arm came to rest {np.max(short):.3f} rad from the end of the motion"
            recorder.event(course.source_time(), "warning", "player", said)
        recorder.event(course.source_time(), "info", "player", "motion ends")


def _raise_failure(cycle: Callable[[], None], player: Player) -> None:
    """End the session where the player has ended; by what the driver says of the cause, if it does."""
    if player.failure is not None:
        cycle()
        raise player.failure


def _follow(cycle: Callable[[], None], course: _Course, begun: float, duration: float | None) -> None:
    """Until the recording has lasted for as long as wanted."""
    while course.interrupted is None:
        cycle()
        recorded = course.clock.now() - begun
        if duration is not None and recorded >= duration:
            return
        if course.view is not None:
            course.view.show("recording", recorded, duration or 0.0)


def _cycle(
    driver: Driver, recorder: Recorder, supervisor: Supervisor, course: _Course, looked_twice: bool = False
) -> None:
    """One cycle: samples, notices, limits, ages, the disk."""
    before = course.clock.now()
    batches = driver.read(READ_TIMEOUT)
    for batch in batches:
        recorder.put(batch)  # first of all, so that the recording shows what stopped it
        course.add(batch)
        if batch.lost:
            when = float(batch.time[0]) if len(batch.time) else float("nan")
            recorder.event(when, "warning", batch.stream, f"{batch.lost} samples lost")
    for breakdown in course.clock.breakdowns():
        raise WorkError(str(breakdown))
    now = course.clock.now()
    breach = None
    for batch in batches:
        exceeded = supervisor.check(batch, now) if len(batch.time) else None
        if exceeded is not None and breach is None:
            breach = replace(exceeded, time=course.joints_time(exceeded.time, batch.stream))
    notice = _note(driver.notices(), recorder)
    if notice is not None and not (breach is not None and breach.time < notice.time):
        # Braking after a protective stop may itself pass a limit: what came first is the reason.
        course.breach_time = notice.time
        raise SafetyStopError(notice.message)
    if breach is not None:
        course.breach_time = breach.time
        raise SafetyStopError(str(breach))
    if recorder.failure is not None:
        raise recorder.failure
    for message in course.clocks.due():
        recorder.event(course.source_time(), "info", "clocks", message)
    explain = driver.silence if isinstance(driver, Attributing) else None
    if (breach := supervisor.check_ages(now, explain)) is not None:
        if now - before > 2.0 * READ_TIMEOUT and not looked_twice:
            # This process may have been stalled itself: what came meanwhile is in the next read, if anything came.
            _cycle(driver, recorder, supervisor, course, looked_twice=True)
            return
        if course.moves:
            raise SafetyStopError(str(breach))
        # Not in motion: the recording goes on until the driver gives the connection up.
        if breach.joint not in course.silent:
            recorder.event(course.source_time(), "warning", "session", str(breach))
            course.silent.add(breach.joint)
        supervisor.restart_ages(now)


def _note(notices: Sequence[Notice], recorder: Recorder) -> Notice | None:
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
def _signals_noted(course: _Course) -> Iterator[None]:
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
