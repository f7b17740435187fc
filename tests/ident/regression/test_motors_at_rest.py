"""Motors at rest while others move: their torque is static friction, and is neither fitted nor compared."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from daq.recording.recording import JOINTS_STREAM
from ident.identify.identification import IdentifyChoices
from ident.identify.identify import identify
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.regressor import RegressorKernel
from ident.model.true_parameters import truth_vector
from ident.regression.velocity_reversals import leave_out_rest
from ident.signals.joint_signals import read_joint_signals
from ident.signals.options import PreprocessChoices
from ident.signals.pipeline import prepare
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording
from studies.synthetic.data_mistakes import with_values

pytestmark = pytest.mark.usefixtures("estimates_alone", "stated_friction")

DURATION = 12.0
STATIC = np.array([5.0, 6.0, 1.5])
"""Torque [N·m] that static friction carries at rest, below every joint's Coulomb friction."""


def single_joint_run(three_joint, moving: int, seed: int):
    """One joint moves, the others rest on their static friction."""
    motion = random_fourier_motion(build_model(three_joint), DURATION, seed)
    for joint in set(range(3)) - {moving}:
        motion.sine[joint] = motion.cosine[joint] = 0.0
    motion.offset[:] += np.random.default_rng(seed).uniform(-1.0, 1.0, 3) * (np.arange(3) != moving)
    recording = simulate_recording(three_joint, motion, DURATION, seed)
    carried = np.where(np.arange(3) == moving, 0.0, STATIC) / np.array([10.0, -8.0, 4.0])
    return with_values(recording, current=recording.streams[JOINTS_STREAM].channels["current"].values + carried)


@pytest.fixture(scope="module")
def runs(three_joint):
    return [single_joint_run(three_joint, moving, seed) for seed in range(2) for moving in range(3)]


def test_stacked_runs_of_single_joints_give_the_truth(three_joint, runs):
    found = identify(runs, [], IdentifyChoices(search_delay=False))
    truth = found.base.projection @ truth_vector(three_joint)
    kept = list(found.solution.active)
    error = np.abs(found.solution.parameters - truth)[kept] / found.std[kept]
    identified = [found.base.kinds[i] for i in kept]
    friction = [kind in ("coulomb", "viscous") for kind in identified]
    assert sum(friction) == 6
    assert np.max(error[friction]) < 4.0
    assert found.validation.relative_error < 0.05
    spoilt = identify(runs, [], IdentifyChoices(search_delay=False, preprocess=PreprocessChoices(keep_rest=True)))
    assert spoilt.validation.relative_error > 4.0 * found.validation.relative_error


def test_rows_and_comparisons_are_those_of_motors_that_move(three_joint, runs):
    model = build_model(three_joint)
    kernel = RegressorKernel(model, base_parameters(model).columns)
    prepared = prepare(read_joint_signals(runs[0], three_joint.robot), PreprocessChoices())
    marked = leave_out_rest(kernel, prepared)
    (segment,) = marked.segments
    assert segment.resting[1:].all()
    slow = np.abs(segment.velocity[0]) < prepared.rest_velocity
    assert not segment.resting[0, ~slow].any()
    assert np.array_equal(segment.resting, segment.reversing)
    assert [step.name for step in marked.steps][-1] == "motors at rest"
    kept = prepare(read_joint_signals(runs[0], three_joint.robot), PreprocessChoices(keep_rest=True))
    assert leave_out_rest(kernel, kept) is kept


def test_a_rest_reaches_as_far_as_the_filter(three_joint, runs):
    """A motor that stops: what static friction does to the filtered torque is left out on both sides."""
    model = build_model(three_joint)
    kernel = RegressorKernel(model, base_parameters(model).columns)
    prepared = prepare(read_joint_signals(runs[0], three_joint.robot), PreprocessChoices())
    (segment,) = prepared.segments
    velocity = np.ones_like(segment.velocity)
    velocity[1, 400:600] = 0.0
    stopping = replace(prepared, segments=(replace(segment, velocity=velocity),))
    (marked,) = leave_out_rest(kernel, stopping).segments
    reach = round(0.5 / prepared.cutoffs.torque * segment.rate)
    assert np.array_equal(np.flatnonzero(marked.resting[1]), np.arange(400 - reach, 600 + reach))
    assert not marked.resting[[0, 2]].any()
