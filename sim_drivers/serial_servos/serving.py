"""`dynid sim` of an arm of serial bus servos."""

from __future__ import annotations

from functools import partial

from daq.robot.loader import RobotFile
from drivers.core.clock import Clock
from drivers.serial_servos.bus import PROTOCOLS
from drivers.serial_servos.settings import parse_settings
from sim_drivers.plant.plant import Plant
from sim_drivers.serial_servos.server import SerialServoServer
from sim_drivers.served import SimOptions
from sim_drivers.server import stated_keys


def serve(robot_file: RobotFile, plant: Plant, options: SimOptions, clock: Clock, driver: str) -> SerialServoServer:
    """Servos of a protocol as the robot file's connection has them; `--channel` is the path of their port."""
    robot = robot_file.robot
    keys = stated_keys(robot, driver, "there are no ids", "docs/serial-servos.md")
    if options.channel is not None:
        keys["url"] = options.channel
    settings = parse_settings(keys, robot.joint_names, robot_file.folder, driver)
    # Of the plant, whose drives are told torques, only the place is taken: servos have a plant of their own.
    return SerialServoServer(robot_file, settings, plant.position.copy(), options.seed, clock=clock)


serve_feetech, serve_dynamixel = (partial(serve, driver=protocol) for protocol in PROTOCOLS)
