"""The options of motions for one purpose: friction, gravity, a servo model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from drivers.core.options import Options, option, read_names
from drivers.core.ranges import Range
from ident.excite.choices import DEFAULT_MARGIN
from ident.ranges import SEED

SMALLEST_STROKE = 0.1
"""Shorter strokes [rad or m] pass too few positions to tell gravity from friction."""

POSES = 20
"""Default number of poses: three to four minutes of most arms."""

FEWEST_POSES = 4

SERVO_LENGTH = 60.0
"""[s] Default length of a motion for a servo model."""

WANTED = 10.0
"""[%] Default half-width of the intervals that are enough."""


@dataclass(frozen=True, kw_only=True)
class MarginAndSeed(Options):
    """What motions of random poses share."""

    margin: float = option(
        DEFAULT_MARGIN,
        "Share of every limit kept free.",
        meaning="share of every limit kept free; of position ranges at both ends together.",
        allowed=Range(0.0, 0.9),
    )
    seed: int = option(0, "Of poses and phases.", allowed=SEED)


@dataclass(frozen=True, kw_only=True)
class SweepChoices(Options):
    """Options of a motion for friction: slow strokes of one joint after the other."""

    joints: Sequence[str] = option(
        (),
        "Joints that move, separated by commas; all if absent.",
        meaning="joints that move, one after the other; all where empty.",
        read=read_names,
    )
    pose: str | None = option(
        None,
        "Pose of the robot file that the other joints rest in; its first.",
        meaning="of the other joints, by its name in the robot file; its first, or the middle of the ranges, if None.",
    )
    stroke: float = option(
        1.2,
        "Of each joint [rad or m].",
        meaning="of each joint, halved until it is free [rad or m].",
        allowed=Range(SMALLEST_STROKE, 12.0, "rad or m"),
    )
    slowest: float = option(
        0.2,
        "Peak of the slowest stroke [rad/s, m/s].",
        allowed=Range(1e-3, 20.0, "rad/s or m/s"),
    )
    speeds: int = option(
        6,
        "Number of peak speeds up to the limits.",
        meaning="number of peak speeds up to what the limits allow, in equal ratios.",
        allowed=Range(2, 30),
    )


@dataclass(frozen=True, kw_only=True)
class PoseCount(Options):
    """How many poses a motion for gravity has."""

    poses: int = option(
        POSES,
        "With --for gravity: number of poses.",
        meaning="number of poses; the first one is visited again at the end.",
        allowed=Range(FEWEST_POSES, 100),
        panel="",
    )


@dataclass(frozen=True, kw_only=True)
class GravityChoices(PoseCount, MarginAndSeed):
    """Options of a motion for gravity."""

    joints: Sequence[str] | None = option(
        None,
        "Joints that move, separated by commas; the others rest.",
        meaning="names of the joints that move; all where None. The others rest in the middle of their range.",
        read=read_names,
    )


@dataclass(frozen=True, kw_only=True)
class ServoMotionLength(Options):
    """How long a motion for a servo model is, and for what."""

    length: float = option(
        SERVO_LENGTH,
        "With --for servo: longest motion [s].",
        meaning="longest motion [s].",
        allowed=Range(15.0, 600.0),
        panel="",
    )
    after: str | Path | None = option(
        None,
        "With --for servo: model folder to continue; designs for the parameters that are still wide.",
        meaning="folder or result.json of a servo model; the motion narrows its parameters that are still wide.",
        command_type=Path,
        panel="",
    )
    wanted: float = option(
        WANTED,
        "With --after: half-width of 95 % intervals that is enough [%].",
        meaning="half-width of 95 % intervals that is enough [%].",
        allowed=Range(0.5, 100.0),
        panel="",
    )


@dataclass(frozen=True, kw_only=True)
class ServoMotionChoices(ServoMotionLength, MarginAndSeed):
    """Options of a motion for a servo model."""
