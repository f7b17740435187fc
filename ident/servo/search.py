"""Output error of servo joints: robust Levenberg-Marquardt on roll-outs side by side, and 95 % intervals at its end.

Joints are searched on their own at first, with the torques between them as known; then all of an arm together, since
a joint shows in the motion of those that it moves.

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
PATIENCE, JUMP = 4, 0.03
"""A joint that sticks elsewhere makes the cost jump: steps of a whole arm that are followed although the cost rises by
such a share, until the next has to be better than all before."""

STILL = 3e-4
"""Relative fall of a joint's cost at which its search ends."""

WIDEST = 3.0
"""Ratio of an interval's end to the value beyond which a positive term cannot be determined."""

TIMING = 0.1
"""Steps by which a roll-out may be early or late: intervals of a delay reach so much further."""

MOVE = 0.25
"""[s] of a move by a profile, early or late by so much twice: intervals of its acceleration reach further, too."""

CONFIDENCE = 0.95

UNSEEN = 1e-3
"""σ of the prior over that of a ridge without which intervals of what the data do not show at all have no end."""

LEAST_REST = 0.05
"""Share of a curvature that a piece leaves to the others, at least: what a single piece shows has no spread."""

CHUNK = 3e6
"""Derivatives that are held at once, at most."""

BIAS = 3e-4
"""[rad or m] σ of the prior of a bias: a digital loop holds to a few steps of its encoder, say 3 mrad, and of about 100
samples of a roll-out one is independent. A wider one lets a joint's torques grow until a bias stands for gravity."""

_SPREAD = np.array([term.spread for term in TERMS])
_PRIOR = np.array([BIAS if term.name == "bias" else term.spread for term in TERMS])


def evaluate(lanes: Lanes, values: FloatArray, free: BoolArray | None = None) -> tuple[FloatArray, FloatArray]:
    """Residuals (S, L) and their derivatives (F, S, L) by the terms that are free in some joint."""
    columns = None if free is None else np.flatnonzero(free.any(axis=0))
    path, tangents = roll_out(lanes, values[lanes.joint].T, columns)[:2]
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


def search_arm(
    lanes: Lanes,
    values: FloatArray,
    free: BoolArray,
    scale: FloatArray,
    centre: FloatArray,
    evaluations: int,
    shape: float,
) -> FloatArray:
    """The same for lanes whose joints move each other: values (n, terms) of least cost of the whole arm."""
    owners, terms = np.nonzero(free)
    if not len(owners):
        return values
    point, precision, damping = to_search(values), 1.0 / _PRIOR[terms] ** 2, DAMPING_START
    curvatures, gradients = _equations(lanes, values, free, scale, shape)
    cost = joint_cost(evaluate(lanes, values)[0], lanes, scale, shape) + _prior(point, centre, free)
    least, best, waited = float(cost.sum()), (point, curvatures, gradients), 0
    for _ in range(evaluations):
        curvature = curvatures.sum(axis=0) + np.diag(precision)
        gradient = gradients.sum(axis=0) + precision * (point - centre)[owners, terms]
        move = -np.linalg.lstsq(curvature + damping * np.diag(np.diag(curvature)), gradient, rcond=None)[0]
        step = np.zeros_like(point)
        step[owners, terms] = np.clip(move, -0.7 * _SPREAD[terms], 0.7 * _SPREAD[terms])
        trial = to_search(np.where(free, from_search(point + step), values))
        moved = np.where(free, from_search(trial), values)
        cost = joint_cost(evaluate(lanes, moved)[0], lanes, scale, shape) + _prior(trial, centre, free)
        fall, waited = least - float(cost.sum()), waited + 1
        if fall > 0:
            point, (curvatures, gradients) = trial, _equations(lanes, moved, free, scale, shape)
            least, best, damping, waited = least - fall, (trial, curvatures, gradients), damping / DAMPING_FACTOR, 0
            if fall < 0.1 * STILL * least:
                break
        elif waited % PATIENCE and -fall < JUMP * least:
            point, (curvatures, gradients) = trial, _equations(lanes, moved, free, scale, shape)
        else:
            (point, curvatures, gradients), damping = best, damping * DAMPING_FACTOR
        if waited > 2 * PATIENCE or damping > DAMPING_LIMIT:
            break
    return np.where(free, from_search(best[0]), values)


def _equations(
    lanes: Lanes, values: FloatArray, free: BoolArray, scale: FloatArray, shape: float, share: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Curvature (P, m, m) and gradient (P, m) by the free terms, joint after joint.

    The curvature is times the `share` (n,) of each joint's residuals.
    """
    pieces, joints, (owners, terms) = np.unique(lanes.piece), len(values), np.nonzero(free)
    columns = np.flatnonzero(free.any(axis=0))
    rows = np.searchsorted(columns, terms) + owners * len(columns)
    share = np.ones(joints) if share is None else share
    gradients = np.empty((len(pieces), len(owners)))
    curvatures = np.empty((len(pieces), len(owners), len(owners)))
    many = max(1, int(CHUNK / (joints * joints * max(len(columns), 1) * len(lanes.load))))
    for first in range(0, len(pieces), many):
        part = lanes.of_pieces(pieces[first : first + many])
        if part.between is None:
            raise AssertionError("the joints of these lanes do not move each other")
        path, tangents = roll_out(part, values[part.joint].T, columns)[:2]
        residual, slopes = at_samples(part, path) - part.measured, at_samples(part, tangents[rows])
        for number in range(len(np.unique(part.piece))):
            own = slice(number * joints, (number + 1) * joints)
            counted = np.isfinite(residual[:, own])
            wide = np.broadcast_to(scale, counted.shape)[counted]
            error, slope = residual[:, own][counted] / wide, slopes[:, :, own][:, counted] / wide
            weight = loss(error, shape)[1]
            counts = weight * np.broadcast_to(share, counted.shape)[counted]
            curvatures[first + number], gradients[first + number] = (slope * counts) @ slope.T, slope @ (weight * error)
    return curvatures, gradients


Intervals = tuple[FloatArray, FloatArray, BoolArray, BoolArray, tuple[FloatArray, ...]]


def intervals(lanes: Lanes, values: FloatArray, free: BoolArray, least: float) -> Intervals:
    """Ends (n, terms) of 95 % intervals, which terms are seen and which no piece shows, covariances by joint.

    From the spread between the pieces of motion, of all terms of the arm together: autocorrelation within a piece does
    no harm.

    Args:
        lanes: pieces of motion whose joints move each other.
        values: (n, terms) at the optimum.
        free: (n, terms) that were searched.
        least: smallest scale of errors [rad or m].
    """
    from scipy.special import stdtrit  # here, since it is slow to import

    low, high = np.full_like(values, np.nan), np.full_like(values, np.nan)
    seen, wide, (owners, terms) = np.zeros_like(free), np.zeros_like(free), np.nonzero(free)
    residual = evaluate(lanes, values)[0]
    scale = robust_scale(residual, lanes, len(values), least)
    share = _bend(residual / scale[lanes.joint], lanes.joint, len(values))
    curvatures, gradients = _equations(lanes, values, free, scale, BLOCKED_LITTLE, share)
    covariance, allowed = _spread(curvatures, gradients, np.diag((UNSEEN / _SPREAD[terms]) ** 2))
    quantile = float(stdtrit(max(1, len(gradients) - 1), 0.5 + CONFIDENCE / 2))
    reach, least_reach = quantile * np.sqrt(np.diag(covariance)), quantile * np.sqrt(allowed)
    point = to_search(values)
    for joint, index, half, shown in zip(owners, terms, reach, least_reach, strict=True):
        term, ends = TERMS[index], np.tile(point[joint], (2, 1))
        further = TIMING * lanes.step * {"delay": 1.0, "acceleration_limit": 2.0 / MOVE}.get(term.name, 0.0)
        ends[:, index] += np.array([-1.0, 1.0]) * (min(half, 50.0) + further)
        low[joint, index], high[joint, index] = from_search(ends)[:, index]
        widest = np.log(WIDEST) if term.positive else term.spread
        seen[joint, index], wide[joint, index] = half < widest, shown >= widest
    blocks = tuple(covariance[np.ix_(owners == joint, owners == joint)] for joint in range(len(values)))
    return low, high, seen, wide, blocks


def _bend(error: FloatArray, joint: IndexArray, joints: int) -> FloatArray:
    """(n,) the loss's second derivative over its weights, means of each joint's errors (S, L): weights know no bend."""
    weight = loss(error, BLOCKED_LITTLE)[1]
    bend = (1.0 - 0.5 * error**2) * weight**2
    sums = [np.array([np.nansum(each[:, joint == row]) for row in range(joints)]) for each in (bend, weight)]
    return np.asarray(np.clip(sums[0] / np.maximum(sums[1], 1e-12), 0.2, 1.0), dtype=np.float64)


def _spread(curvatures: FloatArray, gradients: FloatArray, ridge: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Covariance (m, m) from what each piece's curvature (P, m, m) and gradient (P, m) say; `ridge` (m, m) beside them.

    A piece has drawn the terms towards itself, by the share of the curvature that it has: its gradient is divided by
    the root of the rest (R. M. Bell, D. F. McCaffrey, "Bias reduction in standard errors for linear regression with
    multi-stage samples", Survey Methodology 28, 2002). No term is known better than the curvature allows with the
    inflation that most show: where the data show nothing, or a single piece does, the gradients vanish, too.

    Also the variances (m,) that the curvature of all pieces together allows.
    """
    whole = curvatures.sum(axis=0) + ridge
    lengths = np.sqrt(np.diag(whole))
    powers, axes = np.linalg.eigh(whole / np.outer(lengths, lengths))
    root = axes / np.sqrt(np.maximum(powers, 1e-12)) / lengths[:, None]
    pulls = (gradients - gradients.mean(axis=0)) @ root
    shares, own = np.linalg.eigh(root.T @ curvatures @ root)
    rest = np.sqrt(np.maximum(1.0 - shares, LEAST_REST))
    moved = np.einsum("pij,pj,pkj,pk->pi", own, 1.0 / rest, own, pulls, optimize=True) @ root.T
    spread, allowed = moved.T @ moved, np.sum(root**2, axis=1)
    found = np.diag(spread)
    allowed = allowed * float(np.median(found / np.maximum(allowed, 1e-300)))
    factor = np.sqrt(np.maximum(found, allowed) / np.maximum(found, 1e-300))
    return np.clip(spread * np.outer(factor, factor), -1e6, 1e6), allowed
