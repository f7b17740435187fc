"""The reduced system against the explicit one: every column built, filtered by scipy, decimated, masked, stacked."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from each import each
from pinocchio_reference import pinocchio_regressor
from scipy.signal import sosfiltfilt

from ident.linear_algebra.triangular import GRAM_CONDITION_LIMIT
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.regressor import RegressorKernel, regressor
from ident.model.true_parameters import truth_vector
from ident.regression.observation_matrix import estimate_condition, filtered_samples, reduce_segments, stack_reductions
from ident.signals.filters import ZeroPhaseFilter, butterworth, chebyshev_decimation, no_filter
from ident.signals.pipeline import Segment

FILTERS = {
    "none": no_filter(),
    "every third": no_filter(3),
    "butterworth": butterworth(8.0, 100.0),
    "butterworth, every fifth": butterworth(4.0, 100.0, factor=5),
    "chebyshev, every fourth": chebyshev_decimation(4),
}


def explicit(kernel: RegressorKernel, segment: Segment, zero_phase: ZeroPhaseFilter) -> list[np.ndarray]:
    """[W τ] (rows, b + 1) of each joint; nothing of the code under test but the regressor."""
    dense = regressor(kernel.model, segment.position, segment.velocity, segment.acceleration, kernel.columns)

    def treated(rows: np.ndarray) -> np.ndarray:
        filtered = sosfiltfilt(zero_phase.sos.copy(), rows, axis=1) if len(zero_phase.sos) else rows
        return filtered[:, :: zero_phase.factor][:, segment.used[:: zero_phase.factor]]

    return [
        np.column_stack([treated(dense[joint]).T, treated(segment.torque[joint : joint + 1])[0]])
        for joint in range(kernel.model.dof)
    ]


def assert_same_system(reduction, systems: list[np.ndarray]) -> None:
    for joint, system in zip(reduction.joints, systems, strict=True):
        assert joint.rows == len(system)
        wide = np.zeros((len(joint.factor), system.shape[1]))
        wide[:, [*joint.columns, -1]] = joint.factor
        lengths = np.linalg.norm(system, axis=0)
        lengths = np.maximum(lengths, 1e-6 * np.max(lengths))  # a column that is rounding has no digits to agree in
        tolerance = 1e-10 * np.outer(lengths, lengths)
        assert np.all(np.abs(wide.T @ wide - system.T @ system) <= tolerance)


@pytest.fixture(scope="module")
def noisy_segment(three_joint, smooth_segment):
    """Factory of segments with noise on the torque and rests that do not count."""
    model = build_model(three_joint)

    def make(samples: int, seed: int = 0) -> Segment:
        segment = smooth_segment(model, samples, parameters=truth_vector(three_joint), seed=seed)
        generator = np.random.default_rng(seed)
        used = np.ones(samples, dtype=bool)
        used[: samples // 10] = False
        used[samples // 2 : samples // 2 + samples // 8] = False
        return replace(segment, torque=segment.torque + generator.standard_normal(segment.torque.shape), used=used)

    return make


@each("name", FILTERS)
@each("samples", [45, 128, 129, 1500])
def test_reduction_equals_the_explicit_filtered_system(three_joint, noisy_segment, name, samples):
    model = build_model(three_joint)
    kernel = RegressorKernel(model, base_parameters(model).columns, chunk=128)  # below, at and above one chunk
    segment = noisy_segment(samples)
    systems = explicit(kernel, segment, FILTERS[name])
    reduction = reduce_segments(kernel, [segment], FILTERS[name])
    assert_same_system(reduction, systems)
    assert reduction.rows == model.dof * reduction.samples == sum(len(system) for system in systems)


@pytest.mark.parametrize("seed", range(4))
def test_solution_equals_lstsq_on_random_trees(random_tree, smooth_segment, seed):
    model = random_tree(seed, dof=3 + seed)
    kernel = RegressorKernel(model, base_parameters(model).columns)
    segment = smooth_segment(model, 2000, seed=seed)
    segment = replace(segment, torque=np.random.default_rng(seed).standard_normal(segment.torque.shape))
    system = np.vstack(explicit(kernel, segment, FILTERS["butterworth"]))
    count = len(kernel.columns)
    expected = np.linalg.lstsq(system[:, :count], system[:, count], rcond=None)[0]
    stacked = reduce_segments(kernel, [segment], FILTERS["butterworth"]).stacked()
    found = np.linalg.lstsq(stacked[:count, :count], stacked[:count, count], rcond=None)[0]
    assert np.allclose(found, expected, rtol=0, atol=1e-8 * np.max(np.abs(expected)))
    assert abs(stacked[count, count]) == pytest.approx(np.linalg.norm(system @ [*expected, -1.0]), rel=1e-9)


def test_residual_sums_are_those_of_each_joint(three_joint, noisy_segment):
    model = build_model(three_joint)
    kernel = RegressorKernel(model, base_parameters(model).columns)
    segment = noisy_segment(700)
    parameters = np.random.default_rng(3).standard_normal(len(kernel.columns))
    systems = explicit(kernel, segment, FILTERS["butterworth"])
    expected = [float(np.sum((system @ [*parameters, -1.0]) ** 2)) for system in systems]
    sums = reduce_segments(kernel, [segment], FILTERS["butterworth"]).residual_sums(parameters)
    assert np.allclose(sums, expected, rtol=1e-9)


def test_weights_multiply_each_joints_rows(three_joint, noisy_segment):
    model = build_model(three_joint)
    kernel = RegressorKernel(model, base_parameters(model).columns)
    segment = noisy_segment(300)
    weights = np.array([0.5, 2.0, 30.0])
    systems = explicit(kernel, segment, no_filter())
    weighted = np.vstack([weight * system for weight, system in zip(weights, systems, strict=True)])
    stacked = reduce_segments(kernel, [segment], no_filter()).stacked(weights)
    assert np.allclose(stacked.T @ stacked, weighted.T @ weighted, rtol=0, atol=1e-9 * np.max(weighted.T @ weighted))


def test_two_recordings_stack_to_the_system_of_both(three_joint, noisy_segment):
    model = build_model(three_joint)
    kernel = RegressorKernel(model, base_parameters(model).columns)
    first, second = noisy_segment(400, 1), noisy_segment(900, 2)
    zero_phase = FILTERS["butterworth, every fifth"]
    systems = [
        np.vstack(pair)
        for pair in zip(explicit(kernel, first, zero_phase), explicit(kernel, second, zero_phase), strict=True)
    ]
    stacked = stack_reductions([reduce_segments(kernel, [part], zero_phase) for part in (first, second)])
    assert_same_system(stacked, systems)
    assert_same_system(reduce_segments(kernel, [first, second], zero_phase), systems)
    assert stacked.rows == sum(len(system) for system in systems)
    assert stacked.samples == len(systems[0])


def test_nothing_leaks_from_one_segment_into_the_next(three_joint, noisy_segment):
    """A filter that ran across a gap would make the order of the segments count."""
    model = build_model(three_joint)
    kernel = RegressorKernel(model, base_parameters(model).columns)
    first, second = noisy_segment(400, 1), noisy_segment(900, 2)
    one = reduce_segments(kernel, [first, second], FILTERS["butterworth"]).stacked()
    other = reduce_segments(kernel, [second, first], FILTERS["butterworth"]).stacked()
    assert np.allclose(one.T @ one, other.T @ other, rtol=0, atol=1e-10 * np.max(one.T @ one))


def test_joints_and_samples_cannot_be_mixed_up(three_joint, smooth_segment):
    """figaroh stacked the torque sample by sample against a regressor that was joint by joint."""
    model = build_model(three_joint)
    base = base_parameters(model)
    kernel = RegressorKernel(model, base.columns)
    segment = smooth_segment(model, 1500, parameters=truth_vector(three_joint))
    truth = base.projection @ truth_vector(three_joint)

    def residual_share(torque: np.ndarray) -> float:
        reduction = reduce_segments(kernel, [replace(segment, torque=np.ascontiguousarray(torque))], no_filter())
        return float(np.sqrt(reduction.residual_sums(truth).sum()) / np.linalg.norm(torque))

    assert residual_share(segment.torque) < 1e-7  # what the Gram matrix keeps of an exact fit
    assert residual_share(segment.torque[[1, 0, 2]]) > 0.5
    assert residual_share(segment.torque.T.reshape(segment.torque.shape)) > 0.5


def test_torque_of_pinocchio_leaves_no_residual(three_joint, smooth_segment):
    """The truth's torque comes from another implementation than the regressor that is fitted to it."""
    model = build_model(three_joint)
    base = base_parameters(model)
    segment = smooth_segment(model, 60)
    reference = pinocchio_regressor(model, segment.position, segment.velocity, segment.acceleration)
    torque = np.einsum("npN,p->nN", reference, truth_vector(three_joint))
    reduction = reduce_segments(RegressorKernel(model, base.columns), [replace(segment, torque=torque)], no_filter())
    sums = reduction.residual_sums(base.projection @ truth_vector(three_joint))
    assert np.all(np.sqrt(sums) < 1e-7 * np.linalg.norm(torque, axis=1))


def test_several_torques_are_reduced_alike(three_joint, noisy_segment):
    model = build_model(three_joint)
    kernel = RegressorKernel(model, base_parameters(model).columns)
    segment = noisy_segment(500)
    other = np.gradient(segment.torque, axis=1)
    both = reduce_segments(kernel, [segment], FILTERS["butterworth"], [np.vstack([segment.torque, other])])
    assert both.torque_count == 2
    for number, torque in enumerate((segment.torque, other)):
        alone = reduce_segments(kernel, [replace(segment, torque=torque)], FILTERS["butterworth"]).stacked()
        chosen = [*range(both.column_count), both.column_count + number]
        together = both.stacked()[:, chosen]
        assert np.allclose(together.T @ together, alone.T @ alone, rtol=0, atol=1e-9 * np.max(alone.T @ alone))


@each("length", [63, 64, 65, 640])
def test_blocks_hold_every_kept_sample_once(three_joint, noisy_segment, length):
    model = build_model(three_joint)
    kernel = RegressorKernel(model, base_parameters(model).columns, chunk=64)
    segment = noisy_segment(length)
    zero_phase = FILTERS["butterworth, every fifth"]
    used = [block.used.copy() for block in filtered_samples(kernel, segment, zero_phase, segment.torque)]
    assert np.array_equal(np.concatenate(used), segment.used[::5])


@each("samples", [300, 3000])
@each("smallness", [1e-2, 1e-3])
def test_a_badly_conditioned_system_keeps_its_digits(three_joint, smooth_segment, smallness, samples):
    """A slow, small motion hardly tells inertia from gravity: the plain Gram matrix is not used for it."""
    model = build_model(three_joint)
    base = base_parameters(model)
    kernel = RegressorKernel(model, base.columns)
    good = smooth_segment(model, samples, parameters=truth_vector(three_joint))
    bad = replace(
        good,
        position=smallness * good.position,
        velocity=0.1 * smallness * good.velocity,
        acceleration=0.01 * smallness * good.velocity,
    )
    assert estimate_condition(kernel, [good]) < GRAM_CONDITION_LIMIT < estimate_condition(kernel, [bad])
    assert reduce_segments(kernel, [good], no_filter()).method.startswith("Gram matrix")
    reduction = reduce_segments(kernel, [bad], no_filter())
    assert not reduction.method.startswith("Gram matrix")
    systems = explicit(kernel, bad, no_filter())
    assert_same_system(reduction, systems)
    # Columns scaled, the smallest singular value is what the digits are lost from.
    system = np.vstack(systems)[:, : len(kernel.columns)]
    lengths = np.linalg.norm(system, axis=0)
    expected = np.linalg.svd(system / lengths, compute_uv=False)[-1]
    stacked = reduction.stacked()[:, : len(kernel.columns)]
    found = np.linalg.svd(stacked / lengths, compute_uv=False)[-1]
    assert found == pytest.approx(expected, rel=1e-3, abs=1e-14)
