"""Sessions in one process, as `dynid record` runs them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from daq.recording.recorder import Recorder
from daq.robot.loader import RobotFile
from daq.session.play import Play
from daq.session.session import SessionReport, record
from daq.session.supervisor import TRACKING_ERROR, Limits, Supervisor
from drivers.base import Driver
from drivers.core.clock import SYSTEM_CLOCK, Clock

AnyDriver = TypeVar("AnyDriver", bound=Driver)


@contextmanager
def opened(driver: AnyDriver) -> Iterator[AnyDriver]:
    """A driver, open."""
    try:
        driver.open()
        yield driver
    finally:
        driver.close()


def record_session(
    path: Path,
    robot_file: RobotFile,
    driver: Driver,
    play: Play | None = None,
    duration: float | None = None,
    *,
    trajectory: str = "",
    tracking_error: float = TRACKING_ERROR,
    clock: Clock = SYSTEM_CLOCK,
    **more: Any,
) -> SessionReport:
    """Record from a driver that is open, within the robot file's limits; `more` are arguments of `record`."""
    layouts = driver.streams()
    supervisor = Supervisor(Limits.of_robot(robot_file.robot, tracking_error), layouts)
    recorder = Recorder(path, robot_file, layouts, trajectory=trajectory, clock=clock)
    return record(driver, recorder, supervisor, play, duration, clock=clock, **more)
