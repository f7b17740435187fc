"""Instrumental variables (IDIM-IV: Janot, Vandanjon and Gautier, IEEE Trans. Control Syst. Technol. 22, 2014).

Noise of the positions is in W, and makes least squares biased and inconsistent. Instruments Z, the regressor of another
motion that has the same course but not the same noise, take that away: θ solves Zᵀ(τ − W·θ) = 0.

Durbin, Wu and Hausman's test compares it with least squares (Hausman, Econometrica 46, 1978). H0: W is not correlated
with the errors of τ. Then both estimates have the same limit, and their difference is noise of a covariance that the
delete-block jackknife of the difference gives. A quadratic form in it would need many more blocks than parameters; the
largest of the single differences needs none (Bonferroni).
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from drivers.core.arrays import FloatArray
from drivers.core.errors import IdentificationError
from ident.estimators.estimator import Estimation, EstimationLoop, Estimator, Setup
from ident.estimators.method import Method
from ident.estimators.torque_estimator import SystemEstimator, triangular_system
from ident.linear_algebra.triangular import QrAccumulator, triangular
from ident.regression.comparison import TorqueSeries, compare_torques
from ident.regression.hypothesis_tests import LEVEL, p_text
from ident.regression.jackknife import CorrectedCovariance, FilteredRun, jackknife_covariance, motion_blocks
from ident.regression.least_squares import LeastSquares, inverse_deviations, residual_deviations, weighted_least_squares
from ident.regression.moment_equations import MomentRows, SegmentRows, moment_jackknife, moment_moves
from ident.regression.observation_matrix import Reduction
from ident.signals.prepared import Prepared, Segment, Step
from ident.signals.repetition import own_period

WEAKEST = 10.0
"""First-stage F below which instruments are weak: their bias may reach a tenth of least squares' (Staiger and Stock,
Econometrica 65, 1997)."""

DEPENDENT = 1e-9
"""Share of a column-normalised instrument that is left beside the others, below which they depend on each other."""

Source = Iterable[MomentRows]

ITERATIONS = 30
INSTRUMENTS_SETTLED = 0.01
"""Largest change of a parameter, over its classical deviation."""


def target_motions(runs: Sequence[Prepared]) -> list[tuple[Segment, ...]] | None:
    """Segments of each run with the targets' motion; None where a segment has none without a gap."""
    motions = []
    for run in runs:
        segments = []
        for segment in run.segments:
            target = segment.target
            if target is None:
                return None
            segments.append(
                replace(segment, position=target.position, velocity=target.velocity, acceleration=target.acceleration)
            )
        motions.append(tuple(segments))
    return motions


def independent_rows(runs: Sequence[Prepared], rows: int) -> float:
    """Return how many of the filtered equations are independent: two per period of the torques' cut-off."""
    share = np.mean([min(1.0, 2.0 * run.cutoffs.torque / run.filtered_rate) for run in runs])
    return float(share * rows)


def first_stage_f(factor: FloatArray, count: int, rows: float) -> float:
    """F of the weakest combination of W's columns, regressed on as many instruments (Cragg and Donald 1993).

    0 where the instruments depend on each other, as those of a motion that stands still.

    Args:
        factor: triangular factor (2k, 2k) of [Z W].
        count: k.
        rows: independent ones of both.
    """
    lengths = np.linalg.norm(factor, axis=0)
    if not np.all(lengths > 0.0) or np.min(np.abs(np.diag(factor)[:count]) / lengths[:count]) < DEPENDENT:
        return 0.0
    measured = factor[:, count:] / lengths[count:]
    root = triangular(measured)[:count]
    explained = np.linalg.svd(np.linalg.solve(root.T, measured[:count].T), compute_uv=False)[-1] ** 2
    if explained >= 1.0:
        return float("inf")
    return float(explained / (1.0 - explained) * max(0.0, rows - count) / count)


@dataclass(frozen=True)
class ExogeneityTest:
    """The largest difference of two estimates."""

    column: int  # base column of the parameter
    ratio: float  # its difference in the difference's own standard deviations
    p_value: float  # probability of a larger one under H0, of any parameter


def exogeneity_test(
    series: Sequence[TorqueSeries],
    instrumental: tuple[LeastSquares, Sequence[Source]],
    plain: tuple[LeastSquares, Sequence[Source]],
) -> ExogeneityTest:
    """Compare two solutions of the same active columns.

    Args:
        series: measured and predicted torques of every segment.
        instrumental: the solution by instruments, and its equations of every segment.
        plain: that of least squares, and its.

    Raises:
        IdentificationError: the instruments do not follow the regressor.
    """
    from scipy.special import stdtr

    blocks = motion_blocks(series)
    one, other = (moment_moves(blocks, sources, solution) for solution, sources in (instrumental, plain))
    active = list(instrumental[0].active)
    difference = np.abs(instrumental[0].parameters - plain[0].parameters)[active]
    deviation = np.sqrt(np.diag(jackknife_covariance(one - other)))
    ratios = difference / np.maximum(deviation, np.finfo(float).tiny)
    worst = int(np.argmax(ratios))
    p_value = min(1.0, 2.0 * len(active) * float(stdtr(len(one) - 1, -ratios[worst])))
    return ExogeneityTest(active[worst], float(ratios[worst]), p_value)


@dataclass(frozen=True)
class IvOptions:
    """Options of instrumental variables."""

    instruments: Annotated[
        Literal["auto", "repetition", "target"],
        Field(
            description="motion of the instruments: another repetition of the recorded one, or the recorded target "
            "positions; auto uses the first that exists"
        ),
    ] = "auto"


@dataclass(frozen=True, eq=False)
class _Source:
    """Source of the instruments."""

    words: str  # for the list of steps
    motions: list[tuple[Segment, ...]]  # of each run, its segments with the motion of the instruments
    factors: list[FloatArray]  # of each joint, the triangular factor of [Z W τ]


@dataclass(frozen=True, eq=False, kw_only=True)
class InstrumentalEstimation(Estimation):
    """An estimate with its instruments."""

    instruments: tuple[tuple[Segment, ...], ...]  # of each run, its segments with the motion of the instruments


def repeated_segment(segment: Segment) -> Segment | None:
    """The segment with the motion of one period later, of one period earlier in the last; None where none repeats."""
    period = own_period(segment.velocity)
    if period is None:
        return None
    count = len(segment.time)
    place = np.arange(count) + period
    place = np.where(place < count, place, place - 2 * period)
    # Less than two periods: what has no partner later and none earlier stays itself.
    place = np.where(place >= 0, place, np.arange(count))
    return replace(
        segment,
        position=segment.position[:, place],
        velocity=segment.velocity[:, place],
        acceleration=segment.acceleration[:, place],
        used=segment.used & (place != np.arange(count)),
    )


@dataclass(frozen=True)
class InstrumentalEstimator(SystemEstimator):
    """Instrumental variables with the joints weighted by their residuals."""

    options: IvOptions  # where the instruments come from

    def estimate(self, runs: Sequence[Prepared], plain: Reduction, active: Sequence[int]) -> Estimation:
        """Weights and parameters follow each other, iterated."""
        ordinary = self.solve(plain, active)
        reduction, solution = plain, ordinary
        source = self._source(runs, plain, solution)
        changes: list[float] = []
        while len(changes) < ITERATIONS and (not changes or changes[-1] > INSTRUMENTS_SETTLED):
            weights = inverse_deviations(plain, residual_deviations(plain, solution.parameters, len(solution.active)))
            system = _triangle(source.factors, plain, weights, active)
            solved = triangular_system(
                plain, system[: len(active), len(active) :], weights, active, "iv", len(changes) + 1
            )
            moved = np.abs(solved.solution.parameters - solution.parameters)[list(active)]
            changes.append(float(np.max(moved / solved.solution.std[list(active)])))
            reduction, solution = solved.reduction, solved.solution
        strength = _strength(system, active, independent_rows(runs, plain.rows))
        return InstrumentalEstimation(
            self.setup.kernel,
            reduction,
            solution,
            (EstimationLoop("weights", "σ", tuple(changes), changes[-1] <= INSTRUMENTS_SETTLED),),
            passes=1 + 2 + 5,
            steps=(_step(source, strength), self._exogeneity(runs, source.motions, solution, ordinary)),
            instruments=tuple(source.motions),
        )

    def _exogeneity(
        self,
        runs: Sequence[Prepared],
        motions: Sequence[Sequence[Segment]],
        solution: LeastSquares,
        ordinary: LeastSquares,
    ) -> Step:
        """Test whether least squares differs by more than noise."""
        kernel = self.setup.kernel
        series = [
            compared
            for run in runs
            for compared in compare_torques(
                kernel.model, kernel.columns, solution.parameters, run.segments, run.parallel_filter
            )
        ]
        pairs = [
            (
                SegmentRows(kernel, segment, run.parallel_filter, other),
                SegmentRows(kernel, segment, run.parallel_filter),
            )
            for run, others in zip(runs, motions, strict=True)
            for segment, other in zip(run.segments, others, strict=True)
        ]
        test = exogeneity_test(series, (solution, [pair[0] for pair in pairs]), (ordinary, [pair[1] for pair in pairs]))
        verdict = "the regressor's noise biases wls" if test.p_value < LEVEL else "not statistically significant"
        text = (
            f"wls differs by up to {test.ratio:.3g} σ of the difference ({self.setup.base.names[test.column]}), "
            f"{p_text(test.p_value)} (Durbin, Wu, Hausman): {verdict}"
        )
        return Step("exogeneity", {"largest_ratio": test.ratio, "p_value": test.p_value}, text)

    def covariance(self, runs: Sequence[FilteredRun], estimation: Estimation) -> CorrectedCovariance:
        """Delete-block jackknife, the instruments held."""
        assert isinstance(estimation, InstrumentalEstimation)
        sources = [
            SegmentRows(estimation.kernel, segment, run.parallel_filter, instruments)
            for run, motions in zip(runs, estimation.instruments, strict=True)
            for segment, instruments in zip(run.segments, motions, strict=True)
        ]
        return moment_jackknife([torques for run in runs for torques in run.series], sources, estimation.solution)

    def _source(self, runs: Sequence[Prepared], plain: Reduction, solution: LeastSquares) -> _Source:
        """The first motion in the order of `auto` that instruments can be made of.

        Raises:
            IdentificationError: there is none of the kind that was asked for, or it makes weak instruments.
        """
        wanted, weak = self.options.instruments, ""
        if wanted in ("auto", "repetition") and (repeated := _repetitions(runs)) is not None:
            return _Source("the same motion one period later", repeated, self._factors(runs, repeated, plain))
        if wanted == "repetition":
            raise IdentificationError(
                "a recorded motion does not repeat itself without a gap",
                hint="record two periods or more, or use --method wls",
            )
        targets = target_motions(runs)
        if targets is not None:
            factors = self._factors(runs, targets, plain)
            system = _triangle(factors, plain, solution.weights, solution.active)
            strength = _strength(system, solution.active, independent_rows(runs, plain.rows))
            if strength >= WEAKEST:
                return _Source("the motion of the recorded target positions", targets, factors)
            weak = f"the recorded target positions make weak instruments (F {strength:.3g}, at least {WEAKEST:g})"
        missing = weak or "a recording holds no target positions of all joints"
        if wanted == "auto":
            missing = f"the motion does not repeat itself without a gap, and {missing}"
        raise IdentificationError(missing, hint="record two periods or more, or use --method wls")

    def _factors(
        self, runs: Sequence[Prepared], motions: Sequence[Sequence[Segment]], plain: Reduction
    ) -> list[FloatArray]:
        """Triangular factors (2k + 1, 2k + 1) of each joint's [Z W τ]."""
        sums = [QrAccumulator(2 * len(joint.columns) + 1) for joint in plain.joints]
        for run, segments in zip(runs, motions, strict=True):
            for segment, instruments in zip(run.segments, segments, strict=True):
                for rows in SegmentRows(self.setup.kernel, segment, run.parallel_filter, instruments):
                    if plain.joints[rows.motor].rows:
                        sums[rows.motor].add(np.vstack([rows.instruments, rows.regressor, rows.torque]))
        return [entry.factor() for entry in sums]


def _repetitions(runs: Sequence[Prepared]) -> list[tuple[Segment, ...]] | None:
    """Shift the segments of each run by one period; None where one does not repeat itself."""
    repeated = [[repeated_segment(segment) for segment in run.segments] for run in runs]
    if any(segment is None for segments in repeated for segment in segments):
        return None
    return [tuple(segment for segment in segments if segment is not None) for segments in repeated]


def _triangle(
    factors: Sequence[FloatArray], plain: Reduction, weights: FloatArray, active: Sequence[int]
) -> FloatArray:
    """Triangular factor (a + b + 1) of [Z W τ] of all joints, weighted; Z has the active columns.

    Its first a rows are W and τ projected on the instruments.
    """
    width = plain.column_count
    blocks = []
    for joint, factor, weight in zip(plain.joints, factors, weights, strict=True):
        columns, count = list(joint.columns), len(joint.columns)
        block = np.zeros((len(factor), 2 * width + 1))
        block[:, columns] = factor[:, :count]
        block[:, [width + column for column in columns]] = factor[:, count : 2 * count]
        block[:, -1] = factor[:, -1]
        blocks.append(weight * block)
    return triangular(np.vstack(blocks)[:, [*active, *range(width, 2 * width + 1)]])


def _strength(system: FloatArray, active: Sequence[int], rows: float) -> float:
    """First-stage F of the active columns."""
    count = len(active)
    chosen = [*range(count), *(count + column for column in active)]
    return first_stage_f(triangular(system[:, chosen]), count, rows)


def _step(source: _Source, strength: float) -> Step:
    """Return what the instruments were, and how strong."""
    text = f"{source.words}; first-stage F of the weakest combination {strength:.3g}"
    return Step("instruments", {"first_stage_f": min(strength, sys.float_info.max)}, text)


def _estimator(options: IvOptions, setup: Setup) -> Estimator:
    return InstrumentalEstimator(setup, weighted_least_squares, options)


METHOD = Method(
    "instrumental variables: the regressor of a repetition or of the targets as instruments",
    "torque",
    IvOptions,
    _estimator,
)
