"""The check that a motion passes before it is played, and what it tells of the motion.

It needs the arm's geometry and dynamics, which are not daq's: the package that has them enters a `MakeMotionCheck` in
the entry-point group `dynid.motion_check`. Without one no motion is played.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from typing import Protocol, cast

from daq.motion.trajectories import Motion
from daq.robot.loader import RobotFile
from drivers.core.errors import MotionRefusedError

MOTION_CHECK_GROUP = "dynid.motion_check"
"""Entry-point group of exactly one `MakeMotionCheck`."""

UNCHECKED = "pairs of links that are not checked, since they touch in nearly every pose or may touch by the robot file"
"""What is said before the pairs of `MotionFigures.unchecked`."""


@dataclass(frozen=True)
class SmallestClearance:
    """How near a motion comes to something."""

    what: str  # an obstacle, another link, or a limit of the workspace
    link: str  # that comes nearest, by the joint that moves it
    distance: float  # [m], the links' thickness included
    time: float  # [s]


@dataclass(frozen=True)
class MotionFigures:
    """What will move where."""

    duration: float  # [s]
    lowest: float  # smallest height of the tool point above the base frame's origin, against gravity [m]
    farthest: float  # largest distance of the tool point from the base frame's origin [m]
    tool_speed: float  # largest speed of the tool point [m/s]
    fastest_joint: str  # that uses most of its velocity limit
    speed_share: float  # how much of it
    # to every obstacle, and of the pair of links that come nearest to each other; the smallest first
    clearances: tuple[SmallestClearance, ...]
    torque_joint: str  # that is predicted to use most of its torque limit; empty where nothing can be predicted
    torque_share: float | None  # how much of it; None where nothing can be predicted
    unchecked: tuple[str, ...] = ()  # pairs of links that are not kept apart; neighbours are not named


class MotionCheck(Protocol):
    """Checks motions of one arm against its surroundings, itself, and its torque limits."""

    def trajectory(self, motion: Motion, where: str) -> MotionFigures:
        """Check a motion; `where` is what an error calls it.

        Raises:
            MotionRefusedError: it comes too near to something; names link, obstacle and time.
        """

    def approach(self, motion: Motion) -> MotionFigures:
        """Check the way to a start pose; it may begin too near to something, but must not come nearer.

        Raises:
            MotionRefusedError: as above.
        """


class MakeMotionCheck(Protocol):
    """Makes the check of an arm."""

    def __call__(self, robot_file: RobotFile, prior: Path | None) -> MotionCheck:
        """The check; torque is predicted with the parameters of `prior`, a result.json, or of the robot file.

        Raises:
            DynidError: a file cannot be used.
        """


def load_motion_check(robot_file: RobotFile, prior: Path | None = None) -> MotionCheck:
    """The check that is installed, for an arm.

    Raises:
        MotionRefusedError: none is installed, or several are.
        DynidError: a file cannot be used.
    """
    make = only_entry(MOTION_CHECK_GROUP, "a motion is played only where exactly one check of motions is installed")
    return cast("MakeMotionCheck", make)(robot_file, prior)


def only_entry(group: str, needed: str) -> object:
    """Return what is entered in a group of entry points, alone; `needed` says so in an error.

    Raises:
        MotionRefusedError: nothing is, or several things are.
    """
    entries = list(entry_points(group=group))
    if len(entries) != 1:
        values = ", ".join(sorted(entry.value for entry in entries)) or "none"
        raise MotionRefusedError(f"{needed}; found: {values}", hint="install dynid again")
    made: object = entries[0].load()
    return made
