"""Friction and torque that repeat over a turn, which only several motions can tell.

Along one motion a low harmonic is confounded with inertia and gravity, and a high one fits the shape of a reversal. So
`--friction auto` tries them with at least `LEAST_MOTIONS` recordings of different motions, each left out in turn. A
term counts that lowers their error, and whose partial F-test rejects chance; the terms of all joints stay if the
consistent model predicts every motion better with them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ident.friction.table import OPTIONS, POSITION_KINDS, TERM
from ident.friction.terms import FrictionTerms
from ident.identify.friction.candidates import FOLDS
from ident.identify.friction.selection import FrictionSearch
from ident.regression.comparison import TorqueSeries
from ident.regression.jackknife import distinct_samples
from ident.result.friction import FrictionStep

LEAST_MOTIONS = 3
"""Different motions that the terms need."""

SAME_SHARE = 0.5
"""A run that repeats a larger share of an earlier one is the same motion, and is left out with it."""

LEVEL = 0.001
"""Significance level of the F-test: of the best of many harmonics, stricter than that of other terms."""

INDEPENDENT_SHARE = 0.3
"""Least share of a torque ripple's length that is independent of the other columns: else it may stand for gravity."""


def motion_folds(series: Sequence[TorqueSeries], segments: Sequence[int]) -> list[npt.NDArray[np.int64]]:
    """Fold (M,) of the filtered samples of each segment: its motion, counted from 0; a seventh is with the first.

    Args:
        series: of all segments, a run after the other.
        segments: number of them per run.
    """
    indices = distinct_samples(series).indices
    known: list[set[int]] = []
    folds: list[npt.NDArray[np.int64]] = []
    for count in segments:
        own = indices[len(folds) : len(folds) + count]
        places = {int(place) for one in own for place in one}
        shared = [len(places & earlier) for earlier in known]
        if places and max(shared, default=0) > SAME_SHARE * len(places):
            motion = int(np.argmax(shared))
            known[motion] |= places
        else:
            motion = len(known)
            known.append(places)
        folds += [np.full(len(one), motion % FOLDS) for one in own]
    return folds


def choose_position_terms(
    search: FrictionSearch,
    motors: Sequence[int],
    terms: FrictionTerms,
    names: Sequence[str],
    level: float,
) -> list[FrictionStep]:
    """Add terms to each motor until none counts; the steps that were tried.

    Args:
        search: on the candidates that depend on the position, by motion.
        motors: that may get terms.
        terms: that they have.
        names: of all joints.
        level: of the F-test.
    """
    steps: list[FrictionStep] = []
    for motor in motors:
        words = [
            option.word
            for option in OPTIONS
            if option.kinds[0] in POSITION_KINDS
            and terms.option(option.group, motor) is None
            and (TERM[option.kinds[0]].rubs or not search.confounded(motor, option.word, INDEPENDENT_SHARE))
        ]
        steps += search.choose(motor, names[motor], words, level)
    return steps
