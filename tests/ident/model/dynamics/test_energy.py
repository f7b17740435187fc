"""The energy regressor against inverse dynamics: what the motors give is stored or lost, on any tree."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from arm_kinds import ARM_KINDS
from each import each

from daq.robot.loader import load_robot
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.dynamics.energy import EnergyKernel, energy_base_parameters, motor_velocity
from ident.model.dynamics.pinocchio_model import pinocchio_model
from ident.model.regressor import regressor

NODES, WEIGHTS = np.polynomial.legendre.leggauss(60)


def window(dof: int, seed: int, duration: float = 0.8):
    """Random sums of sines at the ends of a window and at Gauss-Legendre nodes within it; and the nodes' weights."""
    generator = np.random.default_rng(seed)
    amplitude = generator.uniform(0.2, 1.0, (dof, 3, 1))
    pulsation = generator.uniform(0.5, 4.0, (dof, 3, 1))
    phase = generator.uniform(0.0, 2.0 * np.pi, (dof, 3, 1))
    time = np.concatenate([[0.0, duration], 0.5 * duration * (NODES + 1.0)])
    angle = pulsation * time + phase
    position = (amplitude * np.sin(angle)).sum(axis=1)
    velocity = (amplitude * pulsation * np.cos(angle)).sum(axis=1)
    acceleration = (-amplitude * pulsation**2 * np.sin(angle)).sum(axis=1)
    return position, velocity, acceleration, 0.5 * duration * WEIGHTS


@each("aligned", [False, True])
@each("seed", range(12))
def test_energy_difference_is_the_work_of_inverse_dynamics(random_tree, seed, aligned):
    """Against Pinocchio's RNEA, prismatic joints included; quadrature to rounding."""
    import pinocchio as pin

    model = random_tree(seed, dof=1 + seed % 8, aligned=aligned)
    position, velocity, acceleration, weights = window(model.dof, seed)
    inertial = np.random.default_rng(seed).standard_normal(10 * model.dof)
    arm = pinocchio_model(model, inertial)
    data = arm.createData()
    power = [
        velocity[:, k] @ pin.rnea(arm, data, position[:, k], velocity[:, k], acceleration[:, k])
        for k in range(2, position.shape[1])
    ]
    energy = inertial @ EnergyKernel(model, range(10 * model.dof)).energy(position[:, :2], velocity[:, :2])
    assert energy[1] - energy[0] == pytest.approx(weights @ power, rel=0, abs=1e-9 * np.max(np.abs(power)))


def assert_work_is_stored_or_lost(model, seed: int) -> None:
    position, velocity, acceleration, weights = window(model.dof, seed)
    kernel = EnergyKernel(model)
    stored = kernel.energy(position[:, :2], velocity[:, :2])
    balance = stored[:, 1] - stored[:, 0]
    balance[kernel.friction_rows] += kernel.friction_power(velocity[:, 2:]) @ weights
    torque = regressor(model, position[:, 2:], velocity[:, 2:], acceleration[:, 2:])
    work = np.einsum("nk,npk,k->p", motor_velocity(model, velocity[:, 2:]), torque, weights)
    assert np.max(np.abs(balance - work)) < 1e-9 * np.max(np.abs(work))


@each("seed", range(12))
def test_every_column_balances_on_random_trees(random_tree, seed):
    """Motor inertia, friction and offset as well: the same quadrature of losses and work, so kinks do no harm."""
    assert_work_is_stored_or_lost(random_tree(seed + 50, dof=1 + seed % 8), seed)


@each("name", ARM_KINDS)
def test_every_column_balances_on_the_built_in_arms(name):
    """Closed loops and coupled motors included, where the file has them."""
    assert_work_is_stored_or_lost(build_model(load_robot(name)), seed=3)


def assert_same_base(model) -> None:
    dynamic, energy = base_parameters(model), energy_base_parameters(model)
    assert energy.columns == dynamic.columns
    assert energy.names == dynamic.names
    assert energy.no_effect == dynamic.no_effect
    assert np.allclose(energy.projection, dynamic.projection, rtol=0, atol=1e-6)
    assert energy.margin > 1e6


@pytest.mark.parametrize("name", ARM_KINDS)
def test_base_parameters_are_those_of_the_dynamic_model(name):
    assert_same_base(build_model(load_robot(name)))


@each("seed", range(12))
def test_base_parameters_are_those_of_the_dynamic_model_on_random_trees(random_tree, seed):
    assert_same_base(random_tree(seed, dof=6, aligned=bool(seed % 2)))


def test_weightless_arms_have_the_same_base_as_well(three_joint):
    model = replace(build_model(three_joint), gravity=np.zeros(3))
    assert_same_base(model)
    assert energy_base_parameters(model).count < energy_base_parameters(build_model(three_joint)).count


@each("seed", range(4))
def test_chosen_columns_are_the_same_columns(random_tree, seed):
    model = random_tree(seed, dof=5)
    generator = np.random.default_rng(seed)
    position, velocity = generator.uniform(-3, 3, (2, 5, 5000))
    count = len(model.parameters)
    columns = sorted(generator.choice(count, size=count // 2, replace=False).tolist())
    whole, part = EnergyKernel(model), EnergyKernel(model, columns)
    assert np.array_equal(part.energy(position, velocity), whole.energy(position, velocity)[columns])
    lost = np.zeros((count, 5000))
    lost[whole.friction_rows] = whole.friction_power(velocity)
    assert np.array_equal(part.friction_power(velocity), lost[np.array(columns)[part.friction_rows]])
    # States are independent of each other: chunks do not matter.
    assert np.array_equal(
        whole.energy(position[:, 4090:4100], velocity[:, 4090:4100])[:, 3], whole.energy(position, velocity)[:, 4093]
    )
