"""How much an arm's friction changes from run to run, and what that adds to its error bars: random effects.

Bodies are the same in every run; friction is not (temperature, lubricant, load and rest before). The jackknife sees
what changes along a motion. So the friction of run r is taken as x + u_r, u_r of mean 0 and variance τ²: from how far
each run alone, with the shared bodies, moves a friction parameter, and the variance that it has within the run, τ²
follows by moments (DerSimonian and Laird, Controlled Clinical Trials 7, 1986). A few runs say little of one parameter:
τ in proportion to the friction is estimated over all motors together, kind by kind, and a parameter has a τ of its own
where its runs differ by more than that (Cochran's Q, 1 %). The interval of the mean over the runs counts Student's t
for the runs behind τ (after Hartung and Knapp, Statistics in Medicine 20, 2001).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers.core.arrays import FloatArray
from ident.friction.table import FRICTION_KINDS
from ident.model.base_parameters import BaseParameters
from ident.model.regressor import RegressorKernel
from ident.regression.hypothesis_tests import LEVEL, WITHIN_95_PERCENT
from ident.regression.jackknife import (
    BlockSums,
    CorrectedCovariance,
    FilteredRun,
    add_torque_rows,
    distinct_samples,
    jackknife_covariance,
    rows_by_block,
    tolerant_moves,
)
from ident.regression.least_squares import LeastSquares

FEWEST_BLOCKS = 5
"""Blocks of a run below which its own error bars are too uncertain to count."""


@dataclass(frozen=True, eq=False)
class RunDeviations:
    """How far single runs move f friction parameters, R runs; nan where a run says nothing of a parameter."""

    values: FloatArray  # (R, f) deviation from the parameters of all runs
    variances: FloatArray  # (R, f) of these, within the run
    sizes: FloatArray  # (f,) of the friction that a parameter belongs to, in its unit
    kinds: tuple[str, ...]  # (f,) of the parameters


def repeatability(runs: RunDeviations) -> tuple[FloatArray, FloatArray]:
    """τ (f,) of each parameter, and by how much (f,) an interval of 1.96 τ has to be longer for the runs behind it."""
    from scipy.special import chdtri, stdtrit

    deviations, factors = np.zeros(len(runs.sizes)), np.ones(len(runs.sizes))
    count = np.sum(np.isfinite(runs.values), axis=0)
    for kind in dict.fromkeys(runs.kinds):
        same = [place for place, other in enumerate(runs.kinds) if other == kind and count[place] > 1]
        moments = [_moments(runs, place, 0.0) for place in same]
        freedom = sum(own for _, own, _ in moments)
        excess = sum(statistic for statistic, _, _ in moments) - freedom
        scale = sum(slope * runs.sizes[place] ** 2 for place, (_, _, slope) in zip(same, moments, strict=True))
        relative = np.sqrt(max(0.0, excess / scale)) if scale > 0.0 else 0.0
        for place, (statistic, own, slope) in zip(same, moments, strict=True):
            tau, behind = relative * runs.sizes[place], freedom
            if _moments(runs, place, tau)[0] > chdtri(own, LEVEL):
                tau, behind = np.sqrt(max(statistic - own, 0.0) / slope), own
            deviations[place] = tau
            factors[place] = stdtrit(behind, 0.975) / WITHIN_95_PERCENT
    return deviations, factors


def _moments(runs: RunDeviations, place: int, tau: float) -> tuple[float, int, float]:
    """Cochran's Q of one parameter for a given τ, its degrees of freedom, and by how much τ² = 1 would raise it."""
    finite = np.isfinite(runs.values[:, place])
    values, weights = runs.values[finite, place], 1.0 / (runs.variances[finite, place] + tau**2)
    total = float(weights.sum())
    mean = float(weights @ values) / total
    return float(weights @ (values - mean) ** 2), len(values) - 1, total - float(weights @ weights) / total


OF_TEMPERATURE = ("temperature_slope", "temperature_curvature")
"""Kinds of friction that only runs at different temperatures tell from the others: no run has its own."""


def friction_columns(base: BaseParameters, active: Sequence[int]) -> list[int]:
    """Places among the active base columns of what may change from run to run: friction and offsets.

    Not how friction follows the temperature: in a run alone, at nearly one temperature, its columns are those of the
    friction at that temperature, and the difference between runs would be shared out at will.
    """
    return [
        place
        for place, column in enumerate(active)
        if base.kinds[column] in FRICTION_KINDS and base.kinds[column] not in OF_TEMPERATURE
    ]


def friction_sizes(base: BaseParameters, active: Sequence[int], parameters: FloatArray) -> FloatArray:
    """Size (f,) of each friction parameter among base parameters (b,): of an offset that of its Coulomb friction."""
    coulomb = {base.joints[column]: float(parameters[column]) for column in active if base.kinds[column] == "coulomb"}
    columns = [active[place] for place in friction_columns(base, active)]
    return np.abs(
        [
            coulomb.get(base.joints[column], parameters[column])
            if base.kinds[column] == "offset"
            else parameters[column]
            for column in columns
        ]
    )


def with_repeatability(
    corrected: CorrectedCovariance,
    kernel: RegressorKernel,
    base: BaseParameters,
    runs: Sequence[FilteredRun],
    solution: LeastSquares,
) -> CorrectedCovariance:
    """The covariance with what friction that changes from run to run does to all parameters; as it is with one run.

    Args:
        corrected: for changes within the runs.
        kernel: of the base columns.
        base: the base parameters.
        runs: the data.
        solution: of the motors' equations, with their weights.
    """
    active = solution.active
    friction = friction_columns(base, active)
    if len(runs) < 2 or not friction:
        return corrected
    of_runs = list(_sums(kernel, runs, solution, corrected.block_length))
    normals = [sums.gram.sum(axis=0) for sums in of_runs]
    total = np.sum(normals, axis=0)
    bodies = [place for place in range(len(active)) if place not in friction]
    of_bodies = corrected.covariance[np.ix_(bodies, bodies)]
    shared = _solve(total[np.ix_(friction, friction)], total[np.ix_(friction, bodies)])
    deviations = RunDeviations(
        np.full((len(runs), len(friction)), np.nan),
        np.full((len(runs), len(friction)), np.nan),
        friction_sizes(base, active, solution.parameters),
        tuple(str(base.kinds[active[place]]) for place in friction),
    )
    for number, (sums, normal) in enumerate(zip(of_runs, normals, strict=True)):
        lengths = np.diag(normal)[friction]
        excited = np.flatnonzero(lengths > 1e-6 * np.diag(total)[friction])
        own = [friction[place] for place in excited]
        if len(sums.gram) < FEWEST_BLOCKS or not own:
            continue
        block, grams = normal[np.ix_(own, own)], sums.gram[:, own][:, :, own]
        value = _solve(block, sums.score[:, own].sum(axis=0))
        moves = tolerant_moves(BlockSums(grams, sums.score[:, own] - grams @ value), block)
        # An error of the shared bodies moves the friction of runs apart where their motions differ.
        leaning = _solve(block, normal[np.ix_(own, bodies)]) - shared[excited]
        covariance = jackknife_covariance(moves) + leaning @ of_bodies @ leaning.T
        deviations.values[number, excited] = value
        deviations.variances[number, excited] = np.diag(covariance)
    std, factor = repeatability(deviations)
    inverse = _solve(total, np.eye(len(active)))
    added = sum(
        carried @ carried.T for normal in normals for carried in [inverse @ normal[:, friction] * (std * factor)]
    )
    between = np.full(len(active), np.nan)
    between[friction] = std
    return replace(
        corrected,
        covariance=corrected.covariance + added,
        repeatability=between,
        within=corrected.covariance if corrected.within is None else corrected.within,
    )


def _sums(
    kernel: RegressorKernel, runs: Sequence[FilteredRun], solution: LeastSquares, length: int
) -> Iterator[BlockSums]:
    """Sums of each run by blocks of its own."""
    indices = iter(distinct_samples([torques for run in runs for torques in run.series]).indices)
    for run in runs:
        of_segments = [next(indices) // length for _ in run.series]
        blocks = np.unique(np.concatenate(of_segments))
        sums = BlockSums.empty(len(blocks), len(solution.active))
        for segment, torques, block in zip(run.segments, run.series, of_segments, strict=True):
            rows = rows_by_block(kernel, segment, run.parallel_filter, np.searchsorted(blocks, block))
            add_torque_rows(sums, kernel, solution, rows, torques.residual)
        yield sums


def _solve(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solution (k, …) for a normal matrix (k, k), columns normalised; the shortest where they depend on each other."""
    lengths = np.sqrt(np.diag(matrix))
    pairs = np.outer(lengths, lengths)
    inverse = np.linalg.pinv(matrix / pairs, rcond=1e-12, hermitian=True) / pairs
    return np.asarray(inverse @ right)
