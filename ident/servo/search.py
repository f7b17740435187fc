"""Output error of servo joints: robust Levenberg-Marquardt on roll-outs side by side, and 95 % intervals at its end.

Joints are searched on their own at first, with the torques between them as known; then all of an arm together, since
a joint shows in the motion of those that it moves.

The loss of an error e (in scales) is Barron's ("A general and adaptive robust loss function", CVPR 2019) of shape α:
2·(√(e² + 1) − 1) for α = 1, which every error pulls at, and 2·log(e²/2 + 1) for α = 0, which a joint that something
blocked for seconds hardly pulls at.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from drivers.core.arrays import BoolArray, FloatArray, IndexArray
from ident.servo.rollout.lanes import Lanes, at_samples
from ident.servo.rollout.rollout import roll_out
from ident.servo.terms import TERMS, from_search, to_search

DAMPING_START = 1e-2
DAMPING_FACTOR = 4.0
DAMPING_LIMIT = 1e5
PATIENCE, JUMP = 4, 0.03
"""A joint that sticks elsewhere makes the cost jump: steps of a whole arm that are followed although the cost rises by
such a share, until the next has to be better than all before."""

NEAR = 0.01
"""Share of the cost by which a trial of a whole arm may be above the best, to count for where it ends: the cost is
rough, and its lowest trial is one by chance."""

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

ALIKE = {"delay": 1e-3, "acceleration_limit": 0.01}
"""σ [s, logarithm] of the prior of a joint's delay and limit about their mean in the arm, for the same 100 samples: bus
and firmware are those of all joints. Alone, a joint's delay goes to −50 ms where its lag makes up for it."""

_SPREAD = np.array([term.spread for term in TERMS])
_PRIOR = np.array([BIAS if term.name == "bias" else term.spread for term in TERMS])


def evaluate(lanes: Lanes, values: FloatArray, free: BoolArray | None = None) -> tuple[FloatArray, FloatArray]:
    """Residuals (S, L) and their derivatives (L, S, F) by the terms of each lane that are free in some joint."""
    columns = None if free is None else np.flatnonzero(free.any(axis=0))
    rolled = roll_out(lanes, values[lanes.joint].T, columns)
    return at_samples(lanes, rolled.path) - lanes.measured, rolled.slopes[:, :, 0]


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


@dataclass(eq=False)
class _Descent:
    """Levenberg-Marquardt on parameters that are searched together: those of a joint, or of a whole arm."""

    free: BoolArray  # (n, terms) of the parameters
    patience: int  # trials that are followed although the cost rises, until the next has to be better than all before
    still: float  # relative fall of the cost at which it ends
    # coordinates, curvature and gradient of the least cost
    best: tuple[FloatArray, FloatArray, FloatArray] = (np.empty(0), np.empty(0), np.empty(0))
    # of the trial that the next step begins at
    followed: tuple[FloatArray, FloatArray, FloatArray] = (np.empty(0), np.empty(0), np.empty(0))
    least: float = np.inf  # cost of the best
    damping: float = DAMPING_START * DAMPING_FACTOR  # over the curvature's diagonal
    waited: int = 0  # trials since the best
    done: bool = False  # whether it has ended
    # cost, coordinates, curvature and gradient of all
    trials: list[tuple[float, FloatArray, FloatArray, FloatArray]] = field(default_factory=list)

    def judge(self, trial: FloatArray, curvature: FloatArray, gradient: FloatArray, cost: float) -> None:
        """Take a trial, follow it although it is worse, or go back."""
        fall, self.waited = self.least - cost, self.waited + 1
        self.trials.append((cost, trial, curvature, gradient))
        if fall > 0:
            self.done = fall < self.still * self.least
            self.best = self.followed = (trial, curvature, gradient)
            self.least, self.damping, self.waited = cost, self.damping / DAMPING_FACTOR, 0
        elif self.waited % self.patience and -fall < JUMP * self.least:
            self.followed = (trial, curvature, gradient)
        else:
            self.followed, self.damping = self.best, self.damping * DAMPING_FACTOR
        self.done |= self.damping > DAMPING_LIMIT or (self.patience > 1 and self.waited > 2 * self.patience)

    def averaged(self) -> FloatArray:
        """Where the tangents at all trials that are nearly as good as the best lead to, together."""
        near = [trial for trial in self.trials if trial[0] < (1.0 + NEAR) * self.least]
        whole = np.sum([curvature for _, _, curvature, _ in near], axis=0)
        pulled = np.sum([curvature @ trial - gradient for _, trial, curvature, gradient in near], axis=0)
        return np.asarray(np.linalg.solve(whole, pulled), dtype=np.float64)

    def next_trial(self, longest: FloatArray) -> FloatArray:
        """Coordinates of the next trial, at most so far from those that are followed."""
        point, curvature, gradient = self.followed
        move = np.linalg.solve(curvature + self.damping * np.diag(np.diag(curvature)), gradient)
        return np.asarray(point - np.clip(move, -longest, longest), dtype=np.float64)


def search(
    lanes: Lanes,
    values: FloatArray,
    free: BoolArray,
    scale: FloatArray,
    centre: FloatArray,
    evaluations: int,
    shape: float,
) -> FloatArray:
    """Values (n, terms) of least robust cost plus weak prior: of each joint, or of an arm whose joints move each other.

    Args:
        lanes: pieces of motion.
        values: (n, terms) start.
        free: (n, terms) to search.
        scale: (n,) of the errors [rad or m].
        centre: (n, terms) of the prior, in the search's coordinates.
        evaluations: of roll-outs after the first, at most.
        shape: of the loss.
    """
    together = lanes.between is not None
    owned = [free & (np.arange(len(free)) == joint)[:, None] for joint in np.flatnonzero(free.any(axis=1))]
    blocks = [free] if together and owned else owned
    descents = [_Descent(block, PATIENCE if together else 1, STILL * (0.1 if together else 1.0)) for block in blocks]
    trial, likeness = to_search(values), _likeness(free) if together else np.zeros((1, 1))
    for evaluation in range(evaluations + 1):
        running = [each for each in descents if not each.done]
        if not running:
            break
        if evaluation:
            for each in running:
                trial[each.free] = each.next_trial(0.7 * np.tile(_SPREAD, (len(free), 1))[each.free])
            trial = to_search(np.where(free, from_search(trial), values))
            kept = np.any([each.free.any(axis=1) for each in running], axis=0)[lanes.joint]
            if not together and not kept.all():
                lanes = lanes.of(np.flatnonzero(kept))  # what has settled is not rolled out again
        moved = np.where(free, from_search(trial), values)
        summed = _sums(lanes, moved, [each.free for each in running], scale, shape)
        prior = np.where(free, ((trial - centre) / _PRIOR) ** 2, 0.0)
        for each, (curvature, gradient, cost) in zip(running, summed, strict=True):
            precision = np.tile(_PRIOR**-2, (len(free), 1))[each.free]
            own = trial[each.free]
            pull = precision * (own - centre[each.free]) + (likeness @ own if together else 0.0)
            cost += float(prior[each.free].sum()) + (float(own @ likeness @ own) if together else 0.0)
            each.judge(own, curvature + np.diag(precision) + likeness, gradient + pull, cost)
    for each in descents:
        trial[each.free] = each.best[0]
    best = np.where(free, from_search(trial), values)
    if not (together and descents):
        return best
    trial[free] = descents[0].averaged()
    averaged = np.where(free, from_search(trial), values)
    # tangents at trials far apart, or along what the data hardly show, may lead away from all of them
    costs = [float(joint_cost(evaluate(lanes, end)[0], lanes, scale, shape).sum()) for end in (best, averaged)]
    return averaged if costs[1] < (1.0 + NEAR) * costs[0] else best


def _likeness(free: BoolArray) -> FloatArray:
    """Precision (F, F) of the free terms of an arm's joints about the mean of those that are `ALIKE`."""
    terms = np.nonzero(free)[1]
    precision = np.zeros((len(terms), len(terms)))
    for index, term in enumerate(TERMS):
        if term.name in ALIKE and (terms == index).any():
            rows = np.flatnonzero(terms == index)
            precision[np.ix_(rows, rows)] = (np.eye(len(rows)) - 1.0 / len(rows)) / ALIKE[term.name] ** 2
    return precision


def _sums(
    lanes: Lanes, values: FloatArray, blocks: Sequence[BoolArray], scale: FloatArray, shape: float
) -> list[tuple[FloatArray, FloatArray, float]]:
    """Curvature and gradient (half of the derivatives) of the robust cost by blocks of terms, and the cost."""
    if lanes.between is not None:
        curvature, gradient, cost = equations(lanes, values, blocks[0], scale, shape)
        return [(curvature.sum(axis=0), gradient.sum(axis=0), float(cost.sum()))]
    free = np.any(blocks, axis=0)
    columns = np.flatnonzero(free.any(axis=0))
    curvature, gradient, cost = equations(lanes, values, free, scale, shape)
    sums = []
    for block in blocks:
        joint = int(np.flatnonzero(block.any(axis=1))[0])
        own, rows = np.searchsorted(columns, np.flatnonzero(block[joint])), lanes.joint == joint
        total = curvature[rows].sum(axis=0)[np.ix_(own, own)]
        sums.append((total, gradient[rows].sum(axis=0)[own], float(cost[rows].sum())))
    return sums


def equations(
    lanes: Lanes, values: FloatArray, free: BoolArray, scale: FloatArray, shape: float, share: FloatArray | None = None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Curvature (P, F, F), gradient (P, F) and robust cost (P,) of each piece; of lanes alone, each is a piece.

    By the free terms of all joints, joint after joint; of lanes alone by those that are free in some joint. The
    curvature is times the `share` (n,) of each joint's residuals.
    """
    owners, terms = np.nonzero(free)
    joints = len(free) if lanes.between is not None else 1
    if lanes.between is None:
        terms = np.unique(terms)
        owners = np.zeros_like(terms)
    pieces, samples = len(lanes.joint) // joints, len(lanes.sample)
    curvature, gradient = np.empty((pieces, len(terms), len(terms))), np.empty((pieces, len(terms)))
    cost, many = np.empty(pieces), max(1, int(CHUNK / (joints * samples * max(len(terms), 1))))
    share = np.ones(len(free)) if share is None else share
    for first in range(0, pieces, many):
        part = slice(first, min(first + many, pieces))
        own = lanes if many >= pieces else lanes.consecutive(part, joints)
        joint = own.joint.reshape(-1, 1, joints)
        rolled = roll_out(own, values[own.joint].T, terms, owners)
        residual = (at_samples(own, rolled.path) - own.measured).reshape(samples, -1, joints).swapaxes(0, 1)
        error = residual / scale[joint]
        counted = np.isfinite(error)
        error[~counted] = 0.0
        losses, weight = loss(error, shape)
        root = np.where(counted, np.sqrt(weight), 0.0)
        slopes = rolled.slopes
        slopes *= (root / scale[joint])[..., None]
        slopes = slopes.reshape(len(root), -1, len(terms))
        pulled = (root * error).reshape(len(root), -1, 1)
        gradient[part] = np.matmul(slopes.swapaxes(1, 2), pulled)[:, :, 0]
        if share.min() < 1.0:
            slopes *= np.sqrt(np.broadcast_to(share[joint], root.shape)).reshape(len(root), -1, 1)
        curvature[part] = np.matmul(slopes.swapaxes(1, 2), slopes)
        cost[part] = losses.sum(axis=(1, 2))
    return curvature, gradient, cost


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
    curvatures, gradients, _ = equations(lanes, values, free, scale, BLOCKED_LITTLE, share)
    ridge = np.diag((UNSEEN / _SPREAD[terms]) ** 2)
    covariance, allowed, freedom = _spread(curvatures, gradients, ridge)
    found = np.diag(covariance)
    # the cost is rough, and a search ends where no trial was better: so far is it to where the pieces' slopes point
    left = np.linalg.solve(curvatures.sum(axis=0) + ridge, gradients.sum(axis=0))
    covariance = _at_least(covariance, allowed) + np.outer(left, left)
    own, quantile = stdtrit([freedom, np.full_like(freedom, max(1, len(gradients) - 1))], 0.5 + CONFIDENCE / 2)
    least_reach = quantile * np.sqrt(allowed)
    reach = np.hypot(np.maximum(own * np.sqrt(found), least_reach), own * left)
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


def _spread(
    curvatures: FloatArray, gradients: FloatArray, ridge: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Covariance (m, m) from what each piece's curvature (P, m, m) and gradient (P, m) say; `ridge` (m, m) beside them.

    A piece has drawn the terms towards itself, by the share of the curvature that it has: its gradient is divided by
    the root of the rest, and few pieces that show a term tell its spread badly, by the degrees of freedom (m,) of
    Satterthwaite's approximation (R. M. Bell, D. F. McCaffrey, "Bias reduction in standard errors for linear regression
    with multi-stage samples", Survey Methodology 28, 2002).

    Also the variances (m,) that the curvature of all pieces together allows, with the inflation that most show: no term
    is known better. Where the data show nothing, or a single piece does, the gradients vanish, too.
    """
    whole = curvatures.sum(axis=0) + ridge
    lengths = np.sqrt(np.diag(whole))
    powers, axes = np.linalg.eigh(whole / np.outer(lengths, lengths))
    root = axes / np.sqrt(np.maximum(powers, 1e-12)) / lengths[:, None]
    pulls = (gradients - gradients.mean(axis=0)) @ root
    shares, own = np.linalg.eigh(root.T @ curvatures @ root)
    rest = np.sqrt(np.maximum(1.0 - shares, LEAST_REST))
    weights = (own / rest[:, None, :]) @ own.swapaxes(1, 2) @ root.T  # (P, m, m) of each piece's pull on each term
    moved = np.einsum("pj,pji->pi", pulls, weights)
    spread, allowed = moved.T @ moved, np.sum(root**2, axis=1)
    between = (own * shares[:, None, :]) @ own.swapaxes(1, 2)
    freedom = np.empty(len(allowed))
    for term in range(len(allowed)):
        weight = weights[:, :, term]
        drawn = np.einsum("pij,pj->pi", between, weight)
        expected = np.diag(np.einsum("pi,pi->p", weight, drawn)) - drawn @ drawn.T
        freedom[term] = np.trace(expected) ** 2 / max(float(np.sum(expected**2)), 1e-300)
    found = np.diag(spread)
    allowed = allowed * float(np.median(found / np.maximum(allowed, 1e-300)))
    return spread, allowed, np.maximum(freedom, 1.0)


def _at_least(covariance: FloatArray, variances: FloatArray) -> FloatArray:
    """The covariance (m, m) with variances of so much at least (m,), at the same correlations."""
    found = np.diag(covariance)
    factor = np.sqrt(np.maximum(found, variances) / np.maximum(found, 1e-300))
    return np.asarray(np.clip(covariance * np.outer(factor, factor), -1e6, 1e6), dtype=np.float64)
