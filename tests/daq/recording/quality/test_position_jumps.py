"""Positions that jump: none in a motion, and each that was made, with its cause."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from daq.recording.quality.outliers import beside_jumps, position_jumps
from drivers.core.arrays import FloatArray
from ident.signals.resampling import GAP_PERIODS

RATE = 100.0
JOINTS = ("j1", "j2", "j3")


def motion(seed: int, count: int = 1500) -> tuple[FloatArray, FloatArray]:
    """Stamps with a little jitter, and positions (N, 3) of some harmonics at them; the third joint rests at times."""
    generator = np.random.default_rng(seed)
    time = np.arange(count) / RATE + 2e-4 * generator.standard_normal(count)
    size, phase = generator.uniform(0.2, 1.0, (3, 4)), generator.uniform(0.0, 2.0 * np.pi, (3, 4))
    speed = 2.0 * np.pi * np.arange(1, 5) / 8.0
    position = np.einsum("jh,jhN->Nj", size, np.sin(speed[None, :, None] * time + phase[:, :, None]))
    position[:, 2] = np.maximum(position[:, 2], 0.0)
    return time, position


def quantised(position: FloatArray, step: float) -> FloatArray:
    return np.asarray(np.round(position / step) * step)


@settings(max_examples=20)
@given(st.integers(0, 10**6), st.floats(1e-6, 1.5e-3))
def test_a_motion_has_none(seed: int, step: float) -> None:
    time, position = motion(seed)
    assert position_jumps(time, JOINTS, quantised(position, step), np.zeros(len(time), dtype=bool)) == ()


@settings(max_examples=20)
@given(st.integers(0, 10**6), st.floats(1e-6, 1.5e-3), st.sampled_from(["zero", "turn", "rows"]))
def test_each_is_found_with_its_cause(seed: int, step: float, cause: str) -> None:
    time, position = motion(seed)
    if cause == "rows":
        position = np.concatenate([position[:600] - position[600], position[900:] - position[900] + 0.5])
        time = time[: len(position)]
    else:
        position[600:, 1] += 0.6 if cause == "zero" else 2.0 * np.pi
    jumps = position_jumps(time, JOINTS, quantised(position, step), np.zeros(len(time), dtype=bool))
    assert [(one.row, one.cause) for one in jumps] == [(600, cause)]
    left = time[~beside_jumps(time, jumps)]
    assert GAP_PERIODS / RATE < np.max(np.diff(left)) < 2.0 * GAP_PERIODS / RATE
