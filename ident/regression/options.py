"""The user's choices about the equations of an identification, and about the essential parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal, get_args

from drivers.core.options import Options, option, read_names
from drivers.core.ranges import Range

REST_TOLERANCE = 5e-3
"""Default range [rad or m] within which a joint counts as locked.

A joint on its brake sags by the backlash of its gear, some milliradians, while others move. Assumed fixed half a
tolerance away, a moment of gravity of 100 N·m is off by 0.25 N·m, less than residuals are; a joint that is meant to
move does so over a hundred times as much."""

REVERSAL_SHARE = 0.05
"""Share of a velocity's root mean square: below it a motor is near a reversal, and its equation is left out by default
(docs/identification.md has the figures)."""

SIGNIFICANT_RSD = 15.0
"""Relative standard deviation [%] at and above which a parameter is not significant (SR400 .4.3 point 5)."""

PERCENT = Range(1e-3, 100.0, "%")
"""A standard deviation relative to its parameter: wanted, or a threshold of significance."""

EssentialRule = Literal["rsd", "f-test"]
"""What ends the elimination: SR400's threshold of the relative standard deviation, or AUBO's F-test."""


@dataclass(frozen=True, kw_only=True)
class EssentialOptions(Options):
    """Choice of the parameters that leave the essential model."""

    PANEL: ClassVar[str] = "Essential model"

    essential: EssentialRule = option(
        "rsd",
        "Criterion for dropping parameters from the essential model: rsd (--significance) or f-test.",
        meaning='what ends the elimination of parameters from the essential model: "rsd" removes those whose relative '
        'standard deviation reaches `significance` (SR400), "f-test" those without a significant partial F (AUBO).',
        one_of=get_args(EssentialRule),
    )
    significance: float = option(
        SIGNIFICANT_RSD, "Threshold of the relative standard deviation [%].", allowed=PERCENT, hint="the papers use 15"
    )


@dataclass(frozen=True, kw_only=True)
class ExperimentChoices(Options):
    """A user's description of the experiment: joints at rest, and motors whose torques are used."""

    PANEL: ClassVar[str] = "Samples"

    locked: Sequence[str] = option(
        (),
        "Joints that must not move; other joints at rest are detected from the data.",
        metavar="A,B,…",
        read=read_names,
    )
    torques_of: Sequence[str] = option(
        (), "Joints whose motor torques are used; default: all moving motors.", metavar="A,B,…", read=read_names
    )
    rest_tolerance: float = option(
        REST_TOLERANCE, "A joint that stays within this range [rad or m] counts as locked; default 0.005."
    )


@dataclass(frozen=True, kw_only=True)
class ReversalOptions(Options):
    """What becomes of equations near velocity reversals."""

    PANEL: ClassVar[str] = "Samples"

    reversals: float | None = option(
        None,
        "Leave out velocity reversals: motors slower than this share of their RMS velocity; default 0.05, 0 for none.",
        allowed=Range(0.0, 0.99),
    )
    presliding: bool = option(
        True, "Let dry friction change over a travel at velocity reversals.", flag="--presliding/--no-presliding"
    )
