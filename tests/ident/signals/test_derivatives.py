"""Each way to q, q̇ and q̈, through the whole pipeline."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from each import each

from drivers.core.errors import UsageError
from ident.signals.joint_signals import JointSignals
from ident.signals.options import Differentiation, PreprocessChoices
from ident.signals.pipeline import prepare

WAYS = get_args(Differentiation)
RATE = 200.0
JOINTS = ("base", "elbow")


def motion(time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(2, N) position, velocity, acceleration."""
    angular = 2 * np.pi * np.array([[0.4], [0.9]])
    phase = angular * time
    return np.sin(phase) + 1, angular * np.cos(phase), -(angular**2) * np.sin(phase)


def recorded(
    samples: int = 3000, noise: float = 1e-5, velocity: bool = False, gap: bool = False, seed: int = 0
) -> JointSignals:
    time = np.arange(samples) / RATE
    if gap:
        time = np.delete(time, np.s_[1000:1100])
    position, speed, _ = motion(time)
    generator = np.random.default_rng(seed)
    noisy = position + noise * generator.standard_normal(position.shape)
    return JointSignals("", JOINTS, time, noisy.T, position.T, "given", speed.T if velocity else None)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("gap", [False, True])
def test_each_way_recovers_the_motion(way: Differentiation, gap: bool) -> None:
    prepared = prepare(recorded(gap=gap), PreprocessChoices(differentiation=way))
    assert len(prepared.segments) == 1 + gap
    for segment in prepared.segments:
        position, velocity, acceleration = motion(segment.time)
        assert rms(segment.position - position) < 1e-5
        # Five-point smoothing cannot reach so low a cut-off, so more of the noise remains.
        assert rms(segment.velocity - velocity) < (2e-3 if way == "five-point" else 1e-3)
        assert rms(segment.acceleration - acceleration) < (0.2 if way == "five-point" else 0.06)
    assert [step.name for step in prepared.steps][1:3] == [
        "low-pass" if way == "butterworth" else "smoothing",
        "derivatives",
    ]


@pytest.mark.parametrize("way", WAYS)
def test_a_joint_that_rests_has_no_velocity_of_rounding(way: Differentiation) -> None:
    moving = recorded(samples=600)
    position = np.stack([moving.position[:, 0], np.full(600, 1.5708)], axis=1)
    (segment,) = prepare(
        replace(moving, position=position), PreprocessChoices(differentiation=way, keep_rest=True)
    ).segments
    assert not segment.velocity[1].any()
    assert segment.velocity[0].all()


@pytest.mark.parametrize("way", WAYS)
def test_each_way_takes_the_recorded_velocity(way: Differentiation) -> None:
    choices = PreprocessChoices(differentiation=way, measured_velocity=True)
    (segment,) = prepare(recorded(velocity=True, noise=1e-3), choices).segments
    _, velocity, acceleration = motion(segment.time)
    assert np.abs(segment.velocity - velocity).max() < 2e-3
    assert np.abs(segment.acceleration - acceleration).max() < 2e-2


@pytest.mark.parametrize("way", WAYS)
def test_resolved_choices_repeat_the_smoothing(way: Differentiation) -> None:
    first = prepare(recorded(), PreprocessChoices(differentiation=way))
    again = prepare(recorded(), first.choices)
    np.testing.assert_array_equal(again.segments[0].velocity, first.segments[0].velocity)
    other = prepare(recorded(noise=1e-3, seed=1), first.choices)
    assert other.choices.joint_cutoffs == first.choices.joint_cutoffs
    assert other.choices.position_cutoff == first.choices.position_cutoff
    assert (first.choices.joint_cutoffs is None) == (way != "kalman")


def test_each_joint_has_the_smoother_of_its_noise() -> None:
    signals = recorded(noise=0.0)
    generator = np.random.default_rng(0)
    signals.position[:, 0] += 1e-3 * generator.standard_normal(len(signals.time))
    signals.position[:, 1] += 1e-6 * generator.standard_normal(len(signals.time))
    prepared = prepare(signals, PreprocessChoices(differentiation="kalman"))
    noisy, clean = prepared.choices.joint_cutoffs or ()
    assert noisy < clean
    smoothing = next(step for step in prepared.steps if step.name == "smoothing")
    assert smoothing.settings["noise_std_base"] == pytest.approx(1e-3, rel=0.05)
    assert 1e-6 < smoothing.settings["noise_std_elbow"] < 4e-6  # with what is left of the motion
    assert prepared.cutoffs.position == noisy  # what the ends are left out for


def test_a_given_cutoff_is_that_of_all_joints() -> None:
    given = prepare(recorded(), PreprocessChoices(differentiation="kalman", position_cutoff=9.0))
    assert given.choices.joint_cutoffs == (9.0, 9.0)
    # The Kalman smoother is the zero-phase Butterworth of the same cut-off, but for central differences.
    usual = prepare(recorded(), PreprocessChoices(position_cutoff=9.0))
    inner = np.s_[:, 100:-100]
    np.testing.assert_allclose(given.segments[0].position[inner], usual.segments[0].position[inner], atol=2e-6)


@pytest.mark.parametrize("way", WAYS)
def test_each_way_follows_a_decimation(way: Differentiation) -> None:
    (segment,) = prepare(recorded(), PreprocessChoices(differentiation=way, position_decimate=4)).segments
    assert segment.rate == pytest.approx(RATE / 4)
    assert np.abs(segment.velocity - motion(segment.time)[1]).max() < 0.15


@pytest.mark.parametrize(
    ("choices", "words"),
    [
        ({"joint_cutoffs": (5.0,)}, "1 cut-offs for 2 joints"),
        ({"joint_cutoffs": (5.0, 150.0)}, "150 Hz is not below half"),
    ],
)
def test_cutoffs_that_do_not_fit_are_refused(choices: dict[str, tuple[float, ...]], words: str) -> None:
    with pytest.raises(UsageError, match=words):
        prepare(recorded(), PreprocessChoices(differentiation="kalman", **choices))  # type: ignore[arg-type]


def test_stated_noise_levels_are_those_of_all_joints_and_of_the_next_recording() -> None:
    prepared = prepare(recorded(), PreprocessChoices(differentiation="kalman", kalman_noise=(2e5, 1e-9)))
    cutoff = (2e5 * RATE / 1e-9) ** 0.125 / (2 * np.pi)
    assert prepared.choices.joint_cutoffs == pytest.approx((cutoff, cutoff))
    assert prepare(recorded(seed=1), prepared.choices).choices.joint_cutoffs == prepared.choices.joint_cutoffs


@each(
    ("choices", "words"),
    [
        ({"differentiation": "kalman", "joint_cutoffs": (0.0,)}, "joint_cutoffs 0 is not within"),
        ({"differentiation": "kalman", "joint_cutoffs": (-1.0,)}, "joint_cutoffs -1 is not within"),
        ({"differentiation": "kalman", "joint_cutoffs": (float("nan"),)}, "joint_cutoffs nan is not a finite number"),
        ({"differentiation": "spline"}, "--differentiation 'spline' does not exist"),
        ({"differentiation": "kalman", "kalman_noise": (1.0,)}, "is not two numbers"),
        ({"differentiation": "kalman", "kalman_noise": (1.0, 0.0)}, "--kalman-noise 0 is not within"),
        ({"differentiation": "kalman", "kalman_noise": (1.0, 1.0), "position_cutoff": 20.0}, "fix the cut-off"),
        ({"kalman_noise": (1.0, 1.0)}, "need the Kalman smoother"),
    ],
)
def test_cutoffs_ways_and_noise_levels_that_mean_nothing_are_refused(choices: dict[str, object], words: str) -> None:
    with pytest.raises(UsageError, match=words):
        PreprocessChoices(**choices)
