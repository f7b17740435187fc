"""Whether two robot files, or a recording and a robot file, are of one arm."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from daq.recording.recording import Recording
from daq.robot.loader import RobotFile
from drivers.core.errors import DataError, UsageError
from ident.model.dynamic_model import build_model

SAME_PLACE = 1e-4
"""Difference of two arms' joint frames [m, rad] that calibration does not make."""


def another_arm(own: RobotFile, theirs: RobotFile) -> str:
    """Return how their arm differs from ours, in words; empty where joints and geometry are the same."""
    first, second = own.robot, theirs.robot
    if first.joint_names != second.joint_names:
        return (
            f"is of {second.name} with joints {', '.join(second.joint_names)}, not of {first.name} with joints "
            f"{', '.join(first.joint_names)}"
        )
    if own.text == theirs.text and own.urdf_text == theirs.urdf_text:
        return ""
    for joint, other in zip(build_model(own).joints, build_model(theirs).joints, strict=True):
        same = joint.parent == other.parent and joint.prismatic == other.prismatic
        for part in ("rotation", "translation", "axis"):
            same = same and np.allclose(getattr(joint, part), getattr(other, part), atol=SAME_PLACE)
        if not same:
            return f"is of {second.name}, whose joint {other.name} is placed differently than in {first.name}"
    return ""


def check_arm(recordings: Iterable[Recording], robot_file: RobotFile) -> None:
    """Refuse recordings of another arm than a robot file's; one of its name may have been corrected since.

    Raises:
        DataError: name, and joints or geometry, are another's.
    """
    for recording in recordings:
        theirs = recording.robot() if recording.robot_text else robot_file
        if theirs.robot.name != robot_file.robot.name and (said := another_arm(robot_file, theirs)):
            raise DataError(
                said,
                where=recording.label,
                hint="recordings of one arm are needed; if they are, identify with --robot FILE",
            )


def check_one_arm(recordings: Sequence[Recording]) -> None:
    """Refuse recordings of which one is of another arm than the first, by name too, and a file given twice.

    Raises:
        DataError: name, joints, geometry or gravity differ.
        UsageError: two are one file.
    """
    own, paths = recordings[0].robot(), set()
    for recording in recordings:
        if recording.path in paths:
            raise UsageError("the same file is given twice", where=recording.label)
        paths |= {recording.path} - {None}
        theirs = recording.robot()
        difference = another_arm(own, theirs)
        if not difference and theirs.robot.name != own.robot.name:
            difference = f"is of {theirs.robot.name}, not of {own.robot.name}"
        if not difference and theirs.robot.model.gravity != own.robot.model.gravity:
            difference = f"has gravity {theirs.robot.model.gravity}, not {own.robot.model.gravity}"
        if difference:
            raise DataError(difference, where=recording.label, hint="recordings of one arm are needed")
