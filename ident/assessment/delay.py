"""Delay of the recorded torque against the recorded position.

To first order τ(t + δ) = τ + δ·τ̇, so with both τ and τ̇ reduced beside W the delay with the smallest residual follows
in closed form; a few such steps (Gauss-Newton) find it whatever its size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.linear_algebra.triangular import triangular
from ident.model.regressor import RegressorKernel
from ident.regression.autocorrelation import independent_share, residual_autocorrelation
from ident.regression.comparison import compare_torques
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.regression.least_squares import excited_columns, ordinary_least_squares
from ident.regression.observation_matrix import Reduction, only_torques, reduce_segments
from ident.signals.filters import ZeroPhaseFilter
from ident.signals.prepared import Segment
from ident.signals.resampling import shift_torque

WORTHWHILE_GAIN = 0.01
"""A delay is used only if it lowers the residual's norm by at least this share."""

SURE_DEVIATIONS = 4.0
"""… and if it is this many σ from 0."""

LONGEST = 0.1
"""Delays beyond this [s] are not a drive's: something else is wrong with the stamps."""

_STEPS = 6
_SETTLED = 1e-5


@dataclass(frozen=True)
class DelaySearch:
    """Outcome of the search.

    Attributes:
        best: delay [s] with the smallest residual, positive where the torque lags; nan where none was found.
        std: its standard deviation [s], corrected for the residuals' autocorrelation; nan where none was found.
        gain: share by which it lowers the residual's norm.
        used: the delay to use [s]: `best` where it is worthwhile, else 0.
        note: the outcome in words.
    """

    best: float
    std: float
    gain: float
    used: float
    note: str


def search_delay(
    kernel: RegressorKernel,
    segments: Sequence[Segment],
    parallel_filter: ZeroPhaseFilter,
    torques_of: Sequence[int] | None = None,
) -> DelaySearch:
    """Find the delay by which the torque of all segments lags their motion (prepared with delay 0).

    Args:
        kernel: of the base columns.
        segments: prepared with delay 0.
        parallel_filter: for τ and W.
        torques_of: numbers of the joints whose torques are looked at; all where None.
    """
    joints = list(range(kernel.model.dof) if torques_of is None else torques_of)
    delay = 0.0
    at_zero = float("nan")
    for _ in range(_STEPS):
        torques = []
        for segment in segments:
            shifted = shift_torque(segment.torque, segment.rate, delay)
            torques.append(np.vstack([shifted, np.gradient(shifted, 1.0 / segment.rate, axis=1)]))
        reduction = only_torques(reduce_segments(kernel, segments, parallel_filter, torques), joints)
        active = excited_columns(reduction)
        stacked = reduction.stacked()
        rest = triangular(stacked[:, [*active, -2, -1]])[len(active) :, -2:]
        residual, slope = rest[:, 0], rest[:, 1]
        norm = float(np.linalg.norm(residual))
        if np.isnan(at_zero):
            at_zero = norm
        steepness = float(slope @ slope)
        if steepness == 0.0 or at_zero == 0.0:
            return DelaySearch(float("nan"), float("nan"), 0.0, 0.0, "the torque does not change: no delay can be seen")
        step = -float(slope @ residual) / steepness
        if abs(step) < _SETTLED:
            break
        delay += step
        if abs(delay) > LONGEST:
            note = f"no delay within ±{LONGEST * 1e3:g} ms fits; none used"
            return DelaySearch(float("nan"), float("nan"), 0.0, 0.0, note)
    gain = 1.0 - norm / at_zero
    std = _standard_deviation(kernel, segments, parallel_filter, reduction, steepness, joints)
    side = "lags" if delay > 0 else "leads"
    lag = f"torque {side} the motion by {abs(delay) * 1e3:.2f} ± {WITHIN_95_PERCENT * std * 1e3:.2f} ms"
    if abs(delay) < SURE_DEVIATIONS * std:
        return DelaySearch(delay, std, gain, 0.0, f"{lag}: less than {SURE_DEVIATIONS:g} σ, none used")
    lag += f" (residual {gain * 100:.1f} % smaller)"
    if gain < WORTHWHILE_GAIN:
        return DelaySearch(delay, std, gain, 0.0, f"{lag}: too small to matter, none used")
    return DelaySearch(delay, std, gain, delay, lag)


def _standard_deviation(
    kernel: RegressorKernel,
    segments: Sequence[Segment],
    parallel_filter: ZeroPhaseFilter,
    reduction: Reduction,
    steepness: float,
    joints: list[int],
) -> float:
    """Of the delay [s]: the classical one over the square root of the share of independent rows (AR(1) residuals)."""
    solution = ordinary_least_squares(reduction, excited_columns(reduction))
    series = compare_torques(kernel.model, kernel.columns, solution.parameters, segments, parallel_filter)
    share = independent_share(residual_autocorrelation(series)[joints])
    freedom = reduction.rows - len(solution.active)
    return float(np.sqrt(solution.residual_sum / freedom / steepness / share))
