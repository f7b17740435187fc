"""Hashes of a recording's samples: whether two recordings hold the same data, whatever their files are called.

A sample is one instant: positions and torques of all joints, rounded coarser than a copy in single precision or as text
rounds them and finer than the noise between two runs of one motion. A copy, a part and a decimated copy share its
hashes; an interpolated copy shares those of the stamps that both have. Only the smallest hashes are kept (a bottom-k
sketch: A. Broder, On the resemblance and containment of documents, 1997): the share of common samples is estimated from
the samples of one recording whose hash lies below the largest that is kept of the other.

Two runs of one motion share the motion, a processed copy shares the noise, too (`same_noise`). Between two runs of one
commanded motion torques agree where the motion repeats them and differ by independent noise. The regression of one run
on the other then has a slope below 1 wherever there is noise: its share of what repeats. In a copy, be it resampled,
scaled or with noise added, the slope of the copy on its original is the same factor at every frequency, as the
original's noise is in it. So both are brought onto one grid, aligned, and regressed on each other band by band, far
above the motion's frequencies and below what resampling attenuates.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from drivers.core.arrays import FloatArray

KEPT = 1024
"""Hashes that are kept of a recording."""

BITS = 48
"""Bits of a hash: every JSON reader holds such an integer exactly."""

SMALLEST_VALUE = 1e-200
"""Smaller values count as 0: ten to the power of their digits would overflow."""
LEAST_OVERLAP = 0.02
"""Share of common samples up to which it may be coincidence: a joint that passes a pose again with the same torque."""

SAME_DATA = 0.8
"""Share of common samples from which on nothing new is in a recording; rounding loses some of them."""

MANY_JOINTS = 4
"""From so many joints on, coarse rounding is enough to tell samples apart."""

HashArray = npt.NDArray[np.uint64]

BAND = (0.06, 0.22)
"""Frequencies that are compared, over the lower of both rates."""

BANDS = 6
"""Into how many that range is cut."""

SEGMENT = 128
"""Samples of a segment of Welch's estimate."""

FEWEST_SEGMENTS = 12
"""Segments that the runs must have in common."""

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

COHERENT, EQUAL_SLOPE, LEAST_RATE = 0.93, 0.955, 100.0
"""Where noise is not seen, as it was filtered out or ripple of the gears is larger: coherence or slope from which on,
in nine of ten bands, the data are the same, and rate [Hz] that this needs. Ripple that repeats exactly, with next to no
noise, reached 0.84 and 0.93 on simulated arms; linear interpolation left 0.946, added noise a slope of 0.96."""


def sample_hashes(position: FloatArray, torque: FloatArray) -> HashArray:
    """The hashes (M,) of the samples, each once; a sample that repeats the one before does not count.

    Args:
        position: (N, n) as recorded [rad or m].
        torque: (N, n) [N·m or N].
    """
    decimals, digits = (4, 3) if position.shape[1] >= MANY_JOINTS else (6, 5)
    values = np.concatenate([position, torque], axis=1)
    changed = np.ones(len(values), dtype=np.bool_)
    changed[1:] = np.any(np.diff(values, axis=0) != 0.0, axis=1)
    changed &= np.all(np.isfinite(values), axis=1)
    rounded = np.rint(position[changed] * 10.0**decimals).astype(np.int64)
    return np.unique(_mixed(np.concatenate([rounded, *_significant(torque[changed], digits)], axis=1)))


def kept_hashes(hashes: HashArray) -> list[int]:
    """The smallest `KEPT` of the hashes, rising."""
    return [int(value) for value in np.sort(hashes)[:KEPT]]


def overlap(hashes: HashArray, others: Iterable[Sequence[int]]) -> float:
    """The share of a recording's samples that others hold, too; 0 up to `LEAST_OVERLAP`, 1 from `SAME_DATA` on.

    Args:
        hashes: (M,) of all its samples.
        others: those kept of each of the other recordings.
    """
    kept = [other for other in others if len(other)]
    if not kept or not len(hashes):
        return 0.0
    complete = min((max(of_run) for of_run in kept if len(of_run) >= KEPT), default=1 << BITS)
    comparable = hashes[hashes <= np.uint64(complete)]
    if not len(comparable):
        return 0.0
    common = np.isin(comparable, np.concatenate([np.asarray(of_run, dtype=np.uint64) for of_run in kept]))
    share = float(np.mean(common))
    return 0.0 if share <= LEAST_OVERLAP else 1.0 if share >= SAME_DATA else share


def _significant(values: FloatArray, digits: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Mantissas of so many decimal digits and their exponents."""
    size = np.abs(values)
    exponent = np.where(size > SMALLEST_VALUE, np.floor(np.log10(np.where(size > SMALLEST_VALUE, size, 1.0))), 0.0)
    mantissa = np.rint(values * 10.0 ** (digits - 1 - exponent))
    return mantissa.astype(np.int64), exponent.astype(np.int64)


def _mixed(rows: npt.NDArray[np.int64]) -> HashArray:
    """A hash of `BITS` bits per row (N, m): the finaliser of SplitMix64, column after column (Steele et al. 2014)."""
    state = np.full(len(rows), 0x9E3779B97F4A7C15, dtype=np.uint64)
    with np.errstate(over="ignore"):
        for column in rows.T:
            state = state ^ column.astype(np.uint64)
            state = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
            state = (state ^ (state >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
            state = (state ^ (state >> np.uint64(31))) + np.uint64(0x9E3779B97F4A7C15)
    return np.asarray(state >> np.uint64(64 - BITS))


def same_noise(time: FloatArray, torque: FloatArray, other_time: FloatArray, other_torque: FloatArray) -> bool:
    """Whether one of two recordings holds the other's noise.

    Args:
        time: (N,) [s], rising.
        torque: (N, n) [N·m or N].
        other_time: (M,) of the other one.
        other_torque: (M, n).
    """
    pair = _aligned(time, torque, other_time, other_torque)
    if pair is None:
        return False
    first, second, step = pair
    noises = _noise(torque), _noise(other_torque)
    if _only_noise_added(first, second, *noises) or _only_noise_added(second, first, *noises[::-1]):
        return True
    slow = 1.0 / step < LEAST_RATE
    pairs = (first, second, noises[1]), (second, first, noises[0])
    return any(_copied(_slopes(of, on, noise), slow) for of, on, noise in pairs)


def _copied(slopes: FloatArray, slow: bool) -> bool:
    """Whether slopes, shares of noise, coherence and deviations of the slopes (K, 4) are those of a copy."""
    certain = slopes[slopes[:, 3] < UNCERTAIN]
    noisy = certain[certain[:, 1] >= NOISY]
    least = max(1.0, COUNTED * len(slopes))
    if len(noisy) < least:  # much noise was added: all bands together may still show what it hides in each
        noisy = slopes[(slopes[:, 1] >= NOISY) & np.isfinite(slopes[:, 3])]
        weights = 1.0 / np.maximum(noisy[:, 3], LEAST_DEVIATION) ** 2
        known_together = len(noisy) >= least and float(np.sum(weights)) ** -0.5 < UNCERTAIN_TOGETHER
    else:
        weights, known_together = np.ones(len(noisy)), True
    if known_together:
        slope, share = (
            float(weights @ values / weights.sum()) for values in (noisy[:, 0], np.minimum(noisy[:, 1], 1.0))
        )
        return slope > 1.0 - 0.5 * share
    if slow or len(certain) < least:
        return False
    lowest = np.quantile(certain, 0.1, axis=0)
    return bool(lowest[2] > COHERENT or lowest[0] > EQUAL_SLOPE)


def _only_noise_added(of: FloatArray, on: FloatArray, noise: FloatArray, other: FloatArray) -> bool:
    """Whether (N, n) is (N, n), which has next to no noise, times a factor and with white noise.

    What is left of a shift and of interpolation is in proportion to the derivatives.

    Args:
        of: with noise.
        on: without.
        noise: variance (n,) of the first one's.
        other: of the second one's.
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
) -> tuple[FloatArray, FloatArray, float] | None:
    """Both on one grid (K, n), where they overlap after the shift at which they agree best, and its step [s]."""
    from scipy.signal import correlate

    need = SEGMENT * (FEWEST_SEGMENTS + 1) // 2
    if min(len(time), len(other_time)) < need or torque.shape[1] != other_torque.shape[1]:
        return None
    step = max(float(np.median(np.diff(stamps))) for stamps in (time, other_time))
    if not step > 0.0:
        return None
    first, second = _on_grid(time, torque, step, 0.0), _on_grid(other_time, other_torque, step, 0.0)
    if min(len(first), len(second)) < need:
        return None
    changes = [
        np.diff(torques, axis=0) / np.maximum(np.std(torque, axis=0), np.finfo(float).tiny)
        for torques in (first, second)
    ]
    pairs = zip(changes[0].T, changes[1].T, strict=True)
    match = np.sum([correlate(a, b, method="fft") for a, b in pairs], axis=0)
    best = int(np.argmax(match))
    lag = best - (len(changes[1]) - 1)
    if 0 < best < len(match) - 1:  # between two steps of the grid
        before, at, after = match[best - 1 : best + 2]
        curve = before - 2.0 * at + after
        shift = float(np.clip(0.5 * (before - after) / curve, -0.5, 0.5)) if curve < 0.0 else 0.0
        second = _on_grid(other_time, other_torque, step, -shift * step)
    start, stop = max(0, lag), min(len(first), len(second) + lag)
    if stop - start < need:
        return None
    return first[start:stop], second[start - lag : stop - lag], step


def _on_grid(time: FloatArray, values: FloatArray, step: float, offset: float) -> FloatArray:
    """Values (K, n) at even steps from the first stamp on, by cubic splines."""
    from scipy.interpolate import CubicSpline

    rising = np.concatenate([[True], np.diff(np.maximum.accumulate(time)) > 0.0])
    grid = np.arange(time[0], time[-1], step) + offset
    return np.asarray(CubicSpline(time[rising], values[rising])(np.clip(grid, time[0], time[-1])))


def _slopes(of: FloatArray, on: FloatArray, noise: FloatArray) -> FloatArray:
    """Slopes of (N, n) on (N, n) over those of the whole signals, shares of noise, coherence, deviations (K, 4)."""
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
    slopes = np.full((of.shape[1] * BANDS, 4), np.nan)
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
            slopes[joint * BANDS + band] = slope / scale, share, slope**2 * power / own, deviation / scale
    return slopes
