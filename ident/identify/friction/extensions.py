"""Extensions of the friction model: presliding, terms that repeat over a turn, and whether further terms are worth it.

All are tried on a model that was estimated. Torque that repeats over a turn needs several motions: along one of them a
low harmonic is confounded with inertia and gravity, and a high one fits the shape of a reversal. Whether further terms
are worth it is judged on the model that is delivered, the physically consistent one: the unconstrained one may turn
friction into what no arm has, and predict well.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from daq.robot.loader import RobotFile
from drivers.core.arrays import FloatArray
from ident.assessment.validation import LOW_SPEED
from ident.estimators.feasible.consistent import found_consistent
from ident.friction.table import OPTIONS, POSITION_KINDS, TERM
from ident.friction.terms import FrictionTerms
from ident.identify.friction.candidates import FOLDS, solve_columns, squared_error
from ident.identify.friction.rows import FrictionRows
from ident.identify.friction.selection import FrictionSearch
from ident.model.base_parameters import BaseParameters
from ident.model.dynamic_model import DynamicModel
from ident.model.presliding import DryFriction
from ident.regression.comparison import TorqueSeries
from ident.regression.estimate import Estimate, estimate_of
from ident.regression.jackknife import distinct_samples, motion_blocks
from ident.regression.least_squares import LeastSquares
from ident.regression.observation_matrix import Reduction
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

LEAST_MOTIONS = 3
"""Different motions that the terms need."""

SAME_SHARE = 0.5
"""A run that repeats a larger share of an earlier one is the same motion, and is left out with it."""

LEVEL = 0.001
"""Significance level of the F-test: of the best of many harmonics, stricter than that of other terms."""

INDEPENDENT_SHARE = 0.3
"""Least share of a torque ripple's length that is independent of the other columns: else it may stand for gravity."""


def find_travels(dry: DryFriction, runs: Sequence[Run], series: Sequence[TorqueSeries]) -> tuple[PreslidingTravel, ...]:
    """The travels by which Dahl's model leaves least of the residuals; motions one after the other.

    Everything else is held; it is estimated again with the travels (`fit`). The equations away from reversals do not
    depend on the travel, so that all are compared, those included that the regression left out.

    Args:
        dry: dry friction of the identified model.
        runs: the identification data.
        series: their torques without presliding, a series per segment.
    """
    motion = motion_blocks(series)
    blocks, count = motion.of_segments, motion.count
    segments = [(segment, run_filter) for of_run, run_filter in runs for segment in of_run]
    conditions = [dry.conditions(segment.position) for segment, _ in segments]
    residuals = [np.where(np.isfinite(torque.residual), torque.residual, 0.0) for torque in series]
    travels = []
    for name in dry.columns:
        motors, costs, changes = dry.motors(name), np.zeros((len(TRAVELS), count)), []
        for (segment, run_filter), given, torque, residual, of_block in zip(
            segments, conditions, series, residuals, blocks, strict=True
        ):
            change = dry.change(name, TRAVELS, segment.velocity, segment.rate, given)
            counted = (torque.counted & np.isfinite(torque.predicted))[motors]
            filtered = run_filter.apply(change.reshape(-1, change.shape[-1])).reshape(*change.shape[:2], -1)
            filtered = np.where(counted, filtered, 0.0)
            gain = np.sum(filtered * (filtered - 2.0 * residual[motors]), axis=1)
            costs += np.array([np.bincount(of_block[torque.used], row[torque.used], count) for row in gain])
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
    for torque in series:
        slow = torque.counted & np.isfinite(torque.predicted) & (np.abs(torque.velocity) < LOW_SPEED)
        squares += np.sum(np.square(torque.residual[slow])), np.sum(np.square(torque.measured[slow]))
    return float(np.sqrt(squares[0] / squares[1])) if squares[1] > 0 else float("nan")


def _least(costs: FloatArray) -> float:
    """Index, between whole ones, of the least of costs over `TRAVELS`."""
    least = int(np.argmin(costs))
    if not 0 < least < len(costs) - 1:
        return float(least)
    before, at, after = costs[least - 1 : least + 2]
    return least + 0.5 * float(before - after) / float(before - 2.0 * at + after)


def motion_folds(series: Sequence[TorqueSeries], segments: Sequence[int]) -> list[npt.NDArray[np.int64]]:
    """Fold (M,) of the filtered samples of each segment: its motion, counted from 0; a seventh is with the first.

    Args:
        series: of all segments, a run after the other.
        segments: number of them per run.
    """
    indices = distinct_samples(series).indices
    motions: list[set[int]] = []
    folds: list[npt.NDArray[np.int64]] = []
    for count in segments:
        own = indices[len(folds) : len(folds) + count]
        places = {int(place) for segment in own for place in segment}
        shared = [len(places & earlier) for earlier in motions]
        if places and max(shared, default=0) > SAME_SHARE * len(places):
            motion = int(np.argmax(shared))
            motions[motion] |= places
        else:
            motion = len(motions)
            motions.append(places)
        folds += [np.full(len(segment), motion % FOLDS) for segment in own]
    return folds


def choose_position_terms(
    search: FrictionSearch, motors: Sequence[int], terms: FrictionTerms, names: Sequence[str], level: float
) -> list[FrictionStep]:
    """Add terms to each motor until none counts; the steps that were tried.

    Each motion is left out in turn. A term counts that lowers their error, and whose partial F-test rejects chance.

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


def delivered_errors(
    rows: FrictionRows,
    model: DynamicModel,
    base: BaseParameters,
    reduction: Reduction,
    solution: LeastSquares,
    robot_file: RobotFile,
    weights: FloatArray,
    folds: Sequence[npt.NDArray[np.int64]],
) -> FloatArray:
    """Squared error (FOLDS,) of the consistent model on each block of the data that it was not fitted to.

    All equations of motors that move count, velocity reversals included.

    Args:
        rows: the data.
        model: with its friction settled.
        base: its base parameters.
        reduction: its system on all data.
        solution: of it.
        robot_file: for the consistent model.
        weights: (n,) of the motors' equations; the same for models that are compared.
        folds: block (M,) of each filtered sample, an array per segment of all runs; the error of an empty one is 0.
    """
    sums = rows.fold_sums(model, base, folds)
    fitted = np.einsum("m,fmij->fij", np.square(weights), sums.fitted)
    compared = np.einsum("m,fmij->fij", np.square(weights), sums.compared)
    count = max(1, solution.rows - len(solution.active))
    whole = estimate_of(reduction, solution, np.eye(len(solution.active)), FOLDS)
    errors = []
    for own, judged in zip(fitted, compared, strict=True):
        if not np.any(own):  # fewer runs than folds
            errors.append(0.0)
            continue
        rest = fitted.sum(axis=0) - own
        values = solve_columns(rest, solution.active)
        if values is None:
            return np.full(FOLDS, np.inf)
        consistent = found_consistent(model, base, _estimate(rest, values, whole, count), robot_file)
        errors.append(squared_error(judged, values if consistent is None else consistent.base))
    return np.array(errors)


def falls(before: FloatArray, after: FloatArray) -> bool:
    """Whether errors (FOLDS,) on held-out blocks fall on average by more than the standard error of that average.

    The one-standard-error rule: of models that predict alike, the simpler one (Breiman et al., Classification and
    Regression Trees, 1984, §3.4.3).
    """
    if not np.all(np.isfinite(after)):
        return False
    gain = before - after
    return bool(np.mean(gain) > np.std(gain, ddof=1) / np.sqrt(len(gain)))


def _estimate(gram: FloatArray, values: FloatArray, whole: Estimate, count: int) -> Estimate:
    """The estimate (b,) that a Gram matrix (b + 1, b + 1) gives, with `whole`'s unexcited parameters."""
    active = list(whole.active)
    deviation = np.sqrt(max(squared_error(gram, values) / count, np.finfo(float).tiny))
    root = np.linalg.cholesky(gram[np.ix_(active, active)]).T / deviation
    covariance = np.linalg.inv(root.T @ root)
    return Estimate(whole.active, values[active], root, covariance, whole.absorbed, FOLDS)
