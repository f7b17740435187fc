"""Autoregressive noise of the torques: its model from residuals, and equations whitened by it.

The best prediction of e(t) from the k samples before it is −(a₁·e(t−1) + … + a_k·e(t−k)), its error has the variance
v_k (Levinson and Durbin; Box and Jenkins, ch. 3 and 7). An equation minus what the p before it predict has independent
errors; behind a gap, where only k < p samples are known, order k is used, weighted by √(v_p/v_k). Their least squares
is the maximum of the likelihood: Gauss and Markov's estimate for noise of order p, no equation lost.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from drivers.core.arrays import BoolArray, FloatArray
from ident.model.regressor import RegressorKernel
from ident.regression.moment_equations import MomentRows
from ident.regression.observation_matrix import filtered_samples
from ident.signals.filters import ZeroPhaseFilter
from ident.signals.prepared import Segment

LEAST_INNOVATION = 1e-6
"""Of the residual's variance; an order that leaves less is rounding."""


def whitening_filters(
    residuals: Sequence[FloatArray], counted: Sequence[BoolArray], most: int, order: int | None = None
) -> FloatArray:
    """Filters (p + 1, p + 1) of the noise in series of residuals: row k for a sample with k known ones before it.

    Args:
        residuals: each (M,).
        counted: of the same, (M,) whether a sample counts.
        most: largest order that is tried.
        order: p; the one with the least BIC (Schwarz 1978) where None. Less where the data bear out no more.
    """
    known = [np.where(counts, residual, 0.0) for residual, counts in zip(residuals, counted, strict=True)]
    covariances = np.zeros(most + 1)
    for lag in range(most + 1):
        products = sum(float(e[lag:] @ e[: len(e) - lag]) for e in known if len(e) > lag)
        pairs = sum(int(np.sum(c[lag:] & c[: len(c) - lag])) for c in counted if len(c) > lag)
        covariances[lag] = products / max(pairs, 1)
    if covariances[0] <= 0.0:
        return np.ones((1, 1))
    predictors, variances = [np.ones(1)], [covariances[0]]
    for k in range(1, most + 1):
        before = predictors[-1]
        reflection = -float(before @ covariances[k:0:-1]) / variances[-1]
        variance = variances[-1] * (1.0 - reflection**2)
        if variance <= LEAST_INNOVATION * covariances[0]:
            break
        predictors.append(np.append(before, 0.0) + reflection * np.append(0.0, before[::-1]))
        variances.append(variance)
    if order is None:
        count = sum(int(counts.sum()) for counts in counted)
        order = int(np.argmin(count * np.log(variances) + np.arange(len(variances)) * np.log(max(count, 1))))
    order = min(order, len(variances) - 1)
    filters = np.zeros((order + 1, order + 1))
    for k in range(order + 1):
        filters[k, : k + 1] = np.sqrt(variances[order] / variances[k]) * predictors[k]
    return filters


@dataclass(frozen=True, eq=False)
class WhitenedRows:
    """A segment's equations, whitened.

    Attributes:
        kernel: of the base columns.
        segment: motion and torque.
        parallel_filter: for τ and W.
        filters: of each joint, as `whitening_filters` gives them.
    """

    kernel: RegressorKernel
    segment: Segment
    parallel_filter: ZeroPhaseFilter
    filters: tuple[FloatArray, ...]

    def __iter__(self) -> Iterator[MomentRows]:
        """Stream them; arrays are valid until the next one is requested."""
        kernel, segment = self.kernel, self.segment
        before = [
            (np.zeros((len(rows.columns) + 1, len(table) - 1)), 0)
            for rows, table in zip(kernel.joint_rows, self.filters, strict=True)
        ]
        position = 0
        for filtered in filtered_samples(kernel, segment, self.parallel_filter, segment.torque):
            width = len(filtered.used)
            for motor, (rows, table) in enumerate(zip(kernel.joint_rows, self.filters, strict=True)):
                order = len(table) - 1
                past, known = before[motor]
                present = np.concatenate([filtered.regressor[rows.rows], filtered.torque[motor : motor + 1]])
                together = np.concatenate([past, present], axis=1)
                counts = filtered.counts(motor)
                known_before = _known_before(counts, known)
                taps = table[np.minimum(known_before, order)]
                white = np.zeros_like(present)
                for lag in range(order + 1):
                    white += taps[:, lag] * together[:, order - lag : order - lag + width]
                regressor = white[:-1, counts]
                samples = position + np.flatnonzero(counts)
                yield MomentRows(motor, samples, rows.columns, regressor, regressor, white[-1, counts])
                ended = int(known_before[-1]) + 1 if counts[-1] else 0
                before[motor] = together[:, together.shape[1] - order :], ended
            position += width


def _known_before(counts: BoolArray, carried: int) -> npt.NDArray[np.int64]:
    """How many samples (m,) in a row right before each one count, `carried` of them before the first."""
    place = np.arange(len(counts))
    last_gap = np.maximum.accumulate(np.where(counts, -1, place))  # up to this sample
    last_gap = np.concatenate([[-1], last_gap[:-1]])
    return np.where(last_gap < 0, place + carried, place - last_gap - 1)
