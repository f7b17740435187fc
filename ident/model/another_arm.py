"""Whether two robot files, or a recording and a robot file, are of one arm."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterable, Sequence

import numpy as np

from daq.recording.recording import Recording
from daq.robot.loader import RobotFile
from drivers.core.errors import DataError, UsageError
from ident.model.dynamic_model import build_model

SAME_PLACE = 1e-4
"""Difference of two arms' joint frames [m, rad] that calibration does not make."""

SAME_GRAVITY = 0.05
"""Difference of gravity [m/s²] that no other mounting makes: 9.78 at the equator, 9.83 at the poles."""


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
            which = f"another {second.name}" if second.name == first.name else f"{second.name}, not of {first.name}"
            return f"is of {which}: joint {other.name} is placed differently"
    return ""


def robot_sha256(recording: Recording) -> str:
    """SHA-256 of the robot file and the URDF in a recording, as hexadecimal digits."""
    return hashlib.sha256(f"{recording.robot_text}\0{recording.urdf_text}".encode()).hexdigest()


def check_arm(recordings: Iterable[Recording], robot_file: RobotFile, corrected: Collection[str] = ()) -> None:
    """Refuse recordings of another arm than a robot file's, or of one that is mounted or coupled in another way.

    Args:
        recordings: any.
        robot_file: of the arm.
        corrected: `robot_sha256` of recordings whose robot files this one replaces: geometry may differ from theirs.

    Raises:
        DataError: joints, geometry, gravity or coupling are another's.
    """
    for recording in recordings:
        theirs = recording.robot() if recording.robot_text else robot_file
        known = theirs.robot.name == robot_file.robot.name and robot_sha256(recording) in corrected
        if not known and (said := _difference(robot_file, theirs)):
            raise DataError(
                said,
                where=recording.label,
                hint="recordings of one arm are needed; if they are, identify with --robot FILE",
            )


def _difference(own: RobotFile, theirs: RobotFile) -> str:
    """Return how their arm, or its mounting, differs from ours, in words; empty where nothing does."""
    said, ours, other = another_arm(own, theirs), own.robot.model, theirs.robot.model
    if not said and not np.allclose(ours.gravity, other.gravity, atol=SAME_GRAVITY):
        said = f"has gravity {other.gravity}, not {ours.gravity}"
    if not said and ours.coupling != other.coupling:
        said = f"has motors of {theirs.robot.name} that are coupled otherwise than in {own.robot.name}"
    return said


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
        difference = _difference(own, theirs)
        if not difference and theirs.robot.name != own.robot.name:
            difference = f"is of {theirs.robot.name}, not of {own.robot.name}"
        if difference:
            raise DataError(difference, where=recording.label, hint="recordings of one arm are needed")
