"""Measured against predicted torque: both through the same parallel filter, sample by sample.

Also the autocorrelation of what remains, by which fewer samples are independent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from drivers.core.arrays import FloatArray
from ident.model.dynamic_model import DynamicModel
from ident.model.presliding import presliding_states
from ident.model.regressor import model_torque
from ident.signals.filters import ZeroPhaseFilter
from ident.signals.prepared import Segment


@dataclass(frozen=True)
class TorqueSeries:
    """Filtered torques of one gap-free segment."""

    time: FloatArray  # (M,) [s]
    measured: FloatArray  # (n, M) [N·m]
    predicted: FloatArray  # (n, M) [N·m]; nan for joints whose torque the model does not predict
    velocity: FloatArray  # (n, M) [rad/s or m/s]
    used: npt.NDArray[np.bool_]  # (M,) whether the sample counts (the arm moves)
    # (n, M) motors at rest, whose static friction is in no model; None where not determined
    resting: npt.NDArray[np.bool_] | None = None
    # (n, M) by how much each equation counted in a robust estimate, 0 to 1; nan where it took no part. None where all
    # counted alike.
    weights: FloatArray | None = None

    @property
    def counted(self) -> npt.NDArray[np.bool_]:
        """(n, M) whether a joint's torque counts."""
        everywhere = np.broadcast_to(self.used, self.measured.shape)
        return everywhere if self.resting is None else everywhere & ~self.resting

    def part(self, start: int, stop: int) -> TorqueSeries:
        """The samples from `start` to before `stop`."""
        span = slice(start, stop)
        return TorqueSeries(
            self.time[span],
            self.measured[:, span],
            self.predicted[:, span],
            self.velocity[:, span],
            self.used[span],
            None if self.resting is None else self.resting[:, span],
            None if self.weights is None else self.weights[:, span],
        )

    @property
    def residual(self) -> FloatArray:
        """Measured minus predicted torque (n, M) [N·m]; 0 where it does not count."""
        return np.where(self.counted, self.measured - self.predicted, 0.0)


def compare_torques(
    model: DynamicModel,
    columns: Sequence[int],
    parameters: FloatArray,
    segments: Sequence[Segment],
    parallel_filter: ZeroPhaseFilter,
) -> tuple[TorqueSeries, ...]:
    """Filtered measured and predicted torques for base parameters (b,) on the standard `columns`."""
    series = []
    for segment in segments:
        every = slice(None, None, parallel_filter.factor)
        motion = (segment.position, segment.velocity, segment.acceleration)
        states = presliding_states(model, segment.velocity, segment.rate)
        predicted = model_torque(model, columns, parameters, *motion, segment.temperature, states)
        measured = segment.torque
        if segment.known_torque is not None:
            predicted, measured = predicted + segment.known_torque, measured + segment.known_torque
        series.append(
            TorqueSeries(
                time=segment.time[every],
                measured=parallel_filter.apply(measured),
                predicted=parallel_filter.apply(predicted),
                velocity=segment.velocity[:, every],
                used=segment.used[every],
                resting=None if segment.resting is None else segment.resting[:, every],
            )
        )
    return tuple(series)


def only_predicted(series: TorqueSeries, joints: Sequence[int]) -> TorqueSeries:
    """The series without the predictions of all but some joints."""
    others = [joint for joint in range(len(series.predicted)) if joint not in joints]
    predicted = series.predicted.copy()
    predicted[others] = np.nan
    return replace(series, predicted=predicted) if others else series


def residual_autocorrelation(series: Sequence[TorqueSeries]) -> FloatArray:
    """Lag-one autocorrelation (n,) of the residuals, within ±0.99."""
    return lag_one([torques.residual for torques in series])


def lag_one(residuals: Sequence[FloatArray]) -> FloatArray:
    """Lag-one autocorrelation (n,) of series (n, M), within ±0.99."""
    products = sum(np.sum(residual[:, 1:] * residual[:, :-1], axis=1) for residual in residuals)
    squares = sum(np.sum(residual**2, axis=1) for residual in residuals)
    ratio = np.divide(products, squares, out=np.zeros_like(squares), where=np.asarray(squares) > 0)
    return np.asarray(np.clip(ratio, -0.99, 0.99))


def independent_share(autocorrelation: FloatArray) -> float:
    """Share of independent rows among those with lag-one autocorrelations (n,) of the joints, at most 1.

    A sum of N AR(1) values has the variance of N (1 − ρ)/(1 + ρ) independent ones.
    """
    return min(1.0, float(np.mean((1.0 - autocorrelation) / (1.0 + autocorrelation))))
