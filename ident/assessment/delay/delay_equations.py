"""The equations that a search for the torque's delay solves, summed up block by block.

With τ and its derivative at a delay d, τ(t + δ) = τ(t + d) + (δ − d)·τ̇(t + d) to first order: beside the base
parameters, corrections of the delays are linear unknowns. Of each joint and each block of consecutive samples the Gram
matrix of [W τ…] is kept, so that estimates without a block, and errors on it, cost no further pass over the data.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from drivers.core.arrays import FloatArray, IntArray
from ident.model.regressor import RegressorKernel
from ident.regression.jackknife import BlockRows, rows_by_block
from ident.regression.least_squares import LEAST_TORQUE, RESIDUAL_FLOOR
from ident.regression.velocity_reversals import STICKING_SHARE, reversal_mask
from ident.signals.filters import ZeroPhaseFilter
from ident.signals.prepared import Segment
from ident.signals.repetition import motion_phases
from ident.signals.resampling import shift_torque

BLOCKS = 20
FEWEST_BLOCKS = 5
LEAST_SAMPLES = 4
"""Samples of a block after the parallel filter."""

RECORDED, SHIFTED, SLOPE, DRIFTING, CURVATURE = range(5)
"""Torques of every equation: as recorded, at the delay d, its derivative there, this times the time, and the second
derivative."""

KEPT_AT_MOST = 128e6
"""Bytes of filtered regressor rows that are kept from one delay to the next; more are computed each time."""

_TORQUES = 5
_INDEPENDENT = 1e-10
_CLEARLY = 1e2
"""Times `_INDEPENDENT` from which on no eigenvalue needs to be looked at one by one."""

_WEIGHT_STEPS = 5
_CONVEX = 1e-3


@dataclass(frozen=True, eq=False)
class DelayEquations:
    """Gram matrices of [W_j τ…] at given delays; w_j is the number of joint j's structurally non-zero base columns."""

    delays: FloatArray  # (n,) d [s]
    columns: tuple[tuple[int, ...], ...]  # of each joint, the base columns in its equations
    column_count: int  # number of base columns b
    every: tuple[FloatArray, ...]  # of each joint (B, w_j + 5, w_j + 5), over all equations of each block
    sliding: tuple[FloatArray, ...]  # the same without the equations that a velocity reversal affects
    # every_rows, sliding_rows: (B, n) number of equations
    every_rows: FloatArray
    sliding_rows: FloatArray

    @property
    def blocks(self) -> int:
        """B."""
        return len(self.every_rows)

    @cached_property
    def every_total(self) -> tuple[FloatArray, ...]:
        """The sum over the blocks of `every` (w_j + 5, w_j + 5), of each joint."""
        return tuple(gram.sum(axis=0) for gram in self.every)

    @cached_property
    def sliding_total(self) -> tuple[FloatArray, ...]:
        """The same of `sliding`."""
        return tuple(gram.sum(axis=0) for gram in self.sliding)


@dataclass(frozen=True, eq=False)
class DelayFit:
    """A solution on the sliding equations."""

    delays: FloatArray  # (n,) [s]
    drift: float  # growth of the delay with time [s/s]; 0 where it was not estimated
    weights: FloatArray  # (n,) one over each joint's residual [1/(N·m)]; 0 for joints that are left out


def contiguous_blocks(
    segments: Sequence[Segment], parallel_filter: ZeroPhaseFilter
) -> tuple[tuple[IntArray, ...], int]:
    """Number (M,) of each filtered sample's block, and how many there are; repetitions of a motion share blocks."""
    phases = motion_phases([segment.velocity[:, :: parallel_filter.factor] for segment in segments])
    used = [phase[segment.used[:: parallel_filter.factor]] for phase, segment in zip(phases, segments, strict=True)]
    different = np.unique(np.concatenate(used))
    count = max(1, min(BLOCKS, len(different) // LEAST_SAMPLES))
    blocks = [np.searchsorted(different, phase) * count // max(1, len(different)) for phase in phases]
    return tuple(np.minimum(block, count - 1) for block in blocks), count


@dataclass(frozen=True, eq=False)
class DelayData:
    """What no delay changes."""

    kernel: RegressorKernel  # of the base columns
    segments: Sequence[Segment]  # motion and torque, prepared with delay 0
    parallel_filter: ZeroPhaseFilter  # for τ and W
    seen: npt.NDArray[np.bool_]  # (n,) joints whose equations count
    blocks: tuple[tuple[IntArray, ...], int]  # as of `contiguous_blocks`

    @property
    def count(self) -> int:
        """Number of blocks."""
        return self.blocks[1]

    @cached_property
    def slides(self) -> tuple[npt.NDArray[np.bool_], ...]:
        """Equations (n, M) of each segment that no velocity reversal affects."""
        return tuple(~_reversing(self.kernel, segment, self.parallel_filter) for segment in self.segments)

    def rows(self) -> Iterable[Iterable[BlockRows]]:
        """Filtered regressor rows of each segment, without torques."""
        samples = sum(len(segment.time) for segment in self.segments) // self.parallel_filter.factor
        return self._kept if 8 * self.kernel.row_count * samples <= KEPT_AT_MOST else self._streamed()

    @cached_property
    def _kept(self) -> list[list[BlockRows]]:
        return [list(rows) for rows in self._streamed()]

    def _streamed(self) -> Iterator[Iterator[BlockRows]]:
        for segment, blocks in zip(self.segments, self.blocks[0], strict=True):
            yield rows_by_block(self.kernel, replace(segment, reversing=None), self.parallel_filter, blocks)


def delay_equations(data: DelayData, delays: FloatArray) -> DelayEquations:
    """Sum up the equations with the joints' torques at delays (n,) [s]."""
    kernel, segments, count = data.kernel, data.segments, data.count
    dof = kernel.model.dof
    widths = [len(joint.columns) + _TORQUES for joint in kernel.joint_rows]
    every = tuple(np.zeros((count, width, width)) for width in widths)
    sliding = tuple(np.zeros((count, width, width)) for width in widths)
    every_rows, sliding_rows = np.zeros((count, dof)), np.zeros((count, dof))
    middle = 0.5 * (segments[0].time[0] + segments[-1].time[-1])
    for segment, slides, blocks in zip(segments, data.slides, data.rows(), strict=True):
        torques = data.parallel_filter.apply(_torques(segment, delays, middle))
        for block in blocks:
            torque = torques[:, block.samples]
            for joint in np.flatnonzero(data.seen):
                packed = kernel.joint_rows[joint]
                rows = np.concatenate([block.regressor[packed.rows], torque[joint::dof]])
                kept = rows[:, slides[joint, block.samples]]
                every[joint][block.index] += rows @ rows.T
                sliding[joint][block.index] += kept @ kept.T
                every_rows[block.index, joint] += rows.shape[1]
                sliding_rows[block.index, joint] += kept.shape[1]
    columns = tuple(tuple(joint.columns) for joint in kernel.joint_rows)
    return DelayEquations(delays, columns, len(kernel.columns), every, sliding, every_rows, sliding_rows)


def _torques(segment: Segment, delays: FloatArray, middle: float) -> FloatArray:
    shifted = np.vstack(
        [shift_torque(row[None], segment.rate, delay) for row, delay in zip(segment.torque, delays, strict=True)]
    )
    slope = np.gradient(shifted, 1.0 / segment.rate, axis=1)
    curvature = np.gradient(slope, 1.0 / segment.rate, axis=1)
    return np.vstack([segment.torque, shifted, slope, (segment.time - middle) * slope, curvature])


def _reversing(kernel: RegressorKernel, segment: Segment, parallel_filter: ZeroPhaseFilter) -> npt.NDArray[np.bool_]:
    """(n, M) equations near a velocity reversal, and those into which the parallel filter carries it.

    It does for about one period of its cut-off: with half a period, simulated joints that stick still bias the delay.
    """
    reach = _cutoff_period(parallel_filter)
    mask = reversal_mask(kernel, segment, STICKING_SHARE)
    reversals = np.cumsum(np.pad(mask.astype(np.int64), ((0, 0), (reach + 1, reach))), axis=1)
    near = reversals[:, 2 * reach + 1 :] - reversals[:, : -2 * reach - 1]
    return np.asarray(near[:, :: parallel_filter.factor] > 0)


def _cutoff_period(parallel_filter: ZeroPhaseFilter) -> int:
    """Samples in a period of the frequency at which the filter's gain is one half; 0 without a filter."""
    if len(parallel_filter.sos) == 0:
        return 0
    cycles = np.geomspace(1e-6, 0.5, 2000)  # a sample
    passed = np.flatnonzero(parallel_filter.gain(cycles) >= 0.5 * parallel_filter.gain_at_rest())
    return int(np.ceil(1.0 / cycles[passed[-1]]))


def fit_delays(
    equations: DelayEquations,
    groups: Sequence[int | None],
    *,
    without: int | None = None,
    weights: FloatArray | None = None,
    drift: bool = False,
) -> DelayFit:
    """Base parameters and delays by weighted least squares on the sliding equations.

    Args:
        equations: at delays near the solution.
        groups: of each joint, the index of the delay that it shares with others; None keeps the equations' delay.
        without: a block that is left out.
        weights: (n,) of the joints' equations; iterated from equal relative ones where None. 0 leaves a joint out.
        drift: whether a drift that all joints share is estimated, too.
    """
    grams = _without(equations.sliding_total, equations.sliding, without)
    rows = equations.sliding_rows.sum(axis=0)
    iterated = weights is None
    if weights is None:
        weights = _weights(grams, rows, SHIFTED)
    shared = sorted({group for group in groups if group is not None})
    base, count = equations.column_count, len(shared) + drift
    design = []
    for columns, group in zip(equations.columns, groups, strict=True):
        # The residual, as a combination of the rows of [W_j τ…]: τ(d) − matrix @ unknowns.
        matrix = np.zeros((len(columns) + _TORQUES, base + count))
        matrix[range(len(columns)), list(columns)] = 1.0
        if group is not None:
            matrix[SLOPE - _TORQUES, base + shared.index(group)] = -1.0
        if drift:
            matrix[DRIFTING - _TORQUES, -1] = -1.0
        design.append(matrix)
    projected = [matrix.T @ gram for matrix, gram in zip(design, grams, strict=True)]
    normals = np.stack([part @ matrix for part, matrix in zip(projected, design, strict=True)])
    right_sides = np.stack([part[:, SHIFTED - _TORQUES] for part in projected])
    curvature = np.zeros((count, count))
    solution = np.zeros(base + count)
    for _ in range(_WEIGHT_STEPS if iterated else 2):
        squares = weights**2
        solution = _newton_step(np.tensordot(squares, normals, 1), squares @ right_sides, curvature)
        residuals = [_unit(gram, SHIFTED) - matrix @ solution for gram, matrix in zip(grams, design, strict=True)]
        if iterated:
            sums = np.array([_square(gram, residual) for gram, residual in zip(grams, residuals, strict=True)])
            weights = _inverse_deviation(sums, grams, rows, weights > 0)
        curvature = np.zeros((count, count))
        for group, gram, residual, weight in zip(groups, grams, residuals, weights, strict=True):
            if group is not None:
                index = shared.index(group)
                curvature[index, index] += weight**2 * float(residual @ gram[:, CURVATURE - _TORQUES])
    changes = [0.0 if group is None else float(solution[base + shared.index(group)]) for group in groups]
    return DelayFit(equations.delays + np.array(changes), float(solution[-1]) if drift else 0.0, weights)


def _newton_step(normal: FloatArray, right: FloatArray, curvature: FloatArray) -> FloatArray:
    """Least squares whose last unknowns, the delays, have this second-order term; without it where it is not convex.

    The term removes the torque's noise from the slope's square: with the square alone, steps and intervals are too
    small where the parallel filter passes much noise.
    """
    base = len(normal) - len(curvature)
    inverse = _inverse(normal[:base, :base])
    across = normal[:base, base:]
    first = normal[base:, base:] - across.T @ inverse @ across
    scale = _positive(np.sqrt(np.maximum(np.diag(first), 0.0)))
    second = first + curvature
    convex = float(np.linalg.eigvalsh(second / np.outer(scale, scale))[0]) > _CONVEX if len(curvature) else True
    delays = _inverse(second if convex else first) @ (right[base:] - across.T @ inverse @ right[:base])
    return np.concatenate([inverse @ (right[:base] - across @ delays), delays])


def held_out_errors(equations: DelayEquations, delays: FloatArray | None, weights: FloatArray) -> FloatArray:
    """Weighted sum of squared errors (B,) over all equations of each block, parameters from the other blocks.

    Args:
        equations: at delays near `delays`.
        delays: (B, n) [s], found without each block; None compares the torque as recorded.
        weights: (n,) of the joints' equations.
    """
    errors = []
    for block in range(equations.blocks):
        grams = _without(equations.every_total, equations.every, block)
        combined = [
            _unit(gram, RECORDED)
            if delays is None
            else _unit(gram, SHIFTED) + (delays[block, joint] - equations.delays[joint]) * _unit(gram, SLOPE)
            for joint, gram in enumerate(grams)
        ]
        parameters = _parameters(equations, grams, combined, weights)
        error = 0.0
        for joint, torque in enumerate(combined):
            rest = torque.copy()
            rest[: len(equations.columns[joint])] -= parameters[list(equations.columns[joint])]
            error += weights[joint] ** 2 * _square(equations.every[joint][block], rest)
        errors.append(error)
    return np.array(errors)


def recorded_weights(equations: DelayEquations, used: npt.NDArray[np.bool_]) -> FloatArray:
    """(n,) one over each joint's residual over all equations, torque as recorded; 0 for joints not `used` (n,)."""
    grams = equations.every_total
    rows = equations.every_rows.sum(axis=0)
    weights = np.where(used, _weights(grams, rows, RECORDED), 0.0)
    recorded = [_unit(gram, RECORDED) for gram in grams]
    for _ in range(_WEIGHT_STEPS):
        parameters = _parameters(equations, grams, recorded, weights)
        sums = []
        for gram, torque, columns in zip(grams, recorded, equations.columns, strict=True):
            rest = torque.copy()
            rest[: len(columns)] -= parameters[list(columns)]
            sums.append(_square(gram, rest))
        weights = _inverse_deviation(np.array(sums), grams, rows, used)
    return weights


def torque_slopes(equations: DelayEquations) -> FloatArray:
    """(n,) sum of τ̇² over the sliding equations; 0 where a joint's torque shows no delay."""
    return np.array([_square(gram, _unit(gram, SLOPE)) for gram in equations.sliding_total])


def _parameters(
    equations: DelayEquations, grams: Sequence[FloatArray], torques: Sequence[FloatArray], weights: FloatArray
) -> FloatArray:
    """Base parameters (b,) by weighted least squares; `torques` are combinations of the rows of each [W_j τ…]."""
    normal = np.zeros((equations.column_count, equations.column_count))
    right = np.zeros(equations.column_count)
    for gram, torque, columns, weight in zip(grams, torques, equations.columns, weights, strict=True):
        chosen, width = list(columns), len(columns)
        normal[np.ix_(chosen, chosen)] += weight**2 * gram[:width, :width]
        right[chosen] += weight**2 * gram[:width] @ torque
    return np.asarray(_inverse(normal) @ right)


def _without(
    totals: tuple[FloatArray, ...], grams: tuple[FloatArray, ...], block: int | None
) -> tuple[FloatArray, ...]:
    if block is None:
        return totals
    return tuple(total - gram[block] for total, gram in zip(totals, grams, strict=True))


def _unit(gram: FloatArray, torque: int) -> FloatArray:
    """The combination of the rows of [W_j τ…] that is one of its torques."""
    unit = np.zeros(len(gram))
    unit[torque - _TORQUES] = 1.0
    return unit


def _square(gram: FloatArray, combination: FloatArray) -> float:
    return max(0.0, float(combination @ gram @ combination))


def _weights(grams: Sequence[FloatArray], rows: FloatArray, torque: int) -> FloatArray:
    sums = np.array([_square(gram, _unit(gram, torque)) for gram in grams])
    return _inverse_deviation(sums, grams, rows, np.ones(len(rows), dtype=np.bool_))


def _inverse_deviation(
    sums: FloatArray, grams: Sequence[FloatArray], rows: FloatArray, used: npt.NDArray[np.bool_]
) -> FloatArray:
    """One over the root mean square of the residuals, no smaller than the torque's rounding."""
    torque = np.sqrt(np.array([_square(gram, _unit(gram, SHIFTED)) for gram in grams]) / np.maximum(rows, 1.0))
    floor = RESIDUAL_FLOOR * np.maximum(torque, max(1e-9 * float(torque.max()), LEAST_TORQUE))
    deviation = np.maximum(np.sqrt(sums / np.maximum(rows, 1.0)), floor)
    used = used & (rows > 0) & (deviation > 0.0)
    return np.asarray(np.divide(1.0, deviation, out=np.zeros_like(deviation), where=used))


def _inverse(normal: FloatArray) -> FloatArray:
    """Inverse of a normal matrix, column-normalised first; 0 for unknowns that the data do not determine."""
    scale = _positive(np.sqrt(np.maximum(np.diag(normal), 0.0)))
    scaled = normal / np.outer(scale, scale)
    with suppress(np.linalg.LinAlgError):
        plain = np.linalg.inv(scaled)
        if np.linalg.norm(plain) * _INDEPENDENT * _CLEARLY < 1.0:  # the norm is at least 1 over the least eigenvalue
            return np.asarray(0.5 * (plain + plain.T) / np.outer(scale, scale))
    values, vectors = np.linalg.eigh(scaled)
    inverse = np.where(values > _INDEPENDENT, 1.0 / np.maximum(values, _INDEPENDENT), 0.0)
    return np.asarray((vectors * inverse) @ vectors.T / np.outer(scale, scale))


def _positive(lengths: FloatArray) -> FloatArray:
    """The lengths of columns, 1 for columns without any."""
    return np.where(lengths > 0.0, lengths, 1.0)
