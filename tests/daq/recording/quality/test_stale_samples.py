"""Rows that were written again, and encoders that stand still, in motions that are known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daq.recording.quality.stale_samples import StaleSamples, stale_samples
from drivers.core.arrays import FloatArray

RATE = 200.0
JOINTS = ("j1", "j2")


def signals(seed: int, step: float = 1e-4, seconds: float = 10.0) -> dict[str, FloatArray]:
    """Position, velocity and noisy torque (N, 2) of a smooth motion, after a rest of 2 s."""
    generator = np.random.default_rng(seed)
    time = np.arange(round(seconds * RATE)) / RATE
    moving = np.clip((time - 2.0) / 0.5, 0.0, 1.0)[:, None]
    pulsation, phase = generator.uniform(1.0, 6.0, 2), generator.uniform(0.0, 6.0, 2)
    velocity = moving * np.sin(pulsation * time[:, None] + phase)
    position = np.cumsum(velocity, axis=0) / RATE
    torque = np.round(10.0 * np.sin(position) + 0.1 * generator.standard_normal(position.shape), 2)
    noise = 1e-3 * generator.standard_normal(velocity.shape)
    return {"position": np.round(position / step) * step, "velocity": velocity + noise, "torque": torque}


def found(measured: dict[str, FloatArray]) -> StaleSamples:
    return stale_samples(np.arange(len(measured["position"])) / RATE, JOINTS, measured)


@settings(max_examples=25)
@given(st.integers(0, 1000), st.sampled_from([1e-6, 1e-4, 2e-3]))
def test_sound_samples_are_fresh(seed: int, step: float) -> None:
    stale = found(signals(seed, step))
    assert not stale.left_out.any()
    assert stale.encoders == ()


@settings(max_examples=25)
@given(st.integers(0, 1000), st.sampled_from([0.03, 0.13, 0.5]))
def test_repeated_rows_are_found_while_the_arm_moves(seed: int, share: float) -> None:
    measured = signals(seed)
    repeated = np.random.default_rng(seed).random(2000) < share
    repeated[0] = False
    source = np.maximum.accumulate(np.where(repeated, 0, np.arange(2000)))
    stale = found({name: values[source] for name, values in measured.items()})
    assert not (stale.left_out & ~repeated).any()
    assert np.mean(stale.repeated[500:][repeated[500:]]) > 0.8


def test_positions_that_are_read_every_fourth_time_are_held() -> None:
    measured = signals(1)
    measured["position"] = measured["position"][np.arange(2000) // 4 * 4]
    stale = found(measured)
    assert not stale.repeated.any()
    assert np.mean(stale.held[500:]) == pytest.approx(0.75, abs=0.05)


@pytest.mark.parametrize("known", ["velocity", "target_position", "nothing"])
@settings(max_examples=25)
@given(st.integers(0, 1000))
def test_an_encoder_that_stands_still_is_named(known: str, seed: int) -> None:
    measured = signals(seed)
    position = measured["position"]
    start = 600 + int(np.argmax(np.abs(measured["velocity"][600:1200, 1])))
    if known != "velocity":
        del measured["velocity"]
    if known == "target_position":
        measured["target_position"] = position + 1e-3
    stuck = position.copy()
    stuck[start : start + 100, 1] = stuck[start, 1]
    # Where the joint comes back meanwhile, nothing but its velocity or its target shows that it had moved.
    if known == "nothing" and abs(position[start + 100, 1] - position[start, 1]) < 0.05:
        return
    stale = found(measured | {"position": stuck})
    (encoder,) = stale.encoders
    assert encoder.joint == "j2"
    assert encoder.start == pytest.approx(start / RATE, abs=0.011)
    assert encoder.stop == pytest.approx((start + 99) / RATE, abs=0.011)
    assert stale.left_out[start + 2 : start + 99].all()
    assert np.count_nonzero(stale.left_out) < 110


def test_a_joint_that_rests_is_no_stuck_encoder() -> None:
    measured = signals(2)
    measured["position"][:, 1] = 0.3
    measured["velocity"][:, 1] = 1e-3 * np.random.default_rng(1).standard_normal(2000)
    measured["target_position"] = measured["position"] + np.array([1e-3, 1.5e-3])
    assert found(measured).encoders == ()


def test_encoders_that_stop_and_go_on_together_are_rows_that_were_not_read_anew() -> None:
    measured = signals(1)
    held = measured["position"].copy()
    held[1000:1030] = held[1000]
    stale = found({**measured, "position": held})
    assert stale.encoders == ()
    assert stale.held[1001:1030].all()
    held[:, 1] = measured["position"][:, 1]
    (encoder,) = found({**measured, "position": held}).encoders
    assert encoder.joint == "j1"
