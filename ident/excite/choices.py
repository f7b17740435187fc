"""Options of an excitation design."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Kind = Literal["fourier", "fourier-quintic", "sines", "points"]
CriterionName = Literal[
    "condition", "plain-condition", "moments", "d-optimal", "e-optimal", "hadamard", "deviations", "motion-size"
]


DEFAULT_SECONDS = 20.0
"""Default duration of the search [s]."""

DEFAULT_MARGIN = 0.1
"""Share of every limit kept free: late commands make the played path faster than the designed one."""


@dataclass(frozen=True)
class DesignChoices:
    """Options of the design.

    Attributes:
        kind: form of the motion.
        criterion: that is minimised.
        harmonics: of a Fourier series, or number of sines of a sum of sines.
        points: of a point-to-point motion.
        period: of one repetition [s]; the duration of sums of sines and of point-to-point motions.
        periods: repetitions.
        ramp: from rest to full speed [s].
        moving: names of the joints that move; all where None. The others rest in the middle of their range.
        loaded: design for the ten parameters of the last link, which a payload changes, all others being known.
        margin: share of every limit kept free.
        self_collision: whether collisions between links are checked.
        moment_weights: W1, W2 of AUBO eq. 21.
    """

    kind: Kind = "fourier"
    criterion: CriterionName = "d-optimal"
    harmonics: int = 5
    points: int = 12
    period: float = 10.0
    periods: int = 1
    ramp: float = 2.0
    moving: tuple[str, ...] | None = None
    loaded: bool = False
    margin: float = DEFAULT_MARGIN
    self_collision: bool = True
    moment_weights: tuple[float, float] = (1.0, 1.0)
