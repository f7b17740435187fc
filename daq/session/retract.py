"""Retracting after a contact: the stopped arm goes a short way back along its motion, and holds.

It is no safety function: the arm presses on what it touched until it is at rest and controlled anew. It goes back once;
another contact, or any stop of the supervisor, ends it, and nothing starts the motion again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from daq.motion.limits import check_limits
from daq.motion.player import MotionSequence, Player
from daq.motion.trajectories import PointToPoint, slow_move
from daq.robot.schema import JointLimits, Robot
from daq.session.course import GAP, REST_TIME, Course
from daq.session.play import gated_player, raise_failure, wait_for_arrival, wait_for_rest, while_reading
from daq.session.supervisor import TRACKING_ERROR, Supervisor
from daq.session.unrecorded import SampleKeeper
from drivers.base import Driver
from drivers.core.arrays import FloatArray
from drivers.core.errors import ConnectionLostError, DynidError, MotionRefusedError
from drivers.standstill import StandstillWatch

WAY, SLIDING_WAY = 0.15, 0.05
"""[rad], [m] that the joint that moved most goes back."""
SPEED = 0.25
"""[rad/s or m/s] at most."""
SHARE = 0.2
"""Largest share of velocity and acceleration limits."""
RETRACTING = (
    f"after a contact it retracts by itself, by {WAY:g} rad ({SLIDING_WAY:g} m) at no more than {SPEED:g} rad/s; then "
    "it holds"
)
"""What a person should know of it before the arm moves."""
LOOKING_BACK = 0.005
"""[s] between the positions of the motion that are looked at."""


def way_back(here: FloatArray, path: MotionSequence, elapsed: float, limits: Sequence[JointLimits]) -> PointToPoint:
    """Return the way from the arm's position (n,) [rad or m] back along its path, by a point in between.

    It is at rest, `elapsed` [s] on its path.

    Raises:
        MotionRefusedError: the arm is far from the path.
    """
    times = np.arange(elapsed, -LOOKING_BACK, -LOOKING_BACK).clip(min=0.0)
    passed = path.positions(times)
    far = np.abs(here - passed).max(axis=1)
    if far.min() > TRACKING_ERROR:
        raise MotionRefusedError(f"the arm is {far.min():.3g} rad (m) away from its path")
    way = np.array([SLIDING_WAY if limit.sliding else WAY for limit in limits])
    share = (np.abs(passed - passed[0]) / way).max(axis=1)
    last = int(np.argmax(share >= 1.0)) if np.any(share >= 1.0) else len(times) - 1
    points = np.array([here, passed[(last + 1) // 2], passed[last]])
    slower = [limit.model_copy(update={"velocity": min(limit.velocity, SPEED / SHARE)}) for limit in limits]
    moves = [slow_move(begin, end, slower, SHARE) for begin, end in pairwise(points)]
    return PointToPoint(points, np.array([move.duration for move in moves]))


def retract(
    driver: Driver,
    cycle: Callable[[], None],
    course: Course,
    supervisor: Supervisor,
    recorder: SampleKeeper,
    player: Player,
    path: MotionSequence,
    robot: Robot,
    stop: Callable[[Driver, Player | None], None],
) -> None:
    """Go back, hold, and note how it went; never raises. The driver was stopped, and is stopped at the end."""
    back: Player | None = None
    try:
        course.moves, course.gate, course.retracting = False, None, True
        course.rest = StandstillWatch(GAP, REST_TIME)
        course.heard = float("-inf")
        driver.start()
        supervisor.restart_ages(course.clock.now())
        begun = course.clock.now()
        while course.heard < begun and course.interrupted is None:
            cycle()
        wait_for_rest(cycle, course)
        while_reading(driver.take_control, cycle, course)
        wait_for_rest(cycle, course)
        if course.position is None:
            raise ConnectionLostError("no joint position")
        move = way_back(course.position, path, player.elapsed, robot.joints)
        check_limits(move, robot.joints, "the way back")
        if course.interrupted is not None:
            return
        recorder.event(course.source_time(), "warning", "monitor", f"goes back for {move.duration:.2f} s")
        sequence = MotionSequence([move], path.rate)
        back = gated_player(driver, supervisor, course, sequence, robot)
        supervisor.restart_ages(course.clock.now())
        course.moves = True
        back.start()
        while not back.done and course.interrupted is None:
            cycle()
            raise_failure(cycle, back)
        wait_for_arrival(cycle, recorder, course, back, sequence, robot)
        recorder.event(course.source_time(), "warning", "monitor", "went back, and holds")
    except DynidError as error:
        recorder.event(course.source_time(), "error", "monitor", f"did not go back as planned: {error}")
    except Exception as error:  # whatever it was, the arm is stopped and the file closed
        said = f"did not go back as planned: {type(error).__name__}: {error}"
        recorder.event(course.source_time(), "error", "monitor", said)
    finally:
        stop(driver, back)
