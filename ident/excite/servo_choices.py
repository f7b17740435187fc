"""The options of a motion for a servo model."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from drivers.core.options import Options, option
from drivers.core.ranges import Range
from ident.excite.choices import DEFAULT_MARGIN
from ident.ranges import SEED

LENGTH = 60.0
"""[s] Default length of a motion for a servo model."""

WANTED = 10.0
"""[%] Default half-width of the intervals that are enough."""


@dataclass(frozen=True, kw_only=True)
class ServoMotionLength(Options):
    """How long a motion for a servo model is, and for what."""

    length: float = option(
        LENGTH,
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
class ServoMotionChoices(ServoMotionLength):
    """What a user may choose."""

    margin: float = option(
        DEFAULT_MARGIN,
        "Share of every limit kept free.",
        meaning="share of every limit kept free.",
        allowed=Range(0.0, 0.9),
    )
    seed: int = option(0, "Of poses and phases.", allowed=SEED)
