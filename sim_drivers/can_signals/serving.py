"""`dynid sim` of an arm with a signal table."""

from __future__ import annotations

from daq.robot.loader import RobotFile
from drivers.core.clock import Clock
from drivers.core.errors import UsageError
from sim_drivers.can.connection import connection_keys
from sim_drivers.can_signals.server import ProprietaryCanServer
from sim_drivers.options import SimOptions
from sim_drivers.plant.plant import Plant

DRIVER = "can_frames"


def serve(robot_file: RobotFile, plant: Plant, options: SimOptions, clock: Clock) -> ProprietaryCanServer:
    """An arm with the signal table of the robot file's connection.

    Raises:
        UsageError: there is no such connection, or its keys are wrong.
    """
    robot = robot_file.robot
    if options.swap is not None or options.worst_stuffing:
        raise UsageError("--swap and --worst-stuffing are for --wire canopen and slcan")
    keys = connection_keys(robot, DRIVER, options)
    if keys is None:
        raise UsageError(
            f"the robot file has no connection with the driver {DRIVER}, so there is no signal table",
            where=f"{robot.name}: connections",
            hint="docs/can.md shows one",
        )
    return ProprietaryCanServer(plant, robot, keys, robot_file.folder, clock)
