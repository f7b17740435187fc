"""`dynid sim` over RTDE."""

from __future__ import annotations

from daq.robot.arm_lengths import arm_lengths
from daq.robot.loader import RobotFile
from drivers.core.clock import Clock
from sim_drivers.options import SimOptions
from sim_drivers.plant.plant import Plant
from sim_drivers.rtde.server import RtdeServer


def serve(robot_file: RobotFile, plant: Plant, options: SimOptions, clock: Clock) -> RtdeServer:
    """A controller of the version that is asked for, which knows the arm's lengths.

    Raises:
        UsageError: no such version, or not six turning joints.
    """
    server = RtdeServer(plant, host=options.host, version=options.version, joints=robot_file.robot.joints, clock=clock)
    if (lengths := arm_lengths(robot_file)) is not None:
        server.controller.lengths = lengths.tolist()
    return server
