"""Design a motion for friction in one call."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from daq.motion.trajectory_file import PointsTrajectory, dump_trajectory, parse_trajectory
from daq.robot.loader import RobotFile, load_robot
from ident.excite.motion_check import ArmMotionCheck
from ident.excite.prior import find_prior
from ident.excite.sweep_choices import SweepChoices
from ident.excite.velocity_sweep import JointSweep, velocity_sweep
from ident.tasks.excitation import ExcitationTrajectory


def design_sweep(
    robot: str | Path | RobotFile,
    *,
    joints: Sequence[str] = (),
    pose: str | None = None,
    stroke: float = SweepChoices.stroke,
    slowest: float = SweepChoices.slowest,
    speeds: int = SweepChoices.speeds,
    prior: str | Path | None = None,
) -> tuple[ExcitationTrajectory, tuple[JointSweep, ...]]:
    """Design a motion for friction: one joint at a time, forth and back, its speed rising and falling again.

    Args:
        robot: built-in name, robot file, URDF, or the result of `load_robot`.
        joints: that move, one after the other; all where empty.
        pose: of the other joints, by its name in the robot file; its first, or the middle of the ranges, if None.
        stroke: of each joint, made shorter where it is not free [rad or m].
        slowest: peak of the slowest stroke [rad/s or m/s].
        speeds: number of peak speeds up to what the limits allow.
        prior: model folder or result.json that predicts torque; the robot file's truth where None.

    Returns:
        The motion, and what each joint does in it.

    Raises:
        UsageError: an option is not possible for this arm.
        MotionRefusedError: no joint can move.
    """
    robot_file = load_robot(robot)
    known = None if prior is None else Path(prior)
    choices = SweepChoices(tuple(joints), pose, stroke, slowest, speeds)
    sweep = velocity_sweep(robot_file, ArmMotionCheck(robot_file, known), choices)
    trajectory = PointsTrajectory(
        robot=robot_file.robot.name,
        comment="designed by dynid sweep: one joint at a time, forth and back, for friction",
        kind="points",
        points=tuple(map(tuple, sweep.motion.points.tolist())),
        durations=tuple(sweep.motion.durations.tolist()),
    )
    text = dump_trajectory(trajectory)
    motion = parse_trajectory(text, robot_file.robot, where="the sweep", folder=None).motion
    return ExcitationTrajectory(robot_file, text, motion, find_prior(robot_file, known)), sweep.joints
