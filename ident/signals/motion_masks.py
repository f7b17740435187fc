"""Where and how fast the arm moves: the motion's band, and the windows with motion."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from drivers.core.arrays import FloatArray

BAND_POWER = 0.999
"""Share of a joint's velocity power that lies within the motion's band."""

BAND_LIMIT_HZ = 20.0
"""Upper limit of the motion's band: drives do not follow, and the noise of differentiated positions grows with f²."""

MOVING_JOINT = 0.01
"""A joint counts for the band when its velocity's RMS is at least this share of the fastest joint's."""

REST_SHARE = 0.005
REST_FLOOR = 1e-3
"""Default rest velocity: `REST_SHARE` of the largest speed of any joint, but at least `REST_FLOOR` [rad/s or m/s]."""

SHORTEST_REST = 0.3
"""A standstill shorter than this [s] is a velocity reversal, not a rest."""


def motion_band(position: FloatArray, rate: float) -> float:
    """The frequency [Hz] below which `BAND_POWER` of the velocity's power of every moving joint lies.

    Args:
        position: (n, N) [rad or m] on a uniform grid.
        rate: [Hz].

    Positions are differenced and weighted with a Hann window; the spectrum is summed up to `BAND_LIMIT_HZ` or a fifth
    of the rate. The share of white position noise, which grows with f² once differenced, is estimated from the upper
    half of that range and subtracted. At least two periods of the record; 0 where nothing moves.
    """
    samples = position.shape[1] - 1
    if samples < 8:
        return 0.0
    velocity = np.diff(position, axis=1) * rate
    power = np.abs(np.fft.rfft(velocity * np.hanning(samples), axis=1)) ** 2
    frequency = np.fft.rfftfreq(samples, 1 / rate)
    within = frequency <= min(BAND_LIMIT_HZ, rate / 5)
    power, frequency = power[:, within], frequency[within]
    differencing = (2 * rate * np.sin(np.pi * frequency / rate)) ** 2
    upper = frequency > frequency[-1] / 2
    # The median of exponentially distributed values is ln 2 of their mean.
    noise = np.median(power[:, upper] / differencing[upper], axis=1) / np.log(2)
    power = power - noise[:, None] * differencing
    total = power.sum(axis=1)
    moving = total > MOVING_JOINT**2 * total.max()
    if not moving.any():
        return 0.0
    share = np.cumsum(power[moving], axis=1) / total[moving, None]
    last = int(np.argmax(share >= BAND_POWER, axis=1).max())
    return float(max(frequency[last], 2 * rate / samples))


def default_rest_velocity(velocity: FloatArray) -> float:
    """The speed [rad/s or m/s] below which a joint counts as at rest, from `velocity` (n, N)."""
    return max(REST_FLOOR, REST_SHARE * float(np.abs(velocity).max(initial=0.0)))


def moving_mask(velocity: FloatArray, rate: float, rest_velocity: float) -> npt.NDArray[np.bool_]:
    """(N,) False where every joint stays below `rest_velocity` for `SHORTEST_REST` or longer.

    There sign(q̇) is noise, and dry friction anything between its two values. `velocity` is (n, N) [rad/s or m/s] at
    `rate` [Hz].
    """
    moving = np.any(np.abs(velocity) >= rest_velocity, axis=0)
    edges = np.flatnonzero(np.diff(np.concatenate([[True], moving, [True]]).astype(np.int8)))
    for start, stop in edges.reshape(-1, 2):
        if stop - start < SHORTEST_REST * rate:
            moving[start:stop] = True
    return np.asarray(moving)
