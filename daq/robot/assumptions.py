"""Assumptions in place of what a robot file does not state."""

from __future__ import annotations

from daq.robot.loader import RobotFile
from daq.robot.schema import ASSUMED_ACCELERATION


def assumed_limits(robot_file: RobotFile) -> tuple[str, ...]:
    """Limits that motions are kept within although the file does not state them, in words."""
    silent = [limits.name for limits in robot_file.robot.joints if "acceleration" not in limits.model_fields_set]
    if not silent:
        return ()
    everyone = len(silent) == robot_file.robot.dof
    whose = "all joints" if everyone else ", ".join(silent)
    return (f"acceleration limit {ASSUMED_ACCELERATION:g} rad/s² (m/s² of sliding joints) of {whose}",)


def assumptions(robot_file: RobotFile) -> tuple[str, ...]:
    """Everything that is assumed of an arm because its file does not state it, in words."""
    robot = robot_file.robot
    assumed = [*assumed_limits(robot_file), *robot_file.assumed]
    if "gravity" not in robot.model.model_fields_set:
        assumed.append(f"gravity {list(robot.model.gravity)} m/s² in the base frame: the base stands upright")
    if "friction" not in robot.model_fields_set:
        assumed.append(f"friction model {robot.friction.model}" + (" with offset" if robot.friction.offset else ""))
    if "tool" not in robot.workspace.model_fields_set:
        assumed.append("the tool is at the origin of the last joint's frame (workspace.tool)")
    return tuple(assumed)
