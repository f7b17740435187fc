"""Warning where the robot file describes no surroundings of the arm."""

from __future__ import annotations

import numpy as np

from daq.motion.trajectories import Motion
from daq.robot.loader import RobotFile
from daq.robot.obstacles import obstacles_of
from ident.excite.constraints.placements import place_arm, tool_point
from ident.model.dynamic_model import build_model

_SAMPLES = 2000


def surroundings_warning(robot_file: RobotFile, motion: Motion) -> str | None:
    """Lowest height of the joints and the tool point, where the file sets no bound; None where it sets one."""
    workspace = robot_file.robot.workspace
    if workspace.height is not None or obstacles_of(robot_file.robot):
        return None
    model = build_model(robot_file)
    position, _, _ = motion.evaluate(np.linspace(0.0, motion.duration, _SAMPLES))
    placements = place_arm(model, position)
    tool = tool_point(model, placements, workspace.tool)
    lowest = min(float(placements.origin[:-1, 2].min()), float(tool[2].min()))
    return (
        "the robot file names neither a mounting surface nor heights nor obstacles: this motion comes down to "
        f"{lowest:.2f} m in the base frame. Say what the arm is mounted on ('model': mounting) and what stands around "
        "it ('workspace': keep_out)"
    )
