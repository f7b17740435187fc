"""`dynid sim --wire canopen|slcan|can`: what is served, and what is refused; see test_record_over_can for processes."""

from __future__ import annotations

import pytest
from each import each

from daq.robot.loader import load_robot
from drivers.core.clock import SYSTEM_CLOCK
from drivers.core.errors import ConnectionFailedError, DynidError, UsageError
from sim_drivers.canopen import server
from sim_drivers.plant.plant import Plant
from sim_drivers.served import SimOptions
from sim_drivers.serving import simulate


def test_the_options_choose_bus_and_nodes() -> None:
    robot_file = load_robot("ur5e")
    options = SimOptions(robot="ur5e", channel="239.74.163.201", swap="1,2")
    served = server.serve(robot_file, Plant(robot_file), options, SYSTEM_CLOCK)
    ready = served.ready()
    nodes = dict(zip(robot_file.robot.joint_names, (2, 1, 3, 4, 5, 6), strict=True))
    place = {"interface": "udp_multicast", "channel": "239.74.163.201"}
    assert ready == {**place, "bitrate": 1_000_000, "nodes": nodes}
    with pytest.raises(UsageError, match="'nonsense' is not a fault"):
        served.obey("nonsense")


@each(
    ("options", "message"),
    [
        (SimOptions(robot="ur5e", wire="canopen", swap="1"), "two joints"),
        (SimOptions(robot="ur5e", wire="canopen", swap="1,9"), "no joint"),
        (SimOptions(robot="ur5e", wire="canopen", interface="pigeon"), "no interface 'pigeon'"),
        (SimOptions(robot="ur5e", wire="slcan", channel="/dev/ttyUSB0"), "its own port"),
        (SimOptions(robot="ur5e", wire="can"), "can_frames"),
        (SimOptions(robot="panda", wire="canopen", interface="virtual", channel="x", swap="7,7"), "two joints"),
    ],
)
def test_what_cannot_be_served_is_refused(options: SimOptions, message: str) -> None:
    with pytest.raises(DynidError, match=message) as refused:
        simulate(options, live=False)
    assert isinstance(refused.value, UsageError | ConnectionFailedError)
