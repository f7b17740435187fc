"""Base parameters as properties: they carry the torque, cannot be fewer, and do not depend on chance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from each import each
from scipy.spatial.transform import Rotation

from daq.robot.loader import load_robot
from ident.model.base_parameters import base_parameters, random_states
from ident.model.dynamic_model import build_model
from ident.model.kinematics.transmission import direct_transmission
from ident.model.regressor import regressor


@each("seed", range(8))
def test_base_columns_carry_the_torque_of_any_parameters(random_tree, seed):
    model = random_tree(seed, dof=2 + seed % 5, aligned=seed % 2 == 0)
    base = base_parameters(model)
    parameters = np.random.default_rng(seed).standard_normal(len(model.parameters))
    states = random_states(model, 600, seed=99 + seed)
    full = regressor(model, *states)
    torque = np.einsum("npN,p->nN", full, parameters)
    carried = np.einsum("nbN,b->nN", full[:, base.columns], base.projection @ parameters)
    assert np.allclose(carried, torque, rtol=0, atol=1e-8 * np.max(np.abs(torque)))


@each("seed", range(8))
def test_count_is_the_numerical_rank_at_other_states(random_tree, seed):
    model = random_tree(seed + 50, dof=2 + seed % 5)
    stacked = np.concatenate(list(regressor(model, *random_states(model, 800, seed=7)).transpose(0, 2, 1)))
    lengths = np.linalg.norm(stacked, axis=0)
    scaled = stacked[:, lengths > 0] / lengths[lengths > 0]
    assert base_parameters(model).count == np.linalg.matrix_rank(scaled, tol=1e-7 * np.linalg.norm(scaled, 2))


def test_no_effect_parameters_have_zero_columns(ur_like):
    model = build_model(ur_like)
    base = base_parameters(model)
    names = [parameter.name for parameter in model.parameters]
    silent = [names.index(name) for name in base.no_effect]
    assert not np.any(np.abs(regressor(model, *random_states(model, 600))[:, silent]) > 1e-9)
    assert {"XX1", "M1", "MZ2"} <= set(base.no_effect)


def test_expressions_say_what_the_projection_does(ur_like):
    model = build_model(ur_like)
    base = base_parameters(model)
    names = {parameter.name: i for i, parameter in enumerate(model.parameters)}
    for expression, row in zip(base.expressions, base.projection, strict=True):
        rebuilt = np.zeros(len(names))
        sign = 1.0
        for word in expression.split():
            if word in "+-":
                sign = 1.0 if word == "+" else -1.0
                continue
            factor, _, name = word.rpartition("·")
            rebuilt[names[name]] = sign * float(factor or 1)
        assert np.allclose(rebuilt, row, rtol=1e-3, atol=1e-9)


def test_choice_reads_like_the_papers(ur_like):
    base = base_parameters(build_model(ur_like))
    assert {"ZZR1", "XXR2", "XY2", "ZZR2", "MXR2", "MY2", "XX6", "ZZ6", "MX6"} - {"XX6"} <= set(base.names)
    assert not any(name.startswith(("YY", "MZ", "MR")) for name in base.names)
    assert base.margin > 1e6


@each(("name", "inertial"), [("aubo_i5", 36), ("rocr6", 36), ("ur5e", 36), ("ur10e", 36), ("ur10", 36), ("panda", 43)])
def test_inertial_counts_of_the_built_in_arms(name, inertial):
    from dataclasses import replace

    model = build_model(load_robot(name))
    base = base_parameters(replace(model, motor_inertia=(False,) * model.dof))
    assert sum(kind == "inertial" for kind in base.kinds) == inertial
    assert base.margin > 1e4


def test_first_three_joints_of_rocr6_have_fifteen():
    from dataclasses import replace

    model = build_model(load_robot("rocr6"))
    off = (False, False, False)
    three = replace(
        model,
        joints=model.joints[:3],
        limits=model.limits[:3],
        transmission=direct_transmission(3),
        motor_inertia=off,
        viscous=off,
        coulomb=off,
        offset=off,
    )
    assert base_parameters(three).count == 15


@each("size", [1e-6, 5e-5, 3e-4])
def test_the_rounded_angles_of_a_urdf_do_not_end_in_an_error(ur_like, size):
    exact = build_model(ur_like)
    turns = Rotation.from_rotvec(size * np.random.default_rng(3).standard_normal((len(exact.joints), 3))).as_matrix()
    joints = tuple(
        replace(joint, rotation=turn @ joint.rotation) for joint, turn in zip(exact.joints, turns, strict=True)
    )
    model = replace(exact, joints=joints)
    base = base_parameters(model)
    parameters = np.random.default_rng(4).standard_normal(len(model.parameters))
    full = regressor(model, *random_states(model, 100))
    torque = np.einsum("npN,p->nN", full, parameters)
    carried = np.einsum("nbN,b->nN", full[:, base.columns], base.projection @ parameters)
    assert np.allclose(carried, torque, rtol=0, atol=1e-5 * np.max(np.abs(torque)))
