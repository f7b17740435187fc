"""Whether two recordings hold the same samples."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ident.signals.sample_hashes import BITS, KEPT, kept_hashes, overlap, sample_hashes


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
