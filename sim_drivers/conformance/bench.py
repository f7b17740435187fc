"""A bench: a driver and the simulated device at its other end, on one simulated clock."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from daq.robot.loader import RobotFile
from daq.session.connections import driver_settings, keys_of_driver
from drivers.base import Driver
from drivers.core.arrays import FloatArray
from drivers.declaration import declared, named
from sim_drivers.conformance.simulated_clock import SimulatedClock, simulated_time
from sim_drivers.plant.plant import Plant
from sim_drivers.served import Served, SimOptions

TOLERANCES: Mapping[str, float] = {"position": 2e-3, "current": 0.5, "torque": 2.0, "temperature": 2.0}
"""How far a sample may be from what is true, by quantity, in dynid's units: noise and steps of encoders, no more."""


class Obeying(Protocol):
    """A simulated device that obeys typed faults."""

    def obey(self, line: str) -> None:
        """Cause a fault as a person types it into `dynid sim`."""


@dataclass(frozen=True)
class Bench:
    """Both ends of a connection."""

    clock: SimulatedClock  # of both
    driver: Callable[[], Driver]  # makes a driver, closed
    # makes the device, which runs while its context is entered; once more after it was left
    device: Callable[[], AbstractContextManager[Obeying]]
    # quantity → (n,) what the running device's sensors hold now, in dynid's units, a column as the driver's
    truth: Callable[[], Mapping[str, FloatArray]]
    # quantity → how far a sample may be from the truth
    tolerances: Mapping[str, float] = field(default_factory=lambda: TOLERANCES)
    # quantities that the device reports as they are while it is not controlled; drives that are not enabled draw no
    # current, whatever the arm weighs
    idle: tuple[str, ...] = tuple(TOLERANCES)
    lose: str = "drop 3"  # typed fault that loses a few samples
    fall_silent: str = "freeze 60"  # typed fault after which nothing comes for a minute
    babble: str = "garbage 20"  # typed fault that sends nonsense


@contextmanager
def declared_bench(
    robot_file: RobotFile, driver: str, *, wire: str = "", idle: tuple[str, ...] = tuple(TOLERANCES), **faults: str
) -> Iterator[Bench]:
    """A bench of an installed driver, from nothing but its declaration.

    Args:
        robot_file: of the arm, with a truth and a connection of the driver; a CAN bus is of the interface `virtual`.
        driver: its name.
        wire: which of its simulated back ends; the first where empty.
        idle: as `Bench.idle`.
        faults: `lose`, `fall_silent` and `babble`, where its words are others.

    Raises:
        UsageError: no such driver.
    """
    robot, declaration = robot_file.robot, declared(driver)
    keys = keys_of_driver(robot, driver) or {}
    (back_end,) = [end for end in declaration.simulated if end.wire == wire] or declaration.simulated[:1]
    plants: list[Plant] = []
    with simulated_time() as clock:

        def device() -> Served:
            plants.append(Plant(robot_file, position=distinct_pose(robot_file)))
            options = SimOptions(robot=robot.name, wire=back_end.wire)
            served: Served = named(back_end.serve)(robot_file, plants[-1], options, clock)
            return served

        def truth() -> Mapping[str, FloatArray]:
            measured = plants[-1].measure()
            return {quantity: getattr(measured, quantity) for quantity in TOLERANCES}

        settings = replace(driver_settings(robot, keys, robot_file.folder), clock=clock)
        yield Bench(clock, lambda: declaration.make(settings), device, truth, TOLERANCES, idle, **faults)


def distinct_pose(robot_file: RobotFile) -> FloatArray:
    """A position (n,) by which joints, units and signs cannot be taken for others."""
    middles = np.array([0.5 * sum(joint.position) for joint in robot_file.robot.joints])
    spans = np.array([joint.position[1] - joint.position[0] for joint in robot_file.robot.joints])
    numbers = np.arange(1, len(middles) + 1)
    offsets: FloatArray = middles + np.minimum(0.1 * numbers, 0.3 * spans) * np.where(numbers % 2, 1.0, -1.0)
    return offsets
