"""`dynid sim` of CiA 402 drives: from the robot file's connection to the simulated drives behind it."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable

from daq.robot.loader import RobotFile
from daq.robot.schema import Robot
from daq.session.connections import keys_of_driver
from daq.session.session import SWITCH_INTERVAL
from drivers.can.bus import open_bus
from drivers.canopen402.settings import parse_settings
from drivers.core.clock import Clock
from drivers.core.errors import UsageError
from sim_drivers.can.bus_load import Frame, exact_bits, worst_case_bits
from sim_drivers.can.bus_server import with_options
from sim_drivers.can.slcan_adapter import SlcanAdapter
from sim_drivers.canopen.server import CanopenServer
from sim_drivers.faults import joint_index
from sim_drivers.plant.plant import Plant
from sim_drivers.served import SimOptions

DRIVER = "canopen402"
DEFAULT_BUS = {"interface": "udp_multicast", "channel": "239.74.163.2", "options": {"hop_limit": 0}}
"""Default channel of an arm without one in its robot file."""


def serve(robot_file: RobotFile, plant: Plant, options: SimOptions, clock: Clock) -> CanopenServer:
    """CiA 402 drives on the bus of the robot file's connection."""
    return _drives(robot_file, plant, options, _keys(robot_file.robot, options), None, clock)


def serve_behind_adapter(robot_file: RobotFile, plant: Plant, options: SimOptions, clock: Clock) -> CanopenServer:
    """The same drives behind an adapter on a pseudo-terminal.

    Raises:
        UsageError: the connection's keys, or the options, are wrong.
        ConnectionFailedError: the bus behind the adapter cannot be opened.
    """
    if options.interface is not None or options.channel is not None:
        raise UsageError("--wire slcan makes its own port", hint="leave --interface and --channel out")
    keys = _keys(robot_file.robot, options)
    keys |= {"interface": "virtual", "channel": f"behind-slcan-{os.getpid()}", "options": {}}
    settings = parse_settings(keys, robot_file.robot.joint_names)
    # Drives and adapter are threads of this process; a frame must not wait 5 ms for the interpreter to change over.
    sys.setswitchinterval(SWITCH_INTERVAL)
    bus = open_bus(settings.interface, settings.channel, settings.bitrate, settings.options)
    return _drives(robot_file, plant, options, keys, SlcanAdapter(bus, settings.bitrate, clock=clock), clock)


def _drives(
    robot_file: RobotFile,
    plant: Plant,
    options: SimOptions,
    keys: dict[str, object],
    adapter: SlcanAdapter | None,
    clock: Clock,
) -> CanopenServer:
    robot = robot_file.robot
    length: Callable[[Frame], int] = worst_case_bits if options.worst_stuffing else exact_bits
    settings = parse_settings(keys, robot.joint_names)
    swapped = _pair(options.swap, robot) if options.swap is not None else None
    return CanopenServer(plant, robot, settings, swapped=swapped, length=length, adapter=adapter, clock=clock)


def _keys(robot: Robot, options: SimOptions) -> dict[str, object]:
    """The keys of the robot file's connection; default ones where it has none."""
    nodes = {name: {"id": node_id} for node_id, name in enumerate(robot.joint_names, start=1)}
    keys = keys_of_driver(robot, DRIVER)
    return with_options({**DEFAULT_BUS, "nodes": nodes} if keys is None else keys, options)


def _pair(text: str, robot: Robot) -> tuple[int, int]:
    names = [name.strip() for name in text.split(",")]
    if len(names) != 2 or names[0] == names[1]:
        raise UsageError(f"--swap takes two joints, not '{text}'", hint="such as --swap 2,3")
    return joint_index(names[0], robot.joint_names), joint_index(names[1], robot.joint_names)
