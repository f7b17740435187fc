"""Torques that were recorded as absolute values."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from drivers.core.arrays import FloatArray
from ident.assessment.instants import Instants
from ident.assessment.mistakes.competition import EXPLAINED, HALVED, WELL_EXPLAINED, Competition
from ident.assessment.mistakes.equations import equations
from ident.signals.prepared import Prepared

BELOW_ZERO = 0.02
"""Share of its root mean square by which an unsigned torque may be negative, by rounding and resampling."""

NEAR_ZERO = 0.1
"""The same that it must come near to: a torque that keeps its sign because it holds a weight stays away from 0."""

RANK_SHARE = 1e-6
"""Singular values below this share of the largest are rounding."""

SEVERAL = 2
"""Torques that come near 0 and are never negative, as no other one of the arm is, which need no other evidence."""

TURN = 0.3
"""The same below which its sign may change."""

ROUNDS, FREE_ROUNDS = 16, 8
"""Iterations, and those at the beginning in which every instant has a sign of its own."""

DIRECTIONS = 3
"""Eigenvectors from which signs start."""


def unsigned_torques(competition: Competition, runs: Sequence[Prepared]) -> list[int]:
    """Joints whose torques are never negative, if signs chosen for them explain the recording and it is none as it is.

    The signs are those that the model predicts, fitted and predicted again; the first are those of the velocity, or
    all positive. Where no torque of an arm is ever negative, though several come near 0, it is none of signs that are
    found: no arm moves to and fro so.
    """
    least = {joint: _least(joint, runs) for joint in competition.joints}
    folded = [joint for joint, value in least.items() if -BELOW_ZERO <= value < NEAR_ZERO]
    recorded = competition.bound(competition.recorded) if folded else None
    if recorded is not None:  # a torque that is explained as it is has its sign, whatever another joint's noise is
        folded = [joint for joint in folded if recorded.relative[joint] >= WELL_EXPLAINED**2]
    if not folded or competition.well_explained:
        return []
    if len(folded) >= SEVERAL and all(value >= -BELOW_ZERO for value in least.values()):
        return folded
    instants = competition.measured
    _, conditions = competition.system(competition.recorded)
    regressor = competition.regressor(instants)
    size = np.abs(instants.torque)
    used = competition.experiment.torques
    best: tuple[float, float] | None = None
    for start, free_rounds in _starts(instants, regressor, folded):
        torque = instants.torque.copy()
        torque[folded] = size[folded] * start[folded]
        for number in range(ROUNDS):
            system = equations(regressor, replace(instants, torque=torque), used)
            fit = system.fit(competition.recorded.torques, conditions)
            if fit is None:
                break
            predicted = np.einsum("nbN,b->nN", regressor, fit.parameters)
            before = torque.copy()
            for joint in folded:
                free = np.where(predicted[joint] < 0.0, -1.0, 1.0)
                signs = (
                    free if number < free_rounds else _signs(size[joint], predicted[joint], instants.velocity[joint])
                )
                torque[joint] = size[joint] * signs
            error = _error(torque - predicted, torque, instants.counted, used)
            if number >= free_rounds and (best is None or fit.level < best[0]):
                best = (fit.level, error)
            if number >= free_rounds and np.array_equal(before, torque):
                break
    if best is None or recorded is None or recorded.level - best[0] < HALVED:
        return []
    return folded if best[1] < EXPLAINED else []


def _starts(instants: Instants, regressor: FloatArray, folded: Sequence[int]) -> Iterator[tuple[FloatArray, int]]:
    """Signs (n, N) to start from, and the rounds in which every instant has its own: those of spectral initialisation.

    The others are the signs of the velocity, and all positive.

    The parameters' direction is near the largest eigenvectors of Σ τ² w wᵀ over whitened rows w of the regressor
    (Netrapalli, Jain and Sanghavi, Phase retrieval using alternating minimization, 2013, algorithm 2).
    """
    size = np.abs(instants.torque)
    yield np.sign(instants.velocity), 0
    yield np.ones_like(size), 0
    level = np.sqrt(np.mean(size**2, axis=1))[:, None]
    weight = instants.counted[folded] / np.maximum(level[folded], np.finfo(float).tiny)
    rows = (regressor[folded] * weight[:, None]).transpose(0, 2, 1).reshape(-1, regressor.shape[1])
    squares = (size[folded] * weight).reshape(-1) ** 2
    left, singular, _ = np.linalg.svd(rows, full_matrices=False)
    left = left[:, singular > RANK_SHARE * singular[0]]
    vectors = np.linalg.eigh((left * squares[:, None]).T @ left)[1]
    for number in range(1, 1 + min(DIRECTIONS, vectors.shape[1])):
        signs = np.ones_like(size)
        signs[folded] = np.where(left @ vectors[:, -number] < 0.0, -1.0, 1.0).reshape(len(folded), -1)
        yield signs, FREE_ROUNDS
        yield -signs, FREE_ROUNDS


def _signs(size: FloatArray, predicted: FloatArray, velocity: FloatArray) -> FloatArray:
    """Signs (N,) that fit the predicted torque.

    They change only where an absolute torque (N,) comes near 0, and with the sign of the velocity, for the friction.
    """
    near = size < TURN * float(np.sqrt(np.mean(size**2)))
    near[1:] |= np.sign(velocity[1:]) != np.sign(velocity[:-1])
    part = np.cumsum(near)
    agreement = np.bincount(part, weights=size * predicted)
    return np.where(agreement[part] < 0.0, -1.0, 1.0)


def _error(rest: FloatArray, torque: FloatArray, counted: npt.NDArray[np.bool_], used: Sequence[int]) -> float:
    """Relative error of the whole arm, over the instants that count."""
    rows = list(used)
    return float(np.linalg.norm(rest[rows][counted[rows]]) / np.linalg.norm(torque[rows][counted[rows]]))


def _least(joint: int, runs: Sequence[Prepared]) -> float:
    """Least torque over its root mean square; -inf where its joint does not move to and fro."""
    parts = [segment for run in runs for segment in run.segments if segment.used.any()]
    if not parts:
        return -np.inf
    torque = np.concatenate([segment.torque[joint, segment.used] for segment in parts])
    velocity = np.concatenate([segment.velocity[joint, segment.used] for segment in parts])
    size = float(np.sqrt(np.mean(torque**2)))
    to_and_fro = bool(np.min(velocity) < 0.0 < np.max(velocity))
    return float(np.min(torque)) / size if to_and_fro and size > 0.0 else -np.inf
