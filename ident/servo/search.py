"""Output error of servo joints: robust Levenberg-Marquardt on roll-outs side by side, and 95 % intervals at its end.

The loss of an error e (in scales) is Barron's ("A general and adaptive robust loss function", CVPR 2019) of shape α:
2·(√(e² + 1) − 1) for α = 1, which every error pulls at, and 2·log(e²/2 + 1) for α = 0, which a joint that something
blocked for seconds hardly pulls at.
"""

from __future__ import annotations

import numpy as np

from drivers.core.arrays import BoolArray, FloatArray, IndexArray
from ident.servo.rollout import Lanes, at_samples, roll_out
from ident.servo.terms import TERMS, from_search, to_search

DAMPING_START = 1e-2
DAMPING_FACTOR = 4.0
DAMPING_LIMIT = 1e5
STILL = 3e-4
"""Relative fall of a joint's cost at which its search ends."""

WIDEST = 3.0
"""Ratio of an interval's end to the value beyond which a positive term cannot be determined."""

FEWEST_PIECES = 1.2
"""Pieces of motion that must determine a term: with a single one, its error at the optimum is 0 by construction."""

TIMING = 0.1
"""Steps by which a roll-out may be early or late of its own: intervals of a delay reach so much further."""

CONFIDENCE = 0.95

BIAS = 3e-4
"""[rad or m] σ of the prior of a bias: a digital loop holds to a few steps of its encoder, say 3 mrad, and of about 100
samples of a roll-out one is independent. A wider one lets a joint's torques grow until a bias stands for gravity."""

_SPREAD = np.array([term.spread for term in TERMS])
_PRIOR = np.array([BIAS if term.name == "bias" else term.spread for term in TERMS])


def evaluate(lanes: Lanes, values: FloatArray, free: BoolArray | None = None) -> tuple[FloatArray, FloatArray]:
    """Residuals (S, L) and their derivatives (F, S, L) by the terms that are free in some joint."""
    columns = None if free is None else np.flatnonzero(free.any(axis=0))
    path, tangents, _ = roll_out(lanes, values[lanes.joint].T, columns)
    residual = at_samples(lanes, path) - lanes.measured
    if columns is None or not len(columns):
        return residual, np.empty((0, *residual.shape))
    return residual, at_samples(lanes, tangents)


EVERY_ERROR, BLOCKED_LITTLE = 1.0, 0.0
"""Shapes of the loss: while the model is still wrong, and once it is nearly right."""


def loss(error: FloatArray, shape: float) -> tuple[FloatArray, FloatArray]:
    """The loss of errors (…) in scales, and the weights of their squares."""
    if shape == BLOCKED_LITTLE:
        inner = 0.5 * error**2 + 1.0
        return 2.0 * np.log(inner), 1.0 / inner
    root = np.sqrt(1.0 + error**2)
    return 2.0 * (root - 1.0), 1.0 / root


def lane_cost(residual: FloatArray, lanes: Lanes, scale: FloatArray, shape: float) -> FloatArray:
    """(L,) robust cost of each lane, in samples."""
    return np.asarray(np.nansum(loss(residual / scale[lanes.joint], shape)[0], axis=0), dtype=np.float64)


def joint_cost(residual: FloatArray, lanes: Lanes, scale: FloatArray, shape: float) -> FloatArray:
    """(n,) robust cost of each joint, in samples."""
    lane = lane_cost(residual, lanes, scale, shape)
    return np.asarray(np.bincount(lanes.joint, weights=lane, minlength=len(scale)), dtype=np.float64)


def robust_scale(residual: FloatArray, lanes: Lanes, joints: int, least: float) -> FloatArray:
    """(n,) 1.5 times the median absolute error of each joint, at least the encoder's step [rad or m]."""
    scale = np.full(joints, least)
    for joint in range(joints):
        own = np.abs(residual[:, lanes.joint == joint])
        own = own[np.isfinite(own)]
        if len(own):
            scale[joint] = max(least, 1.5 * float(np.median(own)))
    return scale


def search(
    lanes: Lanes,
    values: FloatArray,
    free: BoolArray,
    scale: FloatArray,
    centre: FloatArray,
    evaluations: int,
    shape: float,
) -> FloatArray:
    """Values (n, terms) that minimise each joint's robust cost plus its weak prior.

    Args:
        lanes: pieces of motion.
        values: (n, terms) start.
        free: (n, terms) to search.
        scale: (n,) of the errors [rad or m].
        centre: (n, terms) of the prior, in the search's coordinates.
        evaluations: of roll-outs with derivatives, at most.
        shape: of the loss.
    """
    joints = len(values)
    point = to_search(values)
    damping = np.full(joints, DAMPING_START)
    done = ~free.any(axis=1)
    columns = np.flatnonzero(free.any(axis=0))
    residual, tangents = evaluate(lanes, values, free)
    cost = joint_cost(residual, lanes, scale, shape) + _prior(point, centre, free)
    for _ in range(evaluations):
        step = np.zeros_like(point)
        for joint in np.flatnonzero(~done).tolist():
            own = np.flatnonzero(free[joint])
            curvature, gradient = normal_equations(residual, tangents, lanes, joint, scale[joint], columns, own, shape)
            curvature += np.diag(1.0 / _PRIOR[own] ** 2)
            gradient += (point[joint, own] - centre[joint, own]) / _PRIOR[own] ** 2
            damped = curvature + damping[joint] * np.diag(np.diag(curvature))
            move = -np.linalg.lstsq(damped, gradient, rcond=None)[0]
            step[joint, own] = np.clip(move, -0.7 * _SPREAD[own], 0.7 * _SPREAD[own])
        trial = to_search(np.where(free, from_search(point + step), values))
        new_residual, new_tangents = evaluate(lanes, np.where(free, from_search(trial), values), free)
        new_cost = joint_cost(new_residual, lanes, scale, shape) + _prior(trial, centre, free)
        better = (new_cost < cost) & ~done
        done |= better & (cost - new_cost < STILL * cost)
        damping = np.where(better, damping / DAMPING_FACTOR, damping * DAMPING_FACTOR)
        done |= damping > DAMPING_LIMIT
        point[better], cost[better] = trial[better], new_cost[better]
        taken = better[lanes.joint]
        residual[:, taken], tangents[:, :, taken] = new_residual[:, taken], new_tangents[:, :, taken]
        if done.all():
            break
        left = np.flatnonzero(~done[lanes.joint])
        if len(left) < len(lanes.joint):
            # what has settled is not rolled out again
            lanes, residual, tangents = lanes.of(left), residual[:, left], tangents[:, :, left]
    return np.where(free, from_search(point), values)


def of_joint(
    residual: FloatArray, tangents: FloatArray, lanes: Lanes, joint: int, columns: IndexArray, own: IndexArray
) -> tuple[FloatArray, FloatArray]:
    """Residuals (S, l) of a joint's lanes, and their derivatives (f, S, l) by its own terms among the `columns`."""
    chosen = np.flatnonzero(lanes.joint == joint)
    rows = np.searchsorted(columns, own)
    return residual[:, chosen], tangents[np.ix_(rows, np.arange(tangents.shape[1]), chosen)]


def normal_equations(
    residual: FloatArray,
    tangents: FloatArray,
    lanes: Lanes,
    joint: int,
    scale: float,
    columns: IndexArray,
    own: IndexArray,
    shape: float,
) -> tuple[FloatArray, FloatArray]:
    """Curvature and gradient of a joint's robust cost by its own terms (half of the derivatives)."""
    measured, derivative = of_joint(residual, tangents, lanes, joint, columns, own)
    counted = np.isfinite(measured)
    error, jacobian = measured[counted] / scale, derivative[:, counted] / scale
    weight = loss(error, shape)[1]
    return (jacobian * weight) @ jacobian.T, jacobian @ (weight * error)


def _prior(point: FloatArray, centre: FloatArray, free: BoolArray) -> FloatArray:
    return np.asarray(np.sum(np.where(free, ((point - centre) / _PRIOR) ** 2, 0.0), axis=1), dtype=np.float64)


def intervals(
    lanes: Lanes, values: FloatArray, free: BoolArray, least: float
) -> tuple[FloatArray, FloatArray, BoolArray, BoolArray, tuple[FloatArray, ...]]:
    """Ends of the 95 % intervals (n, terms), which terms the data tell, which are too wide, and covariances.

    The sandwich over pieces (their errors are not independent within one), or, in directions that the data hardly show,
    the curvature alone with the pieces' inflation.
    """
    from scipy.special import stdtrit  # here, since it is slow to import

    low, high = np.full_like(values, np.nan), np.full_like(values, np.nan)
    seen = np.zeros_like(free)
    residual, tangents = evaluate(lanes, values, free)
    scale = robust_scale(residual, lanes, len(values), least)
    columns = np.flatnonzero(free.any(axis=0))
    covariances, wide = [], np.zeros_like(free)
    for joint in range(len(values)):
        own = np.flatnonzero(free[joint])
        if not len(own):
            covariances.append(np.zeros((0, 0)))
            continue
        curvature = normal_equations(residual, tangents, lanes, joint, scale[joint], columns, own, BLOCKED_LITTLE)[0]
        scores = _scores(residual, tangents, lanes, joint, scale[joint], columns, own)
        covariances.append(_covariance(curvature, scores))
        reach = np.sqrt(np.diag(covariances[-1])) * stdtrit(max(1, len(scores) - 1), 0.5 + CONFIDENCE / 2)
        point = to_search(values)[joint]
        for index, half in zip(own, reach, strict=True):
            term = TERMS[index]
            ends = np.tile(point, (2, 1))
            ends[:, index] += np.array([-1.0, 1.0]) * min(float(half), 50.0)
            if term.name == "delay":
                ends[:, index] += np.array([-TIMING, TIMING]) * lanes.step
            low[joint, index], high[joint, index] = from_search(ends)[:, index]
            seen[joint, index] = half < (np.log(WIDEST) if term.positive else term.spread)
        single = _pieces_that_tell(tangents, residual, lanes, joint, columns, own) < FEWEST_PIECES
        wide[joint, own], seen[joint, own] = ~seen[joint, own], seen[joint, own] & ~single
    return low, high, seen, wide, tuple(covariances)


def _pieces_that_tell(
    tangents: FloatArray, residual: FloatArray, lanes: Lanes, joint: int, columns: IndexArray, own: IndexArray
) -> FloatArray:
    """(terms,) number of pieces that a term's information comes from, as if each gave the same."""
    error, derivative = of_joint(residual, tangents, lanes, joint, columns, own)
    information = np.einsum("fsl,sl->fl", derivative**2, np.isfinite(error).astype(np.float64))
    return np.asarray(information.sum(axis=1) ** 2 / np.maximum((information**2).sum(axis=1), 1e-300), dtype=np.float64)


def _scores(
    residual: FloatArray,
    tangents: FloatArray,
    lanes: Lanes,
    joint: int,
    scale: float,
    columns: IndexArray,
    own: IndexArray,
) -> FloatArray:
    """(pieces, terms) gradient of each piece's cost."""
    measured, derivative = of_joint(residual, tangents, lanes, joint, columns, own)
    error = np.nan_to_num(measured / scale)
    weighted = error * loss(error, BLOCKED_LITTLE)[1] / scale
    scores: FloatArray = np.einsum("sl,fsl->lf", weighted, derivative)
    return scores[np.isfinite(measured).any(axis=0)]


def _covariance(curvature: FloatArray, scores: FloatArray) -> FloatArray:
    """Covariance of the terms; very large in directions that the data do not show."""
    count, terms = scores.shape
    lengths = np.sqrt(np.maximum(np.diag(curvature), 1e-150))
    normal = curvature / np.outer(lengths, lengths)
    powers, axes = np.linalg.eigh(normal)
    powers = np.maximum(powers, 1e-12)
    turned = (scores / lengths) @ axes
    spread = turned.T @ turned * (count / max(count - terms, 1))
    inflation = float(np.median(np.diag(spread) / powers))
    # No direction is known better than the curvature allows: where the data show nothing, the scores vanish, too.
    widened = np.maximum(np.diag(spread), inflation * powers)
    factor = np.sqrt(widened / np.maximum(np.diag(spread), 1e-30))
    spread = spread * np.outer(factor, factor)
    turned_back = axes / powers
    covariance: FloatArray = turned_back @ spread @ turned_back.T / np.outer(lengths, lengths)
    return np.clip(covariance, -1e6, 1e6)
