"""Whether two recordings hold the same samples."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import savgol_filter

from drivers.core.arrays import FloatArray
from ident.signals.sample_hashes import BITS, KEPT, kept_hashes, overlap, same_noise, sample_hashes


def recorded(seed: int, samples: int = 4000, joints: int = 6) -> tuple[np.ndarray, np.ndarray]:
    """A motion with noise of an encoder and of a torque."""
    noise = np.random.default_rng(seed)
    time = np.arange(samples) / 200.0
    motion = np.sin(time[:, None] * np.linspace(0.5, 1.5, joints))
    torque = 20.0 * np.cos(time[:, None] * np.linspace(0.5, 1.5, joints))
    return (
        np.round(motion + 1e-5 * noise.standard_normal(motion.shape), 6),
        torque + 0.2 * noise.standard_normal(torque.shape),
    )


@given(st.integers(0, 3500), st.integers(100, 4000), st.integers(1, 5), st.sampled_from([1, 2, 6]))
def test_any_part_of_a_recording_is_found(start: int, length: int, step: int, joints: int) -> None:
    position, torque = recorded(1, joints=joints)
    part = slice(start, start + length * step, step)
    assert overlap(sample_hashes(position[part], torque[part]), [kept_hashes(sample_hashes(position, torque))]) == 1.0


@pytest.mark.parametrize("joints", [2, 3, 6, 7])
def test_two_runs_of_one_motion_share_nothing(joints: int) -> None:
    kept = kept_hashes(sample_hashes(*recorded(1, joints=joints)))
    for seed in range(2, 8):
        assert overlap(sample_hashes(*recorded(seed, joints=joints)), [kept]) == 0.0


@given(st.floats(0.05, 0.75))
def test_the_share_of_common_samples_is_estimated(share: float) -> None:
    (position, torque), (other_position, other_torque) = recorded(1), recorded(2)
    border = int(share * len(position))
    mixed = (
        np.concatenate([position[:border], other_position[border:]]),
        np.concatenate([torque[:border], other_torque[border:]]),
    )
    found = overlap(sample_hashes(*mixed), [kept_hashes(sample_hashes(position, torque))])
    assert abs(found - share) < 0.07


def test_several_recordings_together_hold_what_each_holds() -> None:
    kept = [kept_hashes(sample_hashes(*recorded(seed))) for seed in (1, 2)]
    both = [np.concatenate(parts) for parts in zip(recorded(1), recorded(2), strict=True)]
    assert overlap(sample_hashes(*both), kept) == 1.0
    assert overlap(sample_hashes(*recorded(3)), kept) == 0.0


def test_what_is_kept_is_small_and_every_json_reader_holds_it() -> None:
    kept = kept_hashes(sample_hashes(*recorded(1)))
    assert len(kept) == KEPT
    assert kept == sorted(set(kept))
    assert max(kept) < 1 << BITS <= 1 << 53


def test_nothing_overlaps_with_nothing() -> None:
    hashes = sample_hashes(*recorded(1, samples=50))
    assert overlap(hashes, []) == overlap(hashes, [[]]) == overlap(hashes[:0], [kept_hashes(hashes)]) == 0.0


def test_samples_that_repeat_or_lack_a_value_do_not_count() -> None:
    position, torque = recorded(1, samples=100)
    position[10:20], torque[10:20] = position[10], torque[10]
    position[30] = np.nan
    assert len(sample_hashes(position, torque)) == 100 - 9 - 1


def test_values_next_to_nothing_and_huge_ones_are_hashed() -> None:
    position, torque = recorded(1, samples=100)
    position[3:6] *= 1e-320
    torque[3:6] *= 1e305
    with np.errstate(all="raise"):
        assert len(sample_hashes(position, torque)) >= 98


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


def test_what_is_too_short_to_compare_is_no_copy() -> None:
    time, torque = run(1)
    assert not same_noise(time[:300], torque[:300], time[:300], 1.02 * torque[:300])
