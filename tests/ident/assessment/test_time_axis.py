"""Stamps that are off by a factor, velocities in other units and clocks that drift are recognised and named."""

from __future__ import annotations

import numpy as np
import pytest
from each import each

from daq.recording.recording import JOINTS_STREAM, Channel, Recording, Stream
from ident.assessment.recording_checks import time_axis, time_axis_checks

NAMES = ("j1", "j2")
RATE = 200.0


def recording(*, scale: float = 1.0, gains: tuple[float, float] = (1.0, 1.0), clock: float = 1.0) -> Recording:
    """20 s of two joints: stamps `scale` times the true ones, velocities times `gains`, the host's clock by `clock`."""
    time = np.arange(4000) / RATE
    angle = np.outer(time, [1.3, 2.9])
    noise = 1e-4 * np.random.default_rng(0).standard_normal(angle.shape)
    velocity = np.cos(angle) * [1.3, 2.9] * gains
    channels = {
        "position": Channel("position", np.sin(angle) + noise, "rad", NAMES),
        "velocity": Channel("velocity", velocity[:, ::-1], "rad/s", NAMES[::-1]),
    }
    stamps = scale * time
    late = 1e-3 * np.random.default_rng(1).exponential(size=len(time))
    return Recording("", {JOINTS_STREAM: Stream(JOINTS_STREAM, stamps, 1e4 + clock * stamps + late, channels)})


@each("clock", [1.0, 1.0 + 1e-4, 1.0 - 1e-4])
def test_a_sound_recording_raises_nothing(clock):
    assert time_axis_checks(recording(clock=clock)) == []


@each("scale", [1.25, 0.8, 1.05])
def test_stamps_off_by_a_factor_are_named_with_it(scale):
    found = recording(scale=scale)
    assert time_axis(found).factor == pytest.approx(1.0 / scale, rel=1e-3)
    (check,) = time_axis_checks(found, "run.h5: ")
    assert (check.name, check.severity) == ("wrong-time-axis", "serious")
    assert f"multiplied by {1.0 / scale:.4g}" in check.text
    assert check.text.startswith("run.h5: ")


def test_a_single_joint_s_velocity_in_another_unit_is_no_wrong_time_axis():
    (check,) = time_axis_checks(recording(gains=(1.0, 0.5)))
    assert check.name == "velocity-scale"
    assert check.joints == ("j2",)
    assert "j2 2" in check.text


@each(("unit", "factor"), [("rpm", 30.0 / np.pi), ("deg/s", 180.0 / np.pi), ("rev/s", 0.5 / np.pi)])
def test_velocities_of_another_unit_are_no_wrong_time_axis(unit, factor):
    (check,) = time_axis_checks(recording(gains=(factor, factor)))
    assert (check.name, check.severity) == ("velocity-scale", "note")
    assert f"are in {unit}, not in rad/s" in check.text


def test_a_clock_that_drifts_against_the_host_s_is_named_with_its_factor():
    (check,) = time_axis_checks(recording(clock=1.01))
    assert check.name == "clocks-drift"
    assert "'joints'" in check.text
    assert "multiplied by 1.01" in check.text


def test_without_velocity_and_host_time_nothing_is_said():
    found = recording(scale=1.25)
    stream = found.streams[JOINTS_STREAM]
    position = {"position": stream.channels["position"]}
    bare = Recording("", {JOINTS_STREAM: Stream(JOINTS_STREAM, stream.time, stream.time, position)})
    assert time_axis(bare).factor is None
    assert time_axis_checks(bare) == []


def test_values_that_are_not_numbers_are_left_out():
    found = recording(scale=1.25)
    stream = found.streams[JOINTS_STREAM]
    stream.channels["velocity"].values[10:20] = np.nan
    assert time_axis(found).factor == pytest.approx(0.8, rel=5e-3)
