"""A motion for friction: one joint at a time, forth and back over one stroke, its speed rising and falling again.

While one joint moves and the others rest, its torque is gravity, a function of its position with three coefficients,
its own inertia, and friction; every stroke passes all speeds up to its peak. Speeds rise and fall, so that warming up
does not look like an effect of the speed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from daq.motion.motion_check import MotionCheck, MotionFigures
from daq.motion.trajectories import QUINTIC_ACCELERATION, QUINTIC_VELOCITY, PointToPoint
from daq.robot.loader import RobotFile
from daq.robot.schema import JointLimits
from drivers.core.arrays import FloatArray
from drivers.core.errors import MotionRefusedError, UsageError
from drivers.core.text import did_you_mean
from ident.excite.choices import SMALLEST_STROKE, SweepChoices
from ident.excite.families.moving_joints import middle_of_range

LIMIT_SHARE = 0.9
"""Share of position range, velocity and acceleration limits that is used."""


@dataclass(frozen=True)
class JointSweep:
    """What one joint does."""

    joint: str  # its name
    # low, high: ends of the stroke [rad or m]
    low: float
    high: float
    speeds: tuple[float, ...]  # peak speeds [rad/s or m/s], rising
    refusal: str = ""  # why it does not move; empty where it does


@dataclass(frozen=True, eq=False)
class VelocitySweep:
    """The motion of all joints."""

    motion: PointToPoint  # from the pose back to it
    joints: tuple[JointSweep, ...]  # what each joint does, in order
    figures: MotionFigures  # of the check that every motion passes before it is played


def velocity_sweep(robot_file: RobotFile, check: MotionCheck, choices: SweepChoices) -> VelocitySweep:
    """Design the motion; every stroke keeps the limits and clear of everything, or is made shorter.

    Raises:
        UsageError: no such joint or pose.
        MotionRefusedError: no joint can move from this pose.
    """
    robot = robot_file.robot
    names = choices.joints or robot.joint_names
    for name in names:
        if name not in robot.joint_names:
            hint = did_you_mean(name, robot.joint_names)
            raise UsageError(f"no joint of {robot.name} is called '{name}'", where="--joints", hint=hint)
    pose = _pose(robot_file, choices.pose)
    sweeps = []
    points, durations = [pose], []
    for name in names:
        index = robot.joint_names.index(name)
        sweep, refusal = _free_sweep(robot.joints[index], index, pose, check, choices)
        if sweep is None:
            sweeps.append(JointSweep(name, float(pose[index]), float(pose[index]), (), refusal))
            continue
        low, high = float(sweep.points[:, index].min()), float(sweep.points[:, index].max())
        sweeps.append(JointSweep(name, low, high, _peaks(robot.joints[index], high - low, choices)))
        points += list(sweep.points[1:])
        durations += list(sweep.durations)
    if not durations:
        raise MotionRefusedError(f"no joint can move from this pose: {sweeps[0].refusal}", hint="name another pose")
    motion = PointToPoint(np.array(points), np.array(durations))
    return VelocitySweep(motion, tuple(sweeps), check.trajectory(motion, "the sweep"))


def _pose(robot_file: RobotFile, name: str | None) -> FloatArray:
    poses = robot_file.robot.poses
    if name is None:
        if poses:
            return np.array(next(iter(poses.values())), dtype=np.float64)
        return np.array([middle_of_range(*joint.position) for joint in robot_file.robot.joints])
    if name not in poses:
        hint = f"there are {', '.join(poses)}" if poses else "the robot file has no section 'poses'"
        raise UsageError(f"no pose is called '{name}'", where="--pose", hint=hint)
    return np.array(poses[name], dtype=np.float64)


def _free_sweep(
    limits: JointLimits, index: int, pose: FloatArray, check: MotionCheck, choices: SweepChoices
) -> tuple[PointToPoint | None, str]:
    """The joint's own motion over the longest stroke that is free, or why there is none."""
    stroke, refusal = choices.stroke, "its range is too short"
    while stroke >= SMALLEST_STROKE:
        low, high = _ends(limits, float(pose[index]), stroke)
        if high - low < SMALLEST_STROKE:
            break
        motion = _strokes(limits, index, pose, low, high, _peaks(limits, high - low, choices))
        try:
            check.trajectory(motion, f"the sweep of {limits.name}")
        except MotionRefusedError as error:
            refusal = error.message
            stroke /= 2.0
            continue
        return motion, ""
    return None, refusal


def _ends(limits: JointLimits, centre: float, stroke: float) -> tuple[float, float]:
    """A stroke around the pose, moved into the joint's range."""
    lowest, highest = limits.position
    spare = 0.5 * (1.0 - LIMIT_SHARE) * (highest - lowest)
    lowest, highest = lowest + spare, highest - spare
    low = min(max(centre - 0.5 * stroke, lowest), max(lowest, highest - stroke))
    return low, min(low + stroke, highest)


def _peaks(limits: JointLimits, stroke: float, choices: SweepChoices) -> tuple[float, ...]:
    """Peak speeds in equal ratios, up to what velocity and acceleration limits allow over the stroke."""
    shortest = np.sqrt(QUINTIC_ACCELERATION * stroke / (LIMIT_SHARE * limits.acceleration))
    fastest = min(LIMIT_SHARE * limits.velocity, QUINTIC_VELOCITY * stroke / shortest)
    slowest = min(choices.slowest, 0.5 * fastest)
    return tuple(np.geomspace(slowest, fastest, choices.speeds).tolist())


def _strokes(
    limits: JointLimits, index: int, pose: FloatArray, low: float, high: float, peaks: Sequence[float]
) -> PointToPoint:
    """Moves from the pose to the lower end, forth and back at rising and falling speeds, back to the pose."""
    ends = [float(pose[index]), low]
    speeds = [min(peaks[-1], 2.0 * peaks[0])]
    for peak in (*peaks, *reversed(peaks)):
        ends += [high, low]
        speeds += [peak, peak]
    ends.append(float(pose[index]))
    speeds.append(speeds[0])
    points = np.tile(pose, (len(ends), 1))
    points[:, index] = ends
    ways = np.abs(np.diff(ends))
    times = np.maximum(
        QUINTIC_VELOCITY * ways / np.array(speeds),
        np.sqrt(QUINTIC_ACCELERATION * ways / (LIMIT_SHARE * limits.acceleration)),
    )
    moving = times > 0.0
    return PointToPoint(points[np.concatenate([[True], moving])], times[moving])
