"""General closed loops: regressor, its derivatives, energy and inertia against dynamics with constraint forces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from loop_arms import four_bar_arm, spatial_arm, spherical_arm
from pinocchio_reference import pinocchio_regressor
from regressor_differences import check_gradient

from daq.robot.loader import RobotFile, parse_robot
from daq.robot.obstacles import obstacles_of
from ident.assessment.plausibility import inertia_matrices
from ident.model.base_parameters import base_parameters, random_states
from ident.model.dynamic_model import DynamicModel, build_model
from ident.model.dynamics.energy import EnergyKernel, energy_base_parameters
from ident.model.dynamics.pinocchio_model import pinocchio_model
from ident.model.kinematics.linkages.closed_loops import ClosedLoops
from ident.model.kinematics.loops import loop_ends
from ident.model.regressor import model_torque, regressor
from ident.model.true_parameters import truth_vector

pin = pytest.importorskip("pinocchio")

ARMS: tuple[Callable[[], RobotFile], ...] = (four_bar_arm, spatial_arm, spherical_arm)


def coupled_arm() -> RobotFile:
    """The four-bar arm with a wrist motor that the crank turns too."""
    text = four_bar_arm().text
    return parse_robot(
        text.replace("joints:\n", "  coupling: {wrist: {wrist: 1, crank: 0.5}}\njoints:\n", 1), where="x", folder=None
    )


def physical_links(model: DynamicModel, seed: int) -> np.ndarray:
    """Inertial parameters (10·n,) of random bodies."""
    generator = np.random.default_rng(seed)
    links = []
    for _ in model.joints:
        body = pin.Inertia.Random()
        dynamic = body.toDynamicParameters()
        order = ("M", "MX", "MY", "MZ", "XX", "XY", "YY", "XZ", "YZ", "ZZ")
        values = dict(zip(order, dynamic, strict=True))
        links.append([values[s] for s in ("XX", "XY", "XZ", "YY", "YZ", "ZZ", "MX", "MY", "MZ", "M")])
    return np.concatenate(links) * generator.uniform(0.5, 1.5)


def constrained_acceleration(
    robot_file: RobotFile, links: np.ndarray, tree: np.ndarray, rate: np.ndarray, torque: np.ndarray
) -> np.ndarray:
    """Accelerations (n,) of the tree under joint torques (n,) and the forces that hold the closing frames together.

    Tree dynamics and frames are Pinocchio's; Lagrange multipliers keep the two origins' accelerations equal.
    """
    model = build_model(robot_file)
    arm = pinocchio_model(model, links)
    numbers = {name: number for number, name in enumerate(model.link_names)}
    frames = []
    for loop in robot_file.robot.model.loops:
        for number, (rotation, translation) in loop_ends(loop, numbers):
            frame = pin.Frame(f"end{number}", number + 1, pin.SE3(rotation, translation), pin.FrameType.OP_FRAME)
            frames.append(arm.addFrame(frame))
    data = arm.createData()
    bias = pin.rnea(arm, data, tree, rate, np.zeros_like(rate)).copy()
    upper = pin.crba(arm, data, tree)
    mass = np.triu(upper) + np.triu(upper, 1).T
    pin.forwardKinematics(arm, data, tree, rate, np.zeros_like(rate))
    pin.computeJointJacobians(arm, data, tree)
    pin.updateFramePlacements(arm, data)
    axes = pin.LOCAL_WORLD_ALIGNED
    one, other = (pin.getFrameJacobian(arm, data, frame, axes)[:3] for frame in frames)
    still = [pin.getFrameClassicalAcceleration(arm, data, frame, axes).linear for frame in frames]
    together = one - other
    count = len(rate)
    system = np.block([[mass, -together.T], [together, np.zeros((3, 3))]])
    right = np.concatenate([torque - bias, still[1] - still[0]])
    return np.linalg.lstsq(system, right, rcond=1e-11)[0][:count]


@pytest.mark.parametrize("make", ARMS)
def test_torques_are_those_of_the_tree_with_constraint_forces(make: Callable[[], RobotFile]) -> None:
    robot_file = make()
    model = build_model(robot_file)
    links = physical_links(model, 1)
    motion = random_states(model, 12, seed=5)
    tree = model.tree_motion(*motion)
    torque = model_torque(model, range(10 * len(model.joints)), links, *motion)
    for sample in range(motion[0].shape[1]):
        at_joints = np.zeros(len(model.joints))
        at_joints[list(model.active)] = torque[:, sample]
        found = constrained_acceleration(
            robot_file, links, tree.position[:, sample], tree.velocity[:, sample], at_joints
        )
        expected = tree.acceleration[:, sample]
        np.testing.assert_allclose(found, expected, atol=1e-7 * (1.0 + np.abs(expected).max()))


@pytest.mark.parametrize("make", [*ARMS, coupled_arm])
def test_the_kernel_is_pinocchio_s_regressor(make: Callable[[], RobotFile]) -> None:
    model = build_model(make())
    motion = random_states(model, 600, seed=1)
    reference = pinocchio_regressor(model, *motion)
    np.testing.assert_allclose(regressor(model, *motion), reference, atol=1e-9 * np.abs(reference).max())


@pytest.mark.parametrize("make", [*ARMS, coupled_arm])
def test_the_gradient_is_that_of_finite_differences(make: Callable[[], RobotFile]) -> None:
    model = replace(build_model(make()), smoothing=0.1)
    motion = np.array(random_states(model, 6, seed=7)) * 0.9
    check_gradient(model, motion, 2, 1e-7)


@pytest.mark.parametrize("make", ARMS)
def test_the_energy_changes_by_the_motors_power(make: Callable[[], RobotFile]) -> None:
    model = build_model(make())
    columns = [i for i, p in enumerate(model.parameters) if p.kind in ("inertial", "motor_inertia")]
    parameters = np.random.default_rng(3).standard_normal(len(columns))
    position, velocity, acceleration = random_states(model, 20, seed=6)
    position *= 0.9
    torque = model_torque(model, columns, parameters, position, velocity, acceleration)
    power = np.einsum("nN,nN->N", torque, velocity)
    kernel = EnergyKernel(model, columns)
    step = 1e-5
    energies = [
        parameters @ kernel.energy(position + t * velocity + 0.5 * t**2 * acceleration, velocity + t * acceleration)
        for t in (-step, step)
    ]
    np.testing.assert_allclose((energies[1] - energies[0]) / (2 * step), power, atol=1e-6 * np.abs(power).max())


@pytest.mark.parametrize("make", ARMS)
def test_the_energy_tells_as_many_parameters_as_the_torque(make: Callable[[], RobotFile]) -> None:
    model = build_model(make())
    assert energy_base_parameters(model).count == base_parameters(model).count
    assert base_parameters(model).margin > 1e3


def test_the_inertia_matrix_is_the_tree_s_between_the_joints_with_a_motor() -> None:
    robot_file = four_bar_arm()
    model, truth = build_model(robot_file), truth_vector(robot_file)
    assert isinstance(model.transmission, ClosedLoops)
    base = base_parameters(model)
    position = random_states(model, 600)[0]
    matrices = inertia_matrices(model, base, base.projection @ truth, position)
    still = np.zeros_like(position)
    motion = model.tree_motion(position, still, still)
    arm = pinocchio_model(model, truth[: 10 * len(model.joints)])
    data = arm.createData()
    rotors = np.diag([robot_file.robot.truth.joints[name].motor_inertia for name in model.joint_names])
    for sample in range(5):
        upper = pin.crba(arm, data, motion.position[:, sample])
        follow = motion.follow[..., sample]
        expected = follow.T @ (np.triu(upper) + np.triu(upper, 1).T) @ follow + rotors
        np.testing.assert_allclose(matrices[sample], expected, atol=1e-9 * np.abs(expected).max())
        assert np.linalg.eigvalsh(matrices[sample])[0] > 0


def test_an_excitation_s_constraints_know_the_joints_that_follow() -> None:
    from ident.excite.constraints.collision_geometry import arm_geometry
    from ident.excite.constraints.self_collision import SelfCollision, link_pairs
    from ident.excite.constraints.workspace import WorkspaceLimits
    from ident.excite.path import JointPath

    limits = "\nworkspace: {tool: [0, 0, 0.1], radius: [0.05, 1.5], height: [-0.3, 1.6]}\n"
    robot_file = parse_robot(four_bar_arm().text + limits, where="x", folder=None)
    model = build_model(robot_file)
    geometry = arm_geometry(robot_file, model)
    pairs = link_pairs(model, geometry, ())
    position, *rates = (0.9 * values for values in random_states(model, 3, seed=2))
    for constraint in (
        WorkspaceLimits(model, geometry, robot_file.robot.workspace, obstacles_of(robot_file.robot)),
        SelfCollision(model, geometry, pairs),
    ):
        gradient = constraint.smooth_use(JointPath(np.arange(3.0), position, *rates), 20.0)[1]
        for joint in range(model.dof):
            for sample in range(3):
                moved = []
                for step in (1e-6, -1e-6):
                    there = position.copy()
                    there[joint, sample] += step
                    moved.append(constraint.smooth_use(JointPath(np.arange(3.0), there, *rates), 20.0)[0])
                difference = (moved[0] - moved[1]) / 2e-6
                np.testing.assert_allclose(gradient[:, 0, joint, sample], difference, atol=2e-5)
