"""The options of a motion for gravity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from drivers.core.options import Options, option, read_names
from drivers.core.ranges import Range
from ident.excite.choices import DEFAULT_MARGIN
from ident.ranges import SEED

POSES = 20
"""Default number of poses: three to four minutes of most arms."""

FEWEST_POSES = 4


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
class GravityChoices(PoseCount):
    """What a user may choose."""

    joints: Sequence[str] | None = option(
        None,
        "Joints that move, separated by commas; the others rest.",
        meaning="names of the joints that move; all where None. The others rest in the middle of their range.",
        read=read_names,
    )
    margin: float = option(
        DEFAULT_MARGIN,
        "Share of every limit kept free.",
        meaning="share of every position range kept free, at both ends together.",
        allowed=Range(0.0, 0.9),
    )
    seed: int = option(0, "Of the candidate poses.", allowed=SEED)
