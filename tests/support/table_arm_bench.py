"""A simulated arm that speaks a table of CAN frames, and recordings of it, in one process and in simulated time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import recorded_session
from recorded_session import record_session
from simulated_clock import SimulatedClock

from daq.robot.loader import RobotFile, load_robot
from daq.robot.schema import Robot
from daq.session.connections import driver_settings
from daq.session.play import Play
from daq.session.session import SessionReport
from drivers.can_signals.driver import CanFramesDriver
from drivers.streams import Batch
from sim_drivers.can_signals.arm import TableArm
from sim_drivers.can_signals.server import ProprietaryCanServer
from sim_drivers.plant.plant import Plant

ROBOT_FILE = load_robot("aubo_i5")
ROBOT = ROBOT_FILE.robot
JOINTS = ROBOT.joint_names
KEYS = dict(ROBOT.connections["can"].model_extra or {})
TIME = {"quantity": "time", "id": 0x181, "start": 48, "length": 16, "scale": 0.001, "unit": "s"}
"""Signal of the arm's time, in place of its counter."""
STEP = 2 * np.pi * 2.0**-20
"""Step of a position in a frame [rad]."""
RATE = 200.0
PERIOD = 1 / RATE
CYCLE_TIME = 9 * 135e-6
"""What the frames of a cycle take at most [s]."""
POSE = np.array([0.3, -0.2, 1.0, 0.4, -0.5, 0.1])
_CHANNELS = count()


def keys(**more: object) -> dict[str, Any]:
    """Return the keys of a connection on a bus of its own."""
    return KEYS | {"interface": "virtual", "channel": f"table-{next(_CHANNELS)}", "options": {}} | more


class Noting(Plant):
    """Keeps what it measured, by the number that the table arm's cycle had."""

    def __init__(self, robot_file: RobotFile = ROBOT_FILE) -> None:
        self.noted: dict[int, Any] = {}
        self.talker: TableArm | None = None
        super().__init__(robot_file, seed=3, position=POSE)

    def measure(self) -> Any:
        measured = super().measure()
        if self.talker is not None:
            self.noted[self.talker._cycles] = measured
        return measured


@contextmanager
def served(clock: SimulatedClock, robot_file: RobotFile = ROBOT_FILE, **more: object) -> Iterator[ProprietaryCanServer]:
    """The arm, from now on, with `more` keys of its connection; its plant is a `Noting`."""
    plant = Noting(robot_file)
    server = ProprietaryCanServer(plant, robot_file.robot, keys(**more), clock=clock)
    plant.talker = server._arm
    with server:
        yield server
    assert server.failure is None


def opened(
    connection: dict[str, Any], clock: SimulatedClock, robot: Robot = ROBOT
) -> AbstractContextManager[CanFramesDriver]:
    """The driver of an arm."""
    return recorded_session.opened(CanFramesDriver(replace(driver_settings(robot, connection), clock=clock)))


def connection_of(server: ProprietaryCanServer) -> dict[str, Any]:
    """The keys that reach it."""
    return KEYS | {"interface": "virtual", "channel": server.settings.keys.channel, "options": {}}


def session(
    path: Path, driver: CanFramesDriver, clock: SimulatedClock, play: Play | None = None, duration: float | None = None
) -> SessionReport:
    """Record as `dynid record` does."""
    return record_session(path, ROBOT_FILE, driver, play, duration, clock=clock)


def noted_by(server: ProprietaryCanServer, quantity: str, cycles: np.ndarray) -> np.ndarray:
    """What the plant measured (N, n) in some cycles."""
    noted = server._arm.arm.noted  # type: ignore[attr-defined]
    return np.array([getattr(noted[cycle], quantity) for cycle in cycles.tolist()])


def read_for(driver: CanFramesDriver, clock: SimulatedClock, seconds: float) -> list[Batch]:
    """The joints' blocks of so long [s]."""
    end, blocks = clock.now() + seconds, []
    while (left := end - clock.now()) > 0.0:
        blocks += [block for block in driver.read(min(left, 0.02)) if block.stream == "joints"]
    return blocks
