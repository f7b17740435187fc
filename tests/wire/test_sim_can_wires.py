"""`dynid sim --wire canopen|slcan|can`: what is served, and what is refused; see test_record_over_can for processes."""

from __future__ import annotations

import pytest

from daq.robot.loader import load_robot
from drivers.core.errors import ConnectionFailedError, DynidError, UsageError
from sim_drivers.plant.plant import Plant
from sim_drivers.serving import can as can_wires
from sim_drivers.serving.serve import simulate
from sim_drivers.serving.served import BusOptions


def test_the_options_choose_bus_and_nodes() -> None:
    robot_file = load_robot("ur5e")
    served = can_wires.canopen(robot_file, Plant(robot_file), BusOptions(channel="239.74.163.201", swap="1,2"))
    ready = served.ready()
    nodes = dict(zip(robot_file.robot.joint_names, (2, 1, 3, 4, 5, 6), strict=True))
    place = {"interface": "udp_multicast", "channel": "239.74.163.201"}
    assert ready == {**place, "bitrate": 1_000_000, "nodes": nodes}
    with pytest.raises(UsageError, match="'nonsense' is not a fault"):
        served.obey("nonsense")


@pytest.mark.parametrize(
    ("robot", "wire", "bus", "message"),
    [
        ("ur5e", "canopen", BusOptions(swap="1"), "two joints"),
        ("ur5e", "canopen", BusOptions(swap="1,9"), "no joint"),
        ("ur5e", "canopen", BusOptions(interface="pigeon"), "no interface 'pigeon'"),
        ("ur5e", "slcan", BusOptions(channel="/dev/ttyUSB0"), "its own port"),
        ("ur5e", "can", BusOptions(), "can_frames"),
        ("panda", "canopen", BusOptions(interface="virtual", channel="x", swap="7,7"), "two joints"),
    ],
)
def test_what_cannot_be_served_is_refused(robot: str, wire: str, bus: BusOptions, message: str) -> None:
    with pytest.raises(DynidError, match=message) as refused:
        simulate(robot, wire, "127.0.0.1", "5.22", 1, live=False, bus=bus)
    assert isinstance(refused.value, UsageError | ConnectionFailedError)
