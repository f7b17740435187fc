"""Is a recording a processed copy of another one? Two runs of one motion share the motion, a copy shares the noise.

Between two runs of one commanded motion torques agree where the motion repeats them and differ by independent noise.
The regression of one run on the other then has a slope below 1 wherever there is noise: its share of what repeats. In a
copy, be it resampled, scaled or with noise added, the slope of the copy on its original is the same factor at every
frequency, as the original's noise is in it. So both are brought onto one grid, aligned, and regressed on each other
band by band, far above the motion's frequencies and below what resampling attenuates.

Resampling to a lower rate leaves no such band. There the copy is estimated from its original: interpolated between the
original's samples at the shift that fits best, or as a sum of averages over short intervals, which every filter before
a decimation comes close to. What that leaves of another run is at least its own noise; of a copy next to nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from drivers.core.arrays import FloatArray
from ident.signals.repetition import correlation

BAND = (0.06, 0.22)
"""Frequencies that are compared, over the lower of both rates."""

BANDS = 6
"""Into how many that range is cut."""

SEGMENT = 128
"""Samples of a segment of Welch's estimate."""

FEWEST_SEGMENTS = 12
"""Segments that the runs must have in common where bands are compared."""

FEWEST_SAMPLES = 256
"""Samples that the runs must have in common."""

SAME_MOTION = 0.8
"""Share of a run's power that the other one explains, from which on they may be of one motion: simulated arms of one
seed have the same noise in different motions."""

NO_NOISE, WHITE = 0.1, 2.0
"""Share of the other run's noise below which a run counts as free of it, and power of what both differ by at the
motion's frequencies, over that of white noise: another run differs there by friction, a copy by added noise alone."""

UNCERTAIN = 0.12
"""Standard deviation of a slope above which it does not count: added noise hides what it is of."""

UNCERTAIN_TOGETHER, LEAST_DEVIATION = 0.06, 1e-3
"""The same of all bands together, whose slope is that of a copy or of another run, a quarter away at least from half
way between; and of a single one, which else would weigh all."""

COUNTED = 0.3
"""Share of all bands of all joints that must count."""

NOISY = 0.5
"""Share of noise in a band's power from which on the band counts: what repeats makes a slope of the rest at most."""

LEFT_OF_NOISE, LEAST_RATE = 0.1, 100.0
"""Share of the original's noise that an estimate of a copy leaves at most, median of the joints; a fifth of it at lower
rates [Hz], where ripple of the gears, which another run repeats, looks like noise. Copies left 0 to 0.07, other runs of
one motion 0.75 and more."""

OTHER_NOISE = 1.5
"""Ratio of the variances of torque noise, of some joint, from which on equal positions are those of a copy: where a
simulated arm follows its motion exactly, another run has the same positions and as much noise."""

SAMPLES = 1500
"""Samples of a copy that are compared with the estimate by interpolation."""

INTERVALS, PER_STEP = 10, 4
"""Averages before and after a sample of which a decimated one is estimated, and how many last as long as a step."""


def copied_run(
    one: tuple[FloatArray, FloatArray, FloatArray], other: tuple[FloatArray, FloatArray, FloatArray]
) -> bool:
    """Whether one of two recordings holds the other's noise: in its torques or, where more was added, its positions.

    Args:
        one: stamps (N,) [s], rising, positions (N, n) [rad or m] and torques (N, n) [N·m or N].
        other: those of the other one.
    """
    (time, position, torque), (other_time, other_position, other_torque) = one, other
    if same_noise(time, torque, other_time, other_torque):
        return True
    pair = _aligned(time, torque, other_time, other_torque)
    if pair is None or not _same_motion(pair[0], pair[1]):
        return False
    noises = [np.maximum(_noise(torques), np.finfo(float).tiny) for torques in (torque, other_torque)]
    ratio = noises[0] / noises[1]
    changed = bool(np.any(np.maximum(ratio, 1.0 / ratio) > OTHER_NOISE))
    return changed and same_noise(time, position, other_time, other_position)


def same_noise(time: FloatArray, torque: FloatArray, other_time: FloatArray, other_torque: FloatArray) -> bool:
    """Return whether one of two signals, with rising times [s] and torques (N, n), holds the other's noise."""
    pair = _aligned(time, torque, other_time, other_torque)
    if pair is None:
        return False
    first, second, step, offset = pair
    if len(first) >= SEGMENT * (FEWEST_SEGMENTS + 1) // 2:
        noises = _noise(torque), _noise(other_torque)
        if _only_noise_added(first, second, *noises) or _only_noise_added(second, first, *noises[::-1]):
            return True
        if any(_copied(_slopes(*of_on)) for of_on in ((first, second, noises[1]), (second, first, noises[0]))):
            return True
    if not _same_motion(first, second):
        return False
    limit = LEFT_OF_NOISE * (1.0 if 1.0 / step >= LEAST_RATE else 0.2)
    return (
        _left_of_noise(time + offset, torque, other_time, other_torque, step) < limit
        or _left_of_noise(other_time - offset, other_torque, time, torque, step) < limit
    )


def _copied(slopes: FloatArray) -> bool:
    """Return whether slopes, shares of noise and deviations of the slopes (K, 3) are those of a copy."""
    certain = slopes[slopes[:, 2] < UNCERTAIN]
    noisy = certain[certain[:, 1] >= NOISY]
    least = max(1.0, COUNTED * len(slopes))
    if len(noisy) >= least:
        weights = np.ones(len(noisy))
    else:  # much noise was added: all bands together may still show what it hides in each
        noisy = slopes[(slopes[:, 1] >= NOISY) & np.isfinite(slopes[:, 2])]
        weights = 1.0 / np.maximum(noisy[:, 2], LEAST_DEVIATION) ** 2
        if len(noisy) < least or float(np.sum(weights)) ** -0.5 >= UNCERTAIN_TOGETHER:
            return False
    slope, share = (float(weights @ values / weights.sum()) for values in (noisy[:, 0], np.minimum(noisy[:, 1], 1.0)))
    return slope > 1.0 - 0.5 * share


def _same_motion(first: FloatArray, second: FloatArray) -> bool:
    """Return whether the torques (N, n) of most joints agree but for a factor."""
    centred, centred_other = (values - values.mean(axis=0) for values in (first, second))
    power = np.sum(centred**2, axis=0) * np.sum(centred_other**2, axis=0)
    shared = np.sum(centred * centred_other, axis=0)[power > 0.0] ** 2 / power[power > 0.0]
    return bool(len(shared) and np.median(shared) >= SAME_MOTION)


def _left_of_noise(
    time: FloatArray, torque: FloatArray, source_time: FloatArray, source: FloatArray, step: float
) -> float:
    """Return what the best estimate of a run from another one leaves, over its noise; the median of the joints."""
    from scipy.interpolate import CubicSpline

    rising = np.concatenate([[True], np.diff(np.maximum.accumulate(source_time)) > 0.0])
    source_time, source = source_time[rising], source[rising]
    noise, margin = _noise(source), (INTERVALS + 1) * step / PER_STEP
    used = (noise > 0.0) & (np.std(torque, axis=0) > 0.0)
    inside = np.flatnonzero((time >= source_time[0] + margin) & (time <= source_time[-1] - margin))[: 4 * SAMPLES]
    if not used.any() or len(inside) < FEWEST_SAMPLES - 4 * INTERVALS:
        return np.inf
    time, torque, source, noise = time[inside], torque[np.ix_(inside, used)], source[:, used], noise[used]
    near = slice(*np.searchsorted(source_time, (time[0] - 2.0 * margin, time[-1] + 2.0 * margin)))
    stamps, values = source_time[near], source[near]
    spline = CubicSpline(stamps, values)

    def straight(at: FloatArray) -> FloatArray:
        return np.stack([np.interp(at, stamps, column) for column in values.T], axis=1)

    some = slice(None, None, max(1, len(time) // SAMPLES))
    left = [_left_by_interpolation(time[some], torque[some], between, step) for between in (straight, spline)]
    left.append(_left_by_averages(time, torque, spline, step) / min(1.0, float(np.median(np.diff(stamps))) / step))
    return min(float(np.median(of_joints / noise)) for of_joints in left)


def _left_by_interpolation(
    time: FloatArray, torque: FloatArray, between: Callable[[FloatArray], FloatArray], step: float
) -> FloatArray:
    """Variance (n,) of what (N, n) has beside a factor times (N, n) between its samples, at the best shift."""
    torque = torque - torque.mean(axis=0)

    def left(shift: float) -> FloatArray:
        source = between(time + shift)
        source = source - source.mean(axis=0)
        factor = np.sum(torque * source, axis=0) / np.maximum(np.sum(source**2, axis=0), np.finfo(float).tiny)
        rest = np.mean((torque - factor * source) ** 2, axis=0)
        return np.asarray(rest / np.maximum(factor**2, np.finfo(float).tiny))

    def total(shift: float) -> float:
        return float(np.sum(np.log(left(shift) + np.finfo(float).tiny)))

    shifts = np.linspace(-step, step, 41)
    best = int(np.argmin([total(shift) for shift in shifts]))
    low, high = shifts[max(best - 1, 0)], shifts[min(best + 1, len(shifts) - 1)]
    for _ in range(25):  # golden section
        inner = low + 0.382 * (high - low), low + 0.618 * (high - low)
        low, high = (low, inner[1]) if total(inner[0]) < total(inner[1]) else (inner[0], high)
    return left(min((0.5 * (low + high), shifts[best]), key=total))


def _left_by_averages(
    time: FloatArray, torque: FloatArray, spline: Callable[[FloatArray], FloatArray], step: float
) -> FloatArray:
    """Variance (n,) of what (N, n) has beside the sum that fits best of averages of (N, n) around each sample."""
    length = step / PER_STEP
    integral = spline.antiderivative()  # type: ignore[attr-defined]
    edges = [integral(time + (k - 0.5) * length) for k in range(-INTERVALS, INTERVALS + 2)]
    left = np.empty(torque.shape[1])
    for joint in range(torque.shape[1]):
        averages = [(after[:, joint] - before[:, joint]) / length for before, after in pairwise(edges)]
        columns = np.stack([*averages, np.ones(len(time))], axis=1)
        rest = torque[:, joint] - columns @ np.linalg.lstsq(columns, torque[:, joint], rcond=1e-10)[0]
        gain = np.var(torque[:, joint]) / np.maximum(np.var(averages[INTERVALS]), np.finfo(float).tiny)
        left[joint] = np.sum(rest**2) / (len(time) - columns.shape[1]) / gain
    return left


def _only_noise_added(of: FloatArray, on: FloatArray, noise: FloatArray, other: FloatArray) -> bool:
    """Return whether (N, n) is (N, n), which has next to no noise, times a factor and with white noise.

    What is left of a shift and of interpolation is in proportion to the derivatives.
    """
    used = np.std(of, axis=0) > 0.0
    if not used.any() or np.any((other >= NO_NOISE * noise)[used]):
        return False
    explained = np.stack([on, np.gradient(on, axis=0), np.gradient(np.gradient(on, axis=0), axis=0)], axis=2)
    rest = np.empty_like(of)
    for joint in range(of.shape[1]):
        columns = explained[:, joint]
        rest[:, joint] = of[:, joint] - columns @ np.linalg.lstsq(columns, of[:, joint], rcond=None)[0]
    starts, window = range(0, len(of) - SEGMENT + 1, SEGMENT // 2), np.hanning(SEGMENT)[:, None]
    slow = slice(1, round(BAND[0] * SEGMENT))
    spectra = [np.abs(np.fft.rfft(window * rest[k : k + SEGMENT], axis=0)[slow]) ** 2 for k in starts]
    share = np.mean(spectra, axis=(0, 1)) / np.maximum(noise * float(np.sum(window**2)), np.finfo(float).tiny)
    return bool(np.all(share[used] < WHITE))


def _noise(values: FloatArray) -> FloatArray:
    """Variance (n,) of white noise by the fourth differences of (N, n), of which motion has next to nothing."""
    differences = np.diff(values, n=4, axis=0)
    return np.asarray(np.median(differences**2, axis=0) / (70.0 * 0.4549))


def _aligned(
    time: FloatArray, torque: FloatArray, other_time: FloatArray, other_torque: FloatArray
) -> tuple[FloatArray, FloatArray, float, float] | None:
    """Both on one grid (K, n) where they overlap after the shift at which they agree best; step and shift [s]."""
    if min(len(time), len(other_time)) < FEWEST_SAMPLES or torque.shape[1] != other_torque.shape[1]:
        return None
    step = max(float(np.median(np.diff(stamps))) for stamps in (time, other_time))
    if not step > 0.0:
        return None
    first, second = _on_grid(time, torque, step, 0.0), _on_grid(other_time, other_torque, step, 0.0)
    if min(len(first), len(second)) < FEWEST_SAMPLES:
        return None
    changes = [
        np.diff(torques, axis=0) / np.maximum(np.std(torque, axis=0), np.finfo(float).tiny)
        for torques in (first, second)
    ]
    match = correlation(changes[1].T, changes[0].T).sum(axis=0)
    best = int(np.argmax(match))
    lag = best - (len(changes[1]) - 1)
    shift = 0.0
    if 0 < best < len(match) - 1:  # between two steps of the grid
        before, at, after = match[best - 1 : best + 2]
        curve = before - 2.0 * at + after
        shift = float(np.clip(0.5 * (before - after) / curve, -0.5, 0.5)) if curve < 0.0 else 0.0
        second = _on_grid(other_time, other_torque, step, -shift * step)
    start, stop = max(0, lag), min(len(first), len(second) + lag)
    if stop - start < FEWEST_SAMPLES:
        return None
    offset = float(other_time[0] - time[0]) - (lag + shift) * step
    return first[start:stop], second[start - lag : stop - lag], step, offset


def _on_grid(time: FloatArray, values: FloatArray, step: float, offset: float) -> FloatArray:
    """Values (K, n) at even steps from the first stamp on, by cubic splines."""
    from scipy.interpolate import CubicSpline

    rising = np.concatenate([[True], np.diff(np.maximum.accumulate(time)) > 0.0])
    grid = np.arange(time[0], time[-1], step) + offset
    return np.asarray(CubicSpline(time[rising], values[rising])(np.clip(grid, time[0], time[-1])))


def _slopes(of: FloatArray, on: FloatArray, noise: FloatArray) -> FloatArray:
    """Slopes of (N, n) on (N, n) over those of the whole signals, shares of noise, deviations of the slopes (K, 3)."""
    starts = range(0, len(of) - SEGMENT + 1, SEGMENT // 2)
    window = np.hanning(SEGMENT)[:, None]
    spectra = [
        np.array(
            [
                np.fft.rfft(window * (signal[k : k + SEGMENT] - signal[k : k + SEGMENT].mean(axis=0)), axis=0)
                for k in starts
            ]
        )
        for signal in (of, on)
    ]
    edges = np.round(np.linspace(*BAND, BANDS + 1) * SEGMENT).astype(int)
    slopes = np.full((of.shape[1] * BANDS, 3), np.nan)
    for joint in range(of.shape[1]):
        y, x = (spectrum[:, :, joint] for spectrum in spectra)
        whole = float(np.sum(np.abs(x) ** 2))
        scale = float(np.sum((y * x.conj()).real)) / whole if whole > 0.0 else 0.0
        if scale**2 * whole < SAME_MOTION * float(np.sum(np.abs(y) ** 2)):
            continue
        for band, (low, high) in enumerate(pairwise(edges)):
            here, other = x[:, low:high], y[:, low:high]
            power, own = float(np.sum(np.abs(here) ** 2)), float(np.sum(np.abs(other) ** 2))
            if power <= 0.0 or scale <= 0.0:
                continue
            slope = float(np.sum((other * here.conj()).real)) / power
            deviation = np.sqrt(max(own / power - slope**2, 0.0) / here.size)  # segments overlap, values have two parts
            share = noise[joint] * float(np.sum(window**2)) * here.size / power
            slopes[joint * BANDS + band] = slope / scale, share, deviation / scale
    return slopes
