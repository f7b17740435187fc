"""Torques that were recorded as absolute values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from drivers.streams import FloatArray
from ident.assessment.mistakes.competition import EXPLAINED, HALVED, Competition
from ident.assessment.mistakes.equations import equations
from ident.signals.prepared import Prepared

BELOW_ZERO = 0.02
"""Share of its root mean square by which an unsigned torque may be negative, by rounding and resampling."""

NEAR_ZERO = 0.1
"""The same that it must come near to: a torque that keeps its sign because it holds a weight stays away from 0."""

TURN = 0.3
"""The same below which its sign may change."""

ROUNDS = 8


def unsigned_torques(competition: Competition, runs: Sequence[Prepared]) -> list[int]:
    """Joints whose torques are never negative, if signs chosen for them explain the recording and it is none as it is.

    The signs are those that the model predicts, fitted and predicted again; the first are those of the velocity, or
    all positive.
    """
    folded = [joint for joint in competition.joints if _never_negative(joint, runs)]
    if not folded or competition.well_explained():
        return []
    recorded = competition.bound(competition.recorded)
    instants, positions = competition.instants, competition.recorded.positions
    _, conditions = competition.system(positions)
    regressor = competition.regressor(positions)
    size = np.abs(instants.torque)
    best: tuple[float, float] | None = None
    for start in (np.sign(instants.velocity), np.ones_like(size)):
        torque = instants.torque.copy()
        torque[folded] = size[folded] * start[folded]
        for _ in range(ROUNDS):
            system = equations(regressor, replace(instants, torque=torque), competition.experiment.torques)
            fit = system.fit(competition.recorded.torques, conditions)
            if fit is None:
                break
            predicted = np.einsum("nbN,b->nN", regressor, fit.parameters)
            before = torque.copy()
            for joint in folded:
                torque[joint] = size[joint] * _signs(size[joint], predicted[joint])
            error = _error(torque - predicted, torque, instants.counted, competition.experiment.torques)
            if best is None or fit.level < best[0]:
                best = (fit.level, error)
            if np.array_equal(before, torque):
                break
    if best is None or recorded is None or recorded.level - best[0] < HALVED:
        return []
    return folded if best[1] < EXPLAINED else []


def _signs(size: FloatArray, predicted: FloatArray) -> FloatArray:
    """Signs (N,) that change only where an absolute torque (N,) comes near 0, those that fit the predicted torque."""
    near = size < TURN * float(np.sqrt(np.mean(size**2)))
    part = np.cumsum(near)
    agreement = np.bincount(part, weights=size * predicted)
    return np.where(agreement[part] < 0.0, -1.0, 1.0)


def _error(rest: FloatArray, torque: FloatArray, counted: npt.NDArray[np.bool_], used: Sequence[int]) -> float:
    """Relative error of the whole arm, over the instants that count."""
    rows = list(used)
    return float(np.linalg.norm(rest[rows][counted[rows]]) / np.linalg.norm(torque[rows][counted[rows]]))


def _never_negative(joint: int, runs: Sequence[Prepared]) -> bool:
    """Whether a torque comes near 0 and is never below, while its joint moves to and fro."""
    parts = [segment for run in runs for segment in run.segments if segment.used.any()]
    if not parts:
        return False
    torque = np.concatenate([segment.torque[joint, segment.used] for segment in parts])
    velocity = np.concatenate([segment.velocity[joint, segment.used] for segment in parts])
    size = float(np.sqrt(np.mean(torque**2)))
    least = float(np.min(torque))
    return -BELOW_ZERO * size <= least < NEAR_ZERO * size and bool(np.min(velocity) < 0.0 < np.max(velocity))
