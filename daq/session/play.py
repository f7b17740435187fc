"""Playing a motion: from an arm that rests, through taking control of it, until it has arrived."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np

from daq.motion.limits import check_limits
from daq.motion.player import MotionSequence, Player
from daq.motion.trajectories import Motion
from daq.recording.recording import JOINTS_STREAM
from daq.robot.schema import Robot
from daq.session.command_gate import COMMAND_RATE, CommandGate, GateLimits
from daq.session.course import GAP, REST_TIME, Course
from daq.session.sources import Sources
from daq.session.supervisor import Supervisor
from daq.session.unrecorded import SampleKeeper
from drivers.base import Buffering, Driver, Holding, ReportingSafety
from drivers.clock_rates import COMPARING_LIMIT
from drivers.core.arrays import FloatArray
from drivers.core.errors import ConnectionLostError, DynidError, MotionRefusedError, UsageError, WorkError
from drivers.standstill import StandstillWatch

MOVED_MEANWHILE = 0.02
"""A joint that moved this far [rad or m] while the answer was awaited is somewhere else than the person saw."""
FIRST_SAMPLE_LIMIT = 5.0
"""Time limit [s] for the first samples."""
REST_LIMIT = 2.0
"""How long [s] is waited for that."""
ARRIVAL_LIMIT = 3.0
"""How long [s] an arm may take to come to rest after the last command of a motion."""
ARRIVAL_ERROR = 0.02
"""Distance [rad or m] from the end of the motion at which an arm at rest is said not to have reached it."""


class Permission(Protocol):
    """Permission that a session requests before it moves an arm; it must not block."""

    def approach(self, position: FloatArray) -> Motion:
        """The checked approach from a position (n,) [rad or m] to the start of the motion.

        Raises:
            MotionRefusedError: there is none.
        """

    def ask(self) -> None:
        """Ask whether the arm may make the approach and then play the motion."""

    def answer(self) -> bool | None:
        """The answer; None until there is one."""


@dataclass(frozen=True)
class Play:
    """A motion that a session is to play."""

    motion: Motion  # from rest to rest
    robot: Robot  # whose limits every command keeps
    permission: Permission  # to move, with the approach to the motion's start
    # whether the arm is moved where its controller does not report its safety status
    without_safety_status: bool = False


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


def unreported_safety(driver: Driver, without_safety_status: bool) -> str:
    """What of its safety status the controller of a driver that is open does not report, in words; empty for nothing.

    Raises:
        MotionRefusedError: something, and the arm is not to be moved without.
    """
    names = driver.unreported() if isinstance(driver, ReportingSafety) else ()
    if names and not without_safety_status:
        raise MotionRefusedError(
            f"the controller does not deliver {', '.join(names)}: its stops, and other programs, would not be noticed",
            hint="--without-safety-status moves it nevertheless; recording works as it is",
        )
    return (
        f"the controller does not deliver {', '.join(names)}: its protective and emergency stops, and other programs, "
        "are noticed only by what the arm does"
        if names
        else ""
    )


def wait_for_position(cycle: Callable[[], None], course: Course) -> None:
    """Until the arm has said where it is.

    Raises:
        ConnectionLostError: it does not.
    """
    limit = course.clock.now() + FIRST_SAMPLE_LIMIT
    while course.position is None and course.interrupted is None:
        cycle()
        if course.clock.now() > limit:
            raise ConnectionLostError(f"no joint position within {FIRST_SAMPLE_LIMIT:g} s")


def wait_for_rest(cycle: Callable[[], None], course: Course) -> None:
    """Until the arm, and what its controller aims at, have been at rest for a while.

    Raises:
        MotionRefusedError: they are not, in time.
    """
    limit = course.clock.now() + REST_LIMIT
    while not course.rest.at_rest and course.interrupted is None:
        cycle()
        if course.clock.now() > limit:
            raise MotionRefusedError(
                f"the arm or its controller's target was not at rest for {REST_TIME:g} s",
                hint="something else moves it: stop that first",
            )


def permitted_approach(driver: Driver, cycle: Callable[[], None], course: Course, play: Play) -> Motion | None:
    """The approach to the start pose, once the arm may move and obeys; None where the session was interrupted before.

    Raises:
        UsageError: the motion passes a limit.
        MotionRefusedError: the arm does not rest, moved meanwhile, or the motion was not confirmed.
        DynidError: the driver's own.
    """
    check_limits(play.motion, play.robot.joints, "the trajectory")
    wait_for_rest(cycle, course)
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
    wait_for_rest(cycle, course)
    limit = course.clock.now() + COMPARING_LIMIT
    while not course.rates.compared and course.interrupted is None and course.clock.now() < limit:
        cycle()
    if course.untrusted:
        raise MotionRefusedError(course.untrusted)
    _require_unmoved(course, shown, "before the motion was confirmed")
    while_reading(driver.take_control, cycle, course)
    wait_for_rest(cycle, course)
    if course.interrupted is not None:
        return None
    here = _require_unmoved(course, shown, "while control of it was taken")
    return play.permission.approach(here)


def _require_unmoved(course: Course, shown: FloatArray, when: str) -> FloatArray:
    """Read where the arm is, which must be about where it was shown to be."""
    here = shown if course.position is None else course.position
    if np.max(np.abs(here - shown)) > MOVED_MEANWHILE:
        raise MotionRefusedError(f"the arm moved {when}", hint="start again when it is at rest")
    return here


def while_reading(action: Callable[[], None], cycle: Callable[[], None], course: Course) -> None:
    """Let an action of a driver, which may last seconds, run while samples are read; then wait for a newer position.

    Raises:
        DynidError: the action's.
    """
    failures: list[DynidError] = []

    def act() -> None:
        try:
            action()
        except DynidError as error:
            failures.append(error)

    thread = course.clock.thread(act, "taking control")
    thread.start()
    while thread.is_alive() and course.interrupted is None:
        cycle()
    if failures:
        raise failures[0]
    taken = course.clock.now()
    while course.heard <= taken and course.interrupted is None:
        cycle()  # ends by stale data where nothing comes


def prepare(
    driver: Driver, supervisor: Supervisor, recorder: SampleKeeper, play: Play, course: Course, path: MotionSequence
) -> Player:
    """The player of a motion and the approach to it."""
    approach = float(path.starts[1])
    recorder.event(course.source_time(), "info", "player", f"approach to the start pose, {approach:.2f} s")
    return gated_player(driver, supervisor, course, path, play.robot)


def gated_player(driver: Driver, supervisor: Supervisor, course: Course, path: MotionSequence, robot: Robot) -> Player:
    """The player of a path, with the command gate between it and the driver."""
    limits = GateLimits.of_joints(robot.joints)
    main = driver.main if isinstance(driver, Sources) else driver
    held = main.holds() if isinstance(main, Holding) else True
    send: Callable[[FloatArray, float], None] = lambda position, _due: driver.command(position)  # noqa: E731
    buffered = 0.0
    if isinstance(main, Buffering):
        send, buffered = main.command, main.buffered()
    noted = partial(supervisor.commanded, lag=buffered)
    course.gate = CommandGate(send, noted, limits, 1.0 / path.rate, course.clock)
    if course.position is not None:
        course.gate.measured(course.clock.now(), course.position)
    return Player(course.gate.command, path, limits.acceleration, course.clock, held=held, buffered=buffered)


def follow_motion(
    cycle: Callable[[], None],
    recorder: SampleKeeper,
    course: Course,
    player: Player,
    path: MotionSequence,
    robot: Robot,
) -> None:
    """Until the arm has arrived at the end of the motion.

    Raises:
        WorkError: it does not come to rest.
        DynidError: what ended the player.
    """
    begun, delayed = False, 0.0
    while not player.done and course.interrupted is None:
        cycle()
        raise_failure(cycle, player)
        if not begun and player.elapsed > path.starts[1] + 1e-9:
            begun = True
            recorder.event(course.source_time(), "info", "player", "motion begins")
        if player.delayed > delayed:
            said = (
                f"this computer stalled: the arm was held, and continues from rest {player.delayed - delayed:.3f} s "
                "later"
            )
            recorder.event(course.source_time(), "warning", "player", said)
            delayed, course.resumed = player.delayed, course.clock.now()
        if course.view is not None:
            state = "motion" if begun else "approach to the start pose"
            course.view.show(state, player.elapsed, player.duration)
    if course.interrupted is None:
        recorder.event(course.source_time(), "info", "player", "motion ends")
    wait_for_arrival(cycle, recorder, course, player, path, robot)


def wait_for_arrival(
    cycle: Callable[[], None],
    recorder: SampleKeeper,
    course: Course,
    player: Player,
    path: MotionSequence,
    robot: Robot,
) -> None:
    """Until the arm rests at the end of a path; how far from it is noted where it is far.

    Raises:
        WorkError: it does not come to rest.
        DynidError: what ended the player.
    """
    course.rest, limit = StandstillWatch(GAP), course.clock.now() + ARRIVAL_LIMIT
    while not course.rest.at_rest and course.interrupted is None:
        cycle()
        raise_failure(cycle, player)
        if course.clock.now() > limit:
            raise WorkError(f"the arm did not come to rest within {ARRIVAL_LIMIT:g} s of the motion's last command")
    if course.interrupted is None and course.position is not None:
        short = np.abs(course.position - path.positions(np.array([path.duration]))[0])
        if np.max(short) > ARRIVAL_ERROR:
            joint = robot.joints[int(np.argmax(short))]
            said = f"{joint.name} came to rest {np.max(short):.3f} {joint.unit('rad')} from the end of the motion"
            recorder.event(course.source_time(), "warning", "player", said)


def raise_failure(cycle: Callable[[], None], player: Player) -> None:
    """End the session where the player has ended; by what the driver says of the cause, if it does."""
    if player.failure is not None:
        cycle()
        raise player.failure
