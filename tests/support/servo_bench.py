"""A small arm of simulated serial servos on a simulated line, and recordings of it, in one process."""

from __future__ import annotations

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
from simulated_serial import SerialPort, SimulatedLine, simulated_line
from unchecked import unchecked_play

from daq.motion.trajectories import slow_move
from daq.robot.loader import RobotFile, parse_robot
from daq.session.connections import driver_settings
from daq.session.session import SessionReport
from drivers.serial_servos.driver import SerialServoDriver
from drivers.serial_servos.settings import parse_settings
from sim_drivers.plant import servo
from sim_drivers.serial_servos.server import SerialServoServer

ROBOT = """
name: two_servos
model:
  mdh:
    - {joint: swing, alpha: pi/2, d: 0, r: 0}
    - {joint: bend, antecedent: swing, alpha: 0, d: 0.2, r: 0}
joints:
  - {name: swing, position: [-2, 2], velocity: 4, acceleration: 10, temperature: 70}
  - {name: bend, position: [-2, 2], velocity: 4, acceleration: 10, temperature: 70}
drives:
  - {joint: swing, signal: magnitude, count: 0.0065}
  - {joint: bend, signal: magnitude, count: 0.0065}
connections:
  feetech: {driver: feetech, url: none, model: sts3215, acceleration: 30, motors: {swing: {id: 1}, bend: {id: 7}}}
  dynamixel:
    driver: dynamixel
    url: none
    acceleration: 30
    motors: {swing: {id: 1, model: xl430-w250}, bend: {id: 7, model: xl330-m288, direction: -1}}
truth:
  links:
    swing: {mass: 0.1, com: [0.1, 0, 0], inertia: [1.0e-5, 0, 0, 1.0e-4, 0, 1.0e-4]}
    bend: {mass: 0.1, com: [0.05, 0, 0], inertia: [1.0e-5, 0, 0, 1.0e-4, 0, 1.0e-4]}
  joints:
    swing: {viscous: 0.6, coulomb: 0.05, motor_inertia: 0.028, servo: &s {stiffness: 20, torque_limit: 2.9}}
    bend: {viscous: 0.6, coulomb: 0.05, motor_inertia: 0.028, servo: *s}
  noise: {rate: 100, encoder_resolution: 0.00153398}
"""
WIRES = ("feetech", "dynamixel")
START = np.array([-1.3, 0.4])
"""[rad] where the arm stands."""
STEP = 2.0 * np.pi / 4096
"""[rad] of the encoders."""
STEP_OF_THE_ARM = 0.005
"""[s], two and a half times the usual one; that takes a third less time."""


@cache
def robot_file() -> RobotFile:
    """The arm."""
    return parse_robot(ROBOT, where="two_servos", folder=None)


@dataclass
class ServoBench:
    """A served arm and the keys that reach it."""

    server: SerialServoServer  # the servos
    line: SimulatedLine  # between both
    wire: str  # name of the connection
    keys: dict[str, Any]  # of the connection
    clock: SimulatedClock  # of both

    def port(self, timeout: float = 0.001) -> SerialPort:
        """The client's end, for a test that speaks for itself."""
        return SerialPort(self.line, self.clock, timeout)

    def driver(self, **more: object) -> SerialServoDriver:
        """Not open yet."""
        settings = driver_settings(robot_file().robot, {**self.keys, **more})
        return SerialServoDriver(replace(settings, clock=self.clock), self.wire)

    def opened(self, **more: object) -> AbstractContextManager[SerialServoDriver]:
        """The driver, open."""
        return opened(self.driver(**more))

    def session(
        self, path: Path, to: np.ndarray | None = None, duration: float | None = None, **more: object
    ) -> SessionReport:
        """Record as `dynid record` does: a slow way to a position and back, or only `duration` [s]."""
        robot = robot_file().robot
        play = None if to is None else unchecked_play(slow_move(START, to, robot.joints, share=0.5), robot)
        with self.opened(read_only=play is None, **more) as driver:
            told = "played" if play else ""
            return record_session(path, robot_file(), driver, play, duration, trajectory=told, clock=self.clock)


@contextmanager
def servos(clock: SimulatedClock, wire: str = "feetech", **more: object) -> Iterator[ServoBench]:
    """The arm, served; `more` are keys of its connection."""
    file = robot_file()
    with simulated_line(clock) as line:
        keys = dict(file.robot.connections[wire].model_extra or {}) | {"url": line.path} | more
        settings = parse_settings(keys, file.robot.joint_names, None, wire)
        with patch.object(servo, "STEP", STEP_OF_THE_ARM):
            end: Any = line  # has what is used of a `PseudoTerminal`
            server = SerialServoServer(file, settings, START, line_end=end, clock=clock)
        with server:
            yield ServoBench(server, line, wire, keys, clock)
        assert server.failure is None
