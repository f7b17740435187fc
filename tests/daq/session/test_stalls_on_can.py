"""Stalls of the computer in a brisk motion on CAN: commands keep the limits, and the motion ends with the reason.

Each target over the time since the one before, on the grid of the periods in which commands were sent, or of SYNCs with
what drives put in the place of those left out.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from canopen_recording import RADIANS, arm_on_bus
from simulated_clock import DAY, SimulatedClock
from table_arm_bench import POSE, connection_of, opened, served, session
from table_arm_bench import ROBOT as TABLE_ROBOT
from unchecked import unchecked_play

from daq.motion.trajectories import PointToPoint
from daq.robot.schema import Robot
from daq.session.session import SessionReport
from drivers.core.arrays import FloatArray

SHARE = 0.9
"""Share of the acceleration limit that the motion uses."""
PERIOD = 0.005
BRIDGED = 0.012
"""A stall [s] that is bridged at 200 Hz."""


def brisk(robot: Robot, start: FloatArray) -> PointToPoint:
    """The first and the last joint there and back, at most of their acceleration."""
    away = np.zeros(robot.dof)
    away[[0, -1]] = 0.3
    limit = min(robot.joints[index].acceleration for index in (0, -1))
    duration = float(np.sqrt(10.0 / np.sqrt(3.0) * 0.3 / (SHARE * limit)))
    return PointToPoint(np.array([start, start + away, start]), np.array([duration, duration]))


def when_fast(clock: SimulatedClock, speed: Callable[[], float], fast: float, action: Callable[[], None]) -> None:
    """Do something as soon as the arm is fast, in a thread of its own."""

    def watch() -> None:
        while abs(speed()) < fast:
            clock.sleep(0.002)
        action()

    clock.thread(watch, "watch").start()


def gone_on(slots: Sequence[int], targets: FloatArray) -> tuple[list[int], FloatArray]:
    """Slots and targets with those in the place of what was left out: drives go on with their velocity."""
    whole, rows = list(slots[:2]), list(targets[:2])
    for slot, row in zip(slots[2:], targets[2:], strict=True):
        while whole[-1] + 1 < slot:
            rows.append(2.0 * rows[-1] - rows[-2])
            whole.append(whole[-1] + 1)
        rows.append(row)
        whole.append(slot)
    return whole, np.array(rows)


def utilisation(slots: Sequence[int], targets: FloatArray, robot: Robot) -> float:
    """The largest share of the velocity and acceleration limits that targets (N, n) in slots (N,) of 5 ms use."""
    step, dt = np.diff(targets, axis=0), np.diff(slots) * PERIOD
    velocity = step / dt[:, None]
    acceleration = np.diff(velocity, axis=0) / (0.5 * (dt[1:] + dt[:-1]))[:, None]
    limits = np.array([[joint.velocity, joint.acceleration] for joint in robot.joints]).T
    return float(max(np.max(np.abs(velocity) / limits[0]), np.max(np.abs(acceleration) / limits[1])))


def assert_ended(report: SessionReport, stall: float, used: float, most: float = 1.0) -> None:
    """The commands keep the limits, and a stall that is not bridged is the reason why the motion ended."""
    assert SHARE - 0.15 < used < most
    if stall <= BRIDGED:
        assert report.stopped_by is None
        return
    assert report.error is not None
    reasons = ("this computer stalled for", "stale data", "fault of", "heartbeat or life guarding missed")
    assert any(reason in str(report.stopped_by) for reason in reasons), report.stopped_by


@pytest.mark.parametrize("stall", [BRIDGED, 0.07])
def test_cia402_drives_at_200_hz(tmp_path: Path, stall: float) -> None:
    with arm_on_bus("{sync_rate: 200}") as bench:
        robot, clock = bench.robot_file.robot, bench.clock
        suspend = lambda: clock.suspend(stall, but=("canopen-nodes", "watch"))  # noqa: E731
        if stall:
            when_fast(clock, lambda: float(bench.plant.velocity[0]), 0.6, suspend)
        run = bench.record(tmp_path, motion=brisk(robot, bench.plant.position.copy()))
        applied: dict[int, int] = {}
        slots, rows = [], []
        for frame in bench.frames():
            if 0x200 < frame.arbitration_id < 0x280:
                word, _, applied[frame.arbitration_id] = struct.unpack("<Hbi", bytes(frame.data))
                if word != 0x0F:
                    applied.pop(frame.arbitration_id)
            elif frame.arbitration_id == 0x80 and len(applied) == robot.dof:
                slots.append(round((frame.timestamp - DAY - bench.begun) / PERIOD))
                rows.append([applied[key] for key in sorted(applied)])
        # What they went on without must be made up for: at one stroke that took 8.5 times the limit.
        assert_ended(run.report, stall, utilisation(*gone_on(slots, np.array(rows) * RADIANS), robot), most=1.3)
        assert not any(drive.enabled for drive in bench.server.network.drives)
        stopped = bench.plant.position.copy()
        clock.sleep(0.3)
        assert np.max(np.abs(bench.plant.position - stopped)) < 0.02


@pytest.mark.parametrize("stall", [BRIDGED, 2.0])
def test_an_arm_with_a_signal_table(tmp_path: Path, clock: SimulatedClock, stall: float) -> None:
    with served(clock) as server:
        with opened(connection_of(server), clock) as driver:
            arm = server._arm.arm
            if stall:
                suspend = lambda: clock.suspend(stall, but=("table-arm", "watch"))  # noqa: E731
                when_fast(clock, lambda: float(arm.velocity[0]), 0.6, suspend)  # type: ignore[attr-defined]
            play = unchecked_play(brisk(TABLE_ROBOT, POSE), TABLE_ROBOT)
            slots: list[int] = []
            rows: list[FloatArray] = []
            send, begun = driver.command, 0.0

            def noted(position: FloatArray) -> None:
                nonlocal begun
                begun = begun or clock.now()
                send(position)
                slots.append(math.floor((clock.now() - begun) / PERIOD + 1e-6))
                rows.append(position.copy())

            driver.command = noted  # type: ignore[method-assign]
            report = session(tmp_path / "run.h5", driver, clock, play)
        assert_ended(report, stall, utilisation(slots, np.array(rows), TABLE_ROBOT))
