"""`dynid sim` of an arm of CAN motors."""

from __future__ import annotations

from functools import partial

from daq.robot.loader import RobotFile
from drivers.can_motors.settings import CODECS, parse_settings
from drivers.core.clock import Clock
from sim_drivers.can.bus_server import table_keys
from sim_drivers.can_motors.server import CanMotorServer
from sim_drivers.plant.plant import Plant
from sim_drivers.served import SimOptions


def serve(robot_file: RobotFile, plant: Plant, options: SimOptions, clock: Clock, family: str) -> CanMotorServer:
    """Motors of a family as the robot file's connection has them."""
    robot = robot_file.robot
    keys = table_keys(robot, family, options, "there are no ids", "docs/can-motors.md")
    settings = parse_settings(keys, robot.joint_names, family)
    # Of the plant, whose drives are told torques, only the place is taken: motors have a plant of their own.
    return CanMotorServer(robot_file, settings, plant.position.copy(), clock, held=True)


serve_damiao, serve_robstride, serve_cubemars, serve_moteus, serve_odrive = (
    partial(serve, family=family) for family in CODECS
)
