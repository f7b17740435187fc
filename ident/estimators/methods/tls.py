"""Total least squares with the errors of W and τ as the data show them (Golub and Van Loan 1980; Van Huffel 1991).

The noise of the positions is what is left above the band of the motion and its harmonics. It is taken as white before
the filter, as an encoder's steps are. A realisation of the same noise through the same filter and derivatives, added to
the motion, shows the errors of the columns of W and how they depend on each other: velocities and accelerations share
them, and a column's error depends on the motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from drivers.core.arrays import FloatArray
from drivers.core.errors import IdentificationError
from ident.estimators.estimator import Estimation, EstimationLoop, Estimator, Setup
from ident.estimators.method import Method, NoOptions
from ident.estimators.torque_estimator import SystemEstimator, triangular_system
from ident.linear_algebra.triangular import gram_root
from ident.model.regressor import RegressorKernel
from ident.regression.jackknife import CorrectedCovariance, FilteredRun
from ident.regression.least_squares import inverse_deviations, residual_deviations, weighted_least_squares
from ident.regression.moment_equations import SegmentRows, moment_jackknife
from ident.regression.observation_matrix import Reduction, filtered_samples
from ident.regression.total_least_squares import total_least_squares
from ident.signals.cutoffs import choose_cutoffs
from ident.signals.filters import butterworth
from ident.signals.options import PreprocessChoices
from ident.signals.prepared import Prepared, Segment
from ident.signals.segments import central_difference

END_PERIODS = 4.0
"""Periods of the motion's highest harmonic at both ends of a segment, where the filter's end dominates."""

LEAST_BAND = 1.5
"""The positions' cut-off must be this many times the motion's and its harmonics' for noise to show between them."""

ITERATIONS = 50
SETTLED_CHANGE = 1e-6
LEAST_TORQUE_NOISE = 0.01
"""Share of the residual that counts as noise of the torque at least."""


def noise_deviations(run: Prepared) -> FloatArray:
    """Standard deviation (n,) of the positions' white noise before filtering [rad or m].

    Raises:
        IdentificationError: the positions' cut-off leaves no band without motion.
    """
    rate = run.segments[0].rate
    harmonics = choose_cutoffs(run.cutoffs.band, rate, PreprocessChoices()).torque
    if run.cutoffs.position < LEAST_BAND * harmonics:
        raise IdentificationError(
            f"positions low-passed at {run.cutoffs.position:.3g} Hz show no noise beyond a motion with harmonics up to "
            f"{harmonics:.3g} Hz",
            hint=f"give --position-cutoff {2.0 * harmonics:.3g}, or use --method wls",
        )
    low = butterworth(harmonics, rate)

    edge = round(END_PERIODS * rate / harmonics)

    def above(position: FloatArray, used: npt.NDArray[np.bool_]) -> FloatArray:
        return np.asarray((position - low.apply(position))[:, edge:-edge][:, used[edge:-edge]])

    measured = [above(segment.position, segment.used) for segment in run.segments]
    generator = np.random.default_rng(0)
    white = [above(_band_limited(run, segment, generator), segment.used) for segment in run.segments]
    if not sum(row.shape[1] for row in measured):
        raise IdentificationError(
            f"no segment is longer than {2.0 * END_PERIODS / harmonics:.3g} s, so the position noise cannot be "
            "measured",
            hint="record without gaps, or use --method wls",
        )
    squares, units = (sum(np.sum(block**2, axis=1) for block in parts) for parts in (measured, white))
    return np.asarray(np.sqrt(squares / units))


def _band_limited(run: Prepared, segment: Segment, generator: np.random.Generator) -> FloatArray:
    """White noise of unit deviation (n, N) through the positions' low-pass."""
    white = generator.standard_normal(segment.position.shape)
    return butterworth(run.cutoffs.position, segment.rate).apply(white)


def regressor_noise(
    kernel: RegressorKernel, run: Prepared, deviations: FloatArray, plain: Reduction
) -> list[FloatArray]:
    """Expected Gram matrix (k, k) of the errors of each joint's columns of W, from one realisation.

    Args:
        kernel: of the base columns.
        run: its data.
        deviations: (n,) of the positions' noise [rad or m].
        plain: names each joint's columns.
    """
    grams = [np.zeros((len(joint.columns), len(joint.columns))) for joint in plain.joints]
    generator = np.random.default_rng(1)
    for segment in run.segments:
        position = deviations[:, None] * _band_limited(run, segment, generator)
        velocity = central_difference(position, segment.rate)
        noisy = replace(
            segment,
            position=segment.position + position,
            velocity=segment.velocity + velocity,
            acceleration=segment.acceleration + central_difference(velocity, segment.rate),
        )
        nothing = np.empty((0, len(segment.time)))
        of_both = (filtered_samples(kernel, version, run.parallel_filter, nothing) for version in (segment, noisy))
        for clean, other in zip(*of_both, strict=True):
            for motor, rows in enumerate(kernel.joint_rows):
                counts = clean.counts(motor)
                error = other.regressor[rows.rows][:, counts] - clean.regressor[rows.rows][:, counts]
                grams[motor] += error @ error.T
    return grams


@dataclass(frozen=True, eq=False, kw_only=True)
class TlsEstimation(Estimation):
    """An estimate with what was taken off the normal matrix."""

    correction: FloatArray  # (b, b) λ·C, weighted


@dataclass(frozen=True)
class TlsEstimator(SystemEstimator):
    """Total least squares: the errors of W's columns from the positions' noise, those of τ from the residual."""

    def estimate(self, runs: Sequence[Prepared], plain: Reduction, active: Sequence[int]) -> Estimation:
        """Weights and noise of the torque follow from the residual, iterated."""
        kernel = self.setup.kernel
        of_runs = [regressor_noise(kernel, run, noise_deviations(run), plain) for run in runs]
        noise = [sum(parts) for parts in zip(*of_runs, strict=True)]
        solution = self.solve(plain, active)
        parameters, weights, columns = solution.parameters, solution.weights, list(active)
        changes: list[float] = []
        while len(changes) < ITERATIONS and (not changes or changes[-1] > SETTLED_CHANGE):
            errors = np.zeros((plain.column_count, plain.column_count))
            for joint, weight, gram in zip(plain.joints, weights, noise, strict=True):
                errors[np.ix_(joint.columns, joint.columns)] += weight**2 * gram
            of_torque = max(plain.rows - float(parameters @ errors @ parameters), LEAST_TORQUE_NOISE * plain.rows)
            factor = plain.stacked(weights)
            values, share = total_least_squares(
                factor[:, [*columns, plain.column_count]], errors[np.ix_(columns, columns)], of_torque
            )
            change = np.max(np.abs(values - parameters[columns]) / solution.std[columns])
            parameters = parameters.copy()
            parameters[columns] = values
            weights = inverse_deviations(plain, residual_deviations(plain, parameters, len(columns)))
            changes.append(float(change))
        normal = factor.T @ factor
        correction = share * errors
        root = gram_root(normal[:-1, :-1] - correction)
        right = np.linalg.lstsq(root.T, normal[:-1, -1], rcond=1e-12)[0]
        system = np.column_stack([root, right])
        solved = triangular_system(plain, system, weights, active, "tls", len(changes))
        loop = EstimationLoop("weights and noise of the torque", "σ", tuple(changes), changes[-1] <= SETTLED_CHANGE)
        return TlsEstimation(kernel, solved.reduction, solved.solution, (loop,), passes=3, correction=correction)

    def covariance(self, runs: Sequence[FilteredRun], estimation: Estimation) -> CorrectedCovariance:
        """Delete-block jackknife with the errors' share held."""
        assert isinstance(estimation, TlsEstimation)
        active = list(estimation.solution.active)
        sources = [
            SegmentRows(estimation.kernel, segment, run.parallel_filter) for run in runs for segment in run.segments
        ]
        series = [torques for run in runs for torques in run.series]
        return moment_jackknife(series, sources, estimation.solution, -estimation.correction[np.ix_(active, active)])


def _estimator(options: NoOptions, setup: Setup) -> Estimator:
    return TlsEstimator(setup, weighted_least_squares)


METHOD = Method(
    "total least squares: position noise is estimated above the motion's band and accounted for",
    "torque",
    NoOptions,
    _estimator,
)
