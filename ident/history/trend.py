"""Trend and steps of one parameter over the results of an arm.

A result's value is y_i = a + b·t_i + Σ c_k·(T_i − T̄)ᵏ + Σ s_k·(t_i ≥ t_k) + u_i + e_i: e_i has the σ that
the identification states, u_i is what changes from result to result beside it, with variance τ² and the correlation
exp(−|Δt|/θ). Neither τ nor θ is known: estimates are averaged over a grid of both, weighted by the restricted
likelihood (Harville, Maximum likelihood approaches to variance component estimation, 1977), so that an interval holds
that uncertainty, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import FloatArray, IntArray

LEAST_RESULTS = 5
"""Fewer have no trend: four coefficients of five values are what an interval can be given to."""

MOST_POINTS = 200
"""More results are joined, neighbours in time, to as many groups: the time of an estimate grows with the cube."""

WARMING = ((2.0, 0), (10.0, 20), (20.0, 40))
"""Least spans of the temperature [K], and least results, from which a series is corrected by a line, a parabola, and a
cubic polynomial: friction falls exponentially, and what a correction leaves over follows the seasons."""

MOST_COLLINEAR = 1e4
"""Condition number of time and temperature, columns normalised: beyond it wear and warming are not distinguishable."""

LEAST_SIDE = 4
"""Results on either side of a step."""

MOST_STEPS = 4

CORRELATION_TIMES = (0.0, 0.02, 0.06, 0.15)
"""θ relative to the time between first and last result."""

WHITE_PRIOR = 0.5
"""Prior probability that results are not correlated; the other θ share the rest."""

SCATTER_GRID = 40
"""Values of τ, from none to 2.5 times the scatter about a trend by least squares, of equal prior probability."""


@dataclass(frozen=True)
class Series:
    """Values of one parameter."""

    time: FloatArray  # (N,) rising [s]
    value: FloatArray  # (N,) in the parameter's unit
    std: FloatArray  # (N,) σ stated by the identifications, > 0
    temperature: FloatArray  # (N,) of the joint [°C]; NaN where it is not known

    def __len__(self) -> int:
        return len(self.time)


@dataclass(frozen=True)
class TrendStep:
    """A step of a parameter beside its trend."""

    # before, after: times of the results between which it lies [s]
    before: float
    after: float
    size: float  # in the parameter's unit
    half: float  # half of its 95 % interval
    p_value: float  # probability of so large a step at any place where there is none (Bonferroni over the places)


@dataclass(frozen=True)
class Trend:
    """What a parameter did between the first and the last result; ± is the 95 % interval."""

    start: float  # value at the first result, at the mean temperature
    change: float  # from the first to the last result at the same temperature, steps included
    change_half: float  # half of its interval
    p_value: float  # of no change
    per_kelvin: float | None  # by the joint's temperature, at its mean; None where that is not known or does not vary
    mean_temperature: float | None  # to which values are corrected [°C]; None likewise
    scatter: float  # σ between results, beside that of their identification
    steps: tuple[TrendStep, ...]  # in time
    corrected: FloatArray  # (N,) values at the mean temperature
    line: FloatArray  # (N,) the estimate at the results' times, at the mean temperature


def estimate_trend(series: Series, step_level: float) -> Trend | None:
    """The trend; None with fewer than `LEAST_RESULTS` results, of one time, or where temperature and time go together.

    A step is seen where there is none with probability `step_level`.
    """
    if len(series) < LEAST_RESULTS or series.time[-1] <= series.time[0]:
        return None
    points = _joined(series)
    heat, mean = _warming(points.temperature)
    line = np.column_stack([np.ones(len(points)), _relative(points.time, series)])
    columns = np.column_stack([line, heat])
    if np.linalg.cond(columns / np.linalg.norm(columns, axis=0)) > MOST_COLLINEAR:
        return None
    noise = _Noise(points)
    places: list[int] = []
    steps: list[tuple[int, float]] = []
    fit = noise.fit(columns)
    while len(places) < MOST_STEPS:
        added = _next_step(noise, columns, places, fit.scatter)
        if added is None:
            break
        place, candidates = added
        tried = noise.fit(np.column_stack([columns, _steps(len(points), [*places, place])]))
        p_value = min(1.0, candidates * tried.p_value(tried.unit(-1)))
        if p_value > step_level:
            break
        places, fit = [*places, place], tried
        steps.append((place, p_value))
    first_step = 2 + heat.shape[1]
    of_change = np.zeros(fit.size)
    of_change[1] = 1.0
    of_change[first_step:] = 1.0
    change, change_half = fit.estimate(of_change)
    estimated = [
        TrendStep(
            float(points.time[place - 1]),
            float(points.time[place]),
            *fit.estimate(fit.unit(first_step + number)),
            p_value,
        )
        for number, (place, p_value) in enumerate(steps)
    ]
    own_heat = _heat_columns(series.temperature, mean, heat.shape[1])
    passed = np.array(
        [[series.time[k] >= step.after for step in estimated] for k in range(len(series))], dtype=np.float64
    )
    shape = np.column_stack([np.ones(len(series)), _relative(series.time, series), np.zeros_like(own_heat), passed])
    per_kelvin = fit.estimate(fit.unit(2))[0] if heat.shape[1] else None
    return Trend(
        start=float(fit.mean[0]),
        change=change,
        change_half=change_half,
        p_value=fit.p_value(of_change),
        per_kelvin=per_kelvin,
        mean_temperature=mean if heat.shape[1] else None,
        scatter=fit.scatter,
        steps=tuple(sorted(estimated, key=lambda step: step.after)),
        corrected=series.value - own_heat @ fit.mean[2 : 2 + heat.shape[1]],
        line=shape @ fit.mean,
    )


def _relative(time: FloatArray, series: Series) -> FloatArray:
    passed: FloatArray = (time - series.time[0]) / (series.time[-1] - series.time[0])
    return passed


def _warming(temperature: FloatArray) -> tuple[FloatArray, float]:
    """Columns of the temperature (N, 0 to 3), and its mean [°C]."""
    degree, mean = 0, float(temperature.mean())
    if np.isfinite(mean):
        degree = sum(bool(np.ptp(temperature) >= span) and len(temperature) >= least for span, least in WARMING)
    return _heat_columns(temperature, mean, degree), mean


def _heat_columns(temperature: FloatArray, mean: float, count: int) -> FloatArray:
    columns: FloatArray = np.power((temperature - mean)[:, None], np.arange(1, count + 1))
    return columns


def _joined(series: Series) -> Series:
    """Neighbours in time joined to at most `MOST_POINTS` groups, weighted by their variances."""
    if len(series) <= MOST_POINTS:
        return series
    starts = np.linspace(0, len(series), MOST_POINTS, endpoint=False).astype(np.intp)
    # Scatter between results is not known yet: with it, those of a small stated σ must not outweigh all others.
    weight = 1.0 / (series.std**2 + np.median(series.std) ** 2)
    total = np.add.reduceat(weight, starts)

    def mean(values: FloatArray) -> FloatArray:
        joined: FloatArray = np.add.reduceat(weight * values, starts) / total
        return joined

    std = np.sqrt(np.add.reduceat((weight * series.std) ** 2, starts)) / total
    return Series(mean(series.time), mean(series.value), std, mean(series.temperature))


def _steps(count: int, places: Sequence[int]) -> FloatArray:
    """Columns (N, len(places)) that are 1 from a place on."""
    columns: FloatArray = (np.arange(count)[:, None] >= np.array(places, dtype=np.intp)[None, :]).astype(np.float64)
    return columns


def _next_step(noise: _Noise, fixed: FloatArray, places: Sequence[int], scatter: float) -> tuple[int, int] | None:
    """The place where a further step lowers the error most, and among how many; None where there is no room for one."""
    count = len(noise.value)
    bounds = np.array(sorted([0, *places, count]))
    candidates: IntArray = np.array(
        [k for k in range(count) if np.all(np.abs(bounds - k) >= LEAST_SIDE) and noise.time[k] > noise.time[k - 1]],
        dtype=np.int64,
    )
    columns = np.column_stack([fixed, _steps(count, places)])
    if len(candidates) == 0 or count <= columns.shape[1] + 2:
        return None
    root = np.sqrt(noise.variance + scatter**2)
    basis = np.linalg.qr(columns / root[:, None])[0]
    tried = _steps(count, candidates.tolist()) / root[:, None]
    tried -= basis @ (basis.T @ tried)
    length = np.linalg.norm(tried, axis=0)
    score = np.where(length > 1e-6, np.abs(tried.T @ (noise.value / root)) / np.maximum(length, 1e-6), 0.0)
    return int(candidates[np.argmax(score)]), len(candidates)


@dataclass(frozen=True)
class _Fit:
    """Coefficients, averaged over what is not known of the noise."""

    # mean, covariance: (p,), (p, p) of the coefficients
    mean: FloatArray
    covariance: FloatArray
    freedom: int  # degrees of it
    scatter: float  # mean of τ

    @property
    def size(self) -> int:
        return len(self.mean)

    def unit(self, place: int) -> FloatArray:
        row: FloatArray = np.eye(self.size)[place]
        return row

    def estimate(self, row: FloatArray) -> tuple[float, float]:
        """A linear combination, and half of its 95 % interval."""
        from scipy.special import stdtrit  # Student's t; scipy.stats is slow to import

        deviation = float(np.sqrt(row @ self.covariance @ row))
        return float(row @ self.mean), float(stdtrit(self.freedom, 0.975)) * deviation

    def p_value(self, row: FloatArray) -> float:
        """Probability of so large a combination where it is 0."""
        from scipy.special import stdtr

        deviation = float(np.sqrt(row @ self.covariance @ row))
        return float(2.0 * stdtr(self.freedom, -abs(float(row @ self.mean)) / max(deviation, 1e-300)))


class _Noise:
    """The noise of a series: its principal axes for each θ, by which every τ is diagonal."""

    def __init__(self, points: Series) -> None:
        self.time, self.value = points.time, points.value
        self.variance = points.std**2
        span = points.time[-1] - points.time[0]
        apart = np.abs(points.time[:, None] - points.time[None, :]) / span
        self._axes: list[tuple[FloatArray, FloatArray]] = []
        for length in CORRELATION_TIMES:
            alike = np.exp(-apart / length) if length > 0 else np.eye(len(points))
            weighted = alike / np.sqrt(np.outer(self.variance, self.variance))
            self._axes.append(np.linalg.eigh(weighted) if length > 0 else (1.0 / self.variance, np.eye(len(points))))

    def fit(self, columns: FloatArray) -> _Fit:
        """Coefficients of the columns (N, p), averaged over τ and θ."""
        count, size = columns.shape
        scale = np.linalg.norm(columns, axis=0)
        scaled = columns / scale
        plain = self.value - scaled @ np.linalg.lstsq(scaled, self.value, rcond=None)[0]
        freedom = max(count - size, 1)
        grid = np.linspace(0.0, 2.5 * np.sqrt(plain @ plain / freedom), SCATTER_GRID) ** 2
        root = np.sqrt(self.variance)
        logs, means, covariances = [], [], []
        for place, (values, vectors) in enumerate(self._axes):
            turned = vectors.T @ (np.column_stack([scaled, self.value]) / root[:, None])
            spread = 1.0 + grid[:, None] * np.maximum(values, 0.0)[None, :]
            gram = np.einsum("ki,ia,ib->kab", 1.0 / spread, turned, turned, optimize=True)
            normal, right = gram[:, :size, :size], gram[:, :size, size]
            inverse = np.linalg.pinv(normal, hermitian=True)
            solved = np.einsum("kab,kb->ka", inverse, right)
            left = np.maximum(gram[:, size, size] - np.einsum("ka,ka->k", solved, right), 0.0)
            sign, logdet = np.linalg.slogdet(normal)
            prior = WHITE_PRIOR if place == 0 else (1.0 - WHITE_PRIOR) / (len(self._axes) - 1)
            logs.append(np.log(prior) - 0.5 * (np.log(spread).sum(axis=1) + np.where(sign > 0, logdet, 0.0) + left))
            means.append(solved)
            # Stated σ that are too large are not made smaller by what they leave over.
            covariances.append(inverse * np.maximum(1.0, left / freedom)[:, None, None])
        weight = np.exp(np.concatenate(logs) - np.max(np.concatenate(logs)))
        weight /= weight.sum()
        every = np.concatenate(means)
        mean = weight @ every
        apart = every - mean
        covariance = np.einsum("k,kab->ab", weight, np.concatenate(covariances)) + (apart.T * weight) @ apart
        return _Fit(
            mean / scale,
            covariance / np.outer(scale, scale),
            freedom,
            float(weight @ np.tile(np.sqrt(grid), len(self._axes))),
        )
