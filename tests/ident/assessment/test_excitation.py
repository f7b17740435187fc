"""How well a recorded motion excites the arm."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from daq.recording.recording import JOINTS_STREAM
from ident.assessment.excitation import ExcitationReached, excitation_reached, recorded_motion
from ident.model.dynamic_model import build_model
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording


def recording_of(robot_file, motion, seconds: float = 12.0):
    return simulate_recording(robot_file, motion, seconds, seed=1)


def reached_by(recording, robot_file) -> ExcitationReached:
    motion = recorded_motion(recording, robot_file)
    assert motion is not None
    return excitation_reached(motion)


def test_ranges_and_speeds_are_those_of_the_motion(three_joint):
    motion = random_fourier_motion(build_model(three_joint), 10.0, seed=1)
    reached = reached_by(recording_of(three_joint, motion), three_joint)
    position, velocity, _ = motion.evaluate(np.arange(2000) / 200)
    speed = np.max(np.abs(velocity), axis=1)
    assert reached.position_range == pytest.approx(np.ptp(position, axis=1), abs=2e-3)
    assert reached.velocity_reached == pytest.approx(speed, rel=0.02)
    assert reached.velocity_share_percent == pytest.approx(100 * speed / 3.0, rel=0.02)
    assert reached.unexcited == []
    assert 1.0 < reached.scaled_condition <= reached.condition < 1e3


def test_the_best_of_many_motions_excites_better_than_a_small_one(three_joint):
    model = build_model(three_joint)
    good = random_fourier_motion(model, 10.0, seed=1)
    small = replace(good, sine=0.05 * good.sine, cosine=0.05 * good.cosine)
    conditions = [
        reached_by(recording_of(three_joint, motion), three_joint).scaled_condition for motion in (good, small)
    ]
    assert conditions[1] > 5 * conditions[0]


@pytest.mark.parametrize("dither", [0.0, 1e-5])
def test_a_joint_at_rest_excites_no_friction_even_if_its_encoder_flickers(three_joint, dither):
    motion = random_fourier_motion(build_model(three_joint), 10.0, seed=1)
    motion.sine[1] = motion.cosine[1] = 0.0
    recording = recording_of(three_joint, motion)
    position = recording.streams[JOINTS_STREAM].channels["position"].values
    position[:, 1] += dither * np.random.default_rng(0).integers(0, 2, len(position))
    reached = reached_by(recording, three_joint)
    assert {"Fv2", "Fs2"} <= set(reached.unexcited)
    assert not {"Fv1", "Fs1", "Fv3", "Fs3", "MX3"} & set(reached.unexcited)
    assert reached.velocity_reached[1] < 1e-3


def test_one_joint_alone_excites_what_belongs_to_it(three_joint):
    motion = random_fourier_motion(build_model(three_joint), 10.0, seed=1)
    motion.sine[:2] = motion.cosine[:2] = 0.0
    reached = reached_by(recording_of(three_joint, motion), three_joint)
    assert {"Fv1", "Fs1", "Fv2", "Fs2", "ZZR1"} <= set(reached.unexcited)
    assert not {"Fv3", "Fs3", "Fo3"} & set(reached.unexcited)
