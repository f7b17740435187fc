"""What least squares assumes of its residuals, tested: linearity, independence, constant variance, normality.

The assumptions are those of AUBO section 3.2; its fifth, convergence, is a property of the solution. The tests are the
textbook's (Ramsey 1969, Ljung and Box 1978, Breusch and Pagan 1979 in Koenker's form, Jarque and Bera 1980), for each
joint by itself, on the equations that the fit uses. Two things make them say something of filtered torques:

- All of them take independent residuals for granted, and would reject any sound model otherwise: the parallel filter
  alone makes white noise autocorrelated. So they look at residuals that lie apart: for independence as far as the
  filter remembers, for the others as far as the residuals themselves do (their integrated autocorrelation time).
- With enough samples every real arm rejects everything. So an assumption counts as violated only where the test
  rejects it and the effect, taken from all samples, is large enough to matter.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from pydantic.dataclasses import dataclass as stored

from drivers.core.arrays import BoolArray, FloatArray
from drivers.core.text import percent_text
from ident.regression.comparison import TorqueSeries
from ident.regression.hypothesis_tests import LEVEL, p_text
from ident.signals.filters import ZeroPhaseFilter
from ident.stored import Real
from ident.verdict.catalogue import raised
from ident.verdict.check import Check

LARGEST_AUTOCORRELATION = 0.15
"""Largest autocorrelation of independent residuals (AUBO section 3.2)."""

LARGEST_CURVATURE = 0.05
"""Share of a linear model's residual variance that a curve in torque or velocity may explain."""

LARGEST_SPREAD = 1.5
"""Ratio of the residual's σ between the quarters of the samples where |q̇| and |τ̂| predict most and least."""

LARGEST_SHAPE = 0.5
"""Largest deviation from a normal distribution's shape: the larger of |skewness| and half the |excess kurtosis|."""

FEWEST_RESIDUALS = 40
"""Residuals of a joint, far enough apart, below which a test is not made."""

LAGS = 10
"""Autocorrelations that the test of independence looks at."""

_FORGOTTEN = 0.07  # autocorrelation of filtered white noise that counts as none


@stored(frozen=True)
class AssumptionTest:
    """One assumption of one joint."""

    statistic: Real  # of the test, χ² or F
    p_value: Real  # probability of a larger one if the assumption holds
    effect: Real  # how far the residuals are from it, in the assumption's own measure (see the constants above)
    violated: bool  # whether the test rejects it and the effect is large


@stored(frozen=True)
class ResidualTests:
    """The assumptions of one joint."""

    joint: str  # its name
    residuals: int  # that the fit uses
    independent: int  # that lie far enough apart
    independence: AssumptionTest  # Ljung-Box; effect: largest |autocorrelation|
    # F-test of τ̂², τ̂³, q̇|q̇| and q̇³ beside 1, τ̂, q̇ and sign q̇ (RESET); effect: share of variance explained.
    # None, as the next two, where fewer than `FEWEST_RESIDUALS` are independent.
    linearity: AssumptionTest | None
    # Breusch-Pagan against |q̇| and |τ̂|; effect: ratio of standard deviations
    constant_variance: AssumptionTest | None
    normality: AssumptionTest | None  # Jarque-Bera; effect: the larger of |skewness| and half the |excess kurtosis|


@dataclass(frozen=True)
class _Samples:
    """Residual, predicted torque and velocity (N,) of one joint over all segments, in units of their own spread."""

    residual: FloatArray
    predicted: FloatArray
    velocity: FloatArray


def filter_memory(parallel_filter: ZeroPhaseFilter) -> int:
    """Spacing of filtered samples from which on white noise is no longer autocorrelated, at each of its multiples."""
    if len(parallel_filter.sos) == 0:
        return 1
    factor = parallel_filter.factor
    half = factor * math.ceil(parallel_filter.settling_samples(1e-6) / factor)
    impulse = np.zeros((1, 2 * half + 1))
    impulse[0, half] = 1.0
    unfactored = ZeroPhaseFilter(parallel_filter.sos, 1, parallel_filter.description)
    response = unfactored.apply(impulse)[0]
    spectrum = np.abs(np.fft.rfft(response, 2 * len(response))) ** 2
    correlation = np.fft.irfft(spectrum)[: len(response) : factor]
    correlation = np.abs(correlation / correlation[0])
    spacing = 1
    while correlation[spacing::spacing].max(initial=0.0) > _FORGOTTEN:
        spacing += 1
    return spacing


def residual_tests(
    series: Sequence[TorqueSeries], equations: Sequence[BoolArray], memory: int, joints: Mapping[int, str]
) -> list[ResidualTests]:
    """Test the assumptions of each joint; one with too few residuals is left out.

    Args:
        series: torques of the fit, a part per gap-free segment.
        equations: (n, M) of each part, whether the fit uses the joint's sample.
        memory: of the parallel filter, in samples (see `filter_memory`).
        joints: number and name of those whose torques were used.
    """
    level = LEVEL / max(1, len(joints))
    tests = (
        _joint_tests(series, [each[joint] for each in equations], memory, joint, name, level)
        for joint, name in joints.items()
    )
    return [test for test in tests if test is not None]


def residual_checks(tests: Sequence[ResidualTests]) -> list[Check]:
    """A note for each assumption that joints violate."""
    checks = []
    for check, assumption, sentence in _NOTES:
        of_joints: list[tuple[str, AssumptionTest | None]] = [(test.joint, getattr(test, assumption)) for test in tests]
        violating = [(name, one) for name, one in of_joints if one is not None and one.violated]
        if violating:
            worst, one = max(violating, key=lambda pair: pair[1].effect)
            text = sentence.format(joint=worst, effect=_effect_text(assumption, one.effect), p=p_text(one.p_value))
            if len(violating) > 1:
                text += f"; also {', '.join(name for name, _ in violating if name != worst)}"
            checks.append(raised(check, text, [name for name, _ in violating]))
    return checks


_NOTES = (
    (
        "residuals-curved",
        "linearity",
        "residuals of {joint} are nonlinear in its torque or velocity: a curve explains {effect} of their variance "
        "({p})",
    ),
    (
        "residuals-autocorrelated",
        "independence",
        "residuals of {joint} are autocorrelated beyond the memory of the parallel filter, up to {effect} ({p}); "
        "the error bars allow for it",
    ),
    (
        "residuals-uneven",
        "constant_variance",
        "residuals of {joint} grow with torque or velocity: their standard deviation by a factor of {effect} ({p})",
    ),
    (
        "residuals-not-normal",
        "normality",
        "residuals of {joint} are not normally distributed: the larger of |skewness| and half the |excess kurtosis| is "
        "{effect} ({p})",
    ),
)
"""Check, the assumption that it is about, its sentence."""


def _effect_text(assumption: str, effect: float) -> str:
    return percent_text(effect) if assumption == "linearity" else f"{effect:.2g}"


def _joint_tests(
    series: Sequence[TorqueSeries], used: Sequence[BoolArray], memory: int, joint: int, name: str, level: float
) -> ResidualTests | None:
    samples = [
        _Samples(part.measured[joint] - part.predicted[joint], part.predicted[joint], part.velocity[joint])
        for part in series
    ]
    every = _selected(samples, used, 1)
    spread = float(every.residual.std()) if len(every.residual) else 0.0
    # What rounding leaves of an exact fit is no noise.
    if spread <= 1e-9 * float(np.abs(every.predicted).max(initial=0.0)):
        return None
    centred = [
        np.where(mask, (sample.residual - every.residual.mean()) / spread, 0.0)
        for sample, mask in zip(samples, used, strict=True)
    ]
    longest = max(len(one) for one in centred)
    correlation, _ = _autocorrelation(centred, used, max(longest // 5, LAGS * memory + 1))
    spacing = max(memory, math.ceil(_autocorrelation_time(correlation)))
    apart = _selected(samples, used, spacing)
    enough = len(apart.residual) >= FEWEST_RESIDUALS
    thinned = [row[::memory] for row in centred], [mask[::memory] for mask in used]
    if sum(int(mask.sum()) for mask in thinned[1]) < FEWEST_RESIDUALS:
        return None
    return ResidualTests(
        joint=name,
        residuals=len(every.residual),
        independent=len(apart.residual),
        independence=_independence(*thinned, correlation[memory : LAGS * memory + 1 : memory], level),
        linearity=_linearity(apart, every, level) if enough else None,
        constant_variance=_constant_variance(apart, every, level) if enough else None,
        normality=_normality(apart, every, level) if enough else None,
    )


def _selected(samples: Sequence[_Samples], used: Sequence[BoolArray], spacing: int) -> _Samples:
    """Every `spacing`-th sample, of those that are used."""

    def joined(name: str) -> FloatArray:
        return np.concatenate(
            [getattr(sample, name)[::spacing][mask[::spacing]] for sample, mask in zip(samples, used, strict=True)]
        )

    return _Samples(joined("residual"), joined("predicted"), joined("velocity"))


def _autocorrelation(
    centred: Sequence[FloatArray], used: Sequence[BoolArray], lags: int
) -> tuple[FloatArray, FloatArray]:
    """Autocorrelations (lags,) over the pairs that are used, never across a gap, and how many pairs there are."""
    products, pairs = np.zeros(lags), np.zeros(lags)
    for row, mask in zip(centred, used, strict=True):
        size = 1 << (2 * max(len(row), lags) - 1).bit_length()
        for total, values in ((products, row), (pairs, mask.astype(np.float64))):
            total += np.fft.irfft(np.abs(np.fft.rfft(values, size)) ** 2, size)[:lags]
    pairs = np.round(pairs)
    covariance = np.divide(products, pairs, out=np.zeros(lags), where=pairs > 0)
    return covariance / covariance[0], pairs


def _autocorrelation_time(correlation: FloatArray) -> float:
    """1 + 2·Σ ρ(k) while ρ is positive: samples per independent one (initial positive sequence, Geyer 1992)."""
    negative = np.flatnonzero(correlation <= 0.0)
    last = int(negative[0]) if len(negative) else len(correlation)
    return 1.0 + 2.0 * float(correlation[1:last].sum())


def _regression(columns: FloatArray, response: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Residuals (N,) and fitted values (N,) of `response` on normalised `columns` (N, k)."""
    lengths = np.linalg.norm(columns, axis=0)
    scaled = columns[:, lengths > 0] / lengths[lengths > 0]
    coefficients, *_ = np.linalg.lstsq(scaled, response, rcond=None)
    fitted = scaled @ coefficients
    return response - fitted, np.asarray(fitted)


def _linearity(apart: _Samples, every: _Samples, level: float) -> AssumptionTest:
    from scipy.special import fdtrc

    torque_scale, speed_scale = np.abs(every.predicted).max(), np.abs(every.velocity).max() or 1.0
    freedom = 4

    def squares(samples: _Samples) -> tuple[float, float]:
        """Sums of squares without and with the curves."""
        torque, speed = samples.predicted / torque_scale, samples.velocity / speed_scale
        linear = np.column_stack([np.ones_like(torque), torque, speed, np.sign(speed)])
        curved = np.column_stack([linear, torque**2, torque**3, speed * np.abs(speed), speed**3])
        return tuple(float(np.sum(_regression(each, samples.residual)[0] ** 2)) for each in (linear, curved))  # type: ignore[return-value]

    without, with_curves = squares(apart)
    left = len(apart.residual) - 4 - freedom
    statistic = (without - with_curves) / freedom / (with_curves / left)
    p_value = float(fdtrc(freedom, left, max(statistic, 0.0)))
    without, with_curves = squares(every)
    effect = 1.0 - with_curves / without
    return AssumptionTest(statistic, p_value, effect, p_value < level and effect > LARGEST_CURVATURE)


def _independence(
    thinned: Sequence[FloatArray], used: Sequence[BoolArray], correlation: FloatArray, level: float
) -> AssumptionTest:
    from scipy.special import chdtrc

    apart, pairs = _autocorrelation(thinned, used, LAGS + 1)
    total = pairs[0]
    statistic = float(np.sum(pairs[1:] * apart[1:] ** 2) * (total + 2.0) / total)
    p_value = float(chdtrc(LAGS, statistic))
    effect = float(np.abs(correlation).max(initial=0.0))
    return AssumptionTest(statistic, p_value, effect, p_value < level and effect > LARGEST_AUTOCORRELATION)


def _constant_variance(apart: _Samples, every: _Samples, level: float) -> AssumptionTest:
    from scipy.special import chdtrc

    torque_scale, speed_scale = np.abs(every.predicted).max(), np.abs(every.velocity).max() or 1.0

    def fitted(samples: _Samples) -> tuple[FloatArray, FloatArray]:
        """Squared residuals, relative to their mean, and what is expected of them from |q̇| and |τ̂|."""
        squared = (samples.residual - samples.residual.mean()) ** 2
        squared /= squared.mean()
        size = [np.ones_like(squared), np.abs(samples.velocity) / speed_scale, np.abs(samples.predicted) / torque_scale]
        return squared, _regression(np.column_stack(size), squared)[1]

    squared, expected = fitted(apart)
    share = float(np.var(expected) / np.var(squared))
    statistic = len(squared) * share
    p_value = float(chdtrc(2, statistic))
    squared, expected = fitted(every)
    order = np.argsort(expected)
    quarter = len(order) // 4
    effect = math.sqrt(float(squared[order[-quarter:]].mean()) / float(squared[order[:quarter]].mean()))
    return AssumptionTest(statistic, p_value, effect, p_value < level and effect > LARGEST_SPREAD)


def _normality(apart: _Samples, every: _Samples, level: float) -> AssumptionTest:
    from scipy.special import chdtrc

    def moments(samples: _Samples) -> tuple[float, float]:
        """Skewness and excess kurtosis."""
        scaled = (samples.residual - samples.residual.mean()) / samples.residual.std()
        return float(np.mean(scaled**3)), float(np.mean(scaled**4)) - 3.0

    skewness, kurtosis = moments(apart)
    statistic = len(apart.residual) / 6.0 * (skewness**2 + kurtosis**2 / 4.0)
    p_value = float(chdtrc(2, statistic))
    skewness, kurtosis = moments(every)
    effect = max(abs(skewness), abs(kurtosis) / 2.0)
    return AssumptionTest(statistic, p_value, effect, p_value < level and effect > LARGEST_SHAPE)
