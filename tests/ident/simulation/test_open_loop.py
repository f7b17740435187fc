"""A simulation by recorded torque alone, beside constant velocity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.simulation.open_loop import SHORTEST_WINDOW, WINDOW, WINDOWS, open_loop
from tests.ident.simulation.test_tracking import inverse_of, segment_of


@pytest.fixture(scope="module")
def segment():
    return segment_of("ur5e", 6.0)


def test_the_true_arm_is_far_better_than_constant_velocity(segment):
    found = open_loop(inverse_of("ur5e"), [segment])
    assert found.windows <= WINDOWS
    assert found.window == WINDOW
    assert not found.diverged
    assert np.all(np.array(found.position_rmse) < 0.1 * np.array(found.reference_rmse))


def test_the_reference_is_the_motion_at_constant_velocity(segment):
    short = replace(
        segment,
        **{name: getattr(segment, name)[:, :252] for name in ("position", "velocity", "acceleration", "torque")},
        time=segment.time[:252],
        used=segment.used[:252],
    )
    found = open_loop(inverse_of("ur5e"), [short])
    time = short.time[:251] - short.time[0]
    constant = short.position[:, :1] + short.velocity[:, :1] * time
    expected = np.sqrt(np.mean((constant - short.position[:, :251]) ** 2, axis=1))
    assert found.windows == 1
    assert np.allclose(found.reference_rmse, expected, rtol=1e-3)


def test_a_model_without_friction_is_worse(segment):
    true = open_loop(inverse_of("ur5e"), [segment])
    other = open_loop(inverse_of("ur5e", Fs2=0.0, Fv2=0.0), [segment])
    assert other.position_rmse[1] > 3.0 * true.position_rmse[1]
    assert np.array_equal(other.reference_rmse, true.reference_rmse)


def test_a_motion_that_diverges_says_when(segment):
    pushed = replace(segment, torque=1e7 * np.ones_like(segment.torque))
    found = open_loop(inverse_of("ur5e"), [pushed])
    assert "diverges" in found.diverged
    assert " s of the recording" in found.diverged
    assert found.position_rmse == [None] * 6
    assert np.all(np.isfinite(found.reference_rmse))


def test_too_short_a_motion_says_nothing(segment):
    samples = int(0.5 * SHORTEST_WINDOW * segment.rate)
    short = replace(
        segment,
        **{name: getattr(segment, name)[:, :samples] for name in ("position", "velocity", "acceleration", "torque")},
        time=segment.time[:samples],
        used=segment.used[:samples],
    )
    assert open_loop(inverse_of("ur5e"), [short]) is None
    assert open_loop(inverse_of("ur5e"), [replace(segment, used=np.zeros_like(segment.used))]) is None
