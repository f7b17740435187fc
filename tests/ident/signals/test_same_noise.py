"""A processed copy of a recording is recognised by its noise; another run of the same motion is not taken for one."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from drivers.core.arrays import FloatArray
from ident.signals.sample_hashes import same_noise

RATE, SECONDS, NOISE = 250.0, 16.0, 0.05
Samples = tuple[FloatArray, FloatArray]


def run(seed: int, start: float = 0.0) -> Samples:
    """A run of one motion, with friction and ripple that repeat, and noise of its own."""
    time = np.arange(round(SECONDS * RATE)) / RATE
    phase = 2.0 * np.pi * np.array([0.31, 0.43, 0.17]) * (time[:, None] + start)
    torque = np.sin(phase) + 0.3 * np.tanh(20.0 * np.cos(phase)) + 0.03 * np.sin(25.0 * np.sin(phase))
    return time, torque + NOISE * np.random.default_rng(seed).standard_normal(torque.shape)


def resampled(of: Samples, step: float, start: float = 0.0) -> Samples:
    """Linear interpolation to another rate."""
    time, torque = of
    grid = np.arange(time[0] + start, time[-1], step * (time[1] - time[0]))
    return grid, np.stack([np.interp(grid, time, column) for column in torque.T], axis=1)


def noisy(of: Samples, size: float) -> Samples:
    """More noise."""
    return of[0], of[1] + size * NOISE * np.random.default_rng(9).standard_normal(of[1].shape)


def scaled(of: Samples, factor: float) -> Samples:
    """Another gain."""
    return of[0], factor * of[1]


COPIES: dict[str, Callable[[Samples], Samples]] = {
    "resampled": lambda of: resampled(of, 1.25),
    "resampled between its samples": lambda of: resampled(of, 1.0, 0.5 / RATE),
    "scaled": lambda of: scaled(of, 1.02),
    "with noise": lambda of: noisy(of, 1.0),
    "all of it, cut": lambda of: noisy(scaled(resampled((of[0][900:], of[1][900:]), 1.25), 1.02), 0.5),
}


@pytest.mark.parametrize("copy", COPIES.values(), ids=COPIES)
def test_a_copy_holds_the_noise_of_its_original_whichever_of_both_was_identified_from(
    copy: Callable[..., Samples],
) -> None:
    original = run(1)
    assert same_noise(*original, *copy(original))
    assert same_noise(*copy(original), *original)


@pytest.mark.parametrize("start", [0.0, 0.37 / RATE, 1.7])
def test_another_run_of_the_same_motion_is_no_copy(start: float) -> None:
    assert not same_noise(*run(1), *run(2, start))


def test_what_is_too_short_to_compare_is_no_copy() -> None:
    time, torque = run(1)
    assert not same_noise(time[:300], torque[:300], time[:300], 1.02 * torque[:300])
