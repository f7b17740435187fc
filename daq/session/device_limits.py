"""What a controller says of its own limits and stops, against the robot file: to be known before an arm moves."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from daq.robot.arm_lengths import arm_lengths
from daq.robot.loader import RobotFile
from daq.robot.schema import Robot
from daq.session.sources import Sources
from daq.session.supervisor import TRACKING_ERROR
from drivers.base import Cautioning, DeviceLimits, Driver, Limiting, Measured, Numbered
from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError

POSITION_AGREEMENT = 1e-3
"""[rad]: positions that differ by less are the same."""
LENGTH_AGREEMENT = 0.008
"""[m]: arms of one model differ by less, as they are calibrated; a UR10 and a UR10e by 0.010."""
LENGTHS = ("upper arm", "forearm", "shoulder offset", "wrist offset")
AGREEMENT = 0.01
"""Relative difference of other limits that are the same."""


def before_a_motion(robot: Robot, driver: Driver) -> list[str]:
    """Return what a person should know before a driver that is open moves its arm, one line each."""
    main = driver.main if isinstance(driver, Sources) else driver
    said = looser_limits(robot, main.device_limits()) if isinstance(main, Limiting) else []
    return said + (list(main.cautions()) if isinstance(main, Cautioning) else [])


def serial_number(driver: Driver) -> str:
    """Serial number of the controller of a driver that is open; empty where it tells none."""
    main = driver.main if isinstance(driver, Sources) else driver
    return main.serial_number() if isinstance(main, Numbered) else ""


def require_same_arm(robot_file: RobotFile, driver: Driver) -> None:
    """Compare the robot file's arm with the one that the controller of a driver that is open says it moves.

    Raises:
        UsageError: they differ.
        DynidError: the robot file's geometry cannot be read.
    """
    main = driver.main if isinstance(driver, Sources) else driver
    reported, own = main.arm_lengths() if isinstance(main, Measured) else None, arm_lengths(robot_file)
    if reported is None or own is None or np.max(np.abs(reported - own)) < LENGTH_AGREEMENT:
        return
    pairs = [
        f"{name} {length:.4g} m, and not {own_length:.4g} m"
        for name, length, own_length in zip(LENGTHS, reported, own, strict=True)
        if abs(length - own_length) >= LENGTH_AGREEMENT
    ]
    raise UsageError(
        f"the controller's arm is not {robot_file.robot.name}: {'; '.join(pairs)}",
        where=robot_file.where,
        hint="use the robot file of this arm, or --host of the right one",
    )


def looser_limits(robot: Robot, own: DeviceLimits) -> list[str]:
    """The robot file's limits that are looser than the controller's own, a line per quantity."""
    joints = robot.joints
    lowest, highest = np.array([joint.position for joint in joints]).T
    torque = np.array([np.nan if joint.torque is None else joint.torque for joint in joints])
    acceleration = np.array([joint.acceleration for joint in joints])
    wider = (lowest < own.lowest - POSITION_AGREEMENT) | (highest > own.highest + POSITION_AGREEMENT)
    lines = []
    if wider.any():
        pairs = [
            f"{joints[k].name} {lowest[k]:.4g} to {highest[k]:.4g} {joints[k].unit('rad')}, "
            f"own {own.lowest[k]:.4g} to {own.highest[k]:.4g}"
            for k in np.flatnonzero(wider)
        ]
        lines.append(f"position limits wider than the controller's own ({own.sources['position']}): {'; '.join(pairs)}")
    for name, unit, mine, theirs in (
        ("velocity", "rad/s", np.array([joint.velocity for joint in joints]), own.velocity),
        ("acceleration", "rad/s²", acceleration, own.acceleration),
        ("torque", "N·m", torque, own.torque),
        ("following error", "rad", np.full(len(joints), TRACKING_ERROR), own.following_error),
    ):
        if theirs is not None and (looser := mine > theirs * (1.0 + AGREEMENT)).any():
            listed = _listed(robot, looser, mine, theirs, unit)
            lines.append(f"{name} limits above the controller's own ({own.sources[name.replace(' ', '_')]}): {listed}")
    if own.stopping is not None and (slow := own.stopping < acceleration * (1.0 - AGREEMENT)).any():
        listed = _listed(robot, slow, acceleration, own.stopping, "rad/s²")
        lines.append(
            f"a stop decelerates less than the acceleration limits allow ({own.sources['stopping']}): {listed}"
        )
    return lines


def _listed(robot: Robot, which: npt.NDArray[np.bool_], mine: FloatArray, theirs: FloatArray, unit: str) -> str:
    joints = robot.joints
    return "; ".join(
        f"{joints[k].name} {mine[k]:.4g} {joints[k].unit(unit)}, own {theirs[k]:.4g}" for k in np.flatnonzero(which)
    )
