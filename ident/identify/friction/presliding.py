"""The pre-sliding travel of each motion, from the identification's equations near velocity reversals.

Everything else is held at a model that was estimated; it is estimated again with the travels (`friction_fit`). The
equations away from reversals do not depend on the travel, so that all of them are compared: those that the regression
left out decide.

Friction and torque that repeat over a turn, which only several motions can tell.

Along one motion a low harmonic is confounded with inertia and gravity, and a high one fits the shape of a reversal. So
`--friction auto` tries them with at least `LEAST_MOTIONS` recordings of different motions, each left out in turn. A
term counts that lowers their error, and whose partial F-test rejects chance; the terms of all joints stay if the
consistent model predicts every motion better with them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from drivers.core.arrays import FloatArray
from ident.assessment.validation import LOW_SPEED
from ident.friction.table import OPTIONS, POSITION_KINDS, TERM
from ident.friction.terms import FrictionTerms
from ident.identify.friction.candidates import FOLDS
from ident.identify.friction.selection import FrictionSearch
from ident.model.presliding import DryFriction
from ident.regression.comparison import TorqueSeries
from ident.regression.jackknife import distinct_samples, motion_blocks
from ident.result.friction import FrictionStep
from ident.result.schema import PreslidingTravel
from ident.signals.filters import ZeroPhaseFilter
from ident.signals.prepared import Segment

TRAVELS = np.geomspace(1e-5, 1e-2, 31)
"""Travels that are tried [rad or m]; between them the cost is a parabola over their logarithm.

The least error at either end is no presliding: static friction does as well, or another model error takes its place.
"""

Run = tuple[Sequence[Segment], ZeroPhaseFilter]
"""Segments of a recording and the filter of its torques."""


def find_travels(dry: DryFriction, runs: Sequence[Run], series: Sequence[TorqueSeries]) -> tuple[PreslidingTravel, ...]:
    """The travels by which Dahl's model leaves least of the residuals; motions one after the other.

    Args:
        dry: dry friction of the identified model.
        runs: the identification data.
        series: their torques without presliding, a series per segment.
    """
    motion = motion_blocks(series)
    blocks, count = motion.of_segments, motion.count
    segments = [(segment, run_filter) for of_run, run_filter in runs for segment in of_run]
    conditions = [dry.conditions(segment.position) for segment, _ in segments]
    residuals = [np.where(np.isfinite(part.residual), part.residual, 0.0) for part in series]
    travels = []
    for name in dry.columns:
        motors, costs, changes = dry.motors(name), np.zeros((len(TRAVELS), count)), []
        for (segment, run_filter), given, part, residual, of_block in zip(
            segments, conditions, series, residuals, blocks, strict=True
        ):
            change = dry.change(name, TRAVELS, segment.velocity, segment.rate, given)
            counted = (part.counted & np.isfinite(part.predicted))[motors]
            filtered = run_filter.apply(change.reshape(-1, change.shape[-1])).reshape(*change.shape[:2], -1)
            filtered = np.where(counted, filtered, 0.0)
            gain = np.sum(filtered * (filtered - 2.0 * residual[motors]), axis=1)
            costs += np.array([np.bincount(of_block[part.used], row[part.used], count) for row in gain])
            changes.append(filtered)
        place = _least(costs.sum(axis=1))
        without_each = [_least(costs.sum(axis=1) - block) for block in costs.T]
        held_out = sum(block[round(other)] for block, other in zip(costs.T, without_each, strict=True))
        if place in (0.0, len(TRAVELS) - 1.0) or held_out >= 0.0:
            continue
        for residual, filtered in zip(residuals, changes, strict=True):
            residual[motors] -= filtered[round(place)]
        step = np.log(TRAVELS[1] / TRAVELS[0])
        deviation = np.sqrt((count - 1) / count * np.sum(np.square(np.array(without_each) - place)))
        travel = float(TRAVELS[0] * np.exp(step * place))
        travels.append(PreslidingTravel(parameter=name, travel=travel, std=float(step * deviation * travel)))
    return tuple(travels)


def low_speed_error(series: Sequence[TorqueSeries]) -> float:
    """Relative error of the torques of joints slower than `LOW_SPEED`; nan where there is none."""
    squares = np.zeros(2)
    for part in series:
        slow = part.counted & np.isfinite(part.predicted) & (np.abs(part.velocity) < LOW_SPEED)
        squares += np.sum(np.square(part.residual[slow])), np.sum(np.square(part.measured[slow]))
    return float(np.sqrt(squares[0] / squares[1])) if squares[1] > 0 else float("nan")


def _least(costs: FloatArray) -> float:
    """Index, between whole ones, of the least of costs over `TRAVELS`."""
    least = int(np.argmin(costs))
    if not 0 < least < len(costs) - 1:
        return float(least)
    before, at, after = costs[least - 1 : least + 2]
    return least + 0.5 * float(before - after) / float(before - 2.0 * at + after)


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
