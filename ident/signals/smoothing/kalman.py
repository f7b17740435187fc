"""Kalman filter and Rauch-Tung-Striebel smoother of a sampled signal whose highest derivative is white noise.

The state holds the signal and its derivatives up to order m − 1; the m-th derivative is white noise of density q, and
a sample carries white noise of variance r. Only the ratio matters to the estimate, and it has a plain meaning: run
forward and backward, the smoother is a zero-phase low-pass with

    gain(f) = 1 / (1 + (f / f_c)^(2m))        (2π·f_c)^(2m) = q / (r·T)

at a sampling period T well below 1/f_c: for m = 4 (white snap, "constant jerk") that of the zero-phase Butterworth of
order 4 with the cut-off f_c, but with derivatives that central differences do not attenuate.

A loop runs the filter until its gain is stationary, and the smoother over the same samples, which begin the record.
The rest has constant gains, and therefore is a linear recursion in the eigenvectors of its matrix. For 200,000 samples
of 7 joints this needs 0.2 s, where filterpy's loops over samples need 32 s (23 µs a sample); both agree to 1e-9
(tests/ident/signals/smoothing/test_kalman.py).

Source: Rauch, Tung, Striebel, AIAA Journal 3 (1965); Bar-Shalom, Li, Kirubarajan, Estimation with Applications to
Tracking and Navigation (2001), section 6.2; Kalman smoothing of recorded signals: ROCR6 section 4.2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from drivers.core.arrays import FloatArray

WHITE_SNAP = 4
"""Order of the model of a position: its fourth derivative is white noise (constant jerk between samples)."""

WHITE_CURVATURE = 2
"""Order of the model of a torque: its second derivative is white noise; it jumps where friction reverses."""

_PRIOR_VARIANCE = 1e8
"""Variance of the first state, in variances of a sample: samples outweigh it at once."""

_STATIONARY = 1e-11
"""Relative difference from the stationary gain below which a gain counts as stationary."""

HIGHEST_CUTOFF = 0.2
"""Share of the rate below which the smoother's cut-off is sought; above, next to nothing is smoothed."""

MOST_SAMPLES = 20_000
"""From the middle of a longer record; more say the same."""

_CUTOFFS_TRIED = 12  # cut-offs that are tried before the best of them is refined
_CUTOFF_ACCURACY = 0.01  # relative accuracy of the cut-off
_FILTER_ROUNDING = (
    1e-12  # of the largest sample: what remains of a signal without any noise, by any processor's arithmetic
)


@dataclass(frozen=True, eq=False)
class StationaryFilter:
    """The filter and the smoother with constant gains, in units in which f_c is 1/2π and a sample's variance is 1."""

    transition: FloatArray  # (m, m) F, from one sample to the next
    process: FloatArray  # (m, m) Q
    gain: FloatArray  # (m,) K of the filter
    innovation: float  # variance S of a sample about its prediction, in variances of a sample
    smoother_gain: FloatArray  # (m, m) C of the smoother


@lru_cache(maxsize=64)
def stationary_filter(step: float, order: int) -> StationaryFilter:
    """The stationary filter for `step` = 2π·f_c·T and a model of `order` m, from the discrete Riccati equation."""
    from scipy.linalg import solve_discrete_are

    powers = np.subtract.outer(np.arange(order), np.arange(order))
    transition = np.array([[step**-p / math.factorial(-p) if p <= 0 else 0.0 for p in row] for row in powers.tolist()])
    left = np.arange(order - 1, -1, -1)
    factorials = np.array([math.factorial(power) for power in left.tolist()], dtype=np.float64)
    total = np.add.outer(left, left) + 1  # ∫ of the noise's effect over a step, Bar-Shalom 6.2.2
    process = step ** (total + 1.0) / (np.outer(factorials, factorials) * total)
    first = np.zeros((order, 1))
    first[0] = 1.0
    predicted = solve_discrete_are(transition.T, first, process, np.ones((1, 1)))
    innovation = float(predicted[0, 0]) + 1.0
    gain = predicted[:, 0] / innovation
    filtered = predicted - np.outer(gain, gain) * innovation
    smoother_gain = np.asarray(np.linalg.solve(predicted, transition @ filtered).T, dtype=np.float64)
    return StationaryFilter(transition, process, gain, innovation, smoother_gain)


def kalman_smoother(samples: FloatArray, rate: float, cutoff: float, order: int = WHITE_SNAP) -> FloatArray:
    """The signal and its derivatives as the smoother estimates them, from the whole record: without lag.

    Args:
        samples: (N,) on a uniform grid.
        rate: [Hz].
        cutoff: f_c [Hz].
        order: m of the model.

    Returns:
        (m, N) the signal, its first, its second derivative … [unit of the samples / s^k].
    """
    stationary, means, covariances = _filtered(samples, rate, cutoff, order)
    start = len(covariances)
    if start < means.shape[1]:
        last = means[:, start - 1 :]
        transition, smoother_gain = stationary.transition, stationary.smoother_gain
        inputs = (np.eye(order) - smoother_gain @ transition) @ last[:, :-1]
        backward = _recursion(smoother_gain, np.eye(order), inputs[:, ::-1], last[:, -1])
        means[:, start - 1 : -1] = backward[:, ::-1]
    transition, process = stationary.transition, stationary.process
    for index in range(start - 2, -1, -1):  # the last of these samples is smoothed already where others follow
        predicted = transition @ covariances[index] @ transition.T + process
        gain = covariances[index] @ transition.T @ np.linalg.inv(predicted)
        means[:, index] += gain @ (means[:, index + 1] - transition @ means[:, index])
    return np.asarray(means * (2.0 * math.pi * cutoff) ** np.arange(order)[:, None])  # by s, not by 1/2πf_c


def innovations(samples: FloatArray, step: float, order: int) -> FloatArray:
    """(N − 1,) samples minus their predictions by the stationary filter, started settled on the first one."""
    stationary = stationary_filter(step, order)
    start = np.zeros(order)
    start[0] = samples[0]
    means = _recursion(_closed_loop(stationary), stationary.gain[:, None], samples[None, 1:], start)
    before = np.column_stack([start, means[:, :-1]])
    return np.asarray(samples[1:] - stationary.transition[0] @ before)


def _filtered(
    samples: FloatArray, rate: float, cutoff: float, order: int
) -> tuple[StationaryFilter, FloatArray, FloatArray]:
    """The filter, its means (m, N), and the covariances (k, m, m) of the samples before it is stationary."""
    stationary = stationary_filter(2.0 * math.pi * cutoff / rate, order)
    transition = stationary.transition
    mean, covariance = np.eye(order)[0] * samples[0], _PRIOR_VARIANCE * np.eye(order)
    means = np.empty((order, len(samples)))
    covariances = []
    tolerance = _STATIONARY * np.abs(stationary.gain).max()
    for index, sample in enumerate(samples):
        mean, covariance = transition @ mean, transition @ covariance @ transition.T + stationary.process
        gain = covariance[:, 0] * (1.0 / (covariance[0, 0] + 1.0))
        mean = mean + gain * (sample - mean[0])
        kept = np.eye(order) - np.outer(gain, np.eye(order)[0])
        covariance = kept @ covariance @ kept.T + np.outer(gain, gain)  # Joseph's form stays positive
        means[:, index] = mean
        covariances.append(covariance)
        if np.abs(gain - stationary.gain).max() <= tolerance:
            break
    start = len(covariances)
    if start < len(samples):
        rest = _recursion(
            _closed_loop(stationary), stationary.gain[:, None], samples[None, start:], means[:, start - 1]
        )
        means[:, start:] = rest
    return stationary, means, np.array(covariances)


def _closed_loop(stationary: StationaryFilter) -> FloatArray:
    """(m, m) from one filtered state to the next: (I − K·H)·F."""
    return np.asarray(stationary.transition - np.outer(stationary.gain, stationary.transition[0]))


def _recursion(matrix: FloatArray, inward: FloatArray, inputs: FloatArray, start: FloatArray) -> FloatArray:
    """States (m, N) of x(t) = matrix·x(t − 1) + inward·u(t) for `inputs` (k, N), from the state `start` (m,) before."""
    from scipy.signal import lfilter

    poles, vectors = np.linalg.eig(matrix)
    to_modes = np.linalg.inv(vectors)
    states = np.zeros((len(matrix), inputs.shape[1]))
    for mode in np.flatnonzero(poles.imag >= 0):
        driven = (to_modes[mode] @ inward) @ inputs
        initial = np.array([poles[mode] * (to_modes[mode] @ start)])
        values, _ = lfilter([1.0], [1.0, -poles[mode]], driven.astype(np.complex128), zi=initial)
        # Of a conjugate pair one mode is computed; the other doubles the real part.
        states += (2.0 if poles[mode].imag > 0 else 1.0) * np.outer(vectors[:, mode], values).real
    return states


def cutoff_of_noise(density: float, variance: float, rate: float, order: int) -> float:
    """Cut-off f_c [Hz] of the smoother for noise levels: (2π·f_c)^(2m) = q·rate / r.

    Args:
        density: q, of the m-th derivative [unit of the samples² / s^(2m − 1)].
        variance: r, of a sample [unit of the samples²].
        rate: [Hz].
        order: m of the model.
    """
    return float((density * rate / variance) ** (0.5 / order) / (2.0 * math.pi))


def likeliest_cutoff(samples: FloatArray, rate: float, order: int, lowest_cutoff: float) -> float:
    """Cut-off [Hz] of the smoother, from the ratio of both noises, that makes the innovations likeliest.

    With the variance of the samples eliminated, the likelihood is largest where the mean square of the innovations of
    the stationary filter is smallest, so the cut-off is the only unknown.

    Args:
        samples: (N,) on a uniform grid.
        rate: [Hz].
        order: m of the model.
        lowest_cutoff: [Hz] below it the smoother would distort the motion.
    """
    from scipy.optimize import minimize_scalar

    middle = _middle(samples)
    highest = HIGHEST_CUTOFF * rate
    lowest = min(lowest_cutoff, highest)

    def cost(log_cutoff: float) -> float:
        square = _mean_square(middle, math.exp(log_cutoff) / rate, order)
        return math.log(square) if square > 0 else -math.inf

    grid = np.linspace(math.log(lowest), math.log(highest), _CUTOFFS_TRIED)
    costs = [cost(value) for value in grid]
    best = int(np.argmin(costs))
    chosen = float(grid[best])
    if math.isfinite(costs[best]) and lowest < highest:
        bounds = (grid[max(0, best - 1)], grid[min(_CUTOFFS_TRIED - 1, best + 1)])
        refined = minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": _CUTOFF_ACCURACY})
        if refined.fun < costs[best]:
            chosen = float(refined.x)
    return math.exp(chosen)


def sample_noise(samples: FloatArray, rate: float, order: int, cutoff: float) -> float:
    """Standard deviation √r of a sample's noise, with what the model does not follow of the motion.

    Arguments as those of `likeliest_cutoff`, with the smoother's `cutoff` [Hz].
    """
    innovation = stationary_filter(2.0 * math.pi * cutoff / rate, order).innovation
    return math.sqrt(_mean_square(_middle(samples), cutoff / rate, order) / innovation)


def _middle(samples: FloatArray) -> FloatArray:
    first = max(0, (len(samples) - MOST_SAMPLES) // 2)
    return samples[first : first + MOST_SAMPLES]


def _mean_square(samples: FloatArray, relative_cutoff: float, order: int) -> float:
    """Mean square of the innovations, without those while the filter settles; `relative_cutoff` = f_c·T."""
    errors = innovations(samples, 2.0 * math.pi * relative_cutoff, order)
    settling = min(math.ceil(2.0 / relative_cutoff), len(errors) // 2)
    square = float(np.mean(errors[settling:] ** 2))
    return square if square > (_FILTER_ROUNDING * np.abs(samples).max()) ** 2 else 0.0
