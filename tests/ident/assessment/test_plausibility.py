"""Signs and definiteness that a small residual does not show, on arms whose truth is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from daq.robot.loader import load_robot, parse_robot
from ident.assessment.plausibility import indefinite_share, inertia_matrices, sign_checks
from ident.identify.identification import IdentifyChoices
from ident.identify.identify import identify
from ident.model.base_parameters import base_parameters, random_states
from ident.model.dynamic_model import build_model
from ident.model.dynamics.pinocchio_model import pinocchio_model
from ident.model.true_parameters import truth_vector
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording

pytestmark = pytest.mark.usefixtures("not_simulated", "stated_friction")


@pytest.mark.parametrize("name", ["ur5e", "rocr6", "aubo_i5", "panda"])
def test_inertia_matrix_of_base_parameters_is_pinocchios(name):
    """Motor inertia sits on the diagonal only: it is no rotational inertia of a link (a bug of figaroh)."""
    import pinocchio as pin

    robot_file = load_robot(name)
    model = build_model(robot_file)
    base = base_parameters(model)
    truth = truth_vector(robot_file)
    position, _, _ = random_states(model, 20, seed=3)
    matrices = inertia_matrices(model, base, base.projection @ truth, position)
    names = [parameter.name for parameter in model.parameters]
    motors = [truth[names.index(f"Ia{j + 1}")] if model.motor_inertia[j] else 0.0 for j in range(model.dof)]
    arm = pinocchio_model(model, truth[: 10 * model.dof])
    data = arm.createData()
    for sample in range(20):
        upper = np.triu(pin.crba(arm, data, position[:, sample]))
        expected = upper + np.triu(upper, 1).T + np.diag(motors)
        assert np.allclose(matrices[sample], expected, rtol=0, atol=1e-9 * np.max(np.abs(expected)))


@pytest.mark.parametrize("name", ["ur5e", "rocr6", "aubo_i5", "panda"])
def test_true_parameters_are_never_indefinite(name):
    robot_file = load_robot(name)
    model = build_model(robot_file)
    base = base_parameters(model)
    assert indefinite_share(model, base, base.projection @ truth_vector(robot_file)) == 0.0


def test_a_negative_inertia_is_indefinite_everywhere(three_joint):
    model = build_model(three_joint)
    base = base_parameters(model)
    parameters = base.projection @ truth_vector(three_joint)
    assert indefinite_share(model, base, parameters) == 0.0
    parameters[base.names.index("ZZR1")] = -5.0
    assert indefinite_share(model, base, parameters) == 1.0


def test_offset_and_friction_are_no_inertia(three_joint):
    model = build_model(three_joint)
    base = base_parameters(model)
    parameters = base.projection @ truth_vector(three_joint)
    position, _, _ = random_states(model, 5)
    plain = inertia_matrices(model, base, parameters, position)
    changed = parameters.copy()
    changed[[kind in ("viscous", "coulomb", "offset") for kind in base.kinds]] = 1e3
    assert np.array_equal(inertia_matrices(model, base, changed, position), plain)
    assert np.allclose(plain, plain.transpose(0, 2, 1), rtol=0, atol=1e-12)


@pytest.mark.parametrize(("gravity", "wrong"), [("[0, 0, -9.81]", False), ("[0, 0, 9.81]", True)])
def test_gravity_of_the_wrong_sign_is_found(gravity, wrong):
    """On six joints; on three, and other directions, in `test_every_check`."""
    robot_file = load_robot("ur5e")
    motion = random_fourier_motion(build_model(robot_file), 10.0, seed=1)
    recording = simulate_recording(robot_file, motion, 14.0, seed=1, rate=125.0)
    text = robot_file.text.replace("gravity: [0, 0, -9.81]", f"gravity: {gravity}")
    if wrong:
        text = text.replace("mounting: table", "mounting: ceiling")
    believed = parse_robot(text, where="believed", folder=None)
    found = identify([recording], [], IdentifyChoices(), robot_file=believed)
    assert ("gravity-opposite" in {check.name for check in found.checks}) is wrong


@pytest.mark.parametrize("seed", range(4))
def test_an_arm_that_does_not_feel_gravity_is_not_told_that_its_sign_is_wrong(three_joint, seed):
    """Both signs fit alike; the rounding, or the flickering encoder of a joint at rest, must not decide."""
    text = three_joint.text.replace("alpha: pi/2, d: 0, r: 0", "alpha: 0, d: 0.3, r: 0")  # all axes vertical
    planar = parse_robot(text, where="planar", folder=None)
    motion = random_fourier_motion(build_model(planar), 10.0, seed=seed, candidates=5)
    motion.sine[1] = motion.cosine[1] = 0.0
    recording = simulate_recording(planar, motion, 14.0, seed=seed)
    position = recording.streams["joints"].channels["position"].values
    position[:, 1] += 1e-5 * np.random.default_rng(seed).integers(0, 2, len(position))
    found = identify([recording], [], IdentifyChoices())
    assert not {check.name for check in found.checks} & {"gravity-opposite", "gravity-direction"}


def test_clearly_negative_friction_and_motor_inertia_are_warned_of(three_joint):
    model = replace(build_model(three_joint), motor_inertia=(True, True, True))
    base = base_parameters(model)
    parameters = np.abs(base.projection @ truth_vector(three_joint)) + 0.1
    std = np.full(base.count, 0.1)
    assert sign_checks(base, parameters, std) == []
    for name in ("Fv2", "Fs3"):
        parameters[base.names.index(name)] = -1.0
    (friction,) = sign_checks(base, parameters, std)
    assert friction.name == "negative-friction"
    assert friction.text.startswith("Fv2, Fs3 is negative (not dissipative)")
    parameters[base.names.index("Ia3")] = -1.0
    motors = sign_checks(base, parameters, std)[1]
    assert motors.name == "negative-motor-inertia"
    assert motors.severity == "note"  # the delivered model's is never negative
    assert motors.text.startswith("Ia3 of the unconstrained parameters is negative")
    assert "inertia: false" in motors.text


def test_negative_within_the_error_bar_or_where_it_may_be_is_not_warned_of(three_joint):
    base = base_parameters(build_model(three_joint))
    parameters = -np.ones(base.count)
    assert sign_checks(base, parameters, np.full(base.count, 0.5)) == []
    for i, kind in enumerate(base.kinds):
        if kind in ("viscous", "coulomb", "motor_inertia"):
            parameters[i] = 1.0
    assert sign_checks(base, parameters, np.full(base.count, 1e-3)) == []  # offsets and products may be negative
    alone = np.count_nonzero(base.projection, axis=1) == 1
    mixed = base.projection + 0.5 * np.roll(base.projection, 1, axis=0)  # such as Ia2 + YY2 - 1.8·MZ2 of a lifting arm
    assert sign_checks(replace(base, projection=mixed), np.where(alone, -1.0, 1.0), np.full(base.count, 1e-3)) == []


@pytest.mark.parametrize(("joint", "gain"), [("j1", "10"), ("j2", "-8"), ("j3", "4")])
def test_a_reversed_drive_gain_is_hinted_at(three_joint, joint, gain):
    recording = simulate_recording(three_joint, random_fourier_motion(build_model(three_joint), 10.0, 1), 14.0, 1)
    text = three_joint.text.replace(f"joint: {joint}, gain: {gain},", f"joint: {joint}, gain: {-float(gain)},")
    found = identify([recording], [], IdentifyChoices(), robot_file=parse_robot(text, where="reversed", folder=None))
    assert any("sign" in warning and "drive gain" in warning for warning in found.warnings)
    assert "indefinite-inertia" in {check.name for check in found.checks}
    if joint != "j3":  # of a light last joint only the standard deviations show it
        assert any(f"Fs{joint[1]}" in warning and "not dissipative" in warning for warning in found.warnings)
