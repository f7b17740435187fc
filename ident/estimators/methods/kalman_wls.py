"""Weighted least squares on torques that a Kalman filter has brought together with the model's (ROCR6 .4.2).

The state is a joint's torque, a random walk of variance Q per sample about the model's change of torque, which is its
input; a measured torque has the variance R (eq. 25 to 31 with A = H = 1 and B·u the model's change). With the
stationary gain K the estimate is the model's torque plus what the first-order low-pass of gain K makes of the
residual: the filter takes the model's word above its band, where the residual is gone, and lags in the residual below.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from pydantic import Field

from drivers.core.arrays import FloatArray
from drivers.core.ranges import Range
from ident.estimators.estimator import Estimation, Estimator, Setup
from ident.estimators.method import Method, within
from ident.estimators.torque_estimator import TorqueEstimator
from ident.model.presliding import presliding_states
from ident.model.regressor import model_torque
from ident.ranges import GENERATIONS
from ident.regression.least_squares import LeastSquares, weighted_least_squares
from ident.regression.observation_matrix import Reduction
from ident.signals.prepared import Prepared, Segment


@dataclass(frozen=True)
class KalmanOptions:
    """Options of least squares on Kalman-filtered torques."""

    ratio: Annotated[
        float,
        within(Range(1e-12, 1e12)),
        Field(
            description="Q/R: variance of the model's change over that of the measurement; the settled gain depends on "
            "nothing else, so that Q and R have no settings of their own"
        ),
    ] = 0.1
    rounds: Annotated[int, within(GENERATIONS), Field(description="of filter and estimate; the first model is wls")] = 1


def stationary_gain(ratio: float) -> float:
    """K of eq. 31 once the covariance of eq. 28 and 30 has settled, for Q/R."""
    predicted = 0.5 * (ratio + math.sqrt(ratio**2 + 4.0 * ratio))
    return predicted / (predicted + 1.0)


def filtered_torque(measured: FloatArray, modelled: FloatArray, ratio: float) -> FloatArray:
    """Torque (n, N) by the filter, started settled on the first sample; measured and modelled torque (n, N)."""
    from scipy.signal import lfilter

    gain = stationary_gain(ratio)
    residual = measured - modelled
    low, _ = lfilter([gain], [1.0, gain - 1.0], residual, axis=1, zi=(1.0 - gain) * residual[:, :1])
    return np.asarray(modelled + low)


@dataclass(frozen=True)
class KalmanEstimator(TorqueEstimator):
    """Weighted least squares on filtered torques."""

    ratio: float  # Q/R
    rounds: int  # of filter and estimate

    def estimate(self, runs: Sequence[Prepared], plain: Reduction, active: Sequence[int]) -> Estimation:
        """Filter and estimate in turn, from the plain equations' solution."""
        reduction, solution = plain, self.solve(plain, active)
        for _ in range(self.rounds):
            reduction = self.reduce([self._filtered(run, solution) for run in runs])
            solution = self.solve(reduction, active)
        return Estimation(
            self.setup.kernel, reduction, replace(solution, method="kalman-wls"), passes=1 + 2 * self.rounds
        )

    def restricted(self, estimation: Estimation, columns: Sequence[int]) -> LeastSquares:
        """The filtered equations of fewer columns."""
        return replace(super().restricted(estimation, columns), method="kalman-wls")

    def _filtered(self, run: Prepared, solution: LeastSquares) -> Prepared:
        kernel = self.setup.kernel

        def of(segment: Segment) -> Segment:
            motion = segment.position, segment.velocity, segment.acceleration, segment.temperature
            states = presliding_states(kernel.model, segment.velocity, segment.rate)
            modelled = model_torque(kernel.model, kernel.columns, solution.parameters, *motion, states)
            return replace(segment, torque=filtered_torque(segment.torque, modelled, self.ratio))

        return replace(run, segments=tuple(of(segment) for segment in run.segments))


def _estimator(options: KalmanOptions, setup: Setup) -> Estimator:
    return KalmanEstimator(setup, weighted_least_squares, options.ratio, options.rounds)


METHOD = Method(
    "wls on torques that a Kalman filter combines with the model's (ROCR6)", "torque", KalmanOptions, _estimator
)
