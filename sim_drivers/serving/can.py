"""`dynid sim` on a CAN bus: from the robot file's connection to the simulated devices behind it."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable

from daq.robot.loader import RobotFile
from daq.robot.schema import Robot
from daq.session.session import SWITCH_INTERVAL
from drivers.can.bus import open_bus
from drivers.canopen402.settings import parse_settings
from drivers.core.errors import UsageError
from sim_drivers.can.bus_load import Frame, exact_bits, worst_case_bits
from sim_drivers.can.slcan_adapter import SlcanAdapter
from sim_drivers.canopen.server import CanopenServer
from sim_drivers.faults import joint_index
from sim_drivers.options import SimOptions
from sim_drivers.plant.plant import Plant
from sim_drivers.serving.served import Served

DEFAULT_BUS = {"interface": "udp_multicast", "channel": "239.74.163.2", "options": {"hop_limit": 0}}
"""Default channel of an arm without one in its robot file."""


def canopen(robot_file: RobotFile, plant: Plant, options: SimOptions) -> Served:
    """CiA 402 drives on the bus of the robot file's canopen402 connection.

    Raises:
        UsageError: the connection's keys, or the options, are wrong.
    """
    return _drives(robot_file, plant, options, _canopen_keys(robot_file.robot, options), None)


def slcan(robot_file: RobotFile, plant: Plant, options: SimOptions) -> Served:
    """The same drives behind an adapter on a pseudo-terminal.

    Raises:
        UsageError: the connection's keys, or the options, are wrong.
        ConnectionFailedError: the bus behind the adapter cannot be opened.
    """
    if options.interface is not None or options.channel is not None:
        raise UsageError("--wire slcan makes its own port", hint="leave --interface and --channel out")
    keys = _canopen_keys(robot_file.robot, options)
    keys |= {"interface": "virtual", "channel": f"behind-slcan-{os.getpid()}", "options": {}}
    settings = parse_settings(keys, robot_file.robot.joint_names)
    # Drives and adapter are threads of this process; a frame must not wait 5 ms for the interpreter to change over.
    sys.setswitchinterval(SWITCH_INTERVAL)
    bus = open_bus(settings.interface, settings.channel, settings.bitrate, settings.options)
    return _drives(robot_file, plant, options, keys, SlcanAdapter(bus, settings.bitrate))


def proprietary(robot_file: RobotFile, plant: Plant, options: SimOptions) -> Served:
    """An arm with the signal table of the robot file's can_frames connection.

    Raises:
        UsageError: there is no such connection, or its keys are wrong.
    """
    from sim_drivers.can_signals.server import ProprietaryCanServer

    robot = robot_file.robot
    if options.swap is not None or options.worst_stuffing:
        raise UsageError("--swap and --worst-stuffing are for --wire canopen and slcan")
    keys = _connection_keys(robot, "can_frames", options)
    if keys is None:
        raise UsageError(
            "the robot file has no connection with the driver can_frames, so there is no signal table",
            where=f"{robot.name}: connections",
            hint="docs/can.md shows one",
        )
    return ProprietaryCanServer(plant, robot, keys, robot_file.folder)


def _drives(
    robot_file: RobotFile, plant: Plant, options: SimOptions, keys: dict[str, object], adapter: SlcanAdapter | None
) -> CanopenServer:
    robot = robot_file.robot
    length: Callable[[Frame], int] = worst_case_bits if options.worst_stuffing else exact_bits
    settings = parse_settings(keys, robot.joint_names)
    swapped = _pair(options.swap, robot) if options.swap is not None else None
    return CanopenServer(plant, robot, settings, swapped=swapped, length=length, adapter=adapter)


def _canopen_keys(robot: Robot, options: SimOptions) -> dict[str, object]:
    """The keys of the canopen402 connection; default ones where the robot file has none."""
    nodes = {name: {"id": node_id} for node_id, name in enumerate(robot.joint_names, start=1)}
    keys = _connection_keys(robot, "canopen402", options)
    return keys if keys is not None else _with_options({**DEFAULT_BUS, "nodes": nodes}, options)


def _connection_keys(robot: Robot, driver: str, options: SimOptions) -> dict[str, object] | None:
    """The keys of the first connection with a driver, with the options in their place; None where there is none."""
    for connection in robot.connections.values():
        if connection.driver == driver:
            keys = dict(connection.model_extra or {})
            keys.pop("with", None)  # other sources of a recording
            return _with_options(keys, options)
    return None


def _with_options(keys: dict[str, object], options: SimOptions) -> dict[str, object]:
    if options.interface is not None and options.interface != keys.get("interface"):
        keys |= {"interface": options.interface, "options": {}}
    if options.channel is not None:
        keys["channel"] = options.channel
    return keys


def _pair(text: str, robot: Robot) -> tuple[int, int]:
    names = [name.strip() for name in text.split(",")]
    if len(names) != 2 or names[0] == names[1]:
        raise UsageError(f"--swap takes two joints, not '{text}'", hint="such as --swap 2,3")
    return joint_index(names[0], robot.joint_names), joint_index(names[1], robot.joint_names)
