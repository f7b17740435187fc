"""Roll-out of a whole servo arm on commands alone: joints together, the links brought up to date in between.

Each pass rolls out all joints with the inertia between them, gravity and what depends on velocities along the arm's
last path, which change little with it. Beside it, what positions would be without a model: the command itself, and one
delay and lag for all joints.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import minimize

from drivers.core.arrays import FloatArray
from ident.servo.contact import ServoContact
from ident.servo.links import ServoLinks
from ident.servo.motion import SETTLING, ServoMotion, lanes_of, motion_load, motion_touch
from ident.servo.rollout.lanes import THINNED, Lanes, at_samples
from ident.servo.rollout.rollout import roll_out
from ident.servo.terms import INDEX

AT_ONCE = 16
"""Motions side by side."""

PASSES = 12
"""At most."""

SETTLED = 5e-4
"""[rad or m] Mean change of a path between two passes at which the passes end."""

DELAY_AND_LAG = ((0.02, 0.03), (0.02, 0.1), (0.08, 0.03))
"""[s] Starts of the search."""


def roll_out_arm(
    motions: Sequence[ServoMotion], links: ServoLinks, values: FloatArray, contact: ServoContact | None = None
) -> list[FloatArray]:
    """Positions (N, n) of each motion at its samples, from its commands and first position alone [rad or m].

    Args:
        motions: of one arm.
        links: of the arm.
        values: (n, terms) parameters.
        contact: what the arm may touch.
    """
    return [path for path, _ in touched_paths(motions, links, values, contact)]


def touched_paths(
    motions: Sequence[ServoMotion], links: ServoLinks, values: FloatArray, contact: ServoContact | None = None
) -> list[tuple[FloatArray, FloatArray]]:
    """The same with the contact's force (N,) [N] at the samples."""
    found: list[tuple[FloatArray, FloatArray]] = []
    for first in range(0, len(motions), AT_ONCE):
        found += _side_by_side(motions[first : first + AT_ONCE], links, values, contact)
    return found


def _on_grids(motions: Sequence[ServoMotion], lanes: Lanes, path: FloatArray) -> list[FloatArray]:
    """Positions (K, n) of each motion on its own grid."""
    times, joints = np.arange(len(path)) * lanes.step, motions[0].position.shape[1]
    return [
        np.stack([np.interp(motion.grid, times, column) for column in own.T], axis=1)
        for motion, own in zip(motions, np.split(path, path.shape[1] // joints, axis=1), strict=True)
    ]


def _side_by_side(
    motions: Sequence[ServoMotion], links: ServoLinks, values: FloatArray, contact: ServoContact | None
) -> list[tuple[FloatArray, FloatArray]]:
    joints = len(values)
    lanes, new, force = _settled(motions, links, values, contact)
    sampled, times = at_samples(lanes, new), np.arange(len(new)) * lanes.step
    return [
        (
            sampled[: len(motion.time), number * joints : (number + 1) * joints],
            np.zeros(len(motion.time)) if contact is None else np.interp(motion.time, times, force[:, number]),
        )
        for number, motion in enumerate(motions)
    ]


def _settled(
    motions: Sequence[ServoMotion], links: ServoLinks, values: FloatArray, contact: ServoContact | None
) -> tuple[Lanes, FloatArray, FloatArray]:
    """The lanes of the last pass, with their positions and forces."""
    zero = values[:, INDEX["zero"]]
    paths = []
    for motion in motions:
        paths.append(motion.command[motion.history :].copy())
        paths[-1][0] = motion.position[0]
    before = np.inf
    surface = None if contact is None else contact.surface(len(motions))
    for number in range(PASSES):
        loads, touches = [], []
        for motion, path in zip(motions, paths, strict=True):
            # the first path is the command, which jumps: joints would be given inertia that no pose has
            velocity = np.gradient(path, motion.step, axis=0) if number else None
            rows = np.unique(np.append(np.arange(0, len(path), THINNED), len(path) - 1))
            of_rows = (motion.grid[rows], path[rows])
            loads.append(motion_load(links, motion, *of_rows, zero, None if velocity is None else velocity[rows]))
            if contact is not None:
                touches.append(motion_touch(links, contact.link, motion, *of_rows))
        lanes = lanes_of(motions, loads, None, touches)
        rolled = roll_out(lanes, np.tile(values.T, (1, len(motions))), surface=surface)
        settling = _on_grids(motions, lanes, rolled.path)
        change = max(float(np.mean(np.abs(own - last).max(axis=1))) for own, last in zip(settling, paths, strict=True))
        if change >= before:
            break
        paths, found, before = settling, (lanes, rolled.path, rolled.force), change
        if change < SETTLED:
            break
    return found


def rollout_errors(motions: Sequence[ServoMotion], paths: Sequence[FloatArray]) -> FloatArray:
    """(m, n) mean absolute errors of each motion and joint [rad or m], the first second left out."""
    return np.array(
        [
            np.abs(path - motion.position)[motion.time >= SETTLING].mean(axis=0)
            for motion, path in zip(motions, paths, strict=True)
        ]
    )


def command_paths(motions: Sequence[ServoMotion]) -> list[FloatArray]:
    """Commands (N, n) at the samples of each motion, with those that are sent just then."""
    return [_delayed(motion, -motion.step, 0.0) for motion in motions]


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
    from scipy.signal import lfilter  # here as in motion.py

    step = motion.step
    times = np.arange(-motion.history, len(motion.command) - motion.history) * step
    share = 1.0 if lag <= 0 else 1.0 - np.exp(-step / lag)
    begin = motion.command[:1]
    filtered = lfilter([share], [1.0, share - 1.0], motion.command - begin, axis=0) + begin
    return np.stack([np.interp(motion.time - delay, times, column) for column in filtered.T], axis=1)
