"""Velocities in another unit, scale or sign are told; filtered, noisy and slow ones are not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kinematic_arm import ROBOT_FILE

from daq.session.supervisor import Limits, Supervisor
from drivers.streams import Batch, ChannelLayout, StreamLayout

RATE = 200.0
NAMES = ROBOT_FILE.robot.joint_names
LAYOUT = StreamLayout("joints", tuple(ChannelLayout(name, NAMES) for name in ("position", "velocity")), RATE)


def told(scale: float, *, delay: float = 0.0, noise: float = 0.0, amplitude: float = 0.3, seed: int = 0) -> list[str]:
    """What is said of a shoulder that moves to and fro for 4 s, its velocity scaled, late and noisy."""
    supervisor, said = Supervisor(Limits.of_robot(ROBOT_FILE.robot), (LAYOUT,)), []
    draw = np.random.default_rng(seed)
    for tick in range(round(4.0 * RATE)):
        time = tick / RATE
        position = np.array([[amplitude * np.sin(4.0 * time), 0.1]])
        velocity = scale * np.array([[4.0 * amplitude * np.cos(4.0 * (time - delay)), 0.0]]) + noise * draw.normal(
            size=2
        )
        values = {"position": position, "velocity": velocity}
        said += map(str, supervisor.stuck(Batch("joints", np.array([time]), np.array([time]), values)))
    return [one for one in said if not one.startswith("stuck")]


@pytest.mark.parametrize("scale", [-1.0, 0.0105, 9.55, 57.3, 2.0**16])
def test_another_unit_or_sign_is_told_of_its_joint(scale: float) -> None:
    (first, *_) = told(scale)
    assert first.startswith("velocity channel of shoulder: it says ")
    assert first.endswith("rad/s: another unit, scale or sign")


@settings(max_examples=8)
@given(st.floats(0.8, 1.25), st.floats(0.0, 0.06), st.floats(0.0, 0.5), st.floats(0.001, 0.4), st.integers(0, 9))
def test_what_is_filtered_noisy_or_slow_is_not(
    scale: float, delay: float, noise: float, amplitude: float, seed: int
) -> None:
    assert told(scale, delay=delay, noise=noise, amplitude=amplitude, seed=seed) == []
