"""Leading an arm by hand: limp, or with its weight carried by an identified model, for as long as a key is held.

Every torque passes the hand gate at the moment when it is sent. The key released, its terminal lost, or any stop of the
supervisor ends it: the arm holds or goes limp, as its driver's connection says, and nothing starts it again.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Protocol, cast

import numpy as np

from daq.motion.motion_check import only_entry
from daq.recording.recording import HAND_GUIDED
from daq.robot.loader import RobotFile
from daq.robot.schema import Robot
from daq.session.command_gate import FRESH
from daq.session.course import Course
from daq.session.play import wait_for_position, wait_for_rest, while_reading
from daq.session.sources import Sources
from daq.session.supervisor import CURES
from daq.session.unrecorded import SampleKeeper
from drivers.base import Driver, Guidable
from drivers.core.arrays import FloatArray
from drivers.core.errors import MotionRefusedError, SafetyStopError, UsageError
from drivers.core.units import joint_unit

HAND_SPEED = 1.5
"""[rad/s or m/s] at most: faster than one leads an arm, slower than it falls from a height that matters."""
SPEED_WINDOW = 0.03
"""[s] over which positions give the speed, so that their steps do not."""
KEY_PATIENCE = 60.0
"""[s] that the key is waited for."""
LEANING_SHARE = 0.05
"""Share of a joint's torque limit by which the model may be off, beyond what its friction explains."""
COMPENSATION_GROUP = "dynid.compensation"
"""Entry-point group of exactly one `MakeCompensation`."""


class Hand(Protocol):
    """The person who leads the arm; no method may block."""

    def mind(self, cautions: Sequence[str]) -> None:
        """Take what the person is to mind, one line each."""

    def ask(self) -> None:
        """Ask whether the arm may be let go."""

    def answer(self) -> bool | None:
        """The answer; None until there is one."""

    def held(self) -> bool:
        """Whether the key is held now; False for ever once it was released after that, or its terminal is gone."""


class Compensation(Protocol):
    """Carries the arm's weight."""

    leaning: FloatArray  # (n,) torque that its friction may hide from an arm at rest [N·m or N]

    def torque(self, position: FloatArray, velocity: FloatArray) -> FloatArray:
        """Joint torques (n,) [N·m or N] at a position (n,) [rad or m] and velocity (n,) [rad/s or m/s]."""


class MakeCompensation(Protocol):
    """Makes the compensation of an arm; entered in `COMPENSATION_GROUP`."""

    def __call__(self, robot_file: RobotFile, path: Path) -> Compensation:
        """Build the compensation from the model of a result.json or its folder.

        Raises:
            DynidError: it cannot be used.
        """


def load_compensation(robot_file: RobotFile, path: Path) -> Compensation:
    """The compensation that is installed, for an arm and a model.

    Raises:
        MotionRefusedError: none is installed, or several are.
        DynidError: the model cannot be used.
    """
    make = only_entry(COMPENSATION_GROUP, "an arm is carried only where exactly one compensation is installed")
    return cast("MakeCompensation", make)(robot_file, path)


@dataclass(frozen=True)
class Guiding:
    """How an arm is to be led by hand."""

    robot: Robot  # whose limits hold
    hand: Hand  # of the person
    compensation: Compensation | None = None  # of its weight; None where the arm is to be limp


def require_guidable(driver: Driver, guiding: Guiding) -> Guidable:
    """The driver of an arm that can be led by hand.

    Raises:
        UsageError: it cannot, or a joint has no torque limit to keep.
    """
    main = driver.main if isinstance(driver, Sources) else driver
    pushed = guiding.compensation is not None
    if not isinstance(main, Guidable):
        raise UsageError(
            "arms on this connection cannot be led by hand with dynid",
            hint="use the controller's own free drive, and record with --duration",
        )
    if said := main.guiding_refusal(pushed=pushed):
        raise UsageError(said, hint="without --model the arm is limp, and you carry it" if pushed else "")
    unlimited = [joint.name for joint in guiding.robot.joints if joint.torque is None]
    if pushed and unlimited:
        raise UsageError(f"no torque limit of {', '.join(unlimited)}", hint="give it in the robot file")
    return main


class HandGate:
    """Passes a torque on to the driver, or refuses it; after a refusal nothing is passed any more.

    `send` takes torques (n,), as a driver's `push`. The robot's limits of position and torque are kept, and
    `HAND_SPEED`.
    """

    def __init__(self, send: Callable[[FloatArray], None], robot: Robot, now: Callable[[], float]) -> None:
        self._send, self._now, self._joints = send, now, robot.joints
        self._low, self._high = np.array([joint.position for joint in robot.joints]).T
        self._most = np.array([np.inf if joint.torque is None else joint.torque for joint in robot.joints])
        self._fastest = np.minimum([joint.velocity for joint in robot.joints], HAND_SPEED)
        self._seen: deque[tuple[float, FloatArray]] = deque()
        self._closed: SafetyStopError | None = None
        self.velocity = np.zeros(len(robot.joints))
        """(n,) over the last `SPEED_WINDOW` [rad/s or m/s]."""

    def measured(self, when: float, position: FloatArray) -> None:
        """Take the newest position (n,) [rad or m] and when it was measured [s, host's clock]."""
        if self._seen and when <= self._seen[-1][0]:
            return
        self._seen.append((when, position))
        while len(self._seen) > 2 and when - self._seen[1][0] >= SPEED_WINDOW:
            self._seen.popleft()
        begin, first = self._seen[0]
        if when - begin >= SPEED_WINDOW:
            self.velocity = (position - first) / (when - begin)

    def check(self) -> None:
        """Check that the arm may go on.

        Raises:
            SafetyStopError: it is too fast, beyond its range, or not heard of.
        """
        if self._closed is not None:
            raise SafetyStopError(self._closed.message, hint=self._closed.hint)
        when, position = self._seen[-1] if self._seen else (-np.inf, self._low)
        if self._now() - when > FRESH:
            self._refuse(f"the measured position is {self._now() - when:.3f} s old", CURES["stale data"])
        beyond = ~((position >= self._low) & (position <= self._high))
        if beyond.any():
            self._refuse(f"{self._name(beyond)} left its range", "keep the arm away from its limits while you lead it")
        if (fast := ~(np.abs(self.velocity) <= self._fastest)).any():
            joint = int(np.argmax(fast))
            unit = joint_unit("rad/s", sliding=self._joints[joint].sliding)
            self._refuse(
                f"{self._name(fast)} moves at {abs(self.velocity[joint]):.3g} {unit}, more than "
                f"{self._fastest[joint]:.3g} {unit} by hand",
                "lead it more slowly; if it moved by itself, the model does not compensate its weight",
            )

    def push(self, torque: FloatArray) -> None:
        """Send torques (n,) [N·m or N].

        Raises:
            SafetyStopError: they do not pass, or the arm may not go on.
            DynidError: the driver's own.
        """
        self.check()
        if (over := ~(np.abs(torque) <= self._most)).any():
            joint = int(np.argmax(over))
            self._refuse(
                f"the model asks for {torque[joint]:.3g} of {self._name(over)}, more than {self._most[joint]:.3g}",
                "is it the model of this arm?",
            )
        self._send(torque)

    def _name(self, which: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> str:
        return self._joints[int(np.argmax(which))].name

    def _refuse(self, said: str, cure: str) -> None:
        self._closed = SafetyStopError(said, hint=cure)
        raise self._closed


def lead_by_hand(
    driver: Driver,
    cycle: Callable[[], None],
    course: Course,
    recorder: SampleKeeper,
    guiding: Guiding,
    duration: float | None,
) -> None:
    """Until the key is released, or `duration` [s] has passed; then the session stops the arm.

    Raises:
        MotionRefusedError: not confirmed, no key, or the model does not carry this arm.
        DynidError: the driver's own, and what the supervisor or the gate stopped it for.
    """
    arm = require_guidable(driver, guiding)
    wait_for_position(cycle, course)
    _wait_for_key(cycle, course, guiding.hand)
    carrying = guiding.compensation
    if carrying is not None:
        while_reading(driver.take_control, cycle, course)
        wait_for_rest(cycle, course)
        _require_carried(course, carrying, guiding.robot)
    if course.interrupted is not None:
        return
    gate = HandGate(arm.push, guiding.robot, course.clock.now)
    first = None
    if carrying is not None and course.position is not None:
        first = carrying.torque(course.position, np.zeros_like(course.position))
    while_reading(partial(arm.release, first), cycle, course)
    course.moves = True
    recorder.event(course.source_time(), "info", "session", f"{HAND_GUIDED}: {'carried' if carrying else 'limp'}")
    begun = course.clock.now()
    while course.interrupted is None:
        if course.position is not None:
            gate.measured(course.heard, course.position)
        if carrying is not None and course.position is not None:
            gate.push(carrying.torque(course.position, gate.velocity))
        else:
            gate.check()
        if not guiding.hand.held():
            recorder.event(course.source_time(), "info", "session", "the key was released")
            return
        led = course.clock.now() - begun
        if duration is not None and led >= duration:
            return
        if course.view is not None:
            course.view.show("led by hand", led, duration or 0.0)
        cycle()


def _wait_for_key(cycle: Callable[[], None], course: Course, hand: Hand) -> None:
    """Until the person has said yes and holds the key, or the session is interrupted."""
    hand.ask()
    while (answer := hand.answer()) is None and course.interrupted is None:
        cycle()
    if answer is False:
        raise MotionRefusedError("not confirmed, so the arm was not released")
    limit = course.clock.now() + KEY_PATIENCE
    while not hand.held() and course.interrupted is None:
        cycle()
        if course.clock.now() > limit:
            raise MotionRefusedError(f"the key was not held within {KEY_PATIENCE:g} s, so the arm was not released")


def _require_carried(course: Course, carrying: Compensation, robot: Robot) -> None:
    """Compare what the drives give, of an arm that they hold, with what the model would."""
    if course.torque is None or course.position is None:
        raise MotionRefusedError(
            "this connection delivers no torques, so the model cannot be compared with what holds the arm"
        )
    asked = carrying.torque(course.position, np.zeros_like(course.position))
    bound = carrying.leaning + LEANING_SHARE * np.array([joint.torque or 0.0 for joint in robot.joints])
    off = np.abs(course.torque - asked)
    if not np.all(off <= bound):
        joint = int(np.argmax(off / bound))
        raise MotionRefusedError(
            f"{robot.joint_names[joint]} is held by {course.torque[joint]:.3g} {robot.joints[joint].unit('N·m')}, and "
            f"the model asks for {asked[joint]:.3g}",
            hint="check that the model is of this arm with this tool, and that nothing else supports it",
        )
