"""A simulated arm with a closed loop and a coupled wrist obeys the model that it is identified with."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from controlled_arm import follow

from daq.robot.loader import RobotFile, load_robot
from daq.robot.loops import coupling_matrix
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


@pytest.fixture(scope="module")
def sr400() -> RobotFile:
    return load_robot("sr400")


def test_forward_dynamics_undo_inverse_dynamics_and_agree_with_the_regressor(sr400: RobotFile) -> None:
    model = build_model(sr400)
    truth = truth_vector(sr400)
    coupling = coupling_matrix(sr400.robot.model.coupling, sr400.robot.joint_names)
    rotors = np.array([sr400.robot.truth.joints[name].motor_inertia for name in model.joint_names])
    arm = rigid_arm(model, truth[:80], rotors)
    without_friction = [i for i, p in enumerate(model.parameters) if p.kind in ("inertial", "motor_inertia")]
    generator = np.random.default_rng(5)
    q, v, a = generator.uniform(-1, 1, (3, 6, 8))
    expected = model_torque(model, without_friction, truth[without_friction], q, v, a)
    for sample in range(8):
        motor = [coupling @ values[:, sample] for values in (q, v, a)]
        torque = arm.inverse(*motor)
        np.testing.assert_allclose(torque, expected[:, sample], rtol=1e-10, atol=1e-8)
        np.testing.assert_allclose(arm.forward(motor[0], motor[1], torque), motor[2], rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(arm.inverse(motor[0], 0 * motor[1], 0 * motor[2]), arm.gravity(motor[0]), atol=1e-9)


def test_energy_is_conserved_without_friction_and_drives(
    sr400: RobotFile, with_truth: Callable[..., RobotFile]
) -> None:
    frictionless = {
        name: joint.model_copy(update={"viscous": 0.0, "coulomb": 0.0, "pair_viscous": 0.0, "pair_coulomb": 0.0})
        for name, joint in sr400.robot.truth.joints.items()
    }
    robot_file = with_truth(sr400, joints=frictionless)
    model = build_model(robot_file)
    arm = pinocchio_model(model, truth_vector(robot_file)[:80])
    data = arm.createData()
    coupling = coupling_matrix(robot_file.robot.model.coupling, robot_file.robot.joint_names)
    rotors = np.array([joint.motor_inertia for joint in frictionless.values()])
    plant = Plant(robot_file, PlantSettings(controller="none", step=5e-4))

    def energies() -> tuple[float, float]:
        joints, rates = np.linalg.solve(coupling, plant.position), np.linalg.solve(coupling, plant.velocity)
        tree, tree_rates = (values[:, 0] for values in model.tree_velocity(joints[:, None], rates[:, None]))
        kinetic = pin.computeKineticEnergy(arm, data, tree, tree_rates) + 0.5 * rotors @ plant.velocity**2
        return kinetic, pin.computePotentialEnergy(arm, data, tree)

    start = sum(energies())
    exchanged = 0.0
    for _ in range(40):
        plant.advance(0.02)
        kinetic, potential = energies()
        exchanged = max(exchanged, kinetic)
        assert abs(kinetic + potential - start) < 2e-3 * max(exchanged, 1.0)
    assert exchanged > 20.0


@pytest.mark.slow
def test_the_truth_is_found_from_twenty_seconds_of_the_controlled_arm(sr400: RobotFile) -> None:
    base = base_parameters(build_model(sr400))
    truth = base.projection @ truth_vector(sr400)
    recordings = [[follow(sr400, seed, seconds, rate=250.0)] for seed, seconds in ((1, 20.0), (2, 4.0))]
    found = identify(*recordings, IdentifyChoices())
    assert found.validation.relative_error < 0.05
    deviations = np.abs(found.solution.parameters - truth) / found.std
    assert np.mean(deviations <= 1.96) >= 0.85, dict(zip(base.names, deviations, strict=True))
    for name in ("ZZR2", "ZZR3", "MXR2", "MYR3", "Fs1", "Fs2", "Fsm6", "Fs6"):
        i = base.names.index(name)
        assert found.std[i] < 0.15 * abs(truth[i]), name
