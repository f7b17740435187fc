"""The options of a motion for friction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from drivers.core.options import Options, option, read_names
from drivers.core.ranges import Range

SMALLEST_STROKE = 0.1
"""Shorter strokes [rad or m] pass too few positions to tell gravity from friction."""


@dataclass(frozen=True, kw_only=True)
class SweepChoices(Options):
    """What a user may choose."""

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
