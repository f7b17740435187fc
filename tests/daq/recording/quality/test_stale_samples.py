"""Rows that were written again, and encoders that stand still, in motions that are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daq.recording.quality.stale_samples import StaleSamples, fresh_recording, stale_samples
from daq.recording.recording import JOINTS_STREAM, Channel, Recording, Stream
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


def recorded(status: tuple[str, float, float] | None, off: slice, *, beside: bool = False) -> Recording:
    """A run whose motors are off in some rows: torques are 0 there, and a status has its second value."""
    measured = signals(2)
    time = np.arange(2000) / RATE
    channels = {name: Channel(name, values, "", JOINTS) for name, values in measured.items() if name != "velocity"}
    channels["torque"].values[off, : 2 if status is None else 1] = 0.0
    streams = {}
    if status is not None:
        name, on, other = status
        words = np.full((2000, 2), on)
        words[off, 0] = other
        channel = Channel(name, words, "1", JOINTS)
        if beside:
            streams["status"] = Stream("status", time[::4], time[::4], {name: replace(channel, values=words[::4])})
        else:
            channels[name] = channel
    return Recording("run", streams={JOINTS_STREAM: Stream(JOINTS_STREAM, time, time, channels), **streams})


@pytest.mark.parametrize(
    "status", [None, ("statusword", 0x1237, 0x250), ("joint_mode", 253.0, 255.0)], ids=["zero", "402", "rtde"]
)
@pytest.mark.parametrize("off", [slice(0, 80), slice(200, 320)])
def test_rows_of_a_motor_that_is_off_are_left_out(status: tuple[str, float, float] | None, off: slice) -> None:
    run = recorded(status, off, beside=status is not None and status[0] == "joint_mode")
    fresh, stale = fresh_recording(run)
    assert stale is not None
    assert stale.off is not None
    rows = np.zeros(2000, dtype=np.bool_)
    rows[off] = True
    assert np.array_equal(stale.off, rows)
    time = fresh.streams[JOINTS_STREAM].time
    assert len(time) == 2000 - rows[1:].sum()
    assert time[0] == run.streams[JOINTS_STREAM].time[0]


def test_motors_that_never_are_on_leave_no_row_out() -> None:
    for status in (None, ("statusword", 0x1237, 0x250)):
        assert fresh_recording(recorded(status, slice(None)))[1] is None
