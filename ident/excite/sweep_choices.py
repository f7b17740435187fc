"""The options of a motion for friction."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.core.ranges import Range, check_option

SMALLEST_STROKE = 0.1
"""Shorter strokes [rad or m] pass too few positions to tell gravity from friction."""

STROKE = Range(SMALLEST_STROKE, 12.0, "rad or m")
SPEED = Range(1e-3, 20.0, "rad/s or m/s")
SPEEDS = Range(2, 30)


@dataclass(frozen=True)
class SweepChoices:
    """What a user may choose.

    Attributes:
        joints: that move, one after the other; all where empty.
        pose: of the other joints, by its name in the robot file; its first, or the middle of the ranges, if None.
        stroke: of each joint, halved until it is free [rad or m].
        slowest: peak of the slowest stroke [rad/s or m/s].
        speeds: number of peak speeds up to what the limits allow, in equal ratios.
    """

    joints: tuple[str, ...] = ()
    pose: str | None = None
    stroke: float = 1.2
    slowest: float = 0.2
    speeds: int = 6

    def __post_init__(self) -> None:
        check_option("--stroke", self.stroke, STROKE)
        check_option("--slowest", self.slowest, SPEED)
        check_option("--speeds", self.speeds, SPEEDS)
