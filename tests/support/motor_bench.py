"""A small arm of simulated CAN motors on a virtual bus, and recordings of it, in one process."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from recorded_session import opened, record_session
from simulated_clock import SimulatedClock
from unchecked import unchecked_play

from daq.motion.trajectories import Motion, slow_move
from daq.robot.loader import RobotFile, parse_robot
from daq.session.connections import driver_settings
from daq.session.session import SessionReport
from drivers.can_motors.driver import CanMotorDriver
from drivers.can_motors.settings import parse_settings
from sim_drivers.can_motors.server import CanMotorServer
from sim_drivers.plant import servo

ROBOT = """
name: two_motors
model:
  mdh:
    - {joint: swing, alpha: pi/2, d: 0, r: 0}
    - {joint: bend, antecedent: swing, alpha: 0, d: 0.25, r: 0}
joints:
  - {name: swing, position: [-2, 2], velocity: 6, acceleration: 20, torque: 10, temperature: 90}
  - {name: bend, position: [-2, 2], velocity: 6, acceleration: 20, torque: 10, temperature: 90}
drives:
  - {joint: swing, signal: torque}
  - {joint: bend, signal: torque}
connections:
  damiao: &bus
    driver: damiao
    interface: virtual
    channel: none
    rate: 100
    model: dm4310
    kp: 60
    kd: 2
    motors: {swing: {id: 1}, bend: {id: 7, direction: -1, zero: 0.3}}
  robstride: {<<: *bus, driver: robstride, model: rs-01}
  cubemars: {<<: *bus, driver: cubemars, model: ak80-9}
  moteus: {<<: *bus, driver: moteus, model: moteus}
  odrive:
    <<: *bus
    driver: odrive
    model: odrive
    motors: {swing: {id: 1, ratio: 8}, bend: {id: 7, ratio: 8, direction: -1}}
truth:
  links:
    swing: {mass: 0.8, com: [0.12, 0, 0], inertia: [1.0e-3, 0, 0, 5.0e-3, 0, 5.0e-3]}
    bend: {mass: 0.5, com: [0.1, 0, 0], inertia: [5.0e-4, 0, 0, 2.0e-3, 0, 2.0e-3]}
  joints:
    swing: {viscous: 0.1, coulomb: 0.15, motor_inertia: 0.02, servo: &s {stiffness: 60, gain_d: 2, torque_limit: 10}}
    bend: {viscous: 0.1, coulomb: 0.15, motor_inertia: 0.02, servo: *s}
  noise: {rate: 100}
"""
JOINTS = ("swing", "bend")
WIRES = ("damiao", "robstride", "cubemars", "moteus", "odrive")
START = np.array([-np.pi / 2, 0.0])
"""[rad] where the arm hangs, limp."""
STEP = 0.005
"""Simulation step of the arm [s], half of a period; two and a half times the usual one, for two thirds of the time."""
CHANNELS = itertools.count()


@cache
def robot_file() -> RobotFile:
    """The arm."""
    return parse_robot(ROBOT, where="two_motors", folder=None)


def keys_of(wire: str, **more: object) -> dict[str, Any]:
    """Keys of the arm's connection, on a bus of its own."""
    return dict(robot_file().robot.connections[wire].model_extra or {}) | {"channel": f"motors-{next(CHANNELS)}"} | more


@dataclass
class MotorBench:
    """A served arm and the keys that reach it."""

    server: CanMotorServer  # the motors
    wire: str  # name of the connection
    keys: dict[str, Any]  # of the connection
    clock: SimulatedClock  # of both

    def driver(self, **more: object) -> CanMotorDriver:
        """Not open yet."""
        settings = driver_settings(robot_file().robot, {**self.keys, **more})
        return CanMotorDriver(replace(settings, clock=self.clock), self.wire)

    def opened(self, **more: object) -> AbstractContextManager[CanMotorDriver]:
        """The driver, open."""
        return opened(self.driver(**more))

    def session(self, path: Path, to: np.ndarray | None = None, duration: float | None = None) -> SessionReport:
        """Record as `dynid record` does: a slow way to a position, or only `duration` [s]."""
        return self.play(path, None if to is None else slow_move(START, to, robot_file().robot.joints, 0.3), duration)

    def play(self, path: Path, motion: Motion | None, duration: float | None = None) -> SessionReport:
        """Record a motion, or only `duration` [s]."""
        play = None if motion is None else unchecked_play(motion, robot_file().robot)
        with self.opened(read_only=play is None) as driver:
            told = "played" if play else ""
            return record_session(path, robot_file(), driver, play, duration, trajectory=told, clock=self.clock)


@contextmanager
def motors(clock: SimulatedClock, wire: str = "damiao", **more: object) -> Iterator[MotorBench]:
    """The arm, served; `more` are keys of its connection."""
    file, keys = robot_file(), keys_of(wire, **more)
    with patch.object(servo, "STEP", STEP):
        server = CanMotorServer(file, parse_settings(keys, file.robot.joint_names, wire), START, clock)
    with server:
        yield MotorBench(server, wire, keys, clock)
    assert server.failure is None
