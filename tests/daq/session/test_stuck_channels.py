"""Channels that hang: told where nothing else explains it, and never where resolution, sampling or the motion does."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from kinematic_arm import NAMES, ROBOT_FILE

from daq.session.stuck_channels import LOOK_EVERY, UNMOVED_EVERY, WATCHED, StuckChannel
from daq.session.supervisor import Breach, Limits, Supervisor
from drivers.streams import Batch, ChannelLayout, StreamLayout

LIMITS = Limits.of_robot(ROBOT_FILE.robot)
RATE = 100.0
BATCH = 2
SECONDS = 10.0
TIME = np.arange(0.0, SECONDS, 1.0 / RATE)
SWING = np.outer(0.4 * np.sin(1.5 * TIME), [1.0, -0.7])
SPEED = np.outer(0.6 * np.cos(1.5 * TIME), [1.0, -0.7])
FROZEN = 400
"""The row from which a channel repeats what it was."""


def rounded(values: np.ndarray, step: float) -> np.ndarray:
    return np.rint(values / step) * step if step else values


def reported(
    values: Mapping[str, np.ndarray],
    commands: np.ndarray | None = SWING,
    rate: float = RATE,
    lag: float = 0.0,
    together: float = LOOK_EVERY,
) -> list[Breach]:
    """What is stuck at the end of a recording, and whatever was meanwhile."""
    layouts = (StreamLayout("joints", tuple(ChannelLayout(name, NAMES) for name in values), rate),)
    supervisor, seen = Supervisor(LIMITS, layouts), {}
    for first in range(0, len(next(iter(values.values()))) - BATCH + 1, BATCH):
        rows = slice(first, first + BATCH)
        time = np.arange(first, first + BATCH) / rate
        if commands is not None:
            supervisor.commanded(time[-1], commands[rows][-1], lag)
        batch = Batch("joints", time, time, {name: v[rows] for name, v in values.items()})
        for breach in supervisor.stuck(batch, together):
            seen.setdefault((breach.what, breach.joint), breach)
    return list(seen.values())


def sensors(resolution: float = 0.0, noise: float = 0.5, seed: int = 1) -> dict[str, np.ndarray]:
    """What an arm reports that follows its commands; resolution and noise of the torque [N·m]."""
    draw = np.random.default_rng(seed)
    lagging = np.roll(SWING, 3, axis=0)
    lagging[:3] = SWING[0]
    torque = 20.0 * np.cos(lagging) + 3.0 * np.tanh(SPEED / 0.05) + noise * draw.standard_normal(SWING.shape)
    return {
        "position": rounded(lagging, 1e-5),
        "velocity": SPEED + 0.002 * draw.standard_normal(SPEED.shape),
        "torque": rounded(torque, resolution),
        "current": rounded(torque, resolution) / 10.0,
        "temperature": 30.0 + 0.2 * draw.standard_normal(SPEED.shape),
    }


def test_a_sound_arm_is_told_nothing_of() -> None:
    assert reported(sensors()) == reported(sensors(), together=UNMOVED_EVERY) == []
    assert reported(sensors(resolution=0.05, noise=0.0)) == []
    assert reported(sensors(resolution=2.0, noise=0.3)) == []


@pytest.mark.parametrize("together", [LOOK_EVERY, UNMOVED_EVERY])
@pytest.mark.parametrize("quantity", WATCHED)
def test_a_channel_that_hangs_is_told_of_its_joint_alone(quantity: str, together: float) -> None:
    values = sensors()
    values[quantity][FROZEN:, 1] = values[quantity][FROZEN, 1]
    (breach,) = reported(values, together=together)
    assert (breach.what, breach.joint, breach.supervised) == (f"stuck {quantity}", "elbow", quantity != "current")
    assert breach.value > breach.limit >= WATCHED[quantity]
    least = 0.05 if quantity != "temperature" else WATCHED[quantity]
    assert FROZEN / RATE + least <= breach.time <= FROZEN / RATE + (5.5 if quantity == "temperature" else 2.0)
    assert f"{values[quantity][FROZEN, 1]:.6g}" in str(breach)
    assert "repeats bit for bit" in str(breach)


def test_a_current_is_supervised_where_the_torque_comes_from_it_and_nothing_where_no_limit_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    values = sensors()
    del values["torque"]
    values["current"][FROZEN:] = values["current"][FROZEN]
    assert {breach.joint: breach.supervised for breach in reported(values)} == dict.fromkeys(NAMES, False)
    monkeypatch.setitem(globals(), "LIMITS", replace(LIMITS, torque_per_current=np.full(2, 10.0)))
    assert {breach.joint: breach.supervised for breach in reported(values)} == dict.fromkeys(NAMES, True)
    unlimited = replace(LIMITS, torque=np.full(2, np.inf))
    supervisor = Supervisor(unlimited, ())
    batch = Batch("joints", np.zeros(1), np.zeros(1), {"current": np.zeros((1, 2))})
    assert not supervisor._depends_on(batch, "current", 0)
    assert not Supervisor(LIMITS, ())._depends_on(replace(batch, values={**batch.values, "torque": 0}), "current", 0)


def test_an_arm_that_follows_later_may_rest_while_its_commands_set_off() -> None:
    rate, still = 500.0, np.repeat(SWING[-1:], 100, axis=0)
    lag = round(0.12 * rate)
    commands = np.concatenate([SWING, still, still + np.linspace(0.0, 1.0, 100)[:, np.newaxis]])
    later = {"position": np.concatenate([np.repeat(commands[:1], lag, axis=0), commands[:-lag]])}
    assert {breach.what for breach in reported(later, commands, rate)} == {"stuck position"}
    assert reported(later, commands, rate, lag=0.1) == []


def test_an_arm_at_rest_or_at_a_constant_speed_may_repeat_itself() -> None:
    values = sensors()
    still = np.repeat(SWING[FROZEN : FROZEN + 1], len(SWING), axis=0)
    frozen = {name: np.concatenate([v[:FROZEN], np.repeat(v[FROZEN:][:1], 400, 0)]) for name, v in values.items()}
    del frozen["temperature"]
    assert reported(frozen, np.concatenate([SWING[:FROZEN], still[:400]])) == []
    coast = SWING[FROZEN] + np.outer(np.arange(400) / RATE, SPEED[FROZEN])
    way = np.concatenate([SWING[:FROZEN], coast])
    frozen["position"] = rounded(way, 1e-5)
    assert reported(frozen, way) == []  # nothing changes the torque


def test_a_servo_with_coarse_steps_may_stick_for_many_of_them() -> None:
    step = 1.5e-3
    position = rounded(SWING, step)
    position[FROZEN:] = position[FROZEN]
    assert reported({"position": position[:420]}) == []
    (breach, _) = reported({"position": position})
    assert breach.limit >= 99.0 * step
    assert reported({"position": position}, None) == []  # nothing says where it should be


def test_a_joint_that_a_step_of_the_command_surprises_is_given_its_time() -> None:
    steps = np.repeat(np.array([[0.0, 0.0], [0.1, 0.1], [0.0, 0.0], [0.1, 0.1]]), 300, axis=0)
    late = np.roll(steps, 4, axis=0) + 1e-5 * np.random.default_rng(1).standard_normal(steps.shape)
    late[FROZEN - 20 : FROZEN + 3] = late[FROZEN - 20]
    assert reported({"position": late}, steps) == []


def thermometers(celsius: np.ndarray) -> list[tuple[float, int]]:
    """When a thermometer of many columns hung first, and which."""
    channel, columns = StuckChannel("temperature", celsius.shape[1], 1.0), celsius.shape[1]
    seen: dict[int, float] = {}
    for row, values in enumerate(celsius):
        time = 0.5 * row
        for column in channel.add(time, values[np.newaxis], np.full(columns, time), np.full(columns, np.nan)):
            seen.setdefault(int(column), time)
    return [(time, column) for column, time in seen.items()]


def test_a_temperature_that_settles_is_no_thermometer_that_hangs() -> None:
    """A third of an hour at 2 Hz of warming up, then slow cooling; noise in steps of the resolution."""
    time, draw, columns = np.arange(0.0, 1200.0, 0.5), np.random.default_rng(2), []
    for settled in (20.0, 60.0, 200.0):
        warmed = 25.0 + 15.3 * (1.0 - np.exp(-time / settled)) * (1.0 - 5e-4 * np.clip(time - 900.0, 0.0, 300.0))
        for step in (0.0, 0.01, 0.1, 1.0):
            for noise in (0.0, 0.3):
                columns.append(rounded(warmed + step * noise * draw.standard_normal(len(time)), step))
    assert thermometers(np.stack(columns, axis=1)) == []


def test_a_thermometer_that_hangs_is_told_where_it_has_shown_that_it_never_stands() -> None:
    time, draw = np.arange(0.0, 500.0, 0.5), np.random.default_rng(3)
    cases = [(0.0, 0.02), (0.01, 0.02), (0.01, 0.0), (1.0, 0.0)]
    columns = [rounded(25.0 + 0.02 * time + noise * draw.standard_normal(len(time)), step) for step, noise in cases]
    celsius = np.stack(columns, axis=1)
    celsius[800:] = celsius[800]
    hung = thermometers(celsius)
    assert [column for _, column in sorted(hung, key=lambda one: one[1])] == [0, 1, 2]  # 1 K a step may stand
    assert all(400.0 + WATCHED["temperature"] <= when < 430.0 for when, _ in hung)
