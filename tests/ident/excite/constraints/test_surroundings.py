"""The warning about surroundings that the robot file does not name."""

from __future__ import annotations

import numpy as np

from daq.motion.trajectories import PointToPoint
from daq.robot.loader import load_robot
from ident.excite.constraints.workspace import surroundings_warning
from ident.model.dynamic_model import build_model
from ident.model.dynamics.pinocchio_model import pinocchio_model


def hanging() -> PointToPoint:
    """The UR5e from straight up to straight down: the last frame's origin then is deepest."""
    up, down = np.zeros(6), np.zeros(6)
    up[1], down[1] = -np.pi / 2, np.pi / 2
    return PointToPoint(np.array([up, down]), np.array([4.0]))


def with_workspace(mounting="free", **keys):
    robot_file = load_robot("ur5e")
    workspace = robot_file.robot.workspace.model_copy(update=keys)
    sections = {"workspace": workspace, "model": robot_file.robot.model.model_copy(update={"mounting": mounting})}
    return robot_file.model_copy(update={"robot": robot_file.robot.model_copy(update=sections)})


def test_the_lowest_height_is_that_of_the_forward_kinematics():
    import pinocchio as pin

    robot_file, motion = with_workspace(), hanging()
    arm = pinocchio_model(build_model(robot_file))
    working = arm.createData()
    heights = []
    for position in motion.evaluate(np.linspace(0.0, motion.duration, 400))[0].T:
        pin.forwardKinematics(arm, working, position)
        heights += [placement.translation[2] for placement in list(working.oMi)[1:]]
    warning = surroundings_warning(robot_file, motion)
    assert warning is not None
    assert f"descends to {min(heights):.2f} m" in warning


def test_a_tool_point_below_the_joints_counts():
    warning = surroundings_warning(with_workspace(tool=(0.0, -0.3, 0.0)), hanging())
    other = surroundings_warning(with_workspace(tool=(0.0, 0.3, 0.0)), hanging())
    assert warning != other


def test_a_file_that_names_a_bound_is_not_warned_about():
    assert surroundings_warning(with_workspace(height=(-2.0, 2.0)), hanging()) is None
    assert surroundings_warning(with_workspace("table"), hanging()) is None
