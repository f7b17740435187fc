"""Design a motion for friction in one call."""

from __future__ import annotations

from daq.motion.trajectory_file import PointsTrajectory, dump_trajectory, parse_trajectory
from daq.robot.loader import load_robot
from drivers.core.options import keywords_of, same_named
from ident.excite.motion_check import ArmMotionCheck
from ident.excite.prior import find_prior
from ident.excite.sweep_choices import SweepChoices
from ident.excite.velocity_sweep import JointSweep, velocity_sweep
from ident.result.model import result_path
from ident.tasks.excitation import ExcitationTrajectory
from ident.tasks.options import SweepOptions


@keywords_of(SweepOptions)
def design_sweep(options: SweepOptions) -> tuple[ExcitationTrajectory, tuple[JointSweep, ...]]:
    """Design a motion for friction: one joint at a time, forth and back, its speed rising and falling again.

    Returns:
        The motion, and what each joint does in it.

    Raises:
        UsageError: an option is not possible for this arm.
        MotionRefusedError: no joint can move.
    """
    robot_file = load_robot(options.robot)
    known = None if options.prior is None else result_path(options.prior)
    choices = same_named(options, SweepChoices, joints=tuple(options.joints))
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
