"""Commands beside measured positions: clocks, order, units and cover are told from a servo's own lag."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daq.recording.commanded_motion import TARGET, CommandedMotion
from daq.recording.quality.command_quality import command_quality
from daq.recording.quality.signal_quality import unsigned_joints

STEP = 1.534e-3
JOINTS = ("a", "b", "c")


def motion(seed: int = 0, lag: float = 0.08) -> CommandedMotion:
    """Smooth commands at 50 Hz, positions of a first-order servo behind them at 60 Hz, on an encoder's grid."""
    generator = np.random.default_rng(seed)
    stamps = np.arange(0.0, 30.0, 0.02)
    frequency, phase = generator.uniform(0.2, 1.0, (4, 3)), generator.uniform(0.0, 6.3, (4, 3))
    command = 0.2 * np.sin(2 * np.pi * stamps[:, None, None] * frequency + phase).sum(axis=1)
    time = np.arange(0.0, 30.0, 1 / 60)
    behind = np.column_stack([np.interp(time - lag, stamps, column) for column in command.T])
    return CommandedMotion(JOINTS, time, np.round(behind / STEP) * STEP, stamps, {TARGET: command})


@settings(max_examples=8)
@given(st.integers(0, 10**6), st.floats(0.0, 0.2), st.sampled_from([-0.3, 0.3]), st.permutations([0, 1, 2]))
def test_wrong_clocks_and_orders_are_told_from_a_lag(seed: int, lag: float, shift: float, order: list[int]) -> None:
    sound = motion(seed, lag)
    quality = command_quality(sound)
    assert not quality.apart
    assert quality.delay == pytest.approx(lag, abs=0.03)  # a command holds for 20 ms
    assert (quality.swapped, quality.opposite, quality.still, quality.resting) == ({}, (), (), ())
    assert all(ratio == pytest.approx(1.0, abs=0.02) for ratio in quality.ratios.values())
    late = command_quality(replace(sound, command_time=sound.command_time - shift))
    if not 0.0 <= lag + shift <= 0.3:
        assert late.apart
        assert late.delay == pytest.approx(lag + shift, abs=0.03)
    wrong = command_quality(replace(sound, position=sound.position[:, order]))
    assert wrong.swapped == {JOINTS[to]: JOINTS[of] for to, of in enumerate(order) if to != of}


def test_a_few_seconds_of_a_joint_that_sticks_are_not_another_s_motion() -> None:
    stamps = np.arange(0.0, 2.0, 0.02)
    rise = 1.0 / (1.0 + np.exp(-8.0 * (stamps - 1.0)))
    command = np.column_stack([0.1 * stamps, 0.5 * rise])
    stuck = replace(
        motion(),
        joint_names=("a", "b"),
        time=stamps,
        position=np.column_stack([0.15 * rise, 0.5 * rise]),
        command_time=stamps,
        commands={TARGET: command},
    )
    assert command_quality(stuck).swapped == {}
    far = replace(stuck, position=stuck.position * [4.0, 1.0])
    assert command_quality(far).swapped == {"a": "b"}


def test_the_rest_is_told_by_joint() -> None:
    sound = motion()
    position, command = sound.position.copy(), sound.commands[TARGET].copy()
    position[:, 0] *= -1.0
    position[:, 1] = position[0, 1]
    position[:, 2] = np.rad2deg(position[:, 2])
    quality = command_quality(replace(sound, position=position))
    assert quality.opposite == ("a",)
    assert quality.still == ("b",)
    assert quality.ratios == pytest.approx({"c": 180 / np.pi}, rel=0.02)
    command[:, 1] = 0.3
    assert command_quality(replace(sound, position=position, commands={TARGET: command})).resting == ("b",)
    short = replace(sound, command_time=sound.command_time[300:900], commands={TARGET: command[300:900]})
    assert command_quality(short).before == pytest.approx(6.0, abs=0.02)
    assert command_quality(short).after == pytest.approx(12.0, abs=0.05)


def test_what_was_recorded_as_commands_is_told_from_goals() -> None:
    sound, generator = motion(), np.random.default_rng(0)
    quality = command_quality(sound)
    assert (quality.copied, quality.unrelated, quality.offsets) == (None, False, {})
    command = sound.commands[TARGET]
    for rows in (-1, 0, 1):  # as in data sets whose action is an observation
        copied = replace(sound, command_time=sound.time, commands={TARGET: np.roll(sound.position, -rows, axis=0)})
        assert command_quality(copied).copied == rows
    for values in (np.diff(command, axis=0, prepend=command[:1]), np.gradient(command, 0.02, axis=0)):
        assert command_quality(replace(sound, commands={TARGET: values})).unrelated
    elsewhere = replace(sound, position=sound.position + [0.0, -0.5, 0.0])
    assert command_quality(elsewhere).offsets == {"b": pytest.approx(-0.5, abs=0.1)}
    # A hand on the leader trembles, and the follower's friction holds it.
    position, trembling = sound.position.copy(), command.copy()
    position[:, 1] = np.where(sound.time < 10.0, position[0, 1], position[0, 1] + STEP)
    trembling[:, 1] = position[0, 1] + 0.01 * generator.standard_normal(len(command))
    quality = command_quality(replace(sound, position=position, commands={TARGET: trembling}))
    assert (quality.still, quality.frozen) == ((), {})
    # Exchanged joints rest while their own commands pass them.
    paused = np.where(sound.time < 10.0, 0.0, sound.position[:, 0])
    sent = np.where(sound.command_time < 10.0, 0.0, command[:, 0])
    exchanged = np.stack([sound.position[:, 1], paused, sound.position[:, 2]], axis=1)
    goals = np.stack([sent, command[:, 1], command[:, 2]], axis=1)
    quality = command_quality(replace(sound, position=exchanged, commands={TARGET: goals}))
    assert (quality.swapped, quality.frozen) == ({"a": "b", "b": "a"}, {})


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("value", [0.0, 1e300, -1e12])
def test_damaged_values_and_long_recordings_are_no_obstacle(value: float) -> None:
    sound = motion()
    damaged = np.where(np.arange(3) == 1, value, sound.position)
    damaged[7, 2] = value
    assert command_quality(replace(sound, position=damaged)).delay == pytest.approx(0.08, abs=0.03)
    later = np.where(sound.time > 20.0, sound.time + 1e9, sound.time)
    command_quality(replace(sound, time=later))


@settings(max_examples=12)
@given(st.integers(0, 10**6), st.floats(-2.0, 2.0), st.floats(0.01, 0.3))
def test_a_magnitude_is_told_from_a_signal_under_gravity(seed: int, gravity: float, noise: float) -> None:
    generator = np.random.default_rng(seed)
    position = motion(seed).position
    speed = np.gradient(position, axis=0)
    signed = (
        gravity * np.cos(position) * [0, 1, 1]
        + np.tanh(speed / 2e-3)
        + noise * generator.standard_normal(position.shape)
    )
    assert unsigned_joints(signed, position) == ()
    assert 0 in unsigned_joints(np.abs(signed), position)  # others may hold a weight
    counts = np.round(20.0 * np.abs(signed))
    assert 0 in unsigned_joints(-counts, position)
    assert unsigned_joints(np.abs(signed), 0.0 * position) == ()
