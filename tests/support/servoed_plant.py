"""A simulated arm recorded in simulated time: its plant behind servoj, without the wire in between."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from recorded_session import record_session
from simulated_clock import simulated_time
from unchecked import unchecked_play

from daq.motion.trajectory_file import load_trajectory
from daq.robot.loader import load_robot
from drivers.base import Notice
from drivers.core.clock import Clock
from drivers.streams import Batch, ChannelLayout, StreamLayout
from sim_drivers.plant.control import Reference
from sim_drivers.plant.plant import Plant
from sim_drivers.plant.sensors import Measurement
from sim_drivers.rtde.joint_motion import ServoJ
from sim_drivers.simulated_arm import Record, Recorded

RATE = 500.0
TOGETHER = 5
"""Samples that a read waits for: a session's cycle costs more than the plant's."""
LOOKAHEAD = 0.03
"""Look-ahead time of servoj [s]."""
QUANTITIES = ("position", "velocity", "current", "temperature")


class ServoedPlant:
    """Implements drivers.base.Driver; a sample each period, none late, and some come together."""

    def __init__(self, plant: Plant, clock: Clock) -> None:
        self._plant, self._clock = plant, clock
        self._servo = ServoJ(Reference.at_rest(plant.measure().target_position))
        self._begun = 0.0
        self._count = 0
        self._samples: list[Measurement] = []

    def open(self) -> None: ...

    def streams(self) -> tuple[StreamLayout, ...]:
        joints = self._plant.robot.joint_names
        return (StreamLayout("joints", tuple(ChannelLayout(quantity, joints) for quantity in QUANTITIES), RATE),)

    def start(self) -> None:
        self._begun, self._count = self._clock.now(), 0
        self._samples.clear()

    def read(self, timeout: float) -> tuple[Batch, ...]:
        wanted = self._count - len(self._samples) + TOGETHER
        self._clock.sleep(min(self._begun + wanted / RATE - self._clock.now(), timeout))
        self._advance()
        samples, self._samples = self._samples, []
        if not samples:
            return ()
        host_time = self._begun + np.arange(self._count - len(samples) + 1, self._count + 1) / RATE
        values = {quantity: np.array([getattr(one, quantity) for one in samples]) for quantity in QUANTITIES}
        return (Batch("joints", np.array([one.time for one in samples]), host_time, values),)

    def _advance(self) -> None:
        """Up to now, in periods."""
        due = int((self._clock.now() - self._begun) * RATE + 1e-6)
        for _ in range(self._count, due):
            reference = self._servo.step(1.0 / RATE)
            self._plant.set_target(reference.position, reference.velocity, reference.acceleration)
            self._plant.advance(1.0 / RATE)
            self._samples.append(self._plant.measure())
        self._count = max(self._count, due)

    def notices(self) -> tuple[Notice, ...]:
        return ()

    def command_rate(self) -> float:
        return RATE

    def take_control(self) -> None: ...

    def command(self, position: np.ndarray) -> None:
        self._advance()
        self._servo.retarget(position, LOOKAHEAD)

    def stop(self) -> None: ...

    def close(self) -> None: ...


@contextmanager
def in_simulated_time(robot: str, seed: int, position: np.ndarray) -> Iterator[Record]:
    """In place of `sim_drivers.simulated_arm.over_rtde`."""
    robot_file = load_robot(robot)
    plant = Plant(robot_file, seed=seed, position=position)

    def recorded(trajectory: Path, out: Path) -> Recorded:
        played = load_trajectory(trajectory, robot_file.robot)
        with simulated_time() as clock:
            driver, play = ServoedPlant(plant, clock), unchecked_play(played.motion, robot_file.robot)
            report = record_session(out, robot_file, driver, play, trajectory=played.text, clock=clock)
        assert report.stopped_by is None, report.stopped_by
        return Recorded(report.samples["joints"], report.lost["joints"])

    yield recorded
