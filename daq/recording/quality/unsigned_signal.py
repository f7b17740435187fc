"""Has a motor signal lost its sign? A magnitude reaches zero again and again, and never passes through it."""

from __future__ import annotations

import numpy as np

from daq.recording.quality.quantisation import resolution
from drivers.core.arrays import FloatArray

OTHER_SIGN = 1e-3
"""Share of a signal's samples that single wrong ones may have on the other side of zero."""

NEAR_ZERO = 0.1
"""A signal near zero, over its root mean square …"""

OFTEN = 2e-3
"""… and the share of the samples that are so near, of a signal that reaches zero as a habit."""

REVERSALS = 4
"""So often a joint must turn round for the sign of its friction to show."""

LEAST_TRAVEL = 10.0
"""Encoder steps between two reversals that count."""


def unsigned_joints(signal: FloatArray, position: FloatArray) -> tuple[int, ...]:
    """Joints whose signal stays on one side of zero and reaches it, although they turn round again and again.

    Empty where any joint's signal has both signs: one kind of drive gives one kind of signal. A signed signal may stay
    on one side while gravity outweighs friction, but then it keeps away from zero, or noise takes it across.

    Args:
        signal: (N, n) current, voltage or torque.
        position: (N, n) of the same joints [rad or m].
    """
    known = np.isfinite(signal).all(axis=1) & np.isfinite(position).all(axis=1)
    signal, position = signal[known], position[known]
    if not len(signal):
        return ()
    if np.any((np.mean(signal < 0.0, axis=0) > OTHER_SIGN) & (np.mean(signal > 0.0, axis=0) > OTHER_SIGN)):
        return ()
    size = np.sqrt(np.mean(signal**2, axis=0))
    near = np.mean(np.abs(signal) < NEAR_ZERO * size, axis=0) > OFTEN
    return tuple(
        joint for joint in np.flatnonzero(near & (size > 0.0)).tolist() if _reversals(position[:, joint]) >= REVERSALS
    )


def _reversals(position: FloatArray) -> int:
    """How often a position (N,) turns round by more than its noise and its encoder's steps."""
    travel = max(LEAST_TRAVEL * resolution(position), 0.05 * float(np.ptp(position)))
    levels = np.round(position / travel) if np.isfinite(travel) and travel > 0.0 else np.zeros(0)
    steps = np.diff(levels)
    directions = np.sign(steps[steps != 0.0])
    return int(np.count_nonzero(directions[1:] != directions[:-1]))
