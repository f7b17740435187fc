"""Checks of a robot file for `dynid check`: kinematics, poses, gains, gravity, limits, drivers, bus budgets."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from daq.motion.motion_check import UNCHECKED
from daq.robot.assumptions import assumptions
from daq.robot.loader import RobotFile
from daq.session.connections import bus_budget, connection_keys, driver_settings, tight_bus
from daq.session.session import load_driver
from drivers.bus_budget import TIGHT_SHARE, Budget
from drivers.core.errors import InputError
from drivers.declaration import declared, installed_drivers
from ident.checks.tool_pose import ToolPose, tool_poses
from ident.estimators.feasible.centre_bounds import CentreBound, centre_bounds
from ident.excite.constraints.collision_geometry import arm_geometry
from ident.excite.constraints.constraints import pairs_by_hull, unchecked_pairs
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model

QUICKEST = 300.0
"""[rad/s² or m/s²] beyond what joints of arms can do; typical limits in °/s² are larger."""

LONGEST_LINK = 10.0
"""[m] beyond what links of arms measure; a mesh in mm is longer."""


@dataclass(frozen=True)
class RobotCheck:
    """Results of `dynid check` for a readable robot file."""

    problems: tuple[InputError, ...]  # errors about everything for which the file cannot be used
    warnings: tuple[str, ...]  # doubts, in words
    assumed: tuple[str, ...]  # assumptions in place of what the file does not state, in words
    # of the tool at position zero and at the file's named poses; empty where the kinematics cannot be used
    poses: tuple[ToolPose, ...]
    budgets: dict[str, Budget]  # bus load of each connection whose bus can be too full, by the connection's name


def check_robot(robot_file: RobotFile) -> RobotCheck:
    """Check a robot file that can be read: kinematics, poses, gains, gravity, limits, drivers and bus budgets.

    Raises:
        IdentificationError: its base parameters cannot be decided.
    """
    problems: list[InputError] = []
    warnings = [*_limit_warnings(robot_file), *_gain_warnings(robot_file)]
    poses: tuple[ToolPose, ...] = ()
    assumed = list(assumptions(robot_file))
    try:
        model = build_model(robot_file)
    except InputError as error:
        problems.append(error)
    else:
        base_parameters(model)
        poses = tool_poses(robot_file, model)
        warnings += [
            f"the pose '{pose.name}' is beyond the limits of {', '.join(pose.beyond)}"
            for pose in poses
            if pose.beyond and pose.name in robot_file.robot.poses
        ]
        try:
            assumed += [
                f"a tube along its axes instead of the shape of link {link}"
                for link in arm_geometry(robot_file, model).unread
            ]
            if unchecked := unchecked_pairs(robot_file, model):
                assumed.append(f"{UNCHECKED}: {'; '.join(unchecked)}")
            if by_hull := pairs_by_hull(robot_file, model):
                assumed.append(
                    f"a design (excite) does not check {'; '.join(by_hull)}, whose capsules always touch; the check of "
                    "a motion uses the convex hulls of their meshes and may refuse the design"
                )
            warnings += _bound_warnings(centre_bounds(model, robot_file))
        except InputError as error:
            problems.append(error)
    budgets: dict[str, Budget] = {}
    installed = installed_drivers()
    for name, connection in robot_file.robot.connections.items():
        if connection.driver not in installed:
            names = ", ".join(sorted(installed)) or "none in this version"
            warnings.append(
                f"connection '{name}' needs the driver '{connection.driver}', which is not installed ({names})"
            )
            continue
        try:
            # The driver checks its keys; nothing is opened.
            load_driver(robot_file.robot, name, folder=robot_file.folder, place=robot_file.where)
            if (budget := bus_budget(robot_file, name)) is not None:
                budgets[name] = budget
            keys = connection_keys(robot_file.robot, name)
            settings = driver_settings(robot_file.robot, keys, robot_file.folder)
            warnings += [f"connection '{name}': {line}" for line in declared(connection.driver).advice_on(settings)]
        except InputError as error:
            error.where = error.where or f"{robot_file.where}: connections.{name}"
            problems.append(error)
    warnings += [warning for name, budget in budgets.items() if (warning := tight_bus(name, budget)) is not None]
    return RobotCheck(tuple(problems), tuple(warnings), tuple(assumed), poses, budgets)


def _limit_warnings(robot_file: RobotFile) -> list[str]:
    robot = robot_file.robot
    warnings = []
    length = float(np.linalg.norm(robot.model.gravity))
    if not 9.7 < length < 9.9:
        warnings.append(f"gravity is {length:.4g} m/s²; on Earth it is 9.78 to 9.83")
    without = [joint.name for joint in robot.joints if joint.torque is None]
    if without:
        warnings.append(f"no torque limit for {', '.join(without)}")
    for sliding, unit in ((False, "°/s²"), (True, "mm/s²")):
        quick = [joint.name for joint in robot.joints if joint.acceleration > QUICKEST and joint.sliding == sliding]
        if quick:
            warnings.append(f"the acceleration limit of {', '.join(quick)} is above {QUICKEST:g}: is it in {unit}?")
    return warnings


def _bound_warnings(bounds: Iterable[CentreBound]) -> list[str]:
    lengths = {bound.name: float(np.max(bound.offsets[:3] + bound.offsets[3:6])) for bound in bounds}
    return [
        f"{name} is {length:.3g} m long: are its points in mm? A mesh of a URDF has a 'scale'"
        for name, length in lengths.items()
        if length > LONGEST_LINK
    ]


def _gain_warnings(robot_file: RobotFile) -> list[str]:
    robot = robot_file.robot
    warnings = []
    drives = {joint: robot.drive(joint) for joint in robot.joint_names}
    unknown = [joint for joint, of in drives.items() if of.gain is None and of.signal not in ("torque", "magnitude")]
    if unknown:
        warnings.append(
            f"the drive gain of {', '.join(unknown)} is unknown: recorded current cannot be turned into torque"
        )
    unsigned = [drive.joint for drive in robot.drives if drive.signal == "magnitude"]
    if unsigned:
        warnings.append(
            f"the signal of {', '.join(unsigned)} is a magnitude, not a torque: identify a servo model from commands "
            "and encoder (--method servo)"
        )
    unsure = [drive.joint for drive in robot.drives if drive.gain is not None and drive.gain_std is None]
    if unsure:
        warnings.append(f"the drive gain of {', '.join(unsure)} has no standard deviation (gain_std)")
    return warnings


def budget_object(budget: Budget) -> dict[str, float]:
    """The JSON object of a bus budget."""
    return {
        "bitrate": budget.bitrate,
        "rate_hz": budget.rate,
        "cycle_bits": budget.cycle_bits,
        "load_percent": 100.0 * budget.load,
        "highest_rate_hz": budget.highest_rate(),
        "highest_rate_at_80_percent_hz": budget.highest_rate(TIGHT_SHARE),
    }
