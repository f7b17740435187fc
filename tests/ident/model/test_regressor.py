"""The kernel against Pinocchio, and against itself in other chunks and with other columns."""

from __future__ import annotations

import numpy as np
from each import each
from pinocchio_reference import pinocchio_regressor

from ident.model.dynamics.pinocchio_model import pinocchio_model
from ident.model.regressor import RegressorKernel, model_torque, motion_factor, regressor


def motion(dof: int, count: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    generator = np.random.default_rng(seed)
    q, dq, ddq = (generator.uniform(-3, 3, (dof, count)) for _ in range(3))
    return q, dq, ddq


@each("aligned", [False, True])
@each("seed", range(12))
def test_kernel_equals_pinocchio_on_random_trees(random_tree, seed, aligned):
    model = random_tree(seed, dof=1 + seed % 8, aligned=aligned)
    states = motion(model.dof, 40, seed)
    ours = regressor(model, *states)
    theirs = pinocchio_regressor(model, *states)
    assert np.max(np.abs(ours - theirs)) < 1e-10 * np.max(np.abs(theirs))


@each("seed", range(4))
def test_regressor_times_parameters_is_inverse_dynamics(random_tree, seed):
    import pinocchio as pin

    model = random_tree(seed + 100, dof=7)
    generator = np.random.default_rng(seed)
    parameters = generator.standard_normal(len(model.parameters))
    inertial = parameters[: 10 * model.dof]
    q, dq, ddq = motion(model.dof, 600, seed)
    without_drives = np.concatenate([inertial, np.zeros(len(parameters) - len(inertial))])
    torque = model_torque(model, None, without_drives, q, dq, ddq)
    arm = pinocchio_model(model, inertial)
    data = arm.createData()
    for sample in range(0, 600, 60):
        expected = pin.rnea(arm, data, q[:, sample], dq[:, sample], ddq[:, sample])
        assert np.allclose(torque[:, sample], expected, rtol=0, atol=1e-10 * np.max(np.abs(expected)))


@each("seed", range(5))
def test_chosen_columns_are_the_same_columns(random_tree, seed):
    model = random_tree(seed, dof=5)
    q, dq, ddq = motion(5, 900, seed)
    count = len(model.parameters)
    columns = sorted(np.random.default_rng(seed).choice(count, size=count // 2, replace=False).tolist())
    assert np.array_equal(regressor(model, q, dq, ddq, columns), regressor(model, q, dq, ddq)[:, columns])


def test_chunk_length_does_not_matter(random_tree):
    model = random_tree(3, dof=6)
    q, dq, ddq = motion(6, 1000, 0)
    whole = RegressorKernel(model, chunk=1000)
    part = RegressorKernel(model, chunk=64)
    out = np.empty((whole.row_count, 1000))
    whole.evaluate(q, dq, ddq, out)
    for start in range(0, 1000, 64):
        piece = slice(start, min(start + 64, 1000))
        again = np.empty((part.row_count, piece.stop - piece.start))
        part.evaluate(q[:, piece], dq[:, piece], ddq[:, piece], again)
        assert np.array_equal(again, out[:, piece])


def test_packed_rows_hold_all_that_is_not_zero(random_tree):
    model = random_tree(11, dof=6)
    kernel = RegressorKernel(model)
    q, dq, ddq = motion(6, 50, 0)
    reference = pinocchio_regressor(model, q, dq, ddq)
    for joint, rows in enumerate(kernel.joint_rows):
        absent = [column for column in range(len(kernel.columns)) if column not in rows.columns]
        assert not np.any(reference[joint, absent])


def test_motion_factor_has_the_gram_matrix_of_the_stacked_regressor(random_tree):
    model = random_tree(5, dof=4)
    q, dq, ddq = motion(4, 5000, 0)
    factor = motion_factor(RegressorKernel(model), q, dq, ddq)
    stacked = regressor(model, q, dq, ddq)
    gram = np.einsum("npN,nqN->pq", stacked, stacked)
    assert np.allclose(factor.T @ factor, gram, rtol=0, atol=1e-10 * np.max(gram))


def test_coulomb_column_is_sign_or_tanh(random_tree):
    from dataclasses import replace

    model = replace(random_tree(0, dof=2), coulomb=(True, True))
    velocity = np.array([-1.0, -0.01, 0.0, 0.01, 1.0])
    assert np.array_equal(replace(model, smoothing=0.0).coulomb_direction(velocity), [-1, -1, 0, 1, 1])
    assert np.allclose(replace(model, smoothing=0.02).coulomb_direction(velocity), np.tanh(velocity / 0.02))
