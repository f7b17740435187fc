"""Whether a recording is a processed copy of another one."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.signal import butter, filtfilt, savgol_filter

from drivers.core.arrays import FloatArray
from ident.signals.copied_runs import copied_run, same_noise

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


def decimated(of: Samples, factor: int) -> Samples:
    """Every so-manyth sample after a filter."""
    numerator, denominator = butter(4, 0.8 / factor)
    return of[0][::factor], filtfilt(numerator, denominator, of[1], axis=0)[::factor]


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
    "resampled to a lower rate": lambda of: resampled(of, 2.0, 0.3 / RATE),
    "filtered, to a third of the rate": lambda of: decimated(of, 3),
    "all of it, cut": lambda of: noisy(scaled(resampled((of[0][900:], of[1][900:]), 1.25), 1.02), 0.5),
}


@pytest.mark.parametrize("copy", COPIES.values(), ids=COPIES)
def test_a_copy_holds_the_noise_of_its_original_whichever_of_both_was_identified_from(
    copy: Callable[..., Samples],
) -> None:
    original = run(1)
    assert same_noise(*original, *copy(original))
    assert same_noise(*copy(original), *original)


def test_a_copy_of_a_smooth_run_is_known_by_what_was_added() -> None:
    time, torque = resampled(run(1), 2.0)
    smooth = savgol_filter(torque, 25, 3, axis=0)
    added = 0.03 * np.random.default_rng(4).standard_normal(torque.shape)
    assert same_noise(time, smooth, *resampled((time, 1.02 * (smooth + added)), 1.25))
    other = savgol_filter(resampled(run(2), 2.0)[1], 25, 3, axis=0)
    assert not same_noise(time, smooth, time, other + added)


@pytest.mark.parametrize("start", [0.0, 0.37 / RATE, 1.7])
def test_another_run_of_the_same_motion_is_no_copy(start: float) -> None:
    assert not same_noise(*run(1), *run(2, start))


@pytest.mark.parametrize("way", ["resampled to a lower rate", "filtered, to a third of the rate"])
def test_another_run_at_a_lower_rate_is_no_copy(way: str) -> None:
    other = COPIES[way](run(2, 1.7))
    assert not same_noise(*run(1), *other)
    assert not same_noise(*other, *run(1))


def test_what_is_too_short_to_compare_is_no_copy() -> None:
    time, torque = run(1)
    assert not same_noise(time[:200], torque[:200], time[:200], 1.02 * torque[:200])


def test_positions_show_a_copy_whose_torques_are_hidden_by_noise() -> None:
    """Other runs have positions of their own; where they are followed exactly, torques as noisy as the first one's."""
    time, torque = run(1)
    motion = np.cos(2.0 * np.pi * np.array([0.31, 0.43, 0.17]) * time[:, None])
    encoders = [(time, motion + 1e-4 * np.random.default_rng(seed).standard_normal(motion.shape)) for seed in (5, 6)]
    halved = [resampled(signal, 2.0, 0.3 / RATE) for signal in (*encoders, run(1), run(2))]
    stamps = halved[0][0]
    hidden, of_other = (
        torques + 2.0 * NOISE * np.random.default_rng(9).standard_normal(torques.shape) for _, torques in halved[2:]
    )
    original, copy = (time, encoders[0][1], torque), (stamps, halved[0][1], hidden)
    assert not same_noise(time, torque, stamps, hidden)
    assert copied_run(original, copy)
    assert not copied_run(original, (stamps, halved[1][1], of_other))
    assert not copied_run(original, (time, encoders[0][1], run(2)[1]))
