"""One model from several experiments, each with its own estimate and covariance (SR400 .4.3 point 7).

Experiment i gives values θ_i = P_i·x + ε_i of combinations P_i of the same base parameters x, with covariance C_i. The
merged parameters minimise

    Σ (θ_i − P_i·x)ᵀ N_i (θ_i − P_i·x)

N_i is the information of the experiment for white residuals, divided by the mean factor by which its residuals, which
are not white, make variances larger. For C_i comes from a jackknife over few blocks, and the inverse of such a matrix
is far from that of the true one. In return the covariance of x follows from C_i itself, carried through the estimator:
with x = Σ G_i·θ_i it is Σ G_i·C_i·G_iᵀ.

N_i is kept as its square root R_i: one QR decomposition of the stacked R_i·P_i, never a normal matrix. Estimates add up
in any order, and a merged estimate may be merged again; an estimate used before another experiment's data is its prior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import IdentificationError
from ident.linear_algebra.independent_columns import independent_columns
from ident.linear_algebra.triangular import scaled_condition, triangular
from ident.regression.hypothesis_tests import SignificanceTest, chi_square_test
from ident.regression.least_squares import EXCITATION_TOLERANCE, LeastSquares

CONTRADICTING = 3.0
"""A value this many standard deviations from the merged one contradicts it."""


@dataclass(frozen=True)
class Information:
    """Information of one experiment on b parameters x: values = combinations·x + an error."""

    values: FloatArray  # (a,)
    combinations: FloatArray  # (a, b)
    root: FloatArray  # (a, a); rootᵀ·root weighs the errors
    covariance: FloatArray  # (a, a) of the error
    blocks: int  # of the jackknife behind the covariance


@dataclass(frozen=True)
class MergedEstimate:
    """Parameters from several experiments; b of them, k active."""

    solution: LeastSquares  # by least squares; `rows` is the number of values merged, `residual_sum` the weighted one
    covariance: FloatArray  # (k, k) of the active parameters, from the experiments' covariances
    root: FloatArray  # (k, k) upper triangular square root of the summed information
    absorbed: FloatArray  # (k, b − k) share of each inactive parameter in each active one
    consistency: SignificanceTest | None  # whether the experiments agree; None where they share nothing
    # for each experiment (a,), how many standard deviations its values are from the merged ones; 0 where no other
    # experiment determines the same
    deviations: tuple[FloatArray, ...]
    fitted: tuple[FloatArray, ...]  # for each experiment (a,), what the merged parameters give for its values


def variance_ratio(root: FloatArray, covariance: FloatArray) -> float:
    """Mean ratio of the variances in `covariance` to those that follow from the information rootᵀ·root."""
    return float(np.trace(root @ covariance @ root.T)) / max(1, len(root))


def usable(information: Information) -> Information:
    """Drop the values whose variance is not known; weighted as if they had never been estimated.

    Raises:
        IdentificationError: no value is left.
    """
    finite = np.isfinite(np.diag(information.covariance))
    if not np.any(finite):
        raise IdentificationError("no estimated value has a standard deviation", hint="record longer")
    kept, left = np.flatnonzero(finite), np.flatnonzero(~finite)
    # The first columns of a triangular factor are those that are fitted away.
    root = triangular(information.root[:, [*left, *kept]])[len(left) :, len(left) :]
    return Information(
        values=information.values[kept],
        combinations=information.combinations[kept],
        root=root,
        covariance=information.covariance[np.ix_(kept, kept)],
        blocks=information.blocks,
    )


def identifiable_columns(informations: Sequence[Information], preferred: Sequence[int]) -> tuple[int, ...]:
    """Parameters that the experiments identify together, the preferred ones first."""
    system = np.vstack([information.root @ information.combinations for information in informations])
    lengths = np.linalg.norm(system, axis=0)
    there = lengths > EXCITATION_TOLERANCE * lengths.max()
    scaled = system / np.where(there, lengths, 1.0)
    order = [column for column in preferred if there[column]]
    return tuple(sorted(independent_columns(scaled, order, EXCITATION_TOLERANCE)))


def merge(informations: Sequence[Information], active: Sequence[int]) -> MergedEstimate:
    """Least squares over the values of all experiments; parameters that are not active are 0.

    Raises:
        IdentificationError: the values do not determine the parameters.
    """
    from scipy.linalg import block_diag

    active = tuple(active)
    system = np.vstack([information.root @ information.combinations for information in informations])
    right = np.concatenate([information.root @ information.values for information in informations])
    chosen = system[:, list(active)]
    lengths = np.linalg.norm(chosen, axis=0)
    if len(chosen) < len(active) or not np.all(lengths > 0):
        raise IdentificationError("the experiments do not determine the parameters", hint="merge with another one")
    q, r = np.linalg.qr(chosen / lengths)
    if not np.all(np.abs(np.diag(r)) > EXCITATION_TOLERANCE):
        raise IdentificationError(
            "some parameters act in the same combination in all experiments", hint="merge with another experiment"
        )
    inverse_factor = np.linalg.solve(r, np.eye(len(active))) / lengths[:, None]
    gain = inverse_factor @ q.T
    values = gain @ right
    parameters = np.zeros(system.shape[1])
    parameters[list(active)] = values
    # Of the whitened values: near to one, and block diagonal.
    spread = block_diag(
        *(information.root @ information.covariance @ information.root.T for information in informations)
    )
    covariance = gain @ spread @ gain.T
    left = np.eye(len(right)) - q @ q.T
    residual = right - q @ (q.T @ right)
    inactive = [column for column in range(system.shape[1]) if column not in active]
    singular = np.linalg.svd(chosen, compute_uv=False)
    inverse = inverse_factor @ inverse_factor.T
    return MergedEstimate(
        solution=LeastSquares(
            method="wls",
            active=active,
            parameters=parameters,
            covariance=inverse,
            inverse=inverse,
            weights=np.ones(len(informations)),
            joint_std=np.ones(len(informations)),
            rows=len(right),
            condition=float(singular[0] / singular[-1]),
            scaled_condition=scaled_condition(chosen),
            residual_sum=float(residual @ residual),
            iterations=1,
        ),
        covariance=covariance,
        root=triangular(chosen),
        absorbed=_without_rounding(inverse_factor @ (q.T @ system[:, inactive]), lengths),
        consistency=_consistency(
            right, spread, chosen, residual, min(information.blocks for information in informations)
        ),
        deviations=_deviations(informations, residual, left @ spread @ left),
        fitted=tuple(information.combinations @ parameters for information in informations),
    )


def _consistency(
    right: FloatArray, spread: FloatArray, system: FloatArray, residual: FloatArray, blocks: int
) -> SignificanceTest | None:
    """Test whether the values of several experiments differ significantly from what one set of parameters gives.

    Where the jackknife has too few blocks for the test, only the mean of its variances is used.
    """
    from scipy.special import chdtrc

    freedom = len(right) - system.shape[1]
    if freedom < 1:
        return None
    test = chi_square_test(right, spread, blocks, system)
    if test is not None:
        return test
    statistic = float(residual @ residual)
    return SignificanceTest(statistic, freedom, float(chdtrc(freedom, statistic)))


def _deviations(
    informations: Sequence[Information], residual: FloatArray, covariance: FloatArray
) -> tuple[FloatArray, ...]:
    """Differences in standard deviations, value by value, from whitened ones (all,) with their covariance."""
    deviations, start = [], 0
    for information in informations:
        rows = slice(start, start + len(information.values))
        start = rows.stop
        back = np.linalg.inv(information.root)
        difference = back @ residual[rows]
        std = np.sqrt(np.clip(np.diag(back @ covariance[rows, rows] @ back.T), 0.0, None))
        own = np.sqrt(np.diag(information.covariance))
        shared = std > 1e-6 * own
        deviations.append(np.divide(difference, std, out=np.zeros(len(std)), where=shared))
    return tuple(deviations)


def _without_rounding(shares: FloatArray, lengths: FloatArray) -> FloatArray:
    """Shares (k, …) of other columns in columns of these lengths (k,), small ones set to 0."""
    contribution = np.abs(shares) * lengths[:, None]
    return np.where(contribution > EXCITATION_TOLERANCE * np.max(contribution, axis=0, initial=0.0), shares, 0.0)
