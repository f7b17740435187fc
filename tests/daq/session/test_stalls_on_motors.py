"""Motors that hold their last goal: a stall, and going on after it, take no more torque than the motion."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import motor_bench
import numpy as np
import pytest
import servo_bench
from recorded_session import record_session
from simulated_clock import SimulatedClock, simulated_time
from unchecked import unchecked_play

from daq.motion.trajectories import PointToPoint
from drivers.core.arrays import FloatArray

WAY = np.array([1.0, 0.8])
SHARE = 0.6
"""Share of the acceleration limit that the motion uses."""


def largest_torques(path: Path, bench: ModuleType, arm: Callable[[SimulatedClock], Any], stalls: int) -> FloatArray:
    """The largest torque of each motor (n,) [N·m] in a motion there and back with stalls of 0.03 s in the middle."""
    robot = bench.robot_file()
    duration = float(np.sqrt(10.0 / np.sqrt(3.0) * WAY[0] / (SHARE * robot.robot.joints[0].acceleration)))
    motion = PointToPoint(np.array([bench.START, bench.START + WAY, bench.START]), np.array([duration, duration]))
    torques = []
    with simulated_time() as clock, arm(clock) as served:
        plant, names = served.server.plant.arm, [thread.name for thread in served.server._threads]
        advance = plant.advance

        def noted(goals: FloatArray) -> None:
            advance(goals)
            torques.append(np.abs(plant.torque))

        plant.advance = noted

        def stall() -> None:
            for _ in range(stalls):
                while abs(plant.velocity[0]) < 0.9 * 1.875 * WAY[0] / duration:
                    clock.sleep(0.002)
                clock.suspend(0.03, but=names)
                clock.sleep(0.3)

        clock.thread(stall, "stalls").start()
        with served.opened() as driver:
            play = unchecked_play(motion, robot.robot)
            report = record_session(path, robot, driver, play, trajectory="played", clock=clock)
    assert report.stopped_by is None
    assert report.punctuality is not None
    assert (report.punctuality.delayed_ms > 0.0) == (stalls > 0)
    return np.asarray(np.max(torques, axis=0))


@pytest.mark.parametrize(
    ("bench", "arm"), [(motor_bench, motor_bench.motors), (servo_bench, servo_bench.servos)], ids=["can", "serial"]
)
def test_a_stall_takes_no_more_torque_than_the_motion(
    tmp_path: Path, bench: ModuleType, arm: Callable[[SimulatedClock], Any]
) -> None:
    alone = largest_torques(tmp_path / "alone.h5", bench, arm, stalls=0)
    assert np.all(largest_torques(tmp_path / "stalled.h5", bench, arm, stalls=1) <= 1.05 * alone)
