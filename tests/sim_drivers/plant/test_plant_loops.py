"""Simulated arms with closed loops and coupled joints obey the model that they are identified with."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from loop_arms import four_bar_arm

from daq.robot.loader import RobotFile, load_robot, parse_robot
from daq.robot.loops import coupling_matrix
from drivers.core.arrays import FloatArray
from ident.model.dynamic_model import DynamicModel, build_model
from ident.model.dynamics.pinocchio_model import pinocchio_model
from ident.model.dynamics.rigid_arm import rigid_arm
from ident.model.regressor import model_torque
from ident.model.true_parameters import truth_vector
from sim_drivers.plant.plant import Plant, PlantSettings


def sr400() -> RobotFile:
    return load_robot("sr400")


def coupled() -> RobotFile:
    text = four_bar_arm().text
    return parse_robot(
        text.replace("joints:\n", "  coupling: {wrist: {wrist: 1, crank: 0.5}}\njoints:\n", 1), where="x", folder=None
    )


def bodies(robot_file: RobotFile, model: DynamicModel) -> tuple[FloatArray, FloatArray, FloatArray]:
    """True inertial parameters of the links, rotors' inertia (n,), and motors' over joints' positions (n, n)."""
    inertial = truth_vector(robot_file)[[p.kind == "inertial" for p in model.parameters]]
    rotors = np.array([robot_file.robot.truth.joints[name].motor_inertia for name in model.joint_names])
    return inertial, rotors, coupling_matrix(robot_file.robot.model.coupling, robot_file.robot.joint_names)


@pytest.mark.parametrize(
    ("make", "lowest", "highest"),
    [
        (sr400, -np.ones(6), np.ones(6)),
        (four_bar_arm, [-1.0, -2.3, -1.0], [1.0, -0.5, 1.0]),
        (coupled, [-1.0, -2.3, -1.0], [1.0, -0.5, 1.0]),
    ],
)
def test_forward_dynamics_undo_inverse_dynamics_and_agree_with_the_regressor(
    make: Callable[[], RobotFile], lowest: FloatArray, highest: FloatArray
) -> None:
    robot_file = make()
    model, truth = build_model(robot_file), truth_vector(robot_file)
    inertial, rotors, coupling = bodies(robot_file, model)
    arm = rigid_arm(model, inertial, rotors)
    without_friction = [i for i, p in enumerate(model.parameters) if p.kind in ("inertial", "motor_inertia")]
    generator = np.random.default_rng(5)
    q = generator.uniform(lowest, highest, (8, model.dof)).T
    v, a = generator.uniform(-2, 2, (2, model.dof, 8))
    expected = model_torque(model, without_friction, truth[without_friction], q, v, a)
    for sample in range(8):
        motor = [coupling @ values[:, sample] for values in (q, v, a)]
        torque = arm.inverse(*motor)
        np.testing.assert_allclose(torque, expected[:, sample], rtol=1e-9, atol=1e-8)
        np.testing.assert_allclose(arm.forward(motor[0], motor[1], torque), motor[2], rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(arm.inverse(motor[0], 0 * motor[1], 0 * motor[2]), arm.gravity(motor[0]), atol=1e-9)
        inertia = arm.inertia(motor[0])
        np.testing.assert_allclose(inertia, inertia.T, atol=1e-10)
        assert np.linalg.eigvalsh(inertia)[0] > 0.0


@pytest.mark.parametrize(
    ("make", "start", "swing"), [(sr400, None, 20.0), (four_bar_arm, np.array([0.3, -1.9, 0.5]), 2.0)]
)
def test_energy_is_conserved_without_friction_and_drives(
    with_truth: Callable[..., RobotFile], make: Callable[[], RobotFile], start: FloatArray | None, swing: float
) -> None:
    robot_file = make()
    none = dict.fromkeys(("viscous", "coulomb", "offset", "pair_viscous", "pair_coulomb"), 0.0)
    truths = robot_file.robot.truth.joints
    robot_file = with_truth(robot_file, joints={name: truth.model_copy(update=none) for name, truth in truths.items()})
    model = build_model(robot_file)
    inertial, rotors, coupling = bodies(robot_file, model)
    arm = pinocchio_model(model, inertial)
    data = arm.createData()
    plant = Plant(robot_file, PlantSettings(controller="none", step=5e-4), position=start)

    def energies() -> tuple[float, float]:
        joints, rates = np.linalg.solve(coupling, np.stack([plant.position, plant.velocity], axis=1)).T
        tree, tree_rates = (values[:, 0] for values in model.tree_velocity(joints[:, None], rates[:, None]))
        kinetic = pin.computeKineticEnergy(arm, data, tree, tree_rates) + 0.5 * rotors @ plant.velocity**2
        return kinetic, pin.computePotentialEnergy(arm, data, tree)

    total, exchanged = sum(energies()), 0.0
    for _ in range(20):
        plant.advance(0.02)
        if start is not None and not -2.4 < plant.position[1] < -0.4:
            break  # it swings out of the range in which the loop is known to close
        kinetic, potential = energies()
        exchanged = max(exchanged, kinetic)
        assert abs(kinetic + potential - total) < 2e-3 * max(exchanged, 1.0)
    assert exchanged > swing
