"""Equations of all joints, sample by sample, whitened by the covariance Ω of their residuals (AUBO eq. 12).

The n equations of a sample are multiplied by Ω^(−½), the symmetric root, so that a normalised residual stays as close
to its joint's as it can. Where some of a sample's equations take no part (velocity reversals, motors at rest, torques
that are not used), the others are whitened by the covariance of their own residuals. Rows of different joints mix, so
the system has one triangular factor over all base columns.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from drivers.core.arrays import FloatArray
from ident.model.regressor import RegressorKernel
from ident.regression.observation_matrix import filtered_samples
from ident.signals.filters import ZeroPhaseFilter
from ident.signals.prepared import Segment

LEAST_EIGENVALUE = 1e-6
"""Least eigenvalue of the residuals' correlation matrix: smaller ones are raised to it."""


@dataclass(frozen=True, eq=False)
class SampleEquations:
    """Equations of filtered samples in which the same motors take part."""

    motors: tuple[int, ...]  # (k,) that take part
    samples: npt.NDArray[np.int64]  # (m,) which of the segment's filtered samples
    regressor: FloatArray  # (k, b, m) of the base columns
    torque: FloatArray  # (k, m) filtered [N·m]

    def residual(self, parameters: FloatArray) -> FloatArray:
        """Measured minus predicted torque (k, m) for base parameters (b,) [N·m]."""
        return np.asarray(self.torque - np.einsum("kbm,b->km", self.regressor, parameters))


def sample_equations(
    kernel: RegressorKernel, segment: Segment, parallel_filter: ZeroPhaseFilter, torques: Sequence[int]
) -> Iterator[SampleEquations]:
    """Stream a segment's equations, those of the same motors together.

    Args:
        kernel: for the base columns (b).
        segment: motion and torque on a uniform grid.
        parallel_filter: for τ and W.
        torques: motors whose torques are used.
    """
    powers = 1 << np.arange(kernel.model.dof, dtype=np.int64)
    position = 0
    for filtered in filtered_samples(kernel, segment, parallel_filter, segment.torque):
        taking_part = np.zeros((kernel.model.dof, len(filtered.used)), dtype=np.bool_)
        for motor in torques:
            taking_part[motor] = filtered.counts(motor)
        patterns = powers @ taking_part
        for pattern in np.unique(patterns[patterns > 0]).tolist():
            inside = np.flatnonzero(patterns == pattern)
            motors = tuple(np.flatnonzero(taking_part[:, inside[0]]).tolist())
            regressor = np.zeros((len(motors), len(kernel.columns), len(inside)))
            for place, motor in enumerate(motors):
                rows = kernel.joint_rows[motor]
                regressor[place, list(rows.columns)] = filtered.regressor[rows.rows][:, inside]
            yield SampleEquations(motors, position + inside, regressor, filtered.torque[list(motors)][:, inside])
        position += len(filtered.used)


class Whitening:
    """Roots of Ω for any set of motors."""

    def __init__(self, covariance: FloatArray) -> None:
        """Take a covariance (n, n) [(N·m)²]; rows and columns of motors that never take part do not matter."""
        self._covariance = covariance
        self._roots: dict[tuple[int, ...], tuple[FloatArray, FloatArray]] = {}

    def roots(self, motors: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
        """Ω^(½) and Ω^(−½) (k, k) of these motors."""
        if motors not in self._roots:
            block = self._covariance[np.ix_(motors, motors)]
            deviations = np.sqrt(np.diag(block))
            # Scaled: joints of 300 N·m and of 5 N·m must not decide by their units what is near singular.
            values, vectors = np.linalg.eigh(block / np.outer(deviations, deviations))
            values = np.maximum(values, LEAST_EIGENVALUE)
            values, vectors = np.linalg.eigh(deviations[:, None] * (vectors * values @ vectors.T) * deviations)
            sizes = np.sqrt(np.maximum(values, np.finfo(float).tiny))
            self._roots[motors] = ((vectors * sizes) @ vectors.T, (vectors / sizes) @ vectors.T)
        return self._roots[motors]


class CovarianceSums:
    """Sums that make up Ω (AUBO eq. 14), over samples of different sets of motors."""

    def __init__(self, dof: int) -> None:
        """Factors before the first sample."""
        self._products = np.zeros((dof, dof))
        self._counts = np.zeros((dof, dof))

    def add(self, motors: tuple[int, ...], root: FloatArray, normalised: FloatArray, weights: FloatArray) -> None:
        """Add normalised residuals (k, m) with their weights (k, m)."""
        weighted = np.sqrt(weights) * normalised
        counts = weights.sum(axis=1)
        place = np.ix_(motors, motors)
        self._products[place] += root @ (weighted @ weighted.T) @ root
        self._counts[place] += np.sqrt(np.outer(counts, counts))

    def covariance(self, factor: float, independent: float, floor: FloatArray) -> FloatArray:
        """Ω (n, n).

        With few samples for many joints and parameters the fit makes some combination of the residuals small by chance,
        whitening counts on it, and the next fit makes it smaller still. Correlations are therefore shrunk by the share
        of them that chance explains (Schäfer and Strimmer 2005, eq. 8 with their target D).

        Args:
            factor: of all variances.
            independent: number of independent samples that the correlations are estimated from.
            floor: (n,) smallest standard deviations.
        """
        covariance = shrunk(factor * self._products / np.maximum(self._counts, 1e-300), independent)
        deviations = np.sqrt(np.diag(covariance))
        scale = np.maximum(deviations, floor) / np.maximum(deviations, np.finfo(float).tiny)
        raised = np.where(deviations > 0, scale, 0.0)
        covariance = covariance * np.outer(raised, raised)
        empty = deviations == 0
        covariance[empty, empty] = floor[empty] ** 2
        return np.asarray(covariance)


def shrunk(covariance: FloatArray, independent: float) -> FloatArray:
    """A covariance (n, n) of so many independent samples, its correlations shrunk by what chance explains of them."""
    deviations = np.sqrt(np.diag(covariance))
    pairs = np.outer(deviations, deviations)
    correlation = np.divide(covariance, pairs, out=np.zeros_like(covariance), where=pairs > 0)
    np.fill_diagonal(correlation, 0.0)
    if np.max(np.abs(correlation)) > 1.0 + 1e-6:  # rounding residue, where residuals vanish
        return np.diag(deviations**2)
    by_chance = np.square(1.0 - correlation**2) * (correlation != 0)
    total = float(np.sum(correlation**2))
    share = float(np.sum(by_chance)) / max(independent, 1.0) / total if total > 0 else 0.0
    return np.asarray((1.0 - min(1.0, share)) * correlation * pairs + np.diag(deviations**2))


def whitened(regressor: FloatArray, torque: FloatArray, unroot: FloatArray, root_weight: FloatArray) -> FloatArray:
    """Rows (b + 1, k·m) of the whitened and weighted system, the torque last.

    Args:
        regressor: (k, b, m).
        torque: (k, m).
        unroot: Ω^(−½) (k, k).
        root_weight: (k, m) roots of the weights.
    """
    equations = np.concatenate([regressor, torque[:, None]], axis=1)
    mixed = np.einsum("kj,jbm->bkm", unroot, equations, optimize=True) * root_weight
    return np.asarray(mixed.reshape(equations.shape[1], -1))
