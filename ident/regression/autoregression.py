"""Autoregressive noise of the torques: its polynomial from residuals, and equations whitened by it.

A(z)·e = ε with A = 1 + a₁z⁻¹ + … + a_p z⁻ᵖ and ε white: the equations A(z)(τ − W·θ) = ε have independent errors, and
their least squares is the maximum of the likelihood given the first p samples (Cochrane and Orcutt 1949; Box and
Jenkins, ch. 7).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view

from drivers.streams import FloatArray
from ident.linear_algebra.triangular import triangular
from ident.model.regressor import RegressorKernel
from ident.regression.moment_equations import MomentRows
from ident.regression.observation_matrix import filtered_samples
from ident.signals.filters import ZeroPhaseFilter
from ident.signals.prepared import Segment

BoolArray = npt.NDArray[np.bool_]

ROWS_PER_COEFFICIENT = 10
"""Fewer residuals per coefficient say nothing of the noise."""


def fit_autoregression(
    residuals: Sequence[FloatArray], counted: Sequence[BoolArray], most: int, order: int | None = None
) -> FloatArray:
    """Polynomial (p + 1,) of the noise in series of residuals, 1 first; conditional least squares.

    Args:
        residuals: each (M,).
        counted: of the same, (M,) whether a sample counts.
        most: largest order that is tried; all are judged on the same samples.
        order: p; the one with the least BIC (Schwarz 1978) where None.
    """
    windows = [
        sliding_window_view(residual, most + 1)[sliding_window_view(counts, most + 1).all(axis=1)]
        for residual, counts in zip(residuals, counted, strict=True)
        if len(residual) > most
    ]
    rows = np.concatenate(windows)[:, ::-1] if windows else np.empty((0, most + 1))
    if len(rows) < ROWS_PER_COEFFICIENT * (most + 1):
        return np.ones(1)
    # e_t last: the squares below each diagonal entry of its column are what the lags before it leave.
    factor = triangular(np.column_stack([rows[:, 1:], rows[:, 0]]))
    left = np.sum(factor[:, -1] ** 2) - np.concatenate([[0.0], np.cumsum(factor[:-1, -1] ** 2)])
    if order is None:
        left = np.maximum(left, np.finfo(float).tiny)
        order = int(np.argmin(len(rows) * np.log(left) + np.arange(most + 1) * np.log(len(rows))))
    coefficients = np.linalg.lstsq(factor[:order, :order], factor[:order, -1], rcond=1e-12)[0]
    return np.concatenate([[1.0], -coefficients])


@dataclass(frozen=True, eq=False)
class WhitenedRows:
    """A segment's equations, whitened; those without p counted ones right before them are left out.

    Attributes:
        kernel: of the base columns.
        segment: motion and torque.
        parallel_filter: for τ and W.
        polynomials: of each joint's noise.
    """

    kernel: RegressorKernel
    segment: Segment
    parallel_filter: ZeroPhaseFilter
    polynomials: tuple[FloatArray, ...]

    def __iter__(self) -> Iterator[MomentRows]:
        """Stream them; arrays are valid until the next one is requested."""
        kernel, segment = self.kernel, self.segment
        before: list[tuple[FloatArray, BoolArray]] = [
            (np.zeros((len(rows.columns) + 1, len(polynomial) - 1)), np.zeros(len(polynomial) - 1, dtype=np.bool_))
            for rows, polynomial in zip(kernel.joint_rows, self.polynomials, strict=True)
        ]
        position = 0
        for filtered in filtered_samples(kernel, segment, self.parallel_filter, segment.torque):
            width = len(filtered.used)
            for motor, (rows, polynomial) in enumerate(zip(kernel.joint_rows, self.polynomials, strict=True)):
                order = len(polynomial) - 1
                past, past_counts = before[motor]
                present = np.concatenate([filtered.regressor[rows.rows], filtered.torque[motor : motor + 1]])
                together = np.concatenate([past, present], axis=1)
                counts = np.concatenate([past_counts, filtered.counts(motor)])
                white = sum(a * together[:, order - lag : order - lag + width] for lag, a in enumerate(polynomial))
                valid = np.all([counts[order - lag : order - lag + width] for lag in range(order + 1)], axis=0)
                regressor = np.asarray(white)[:-1, valid]
                yield MomentRows(
                    motor, position + np.flatnonzero(valid), rows.columns, regressor, regressor,
                    np.asarray(white)[-1, valid],
                )  # fmt: skip
                before[motor] = together[:, together.shape[1] - order :], counts[len(counts) - order :]
            position += width
