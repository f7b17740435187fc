"""Forward simulation of any model that predicts torques, against an arm that keeps its velocity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import FloatArray
from ident.benchmark.entry import TorquePredictor
from ident.benchmark.motion import BenchmarkMotion

DURATION = 0.3
"""[s] of a window."""

STEP = 0.002
"""[s] of the semi-implicit Euler steps."""

WINDOWS = 20
"""Windows of a motion at most, evenly spaced."""

LEAST_SPEED = 0.1
"""[rad/s or m/s] Some joint is at least so fast where a window begins."""

DIVERGED = 10.0
"""Error, as a multiple of the constant velocity's, from which a window has diverged."""


@dataclass(frozen=True)
class ForwardError:
    """Errors of simulated positions, under the measured torques and from measured states."""

    ratio: float  # median over the windows of the error over that of constant velocity; below 1 the model is of use
    diverged: float  # share of the windows beyond `DIVERGED`, or without an inertia matrix that can be inverted
    windows: int  # their number


def forward_error(predictor: TorquePredictor, motions: list[BenchmarkMotion]) -> ForwardError | None:
    """Simulate windows of held-out motions side by side; None where no joint moves.

    The inertia matrix and the other torques are taken from the predictor's torques, so that every model is simulated
    alike: M's columns are τ(q, 0, e_j) − τ(q, 0, 0), the rest is τ(q, q̇, 0).
    """
    ratios = [_window_ratios(predictor, motion) for motion in motions]
    every = np.concatenate(ratios)
    if not len(every):
        return None
    finite = np.where(np.isfinite(every), every, np.inf)
    return ForwardError(float(np.median(finite)), float(np.mean(finite > DIVERGED)), len(every))


def _window_ratios(predictor: TorquePredictor, motion: BenchmarkMotion) -> FloatArray:
    length = int(DURATION * motion.rate)
    first, last = motion.inner.start, motion.inner.stop - length
    fast = np.flatnonzero(np.max(np.abs(motion.dq), axis=1) >= LEAST_SPEED)
    fast = fast[(fast >= first) & (fast < last)]
    if not len(fast):
        return np.zeros(0)
    starts = fast[np.unique(np.linspace(0, len(fast) - 1, WINDOWS).astype(int))]
    time = np.arange(len(motion.q)) / motion.rate
    delays = np.broadcast_to(predictor.delay, motion.q.shape[1])
    columns = zip(motion.in_band(motion.torque).T, delays, strict=True)
    driving = np.stack([np.interp(time + delay, time, column) for column, delay in columns], axis=1)
    q, dq = motion.q[starts], motion.dq[starts]
    steps = int(DURATION / STEP)
    own, constant = np.zeros(len(starts)), np.zeros(len(starts))
    with np.errstate(all="ignore"):
        for step in range(1, steps + 1):
            seconds = starts / motion.rate + (step - 1) * STEP
            torque = _at(time, driving, seconds)
            acceleration = _acceleration(predictor, q, dq, torque)
            dq = dq + STEP * acceleration
            q = q + STEP * dq
            measured = _at(time, motion.q, seconds + STEP)
            own += np.mean(np.square(q - measured), axis=1)
            kept = motion.q[starts] + step * STEP * motion.dq[starts]
            constant += np.mean(np.square(kept - measured), axis=1)
        return np.sqrt(own / constant)


def _acceleration(predictor: TorquePredictor, q: FloatArray, dq: FloatArray, torque: FloatArray) -> FloatArray:
    """Accelerations (W, n); nan where the simulation has left every sensible state."""
    joints = q.shape[1]
    sane = np.all(np.isfinite(q) & np.isfinite(dq), axis=1) & (np.max(np.abs(dq), axis=1, initial=0.0) < 1e3)
    result = np.full_like(q, np.nan)
    if not sane.any():
        return result
    q, dq, count = q[sane], dq[sane], int(sane.sum())
    still = np.zeros_like(q)
    units = np.tile(np.eye(joints), (count, 1))
    positions = np.concatenate([q, q, np.repeat(q, joints, axis=0)])
    velocities = np.concatenate([dq, still, np.zeros_like(units)])
    accelerations = np.concatenate([still, still, units])
    torques = np.asarray(predictor.torque(positions, velocities, accelerations), dtype=np.float64)
    rest, level = torques[:count], torques[count : 2 * count]
    columns = torques[2 * count :].reshape(count, joints, joints) - level[:, None, :]
    matrices = columns.transpose(0, 2, 1)
    solved = [
        np.linalg.lstsq(matrix, right, rcond=None)[0] if np.all(np.isfinite(matrix)) else np.full(joints, np.nan)
        for matrix, right in zip(matrices, torque[sane] - rest, strict=True)
    ]
    result[sane] = solved
    return result


def _at(time: FloatArray, values: FloatArray, seconds: FloatArray) -> FloatArray:
    return np.stack([np.interp(seconds, time, column) for column in values.T], axis=1)
