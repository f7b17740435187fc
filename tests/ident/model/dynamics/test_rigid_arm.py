"""Dynamics of simulated arms do not depend on the order in which a robot file lists its joints."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from loop_arms import four_bar_arm

from daq.robot.loader import RobotFile, load_robot, parse_robot
from daq.robot.schema import JointLimits
from ident.model.dynamic_model import DynamicModel, build_model
from ident.model.dynamics.rigid_arm import RigidArm, rigid_arm
from ident.model.kinematics.joints import Joint
from ident.model.kinematics.transmission import direct_transmission
from ident.model.true_parameters import truth_vector


def agrees_with_inverse_dynamics(arm: RigidArm, position, velocity, acceleration) -> None:
    """The inertia matrix column by column, and forward dynamics, from torques of `inverse` (recursive Newton-Euler)."""
    still = np.zeros_like(position)
    holding = arm.gravity(position)
    columns = [arm.inverse(position, still, unit) - holding for unit in np.eye(len(position))]
    scale = max(1.0, np.abs(columns).max())
    np.testing.assert_allclose(arm.inertia(position), np.transpose(columns), rtol=0, atol=1e-8 * scale)
    torque = arm.inverse(position, velocity, acceleration)
    np.testing.assert_allclose(arm.forward(position, velocity, torque), acceleration, rtol=1e-6, atol=1e-6)


@given(
    parents=st.lists(st.integers(0, 7), min_size=2, max_size=8).map(
        lambda picks: [pick % (joint + 1) - 1 for joint, pick in enumerate(picks)]
    ),
    seed=st.integers(0, 2**32 - 1),
)
def test_random_trees_whose_joints_are_numbered_in_any_order(parents: list[int], seed: int) -> None:
    generator = np.random.default_rng(seed)
    dof = len(parents)
    joints = []
    inertial = []
    for number, parent in enumerate(parents):
        rotation = np.linalg.qr(generator.standard_normal((3, 3)))[0]
        axis = generator.standard_normal(3)
        joints.append(
            Joint(
                name=f"j{number + 1}",
                parent=parent,
                prismatic=bool(generator.random() < 0.3),
                rotation=rotation * np.linalg.det(rotation),
                translation=generator.uniform(-0.5, 0.5, 3),
                axis=axis / np.linalg.norm(axis),
            )
        )
        # A handful of point masses: any such link is physically possible.
        masses, points = generator.uniform(0.2, 2.0, 5), generator.uniform(-0.3, 0.3, (5, 3))
        second = np.einsum("k,ki,kj->ij", masses, points, points)
        tensor = np.trace(second) * np.eye(3) - second
        inertial += [*tensor[np.triu_indices(3)], *(masses @ points), masses.sum()]
    none = (False,) * dof
    model = DynamicModel(
        name="tree",
        joints=tuple(joints),
        limits=tuple(JointLimits(name=joint.name, position=(-3.0, 3.0), velocity=3.0) for joint in joints),
        gravity=generator.uniform(-10, 10, 3),
        motor_inertia=none,
        viscous=none,
        coulomb=none,
        offset=none,
        transmission=direct_transmission(dof),
        smoothing=0.0,
    )
    arm = rigid_arm(model, np.array(inertial), generator.uniform(0.05, 0.5, dof))
    agrees_with_inverse_dynamics(arm, *generator.uniform(-2.0, 2.0, (3, dof)))


def relisted(robot_file: RobotFile, priority: list[int]) -> RobotFile:
    """The same arm with its joints in another order, antecedents first."""
    content = yaml.safe_load(robot_file.text)
    waiting = sorted(content["model"]["mdh"], key=lambda row: priority[content["model"]["mdh"].index(row)])
    before = {row["joint"]: row.get("antecedent", "base") for row in waiting}
    rows: list[dict[str, object]] = []
    while waiting:
        listed = {"base", *(row["joint"] for row in rows)}
        rows.append(next(row for row in waiting if before[row["joint"]] in listed))
        waiting.remove(rows[-1])
    content["model"]["mdh"] = rows
    names = [row["joint"] for row in rows]
    for section in ("joints", "drives"):
        content[section].sort(key=lambda entry: names.index(str(entry.get("name", entry.get("joint")))))
    return parse_robot(yaml.safe_dump(content, sort_keys=False), where="relisted", folder=None)


@pytest.mark.parametrize(
    ("robot_file", "posture"),
    [(load_robot("sr400"), [0.3, -1.6, 0.5, -0.4, 0.7, 3.1]), (four_bar_arm(), [0.3, -1.4, 0.5])],
    ids=["parallelogram", "closing frames"],
)
@settings(max_examples=8)
@given(data=st.data())
def test_arms_with_loops_whose_joints_are_listed_in_any_order(
    robot_file: RobotFile, posture: list[float], data: st.DataObject
) -> None:
    rows = len(yaml.safe_load(robot_file.text)["model"]["mdh"])
    changed = relisted(robot_file, data.draw(st.permutations(range(rows))))
    motion = np.array([posture, *np.random.default_rng(1).uniform(-1.0, 1.0, (2, len(posture)))])
    matrices = []
    for file in (robot_file, changed):
        model, truth = build_model(file), truth_vector(file)
        rotors = np.array([file.robot.truth.joints[name].motor_inertia for name in model.joint_names])
        arm = rigid_arm(model, truth[: 10 * len(model.joints)], rotors)
        columns = [robot_file.robot.joint_names.index(name) for name in model.joint_names]
        agrees_with_inverse_dynamics(arm, *motion[:, columns])
        back = np.argsort(columns)
        matrices.append(arm.inertia(motion[0, columns])[np.ix_(back, back)])
    np.testing.assert_allclose(matrices[1], matrices[0], rtol=1e-8, atol=1e-8)
