"""Joints that rest, or hardly move, are locked or warned of; the torques of the others alone count."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from each import each
from true_results import truth_of

from daq.recording.recording import JOINTS_STREAM
from daq.robot.loader import load_robot, parse_robot
from drivers.core.errors import DataError, UsageError
from ident.identify.identification import IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from ident.identify.revalidate import revalidate
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.true_parameters import truth_vector
from ident.regression.observability import find_experiment
from ident.regression.options import ExperimentChoices
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording

STATED = IdentifyChoices(search_delay=False, presliding=False, model=ModelChoices(friction="coulomb-viscous"))
"""The terms that the arm has, and no search: a third of the time of an identification without its checks."""
alone = pytest.mark.usefixtures("estimate_alone")
SLIGHTLY = 3e-3
"""Share of a random motion's amplitude that is motion, but slower than what counts as such."""


def test_a_joint_that_sags_on_its_brake_is_locked_within_the_tolerance(three_joint):
    """By 3 mrad, while the others move; the held-out part too, and another recording with the stored model."""
    motion = random_fourier_motion(build_model(three_joint), 10.0, seed=1)
    motion.sine[1] = motion.cosine[1] = 0.0
    recording = simulate_recording(three_joint, motion, 20.0, seed=1)
    position = recording.streams[JOINTS_STREAM].channels["position"].values
    position[:, 1] += 1.5e-3 * np.sin(0.7 * recording.streams[JOINTS_STREAM].time)
    said = replace(STATED, experiment=ExperimentChoices(locked=("j2",)))
    found = identify([recording], [], said)
    assert found.experiment.locked == (1,)
    assert found.validation.relative_error < 0.05
    result = found.result
    (step,) = [step for step in result.preprocessing if step.name == "experiment"]
    assert "rest tolerance of 0.005" in step.text
    assert revalidate(result, recording).full.rmse[1] is None
    strict = replace(said, experiment=replace(said.experiment, rest_tolerance=1e-3))
    with pytest.raises(DataError, match=r"moves over 0\.003 rad; the tolerance is 0\.001 rad") as caught:
        identify([recording], [], strict)
    assert "--rest-tolerance" in (caught.value.hint or "")
    stored = result.model_copy(update={"options": {**result.options, "rest_tolerance": 1e-3}})
    with pytest.raises(DataError, match="was locked"):
        revalidate(stored, recording)


@each("tolerance", [-1e-3, 0.2, float("nan")])
def test_a_rest_tolerance_that_is_a_motion_is_refused(tolerance):
    with pytest.raises(UsageError, match=r"moves over \S+ rad is not at rest|--rest-tolerance nan"):
        find_experiment(build_model(load_robot("ur5e")), [], ExperimentChoices(rest_tolerance=tolerance))
    row = "{joint: s, type: prismatic, alpha: 0, d: 0, r: 0}"
    text = f"name: a\nmodel: {{mdh: [{row}]}}\njoints: [{{name: s, position: [0, 1], velocity: 1}}]"
    slides = parse_robot(text, where="a", folder=None)
    with pytest.raises(UsageError, match=r"moves over \S+ m is not at rest|--rest-tolerance nan"):
        find_experiment(build_model(slides), [], ExperimentChoices(rest_tolerance=tolerance))


def test_a_joint_that_hardly_moves_is_warned_of_and_its_friction_has_no_values(noise_free, three_joint):
    motion = random_fourier_motion(build_model(noise_free), 10.0, seed=1)
    motion.sine[1] *= SLIGHTLY
    motion.cosine[1] *= SLIGHTLY
    recording = simulate_recording(three_joint, motion, 20.0, seed=1)
    found = identify([recording], [], STATED)
    silent = {found.base.names[i] for i in range(found.base.count) if i not in found.solution.active}
    assert {"Fv2", "Fs2"} <= silent
    (warning,) = [text for text in found.warnings if "does not excite" in text]
    assert all(name in warning for name in silent)
    place = found.base.names.index("Fs2")
    assert found.solution.parameters[place] == 0.0
    assert np.isinf(found.std[place])
    for name in ("Fs1", "Fs3", "Fv3", "MX3"):
        place = found.base.names.index(name)
        error = abs(found.solution.parameters[place] - truth_of(three_joint)[place])
        assert error < 5 * found.std[place] < 0.5 * abs(truth_of(three_joint)[place]) + 0.1
    # Its torque is friction of a joint at rest: not compared.
    first, resting, third = found.validation.joint_relative_error
    assert resting is None
    assert max(first, third) < 0.05


def test_joints_that_stand_still_are_found_and_the_others_identified(three_joint):
    motion = random_fourier_motion(build_model(three_joint), 10.0, seed=1)
    motion.sine[1] = motion.cosine[1] = 0.0
    recording = simulate_recording(three_joint, motion, 20.0, seed=1)
    found = identify([recording], [], STATED)
    assert found.experiment.locked == (1,)
    assert found.experiment.torques == (0, 2)
    assert not any(name.endswith("2") for name in found.base.names)
    assert found.solution.active == tuple(range(found.base.count))
    assert np.isnan(found.joint_std[1])
    assert np.all(found.joint_std[[0, 2]] > 0)
    truth = found.base.projection @ truth_vector(three_joint)
    error = np.abs(found.solution.parameters - truth) / found.std
    assert np.mean(error < 1.96) > 0.8
    assert np.max(error) < 5.0
    assert found.validation.relative_error < 0.05
    assert found.validation.rmse[1] is None
    (warning,) = [text for text in found.warnings if "did not move" in text]
    assert warning.startswith("j2 did not move")
    said = identify([recording], [], replace(STATED, experiment=ExperimentChoices(locked=("j2",))))
    assert not any("did not move" in text for text in said.warnings)
    assert np.array_equal(said.solution.parameters, found.solution.parameters)


def test_the_torque_of_a_joint_at_rest_is_used_where_it_is_asked_for(three_joint):
    motion = random_fourier_motion(build_model(three_joint), 10.0, seed=1)
    motion.sine[1] = motion.cosine[1] = 0.0
    recording = simulate_recording(three_joint, motion, 20.0, seed=1)
    choices = ExperimentChoices(torques_of=("j1", "j2", "j3"))
    found = identify([recording], [], replace(STATED, experiment=choices))
    assert found.experiment.torques == (0, 1, 2)
    assert any(name.endswith("2") for name in found.base.names)  # what its motor holds
    assert np.all(found.joint_std > 0)
    assert any("is at rest, and its torque is used" in text for text in found.warnings)


@alone
@pytest.mark.parametrize("method", ["ols", "wls"])
def test_only_the_chosen_torques_count(recorded, three_joint, method):
    """What the others say does not matter, and the values are those of the arm."""
    spoilt = recorded(20.0)
    spoilt.streams[JOINTS_STREAM].channels["current"].values[:, :2] *= 3.0
    choices = replace(STATED, method=method, experiment=ExperimentChoices(torques_of=("j3",)), search_delay=True)
    found, clean = identify([spoilt], [], choices), identify([recorded(20.0)], [], choices)
    assert np.array_equal(found.solution.parameters, clean.solution.parameters)
    assert np.array_equal(found.std, clean.std)
    assert found.delay is not None
    assert found.delay.best == clean.delay.best
    assert found.base.count == found.base.projection.shape[0] < base_parameters(found.model).count
    truth = found.base.projection @ truth_vector(three_joint)
    assert np.max(np.abs(found.solution.parameters - truth) / found.std) < 5.0
    assert found.fit.rmse[0] is None
    assert found.fit.rmse[2] > 0
    assert found.fit.relative_error == pytest.approx(found.fit.joint_relative_error[2])


def test_a_held_out_motion_of_a_locked_joint_is_refused(recorded, three_joint):
    motion = random_fourier_motion(build_model(three_joint), 10.0, seed=1)
    motion.sine[1] = motion.cosine[1] = 0.0
    recording = simulate_recording(three_joint, motion, 20.0, seed=1)
    with pytest.raises(DataError, match=r"it moves j2 over .* and j2 was locked"):
        identify([recording], [recorded(8.0, 5)], IdentifyChoices())


@alone
def test_energy_methods_take_locked_joints_but_no_choice_of_torques(three_joint):
    motion = random_fourier_motion(build_model(three_joint), 10.0, seed=1)
    motion.sine[0] = motion.cosine[0] = 0.0
    recording = simulate_recording(three_joint, motion, 30.0, seed=1)
    found = identify([recording], [], IdentifyChoices(method="power", search_delay=False))
    assert found.experiment.locked == (0,)
    truth = found.base.projection @ truth_vector(three_joint)
    active = list(found.solution.active)
    assert np.mean(np.abs(found.solution.parameters - truth)[active] < 3 * found.std[active]) > 0.9
    with pytest.raises(UsageError, match="--torques-of has no meaning"):
        IdentifyChoices(method="energy", experiment=ExperimentChoices(torques_of=("j1",)))
