"""The overdetermined system Y = W·X + ρ (SR400 eq. 12), reduced while it streams by.

Chunks of samples flow through the regressor kernel and the parallel filter into one triangular factor per joint.
W is never stored: a recording is reduced to, for each joint, R with RᵀR = [W τ]ᵀ[W τ], which is all that least
squares with per-joint weights, subset selection and residual norms need. Factors of several recordings just stack.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from drivers.core.arrays import FloatArray
from ident.linear_algebra.triangular import (
    GRAM_CONDITION_LIMIT,
    PRECONDITIONED_CONDITION_LIMIT,
    Accumulator,
    GramAccumulator,
    PreconditionedGram,
    QrAccumulator,
    scaled_condition,
    triangular,
)
from ident.model.presliding import presliding_states
from ident.model.regressor import RegressorKernel, evaluate_in_chunks, motion_factor
from ident.signals.filters import StreamedFilter, ZeroPhaseFilter
from ident.signals.prepared import Segment

CONDITION_SAMPLES = 1000
"""Samples, spread over the data, that give condition and preconditioner before the first pass."""

KEPT_AT_MOST = 32_000_000
"""Filtered rows [bytes] that a kernel keeps: several passes over the same motion differ in torques and masks alone."""


@dataclass(frozen=True)
class JointFactor:
    """One joint's rows of the system."""

    columns: tuple[int, ...]  # indices of the base columns that are not structurally zero in them
    factor: FloatArray  # (k, len(columns) + m); the last m columns belong to the m torques
    rows: int  # how many rows it replaces


@dataclass(frozen=True)
class Reduction:
    """The whole system, joint by joint."""

    joints: tuple[JointFactor, ...]  # one factor per joint; a single one for the whole arm where its energy is balanced
    column_count: int  # number of base columns b
    torque_count: int  # number of torques m, all reduced alike (1, but for a search of the delay: τ and its derivative)
    samples: int  # number of filtered samples that went in
    method: str  # how the factors were built, in words

    @property
    def rows(self) -> int:
        """Number of rows r of the system."""
        return sum(joint.rows for joint in self.joints)

    def stacked(self, weights: FloatArray | None = None, columns: Sequence[int] | None = None) -> FloatArray:
        """R of [W τ…] over all joints, each joint's rows times its weight (n,) (ones where None).

        Of chosen base columns and the first torque: (b + m, b + m) of all columns and torques where None.
        """
        rows = self._rows if columns is None else self._rows[:, [*columns, self.column_count]]
        if weights is not None:
            rows = rows * np.repeat(weights, [len(joint.factor) for joint in self.joints])[:, None]
        return triangular(rows)

    @cached_property
    def _rows(self) -> FloatArray:
        """All joints' rows (Σ k, b + m), with structural zeros."""
        blocks = []
        for joint in self.joints:
            block = np.zeros((joint.factor.shape[0], self.column_count + self.torque_count))
            width = len(joint.columns)
            block[:, list(joint.columns)] = joint.factor[:, :width]
            block[:, self.column_count :] = joint.factor[:, width:]
            blocks.append(block)
        return np.vstack(blocks)

    @cached_property
    def joint_rows(self) -> FloatArray:
        """Number (n,) of each joint's rows."""
        return np.array([float(joint.rows) for joint in self.joints])

    @cached_property
    def own_columns(self) -> FloatArray:
        """Number (n,) of columns that act on each joint and on no other."""
        seen = Counter(column for joint in self.joints if joint.rows for column in joint.columns)
        return np.array([float(sum(seen[column] == 1 for column in joint.columns)) for joint in self.joints])

    @cached_property
    def torques(self) -> FloatArray:
        """Root mean square (n,) of each joint's first torque [N·m or N]."""
        lengths = [np.linalg.norm(joint.factor[:, len(joint.columns)]) for joint in self.joints]
        return np.array(lengths) / np.sqrt(np.maximum(self.joint_rows, 1.0))

    def residual_sums(self, parameters: FloatArray) -> FloatArray:
        """Sum of squared residuals (n,) of the first torque, joint by joint, for base parameters (b,)."""
        sums = []
        for joint in self.joints:
            width = len(joint.columns)
            rest = joint.factor[:, :width] @ parameters[list(joint.columns)] - joint.factor[:, width]
            sums.append(float(rest @ rest))
        return np.array(sums)


def only_torques(reduction: Reduction, joints: Sequence[int]) -> Reduction:
    """The system without the rows of all but some joints, which keep their index."""
    return replace(
        reduction,
        joints=tuple(
            joint if joint_index in joints else JointFactor(joint.columns, joint.factor[:0], 0)
            for joint_index, joint in enumerate(reduction.joints)
        ),
    )


def stack_reductions(reductions: Sequence[Reduction]) -> Reduction:
    """One system from several recordings of the same arm with the same columns."""
    first = reductions[0]
    joints = []
    for joint_index, joint in enumerate(first.joints):
        same_joint = [reduction.joints[joint_index] for reduction in reductions]
        joints.append(
            JointFactor(
                joint.columns,
                triangular(np.vstack([entry.factor for entry in same_joint])),
                sum(entry.rows for entry in same_joint),
            )
        )
    return Reduction(
        joints=tuple(joints),
        column_count=first.column_count,
        torque_count=first.torque_count,
        samples=sum(reduction.samples for reduction in reductions),
        method=", ".join(dict.fromkeys(reduction.method for reduction in reductions)),
    )


@dataclass(frozen=True)
class FilteredSamples:
    """Consecutive filtered samples."""

    # (kernel.row_count, m) packed rows; samples at rest are there, see `used`. 0 at velocity reversals.
    regressor: FloatArray
    torque: FloatArray  # as `torques`, filtered; 0 at velocity reversals
    used: npt.NDArray[np.bool_]  # (m,) whether the sample takes part
    # (n, m) motors near a velocity reversal, whose equation takes no part; None where all do
    reversing: npt.NDArray[np.bool_] | None

    def counts(self, motor: int) -> npt.NDArray[np.bool_]:
        """(m,) whether a motor's equation takes part."""
        return self.used if self.reversing is None else self.used & ~self.reversing[motor]


def filtered_samples(
    kernel: RegressorKernel, segment: Segment, parallel_filter: ZeroPhaseFilter, torques: FloatArray
) -> Iterator[FilteredSamples]:
    """Stream one segment through kernel and parallel filter (SR400 .4.3 point 4).

    Args:
        kernel: gives the regressor's packed rows.
        segment: motion on a uniform grid.
        parallel_filter: applied to τ and to every column of W alike.
        torques: (m·n, N).

    Yields:
        Samples whose arrays are not to be written to.
    """
    every = slice(None, None, parallel_filter.factor)
    used, reversing = segment.used[every], None if segment.reversing is None else segment.reversing[:, every]

    def samples(regressor: FloatArray, torque: FloatArray, chunk: slice) -> FilteredSamples:
        if reversing is None:
            return FilteredSamples(regressor, torque, used[chunk], None)
        regressor, torque = regressor.copy(), torque.copy()
        for motor, left_out in enumerate(reversing[:, chunk]):
            regressor[kernel.joint_rows[motor].rows, left_out] = 0.0
            torque[motor :: kernel.model.dof, left_out] = 0.0
        return FilteredSamples(regressor, torque, used[chunk], reversing[:, chunk])

    chunks = (torques[:, start : start + kernel.chunk] for start in range(0, torques.shape[1], kernel.chunk))
    filtered_torques = _streamed(parallel_filter, len(torques), chunks)
    position = 0
    for regressor, torque in zip(_filtered_rows(kernel, segment, parallel_filter), filtered_torques, strict=True):
        if width := regressor.shape[1]:
            yield samples(regressor, torque, slice(position, position + width))
            position += width


def _filtered_rows(kernel: RegressorKernel, segment: Segment, parallel_filter: ZeroPhaseFilter) -> Iterator[FloatArray]:
    """A segment's packed rows (kernel.row_count, m), filtered, chunk by chunk; the kernel keeps them for the next pass.

    They do not depend on which samples or equations take part.
    """
    motion = (segment.position, segment.velocity, segment.acceleration)
    key = (*motion, segment.temperature, parallel_filter)
    for kept, chunks in kernel.filtered:
        if all(one is other for one, other in zip(kept, key, strict=True)):
            yield from chunks
            return
    states = presliding_states(kernel.model, segment.velocity, segment.rate)
    packed = (rows for _, rows in evaluate_in_chunks(kernel, *motion, segment.temperature, states))
    chunks, samples = [], segment.position.shape[1] / parallel_filter.factor
    keep = 8 * kernel.row_count * samples <= KEPT_AT_MOST
    for rows in _streamed(parallel_filter, kernel.row_count, packed):
        rows.setflags(write=False)
        if keep:
            chunks.append(rows)
        yield rows
    if keep:
        kernel.filtered.append((key, chunks))
        while sum(rows.nbytes for _, kept_chunks in kernel.filtered for rows in kept_chunks) > KEPT_AT_MOST:
            kernel.filtered.pop(0)


def _streamed(parallel_filter: ZeroPhaseFilter, rows: int, chunks: Iterable[FloatArray]) -> Iterator[FloatArray]:
    """Filter signals (rows, m) that come in chunks; the chunks of the output may be empty."""
    streamed = StreamedFilter(parallel_filter, rows)
    for chunk in chunks:
        yield streamed.push(chunk)
    yield streamed.finish()


def reduce_segments(
    kernel: RegressorKernel,
    segments: Sequence[Segment],
    parallel_filter: ZeroPhaseFilter,
    torques: Sequence[FloatArray] | None = None,
) -> Reduction:
    """Reduce a recording to one triangular factor per joint.

    Args:
        kernel: for the base columns.
        segments: motion and torque on uniform grids.
        parallel_filter: for τ and W.
        torques: for each segment, torques (m·n, N), all joints of the first one first; the segment's own where None.
    """
    torques = [segment.torque for segment in segments] if torques is None else torques
    variants = torques[0].shape[0] // kernel.model.dof if torques else 1
    condition = estimate_condition(kernel, segments)
    name, accumulators = _accumulators(kernel, segments, torques, condition)
    samples = _accumulate(kernel, segments, parallel_filter, torques, accumulators)
    if any(isinstance(joint, PreconditionedGram) and not joint.sound for joint in accumulators):
        name, accumulators = _accumulators(kernel, segments, torques, float("inf"))
        samples = _accumulate(kernel, segments, parallel_filter, torques, accumulators)
    return Reduction(
        joints=tuple(
            JointFactor(rows.columns, accumulator.factor(), accumulator.rows)
            for rows, accumulator in zip(kernel.joint_rows, accumulators, strict=True)
        ),
        column_count=len(kernel.columns),
        torque_count=variants,
        samples=samples,
        method=f"{name} (estimated condition {condition:.2g})",
    )


def _accumulate(
    kernel: RegressorKernel,
    segments: Sequence[Segment],
    parallel_filter: ZeroPhaseFilter,
    torques: Sequence[FloatArray],
    accumulators: Sequence[Accumulator],
) -> int:
    """Hand each joint's rows of [W τ…] to its accumulator; the number of samples that took part."""
    samples = 0
    for segment, torque in zip(segments, torques, strict=True):
        for filtered in filtered_samples(kernel, segment, parallel_filter, torque):
            samples += int(filtered.used.sum())
            for joint, accumulator in enumerate(accumulators):
                rows = _joint_rows(kernel, joint, filtered.regressor, filtered.torque)
                counts = filtered.counts(joint)
                accumulator.add(rows if counts.all() else rows[:, counts])
    return samples


def _joint_rows(kernel: RegressorKernel, joint: int, packed: FloatArray, torque: FloatArray) -> FloatArray:
    """(k + m, samples) one joint's non-zero columns of W, then its torques."""
    return np.concatenate([packed[kernel.joint_rows[joint].rows], torque[joint :: kernel.model.dof]])


def _accumulators(
    kernel: RegressorKernel, segments: Sequence[Segment], torques: Sequence[FloatArray], condition: float
) -> tuple[str, list[Accumulator]]:
    """The fastest way that keeps the digits at this condition, in words, and one accumulator per joint."""
    variants = torques[0].shape[0] // kernel.model.dof if torques else 1
    widths = [len(joint.columns) + variants for joint in kernel.joint_rows]
    if condition <= GRAM_CONDITION_LIMIT:
        return "Gram matrix", [GramAccumulator(width) for width in widths]
    sampled = [QrAccumulator(width) for width in widths]
    if condition > PRECONDITIONED_CONDITION_LIMIT or _sample_count(segments) < CONDITION_SAMPLES:
        return "QR of stacked blocks", [*sampled]
    torque = np.concatenate([torque[:, :: _stride(segments)] for torque in torques], axis=1)
    for chunk, packed in evaluate_in_chunks(kernel, *_spread_motion(segments)):
        for joint, accumulator in enumerate(sampled):
            accumulator.add(_joint_rows(kernel, joint, packed, torque[:, chunk]))
    return "preconditioned Gram matrix", [PreconditionedGram(chunk.factor(), chunk.rows) for chunk in sampled]


def estimate_condition(kernel: RegressorKernel, segments: Sequence[Segment]) -> float:
    """Condition number of the scaled columns at samples spread over the segments, before any filtering."""
    return scaled_condition(motion_factor(kernel, *_spread_motion(segments)))


def _sample_count(segments: Sequence[Segment]) -> int:
    return sum(segment.position.shape[1] for segment in segments)


def _stride(segments: Sequence[Segment]) -> int:
    return max(1, _sample_count(segments) // CONDITION_SAMPLES)


def _spread_motion(segments: Sequence[Segment]) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray | None]:
    """Position, velocity, acceleration, and temperature where all segments have one (n, about CONDITION_SAMPLES)."""

    def spread(rows: Sequence[FloatArray]) -> FloatArray:
        return np.concatenate([values[:, :: _stride(segments)] for values in rows], axis=1)

    temperatures = [segment.temperature for segment in segments if segment.temperature is not None]
    return (
        spread([segment.position for segment in segments]),
        spread([segment.velocity for segment in segments]),
        spread([segment.acceleration for segment in segments]),
        spread(temperatures) if len(temperatures) == len(segments) else None,
    )
