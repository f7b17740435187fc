"""Further friction terms: columns, slopes, sensitivities, conditions, and the paper's coefficients."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from friction_arm import TERMS, arm_file
from pinocchio_reference import pinocchio_regressor

from drivers.core.errors import DataError, ModelError
from ident.friction.table import SHAPED, root_coefficients, temperature_coefficients
from ident.friction.terms import FrictionConditions, friction_terms, no_terms
from ident.model.base_parameters import base_parameters, random_states, random_temperature
from ident.model.dynamic_model import build_model
from ident.model.dynamics.energy import EnergyKernel
from ident.model.dynamics.inverse_dynamics import InverseDynamics
from ident.model.joint_columns import column_signal, column_slope, joint_column
from ident.model.regressor import LoadTorqueKernel, RegressorKernel, evaluate_in_chunks, model_torque, regressor
from ident.model.true_parameters import true_model, truth_vector


@pytest.fixture(scope="module")
def arm():
    file = arm_file()
    return file, true_model(file)


def states(model, count, seed=3):
    q, dq, ddq = random_states(model, count, seed)
    return q, dq, ddq, random_temperature(model, count, seed)


def test_torque_is_the_papers_formula(arm):
    file, model = arm
    q, dq, ddq, kelvin = states(model, 600)
    plain = build_model(file)
    torque = model_torque(model, None, truth_vector(file, model), q, dq, ddq, kelvin)
    still = np.zeros_like(q)
    inertial = truth_vector(file)[:30]
    load = model_torque(plain, range(30), inertial, q, still, still)
    links = model_torque(plain, None, np.where(np.arange(42) < 33, truth_vector(file), 0.0), q, dq, ddq)
    for joint, name in enumerate(model.joint_names):
        truth = file.robot.truth.joints[name]
        beta1, beta2, beta3 = truth.temperature
        speed, heat = np.abs(dq[joint]), kelvin[joint]
        dry = truth.coulomb + truth.stribeck * np.exp(-((speed / truth.stribeck_velocity) ** 2))
        dry += truth.load * np.abs(load[joint]) ** (1 if name == "j3" else 2)
        sliding = truth.viscous * speed**truth.alpha + np.sqrt(speed) * (beta1 + beta2 * heat + beta3 / heat**3)
        expected = links[joint] + np.sign(dq[joint]) * (dry + sliding) + truth.offset
        assert np.allclose(torque[joint], expected, rtol=0, atol=1e-9 * np.max(np.abs(expected)))


def test_every_way_to_the_torque_agrees(arm):
    file, model = arm
    base = base_parameters(model)
    truth = truth_vector(file, model)
    q, dq, ddq, kelvin = states(model, 450)
    many = model_torque(model, None, truth, q, dq, ddq, kelvin)
    load = LoadTorqueKernel(model).torque(q)
    dense = pinocchio_regressor(model, q, dq, ddq, FrictionConditions(load, kelvin))
    assert np.allclose(np.einsum("npN,p->nN", dense, truth), many, atol=1e-9)
    few = regressor(model, q[:, :7], dq[:, :7], ddq[:, :7], base.columns, kelvin[:, :7])
    assert np.allclose(np.einsum("nbN,b->nN", few, base.projection @ truth), many[:, :7], atol=1e-9)
    dynamics = InverseDynamics(model, base, base.projection @ truth)
    assert np.allclose(dynamics.torque(q, dq, ddq, kelvin), many, atol=1e-9)
    assert np.allclose(dynamics.torque(q[:, :5], dq[:, :5], ddq[:, :5], kelvin[:, :5]), many[:, :5], atol=1e-9)


def test_chunks_and_the_energy_agree_with_the_whole(arm):
    _, model = arm
    q, dq, ddq, kelvin = states(model, 90)
    whole, parts = RegressorKernel(model), RegressorKernel(model, chunk=40)
    (_, expected), *_ = evaluate_in_chunks(whole, q, dq, ddq, kelvin)
    packed = [part.copy() for _, part in evaluate_in_chunks(parts, q, dq, ddq, kelvin)]
    assert np.array_equal(np.concatenate(packed, axis=1), expected)
    energy = EnergyKernel(model)
    power = energy.friction_power(dq, q, kelvin)
    for row, lost in zip(energy.friction_rows, power, strict=True):
        entry = next(e for e in whole.joint_parameter_rows if model.parameters[row].name == _name(model, whole, e))
        assert np.allclose(lost, expected[entry.row] * dq[entry.column.motion[0][0]])


def _name(model, kernel, entry):
    joint = next(j for j, rows in enumerate(kernel.joint_rows) if entry.row < rows.rows.stop)
    rows = kernel.joint_rows[joint]
    return model.parameters[rows.columns[entry.row - rows.rows.start]].name


def test_all_friction_is_identifiable_and_load_only_where_gravity_acts(arm):
    _, model = arm
    base = base_parameters(model)
    names = {name.rstrip("123") for name in base.names}
    assert {"Fv", "Fs", "Fo", "Fb", "Fl", "Ft", "Fts", "Ftc"} <= names
    assert "Fl2" in base.names
    assert "Fl1" in base.no_effect


def test_slopes_and_sensitivities_are_derivatives(arm):
    _, model = arm
    shaped = replace(
        model, smoothing=0.1, terms=replace(model.terms, sensitivities=True, free=dict.fromkeys(SHAPED, (True,) * 3))
    )
    speed = np.random.default_rng(1).uniform(0.05, 2.0, (3, 40)) * np.array([[1.0], [-1.0], [1.0]])
    conditions = FrictionConditions(np.full_like(speed, 3.0), np.full_like(speed, 310.0))
    step, columns = 1e-6, {}
    for parameter in shaped.parameters:
        if parameter.kind in ("inertial", "motor_inertia"):
            continue
        column = joint_column(shaped, parameter)
        columns[parameter.name] = column
        up, down = (column_signal(shaped, column, speed + sign * step, speed, conditions) for sign in (1.0, -1.0))
        slope = column_slope(shaped, column, speed, conditions)
        assert np.allclose((np.asarray(up) - down) / (2 * step), slope, atol=1e-6), parameter.name
    for shape, term in (("Fve", "Fv"), ("Fbv", "Fb")):
        for number in "123":
            base = columns[term + number]
            up, down = (
                column_signal(shaped, replace(base, shape=base.shape + sign * step), speed, speed, conditions)
                for sign in (1.0, -1.0)
            )
            derivative = column_signal(shaped, columns[shape + number], speed, speed, conditions)
            assert np.allclose((up - down) / (2 * step), derivative, atol=1e-6)


def test_a_missing_temperature_is_refused(arm):
    _, model = arm
    q, dq, ddq, kelvin = states(model, 10)
    with pytest.raises(ModelError, match="j1 lacks its temperature"):
        model_torque(model, None, np.ones(len(model.parameters)), q, dq, ddq)
    with pytest.raises(DataError, match="temperature of j2 is missing"):
        model.require_temperature(np.where(np.arange(3)[:, None] == 1, np.nan, kelvin), "run")
    replace(model, terms=no_terms(3)).require_temperature(None, "run")


def terms_of(text):
    robot = arm_file(text).robot
    return friction_terms(robot.friction, robot.joint_names)


def test_terms_of_a_robot_file():
    terms = terms_of(TERMS)
    assert [terms.shape("exponent", motor) for motor in range(3)] == [0.6, 0.6, 1.0]
    assert [terms.option("load", motor).value for motor in range(3)] == ["quadratic", "quadratic", "linear"]
    assert [terms.option("temperature", motor).value for motor in range(3)] == ["full", "full", "linear"]
    assert not terms.shaped
    free = terms_of("\nfriction: {stribeck: true, exponent: estimated}\n")
    assert free.free["exponent"] == free.free["stribeck_velocity"] == (True,) * 3
    assert terms_of("").plain


def test_no_terms_change_nothing(arm):
    file, _ = arm
    plain = build_model(file)
    with_none = replace(plain, terms=no_terms(3))
    q, dq, ddq, _ = states(with_none, 600)
    assert [p.name for p in plain.parameters] == [p.name for p in with_none.parameters]
    assert np.array_equal(regressor(plain, q, dq, ddq), regressor(with_none, q, dq, ddq))


def test_coefficients_about_the_reference_are_the_papers():
    beta = (40.0, -0.12, 9.0e6)
    assert temperature_coefficients(*root_coefficients(*beta)) == pytest.approx(beta, rel=1e-9)
