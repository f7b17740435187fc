"""A simulated arm with a general closed loop obeys the model that it is identified with."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from controlled_arm import follow
from loop_arms import four_bar_arm

from daq.robot.loader import RobotFile, parse_robot
from ident.identify.identification import IdentifyChoices
from ident.identify.identify import identify
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.dynamics.pinocchio_model import pinocchio_model
from ident.model.dynamics.rigid_arm import rigid_arm
from ident.model.regressor import model_torque
from ident.model.true_parameters import truth_vector
from sim_drivers.plant.plant import Plant, PlantSettings

pytestmark = pytest.mark.usefixtures("estimates_alone", "stated_friction")


def coupled() -> RobotFile:
    text = four_bar_arm().text
    return parse_robot(
        text.replace("joints:\n", "  coupling: {wrist: {wrist: 1, crank: 0.5}}\njoints:\n", 1), where="x", folder=None
    )


@pytest.mark.parametrize("make", [four_bar_arm, coupled])
def test_forward_dynamics_undo_inverse_dynamics_and_agree_with_the_regressor(make: Callable[[], RobotFile]) -> None:
    robot_file = make()
    model, truth = build_model(robot_file), truth_vector(robot_file)
    transmission = model.transmission
    rotors = np.array([robot_file.robot.truth.joints[name].motor_inertia for name in model.joint_names])
    arm = rigid_arm(model, truth[:50], rotors)
    without_friction = [i for i, p in enumerate(model.parameters) if p.kind in ("inertial", "motor_inertia")]
    q = np.random.default_rng(5).uniform([[-1], [-2.3], [-1]], [[1], [-0.5], [1]], (3, 8))
    v, a = np.random.default_rng(6).uniform(-2, 2, (2, 3, 8))
    expected = model_torque(model, without_friction, truth[without_friction], q, v, a)
    for sample in range(8):
        motor = [transmission.coupling @ values[:, sample] for values in (q, v, a)]
        torque = arm.inverse(*motor)
        np.testing.assert_allclose(torque, expected[:, sample], rtol=1e-9, atol=1e-8)
        np.testing.assert_allclose(arm.forward(motor[0], motor[1], torque), motor[2], rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(arm.inverse(motor[0], 0 * motor[1], 0 * motor[2]), arm.gravity(motor[0]), atol=1e-9)
        inertia = arm.inertia(motor[0])
        np.testing.assert_allclose(inertia, inertia.T, atol=1e-10)
        assert np.linalg.eigvalsh(inertia)[0] > 0.0


def test_energy_is_conserved_without_friction_and_drives(with_truth: Callable[..., RobotFile]) -> None:
    robot_file = four_bar_arm()
    frictionless = {
        name: joint.model_copy(update={"viscous": 0.0, "coulomb": 0.0, "offset": 0.0})
        for name, joint in robot_file.robot.truth.joints.items()
    }
    robot_file = with_truth(robot_file, joints=frictionless)
    model = build_model(robot_file)
    arm = pinocchio_model(model, truth_vector(robot_file)[:50])
    data = arm.createData()
    rotors = np.array([frictionless[name].motor_inertia for name in model.joint_names])
    plant = Plant(robot_file, PlantSettings(controller="none", step=5e-4), position=np.array([0.3, -1.9, 0.5]))

    def energies() -> tuple[float, float]:
        tree, rates = (v[:, 0] for v in model.tree_velocity(plant.position[:, None], plant.velocity[:, None]))
        kinetic = pin.computeKineticEnergy(arm, data, tree, rates) + 0.5 * rotors @ plant.velocity**2
        return kinetic, pin.computePotentialEnergy(arm, data, tree)

    start = sum(energies())
    exchanged = 0.0
    for _ in range(20):
        plant.advance(0.02)
        if not -2.4 < plant.position[1] < -0.4:
            break  # it swings out of the range in which the loop is known to close
        kinetic, potential = energies()
        exchanged = max(exchanged, kinetic)
        assert abs(kinetic + potential - start) < 2e-3 * max(exchanged, 1.0)
    assert exchanged > 2.0


def test_the_truth_is_found_from_ten_seconds_of_the_controlled_arm() -> None:
    robot_file = four_bar_arm()
    base = base_parameters(build_model(robot_file))
    truth = base.projection @ truth_vector(robot_file)
    recording = follow(robot_file, 1, 10.0, rate=150.0)
    found = identify([recording], [], IdentifyChoices(split=8.5, search_delay=False))
    assert found.validation.relative_error < 0.05
    deviations = np.abs(found.solution.parameters - truth) / found.std
    assert np.mean(deviations <= 1.96) >= 0.85, dict(zip(base.names, deviations, strict=True))
    for name in ("Fv1", "Fv2", "Fv5", "Fs1", "Fs2", "Fs5"):
        i = base.names.index(name)
        assert found.std[i] < 0.15 * abs(truth[i]), name
