"""Statistics of the residuals per joint: autocorrelation, histogram, moments (AUBO .3.2, figures 5, 7 and 8)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import FloatArray
from ident.regression.comparison import TorqueSeries
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT

HISTOGRAM_EDGES = np.linspace(-5.0, 5.0, 51)
"""In standard deviations; what lies beyond counts for the first and the last bin."""

PROBABILITIES = np.concatenate([[0.0005, 0.001, 0.002], np.linspace(0.005, 0.995, 100), [0.998, 0.999, 0.9995]])
"""Of the quantiles that are compared with those of a normal distribution."""

ROUNDING = 1e-9
"""A mean of fewer standard deviations is what rounding left of 0: an offset column takes it out exactly."""


@dataclass(frozen=True)
class JointResidual:
    """Residuals of one joint, over the samples used.

    Attributes:
        velocity, predicted, residual: (N,) [rad/s or m/s], [N·m], [N·m], segments one after the other.
        mean, std: [N·m]; nan without samples.
        autocorrelation: (L,) at lags 0 … L − 1.
        band: half width of the 95 % band of white residuals.
        outside: share of the autocorrelations from lag 1 on outside the band.
        density: (50,) histogram of residual / std, as a density.
        quantiles: (Q,) of residual / std, at the probabilities `PROBABILITIES`; empty without samples.
        beyond_three: share of the samples further than 3 std from the mean (0.27 % of a normal distribution).
        excess_kurtosis: 0 for a normal distribution.
    """

    velocity: FloatArray
    predicted: FloatArray
    residual: FloatArray
    mean: float
    std: float
    autocorrelation: FloatArray
    band: float
    outside: float
    density: FloatArray
    quantiles: FloatArray
    beyond_three: float
    excess_kurtosis: float


def joint_residual(series: Sequence[TorqueSeries], joint: int, lags: int) -> JointResidual:
    """Describe the residual of joint number `joint`; `lags` autocorrelations, never across a gap."""
    used = [segment.counted[joint] for segment in series]
    velocity = _joined([segment.velocity[joint, mask] for segment, mask in zip(series, used, strict=True)])
    segments = [segment.measured[joint] - segment.predicted[joint] for segment in series]
    residual = _joined([segment[mask] for segment, mask in zip(segments, used, strict=True)])
    samples = len(residual)
    mean = float(residual.mean()) if samples else float("nan")
    std = float(residual.std()) if samples else float("nan")
    if abs(mean) < ROUNDING * std:
        mean = 0.0
    centred = [np.where(mask, segment - mean, 0.0) for segment, mask in zip(segments, used, strict=True)]
    correlation = _autocorrelation(centred, min(lags, max(1, samples - 1))) if samples and std > 0 else np.empty(0)
    band = WITHIN_95_PERCENT / np.sqrt(samples) if samples else float("nan")
    scaled = (residual - mean) / std if samples and std > 0 else np.empty(0)
    counts, _ = np.histogram(np.clip(scaled, -4.999, 4.999), HISTOGRAM_EDGES)
    nothing = float("nan")
    return JointResidual(
        velocity=velocity,
        predicted=_joined([segment.predicted[joint, mask] for segment, mask in zip(series, used, strict=True)]),
        residual=residual,
        mean=mean,
        std=std,
        autocorrelation=correlation,
        band=band,
        outside=float(np.mean(np.abs(correlation[1:]) > band)) if len(correlation) > 1 else nothing,
        density=counts / (max(1, len(scaled)) * np.diff(HISTOGRAM_EDGES)),
        quantiles=np.quantile(scaled, PROBABILITIES) if len(scaled) else np.empty(0),
        beyond_three=float(np.mean(np.abs(scaled) > 3.0)) if len(scaled) else nothing,
        excess_kurtosis=float(np.mean(scaled**4)) - 3.0 if len(scaled) else nothing,
    )


def _joined(segments: Sequence[FloatArray]) -> FloatArray:
    return np.concatenate(segments) if segments else np.empty(0)


def _autocorrelation(centred: Sequence[FloatArray], lags: int) -> FloatArray:
    """Sums of products at lags 0 … lags − 1 within each segment, added up, relative to lag 0."""
    total = np.zeros(lags)
    for segment in centred:
        size = 1 << (2 * max(len(segment), lags) - 1).bit_length()
        spectrum = np.fft.rfft(segment, size)
        total += np.fft.irfft(np.abs(spectrum) ** 2, size)[:lags]
    return np.asarray(total / total[0])
