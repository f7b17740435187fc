"""Torques read anywhere between two goals are those of a spring to a goal that moves evenly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from daq.recording.recording import Channel, Recording, Stream
from drivers.streams import GOAL_AGE
from ident.signals.joint_signals import with_even_goals

KP, SPEED, PERIOD = 60.0, 0.8, 0.01


def recording(ages: np.ndarray) -> Recording:
    """A joint that moves evenly behind goals in steps, read at ages of the goals."""
    stamps = np.cumsum(np.full(len(ages), PERIOD))
    goals = SPEED * stamps
    times = stamps + ages
    position = SPEED * (times - 0.004)  # behind the evenly moving goal by 4 ms and half a period
    torque = KP * (goals - position)
    column = lambda name, values, unit="": Channel(name, values[:, None], unit, ("swing",))  # noqa: E731
    joints = {name: column(name, values) for name, values in (("torque", torque), (GOAL_AGE, ages))}
    told = {"target_position": column("target_position", goals), "gain_p": column("gain_p", np.full(len(goals), KP))}
    streams = {"joints": Stream("joints", times, times, joints), "commands": Stream("commands", stamps, stamps, told)}
    return Recording("", streams)


def even_torque(run: Recording, joints: Stream) -> np.ndarray:
    return with_even_goals(joints, run.streams.get("commands")).channels["torque"].values[:, 0]


def test_the_torque_does_not_depend_on_when_it_was_read():
    rng = np.random.default_rng(0)
    mean = KP * SPEED * (0.004 - PERIOD / 2.0)
    for ages in (np.full(50, 0.002), np.full(50, 0.009), rng.uniform(0.0, PERIOD, 50)):
        run = recording(ages)
        joints = run.streams["joints"]
        assert even_torque(run, joints)[2:-2] == pytest.approx(mean, abs=1e-9)
        raw = joints.channels["torque"].values[:, 0]
        assert np.max(np.abs(raw - mean)) > 0.1
        # Where it is not known when goals were obeyed, what was read stands.
        unknown = replace(joints.channels[GOAL_AGE], values=np.full((50, 1), np.nan))
        hushed = replace(joints, channels={**joints.channels, GOAL_AGE: unknown})
        assert np.array_equal(even_torque(run, hushed), raw)
        assert np.array_equal(even_torque(Recording("", {"joints": joints}), joints), raw)


def test_live_the_newest_goals_suffice():
    """A row comes with the goal that was sent in the same frame, and with none that follows."""
    run = recording(np.full(50, PERIOD))
    joints, goals = run.streams["joints"], run.streams["commands"]
    whole = even_torque(run, joints)
    for row in (10, 30):
        seen = goals.time <= joints.time[row] + 1e-9
        heard = replace(
            goals,
            time=goals.time[seen],
            channels={name: replace(channel, values=channel.values[seen]) for name, channel in goals.channels.items()},
        )
        now = replace(
            joints,
            time=joints.time[: row + 1],
            channels={
                name: replace(channel, values=channel.values[: row + 1]) for name, channel in joints.channels.items()
            },
        )
        assert even_torque(Recording("", {"commands": heard}), now)[-1] == pytest.approx(whole[row], abs=1e-9)
