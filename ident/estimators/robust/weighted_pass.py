"""One pass over the data: whiten, weigh and reduce all equations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import FloatArray
from ident.estimators.robust.weight_functions import WeightFunction
from ident.estimators.robust.whitened_equations import CovarianceSums, Whitening, sample_equations, whitened
from ident.linear_algebra.triangular import QrAccumulator
from ident.model.regressor import RegressorKernel
from ident.regression.observation_matrix import JointFactor, Reduction
from ident.signals.prepared import Prepared

ROWS_AT_ONCE = 4096
"""Rows that are collected before they are added to the triangular factor."""


@dataclass(frozen=True, eq=False)
class Pass:
    """What one pass over the data gives.

    Attributes:
        reduction: of the whitened and weighted equations.
        weights: for each segment (n, M), nan where an equation takes no part.
        normalised: residuals of the parameters that the pass began with, likewise.
        sums: for the next Ω.
    """

    reduction: Reduction
    weights: tuple[FloatArray, ...]
    normalised: tuple[FloatArray, ...]
    sums: CovarianceSums


def weighted_pass(
    kernel: RegressorKernel,
    runs: Sequence[Prepared],
    torques: Sequence[int],
    parameters: FloatArray,
    covariance: FloatArray,
    function: WeightFunction | None,
) -> Pass:
    """Whiten, weigh and reduce all equations once.

    Args:
        kernel: for the base columns (b).
        runs: the data.
        torques: motors whose torques are used.
        parameters: (b,) whose residuals are weighed.
        covariance: Ω (n, n).
        function: of the weights; all equations count alike where None.
    """
    whitening, sums = Whitening(covariance), CovarianceSums(kernel.model.dof)
    accumulator = _Collected(len(kernel.columns) + 1)
    all_weights, all_normalised = [], []
    rows = samples = 0
    for run in runs:
        for segment in run.segments:
            count = len(segment.used[:: run.parallel_filter.factor])
            weights, normalised = (np.full((kernel.model.dof, count), np.nan) for _ in range(2))
            for sample_equation in sample_equations(kernel, segment, run.parallel_filter, torques):
                root, unroot = whitening.roots(sample_equation.motors)
                residual = unroot @ sample_equation.residual(parameters)
                weight = np.ones_like(residual) if function is None else function(residual)
                place = np.ix_(np.array(sample_equation.motors), sample_equation.samples)
                weights[place], normalised[place] = weight, residual
                sums.add(sample_equation.motors, root, residual, weight)
                accumulator.add(whitened(sample_equation.regressor, sample_equation.torque, unroot, np.sqrt(weight)))
                rows += int(np.count_nonzero(weight))
                samples += len(sample_equation.samples)
            all_weights.append(weights)
            all_normalised.append(normalised)
    columns = tuple(range(len(kernel.columns)))
    reduction = Reduction(
        joints=(JointFactor(columns, accumulator.factor(), rows),),
        column_count=len(columns),
        torque_count=1,
        samples=samples,
        method="QR of the whitened equations",
    )
    return Pass(reduction, tuple(all_weights), tuple(all_normalised), sums)


class _Collected:
    """A triangular factor of many small blocks, which are stacked before they are added."""

    def __init__(self, width: int) -> None:
        self._factor = QrAccumulator(width)
        self._blocks: list[FloatArray] = []

    def add(self, block: FloatArray) -> None:
        self._blocks.append(block)
        if sum(waiting.shape[1] for waiting in self._blocks) >= ROWS_AT_ONCE:
            self._flush()

    def factor(self) -> FloatArray:
        self._flush()
        return self._factor.factor()

    def _flush(self) -> None:
        if self._blocks:
            self._factor.add(np.concatenate(self._blocks, axis=1))
            self._blocks = []
