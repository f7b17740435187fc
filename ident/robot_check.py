"""What `dynid check` finds in a robot file beyond its keys."""

from __future__ import annotations

from importlib.metadata import entry_points

import numpy as np

from daq.robot import RobotFile
from drivers.base import DRIVERS_GROUP
from ident.base_parameters import base_parameters
from ident.model import build_model


def check_robot(robot_file: RobotFile) -> list[str]:
    """Warnings about a valid robot file, in words.

    Raises:
        RobotFileError: its kinematics cannot be used.
        IdentificationError: its base parameters cannot be decided.
    """
    robot = robot_file.robot
    base_parameters(build_model(robot_file))
    warnings = []
    unknown = [joint for joint in robot.joint_names if _needs_gain(robot_file, joint)]
    if unknown:
        warnings.append(
            f"the drive gain of {', '.join(unknown)} is unknown: recorded current cannot be turned into torque"
        )
    unsure = [drive.joint for drive in robot.drives if drive.gain is not None and drive.gain_std is None]
    if unsure:
        warnings.append(f"the drive gain of {', '.join(unsure)} has no standard deviation (gain_std)")
    length = float(np.linalg.norm(robot.model.gravity))
    if not 9.7 < length < 9.9:
        warnings.append(f"gravity is {length:.4g} m/s²; on Earth it is 9.78 to 9.83")
    without = [joint.name for joint in robot.joints if joint.torque is None]
    if without:
        warnings.append(f"no torque limit for {', '.join(without)}")
    installed = {entry.name for entry in entry_points(group=DRIVERS_GROUP)}
    for name, connection in robot.connections.items():
        if connection.driver not in installed:
            known = ", ".join(sorted(installed)) or "none in this version"
            warnings.append(
                f"connection '{name}' needs the driver '{connection.driver}', which is not installed ({known})"
            )
    return warnings


def _needs_gain(robot_file: RobotFile, joint: str) -> bool:
    drive = robot_file.robot.drive(joint)
    return drive.gain is None and drive.signal != "torque"
