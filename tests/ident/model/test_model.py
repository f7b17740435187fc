"""Columns, their names and order, and every combination of options."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from each import each

from daq.robot.loader import parse_robot
from drivers.core.errors import RobotFileError
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.dynamics.pinocchio_model import pinocchio_model
from ident.model.kinematics.joints import Joint
from ident.model.parameters import INERTIAL, link_parameters
from ident.model.true_parameters import truth_vector


def test_column_order_is_as_documented(ur_like):
    names = [parameter.name for parameter in build_model(ur_like).parameters]
    assert names[:10] == ["XX1", "XY1", "XZ1", "YY1", "YZ1", "ZZ1", "MX1", "MY1", "MZ1", "M1"]
    assert names[10:12] == ["XX2", "XY2"]
    assert names[60:] == [f"{symbol}{i}" for symbol in ("Ia", "Fv", "Fs", "Fo") for i in range(1, 7)]


@each("flags", list(itertools.product([False, True], repeat=4)))
def test_every_combination_of_joint_columns(ur_like, flags):
    columns = dict(zip(("motor_inertia", "viscous", "coulomb", "offset"), flags, strict=True))
    model = replace(build_model(ur_like), **{name: (flag, not flag) * 3 for name, flag in columns.items()})
    base = base_parameters(model)
    for name, flag in columns.items():
        joints = [i for i in range(6) if (i % 2 == 0) == flag]
        expected = [i for i in joints if not (name == "motor_inertia" and i < 2)]  # Ia1, Ia2 join ZZR1, ZZR2
        assert [j for j, kind in zip(base.joints, base.kinds, strict=True) if kind == name] == expected
    assert sum(kind == "inertial" for kind in base.kinds) == 36


def test_friction_section_decides_the_columns():
    text = """
name: two
model: {mdh: [{joint: a, alpha: 0, d: 0, r: 0}, {joint: b, antecedent: a, alpha: pi/2, d: 0.3, r: 0}]}
joints: [{name: a, position: [-1, 1], velocity: 1}, {name: b, position: [-1, 1], velocity: 1}]
drives: [{joint: b, inertia: false}]
friction: {model: coulomb, offset: false, smoothing: 0.02, joints: {b: {viscous: true, coulomb: false, offset: true}}}
"""
    model = build_model(parse_robot(text, where="two", folder=None))
    assert (model.motor_inertia, model.viscous, model.coulomb, model.offset) == (
        (True, False),
        (False, True),
        (True, False),
        (False, True),
    )
    assert model.smoothing == 0.02


def test_link_parameters_follow_the_parallel_axis_theorem():
    import pinocchio as pin

    inertia = pin.Inertia.Random()
    about_com = inertia.inertia
    six = [about_com[0, 0], about_com[0, 1], about_com[0, 2], about_com[1, 1], about_com[1, 2], about_com[2, 2]]
    ours = dict(zip(INERTIAL, link_parameters(inertia.mass, inertia.lever, six), strict=True))
    theirs = dict(
        zip(("M", "MX", "MY", "MZ", "XX", "XY", "YY", "XZ", "YZ", "ZZ"), inertia.toDynamicParameters(), strict=True)
    )
    assert all(np.isclose(ours[name], theirs[name]) for name in INERTIAL)


def test_truth_needs_a_link_for_every_joint(ur_like):
    with pytest.raises(RobotFileError, match="no true link for"):
        truth_vector(ur_like)


def test_mdh_frames_are_khalil_kleinfinger(random_tree):
    from daq.robot.schema import MdhRow
    from ident.model.kinematics.mdh import mdh_placement

    row = MdhRow(joint="j", gamma=0.3, b=0.1, alpha=0.7, d=0.2, theta0=-0.4, r=0.5)

    def rot(axis: int, angle: float) -> np.ndarray:
        import pinocchio as pin

        return pin.SE3(pin.AngleAxis(angle, np.eye(3)[axis]).toRotationMatrix(), np.zeros(3)).homogeneous

    def trans(axis: int, length: float) -> np.ndarray:
        matrix = np.eye(4)
        matrix[axis, 3] = length
        return matrix

    expected = rot(2, 0.3) @ trans(2, 0.1) @ rot(0, 0.7) @ trans(0, 0.2) @ rot(2, -0.4) @ trans(2, 0.5)
    rotation, translation = mdh_placement(row)
    assert np.allclose(rotation, expected[:3, :3])
    assert np.allclose(translation, expected[:3, 3])


def test_a_tree_of_mdh_rows_branches():
    text = """
name: fork
model:
  mdh:
    - {joint: trunk, alpha: 0, d: 0, r: 0.5}
    - {joint: left, antecedent: trunk, gamma: pi/2, b: 0.1, alpha: pi/2, d: 0.2, r: 0}
    - {joint: right, antecedent: trunk, gamma: -pi/2, alpha: pi/2, d: 0.2, r: 0, type: prismatic}
joints:
  - {name: trunk, position: [-1, 1], velocity: 1}
  - {name: left, position: [-1, 1], velocity: 1}
  - {name: right, position: [-0.1, 0.1], velocity: 1}
"""
    model = build_model(parse_robot(text, where="fork", folder=None))
    assert [joint.parent for joint in model.joints] == [-1, 0, 0]
    assert [joint.prismatic for joint in model.joints] == [False, False, True]


def test_pinocchio_model_keeps_our_order(random_tree):
    model = random_tree(7, dof=5)
    assert list(pinocchio_model(model).names)[1:] == list(model.joint_names)
    assert isinstance(model.joints[0], Joint)
