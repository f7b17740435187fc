"""The driver keeps what every driver of dynid has to keep."""

from contextlib import AbstractContextManager
from pathlib import Path

import toy_bus

from daq.robot.loader import RobotFile, parse_robot
from dynid.testing import Bench, DriverConformance, declared_bench

ARM = Path(toy_bus.__file__).with_name("arm.yaml")


def on_virtual_bus() -> RobotFile:
    """The arm on a CAN bus that lives in this process, and in simulated time."""
    text = ARM.read_text(encoding="utf-8").replace("udp_multicast", "virtual")
    return parse_robot(text, where=str(ARM), folder=ARM.parent)


class TestToyBus(DriverConformance):
    """One test a point: life cycle, time stamps, gaps, units and signs, stop, silence, garbage, restart, clock."""

    def bench(self) -> AbstractContextManager[Bench]:
        return declared_bench(on_virtual_bus(), "toy_bus")
