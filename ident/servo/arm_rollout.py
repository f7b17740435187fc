"""Roll-out of a whole servo arm on commands alone: joints in turn, the links' torques brought up to date in between.

Each pass rolls out all joints with gravity and coupling along the arm's last path (waveform relaxation); high gears
make the joints nearly independent, so that a few passes do.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drivers.core.arrays import FloatArray
from ident.servo.links import ServoLinks
from ident.servo.motion import SETTLING, MotionLoad, ServoMotion, lanes_of, motion_load, with_coupling
from ident.servo.rollout import at_samples, roll_out
from ident.servo.terms import INDEX

PASSES = 12
"""At most."""

SETTLED = 1e-4
"""[rad or m] Mean change of a path between two passes at which the passes end."""

EVERY = 4
"""Links' torques are evaluated at every fourth step of the grid."""

COUPLING_SPAN = 0.04
"""[s] over which accelerations are averaged for coupling: those of a stick-slip step are impulses."""


def roll_out_arm(motions: Sequence[ServoMotion], links: ServoLinks, values: FloatArray) -> list[FloatArray]:
    """Positions (N, n) of each motion at its samples, from its commands and first position alone [rad or m].

    Args:
        motions: of one arm.
        links: of the arm.
        values: (n, terms) parameters.
    """
    return [_roll_out(motion, links, values) for motion in motions]


def _roll_out(motion: ServoMotion, links: ServoLinks, values: FloatArray) -> FloatArray:
    zero = values[:, INDEX["zero"]]
    path = motion.command[motion.history :].copy()
    path[0] = motion.position[0]
    moving = False
    for _ in range(PASSES):
        lanes = lanes_of([motion], [path_load(links, motion, path, zero, moving)], None)
        new = roll_out(lanes, values.T)[0][: len(path)]
        change = float(np.mean(np.abs(new - path[: len(new)]).max(axis=1)))
        path, moving = new, True
        if change < SETTLED:
            break
    sampled: FloatArray = at_samples(lanes, new)
    return sampled


def path_load(links: ServoLinks, motion: ServoMotion, path: FloatArray, zero: FloatArray, moving: bool) -> MotionLoad:
    """The links along a path (K, n) on a motion's grid; with the torques between the joints where it is `moving`."""
    thin = np.unique(np.append(np.arange(0, len(path), EVERY), len(path) - 1))
    times = motion.grid[thin]
    load = motion_load(links, motion, times, path[thin], zero)
    if not moving or path.shape[1] < 2:
        return load
    span = max(1, round(COUPLING_SPAN / motion.step))
    velocity = _averaged(np.gradient(path, motion.step, axis=0), span)
    acceleration = _averaged(np.gradient(velocity, motion.step, axis=0), span)
    return with_coupling(links, motion, load, times, (path[thin] + zero, velocity[thin], acceleration[thin]))


def rollout_errors(motions: Sequence[ServoMotion], paths: Sequence[FloatArray]) -> FloatArray:
    """(m, n) mean absolute errors of each motion and joint [rad or m], the first second left out."""
    return np.array(
        [
            np.abs(path - motion.position)[motion.time >= SETTLING].mean(axis=0)
            for motion, path in zip(motions, paths, strict=True)
        ]
    )


def _averaged(values: FloatArray, span: int) -> FloatArray:
    """Moving average over `span` rows."""
    from scipy.ndimage import uniform_filter1d

    averaged: FloatArray = uniform_filter1d(values, span, axis=0, mode="nearest")
    return averaged
