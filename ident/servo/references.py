"""What positions would be without a servo model: the command itself, one delay and lag for all joints, a model file."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import minimize
from scipy.signal import lfilter

from drivers.core.arrays import FloatArray
from ident.servo.motion import SETTLING, ServoMotion

DELAY_AND_LAG = ((0.02, 0.03), (0.02, 0.1), (0.08, 0.03))
"""[s] Starts of the search."""


def command_paths(motions: Sequence[ServoMotion]) -> list[FloatArray]:
    """Commands (N, n) at the samples of each motion."""
    return [_delayed(motion, 0.0, 0.0) for motion in motions]


def delay_and_lag(motions: Sequence[ServoMotion]) -> tuple[float, float]:
    """The delay and first-order lag [s] of all joints together with the least mean absolute error."""

    def cost(point: FloatArray) -> float:
        delay, lag = np.abs(point)
        errors = [
            np.abs(_delayed(motion, float(delay), float(lag)) - motion.position)[motion.time >= SETTLING]
            for motion in motions
        ]
        return float(np.mean(np.concatenate(errors)))

    starts = sorted((cost(np.array(start)), start) for start in DELAY_AND_LAG)
    best = minimize(
        cost, np.array(starts[0][1]), method="Nelder-Mead", options={"xatol": 5e-4, "fatol": 1e-7, "maxfev": 80}
    )
    delay, lag = np.abs(best.x)
    return float(delay), float(lag)


def delayed_paths(motions: Sequence[ServoMotion], delay: float, lag: float) -> list[FloatArray]:
    """Commands (N, n) at the samples of each motion, delayed and lagged [s]."""
    return [_delayed(motion, delay, lag) for motion in motions]


def _delayed(motion: ServoMotion, delay: float, lag: float) -> FloatArray:
    step = motion.step
    times = np.arange(-motion.history, len(motion.command) - motion.history) * step
    share = 1.0 if lag <= 0 else 1.0 - np.exp(-step / lag)
    begin = motion.command[:1]
    filtered = lfilter([share], [1.0, share - 1.0], motion.command - begin, axis=0) + begin
    return np.stack([np.interp(motion.time - delay, times, column) for column in filtered.T], axis=1)
