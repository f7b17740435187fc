"""What each quantity can sensibly be: one table of ranges for files, options and recordings.

A number outside them is a mistake (of unit, of an exponent), and would overflow, or take for ever, further on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from drivers.core.errors import UsageError


@dataclass(frozen=True)
class Range:
    """The values that a quantity can have."""

    least: float  # smallest value, in `unit`
    most: float  # largest value, in `unit`
    unit: str = ""  # as messages write it; empty for a count

    def holds(self, value: float) -> bool:
        """Return whether a number is within; NaN is not."""
        return self.least <= value <= self.most

    def __str__(self) -> str:
        return f"{self.least:g} to {self.most:g} {self.unit}".rstrip()


# A turn's and seven turns' worth; limits in degrees are mostly larger.
TABLE_ANGLE = Range(-2 * math.pi * (1 + 1e-5), 2 * math.pi * (1 + 1e-5), "rad")
"""A frame is turned by one turn at most; rounded digits of 2π are allowed."""
POSITION_LIMIT = Range(-45.0, 45.0, "rad or m")
"""Seven turns: hardly a joint goes further. What is written as a multiple of pi is in radians, whatever its size."""
VELOCITY_LIMIT = Range(0.0, 75.0, "rad/s or m/s")
"""4300 °/s; the last joint of a quick SCARA turns at 3000 °/s, and arms' limits in °/s are mostly larger."""
JOINTS = Range(1, 50)
"""Joints of an arm, followers included; base parameters of 50 take 12 s and 0.9 GB, those of 300 over 20 GB."""
LENGTH = Range(-100.0, 100.0, "m")
"""Lengths of links, tools and the surroundings; a gantry may be some 10 m long."""
NUMBER = Range(-1e9, 1e9)
"""Numbers of a robot file, where nothing narrower is known."""
POSITIVE = Range(1e-12, 1e9)
"""The same where 0 makes no sense, as of a resolution or a capacity."""
MASS = Range(0.0, 1e5, "kg")
PAYLOAD = Range(1e-3, 1e4, "kg")
"""What an arm lifts; the strongest ones lift 2.3 t."""
INERTIA = Range(-1e6, 1e6, "kg·m²")

STAMP = Range(-1e11, 1e11, "s")
"""Seconds since 1970 are 2e9; beyond 1e11 a double cannot tell samples of 20 µs apart."""
SAMPLING_RATE = Range(1.0, 20_000.0, "Hz")
"""Sampling rates of a robot arm's recordings; beyond them the stamps are probably not in seconds."""

DELAY = Range(-60.0, 60.0, "s")
EXPONENT = Range(0.05, 4.0)
"""Exponent of the velocity in viscous friction; measured ones lie between 0.3 and 1.5."""
STRIBECK_VELOCITY = Range(1e-4, 10.0, "rad/s or m/s")
"""Where the Stribeck term has fallen to 1/e; of gears mostly 0.01 to 0.5 rad/s."""

COEFFICIENTS = Range(1, 1000)
"""Harmonics or sines of a joint in a trajectory file; the check of the limits of 13,000 takes a minute and 4 GB."""
PIECE = Range(1e-3, 86_400.0, "s")
"""Duration of a move, or of a whole motion. Shorter than a command period it would be a step, and no check of limits on
floating-point times could tell where."""
SAMPLE_STEP = Range(1e-4, 86_400.0, "s")
"""Between samples of a trajectory."""
PERIOD = Range(0.1, 3600.0, "s")
"""Period of an excitation trajectory."""
RECORDING_TIME = Range(1e-3, 604_800.0, "s")


def check_option(option: str, value: float, allowed: Range, hint: str = "") -> None:
    """Refuse an option's value out of its range.

    Raises:
        UsageError: names the option, its value and what is allowed.
    """
    if not allowed.holds(value):
        raise UsageError(f"{option} {value:g} is not within {allowed}", hint=hint)
