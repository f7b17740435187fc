"""First fit of a servo arm: values by linear regression, then with whatever limits how fast each joint follows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from drivers.core.arrays import BoolArray, FloatArray, IndexArray
from ident.servo.links import ServoLinks
from ident.servo.motion import ServoMotion, some_pieces
from ident.servo.rollout.lanes import Lanes, repeated
from ident.servo.search import BLOCKED_LITTLE, EVERY_ERROR, evaluate, joint_cost, lane_cost, robust_scale, search
from ident.servo.terms import INDEX, members, start_values, to_search, with_group

STARTING_PIECES = 24
"""Pieces at most in the first searches from several limits of acceleration."""

LIKE = 2
"""Joints with a profile, at least, from which on another is taken to have one alike."""

GAIN = 1.3
"""What a term saves on held-out pieces, over what it costs on others: no t-test, since a limit of acceleration shows in
few pieces, and there clearly."""

LEAST_GAIN = 0.01
"""Share of the cost of held-out pieces that a profile must save."""

ACCELERATIONS = (5.0, 10.0, 20.0, 40.0, 80.0, 160.0)
"""[rad/s²] Starts of a profile's limit."""

SATURATIONS = (0.4, 0.2, 0.1)
"""Starts of a drive's limit, over the torque that the largest position error would ask for: the first of equal ones is
the highest, since a lower one that these pieces do not reach lets the joint fall in others."""

OWN_START = 0.1
"""Share of its cost that a joint's own start has to save against that which is best for all joints."""

FIRST_GROUPS = ("profile", "saturation")
"""Optional terms of which one is settled with those that every joint has: either limits how fast a joint follows."""

CLEAR = 3.0
"""Times the median change of a held-out piece's cost from which on a change counts for `GAIN`."""

MOVING = 0.02
"""[rad/s] of a joint in the regression that gives the start."""

CONTRADICTED = 0.5
"""Share of the cost of held-out pieces that is left without what was declared, below which it is not believed (0.46 at
45 rad/s² where 39 were declared, 0.1 without a profile; 0.8 to 0.95 on a real SO-101, where the profile is set)."""


def regressed_values(motions: Sequence[ServoMotion], links: ServoLinks) -> FloatArray:
    """Values from a regression of the position error on gravity, friction's direction and velocity."""
    joints = motions[0].position.shape[1]
    values = start_values(joints)
    gravity = np.concatenate([links.gravity(motion.position.T) for motion in motions], axis=1)
    errors, velocities = [], []
    for motion in motions:
        commanded = np.stack(
            [np.interp(motion.time, motion.grid, column) for column in motion.command[motion.history :].T], axis=1
        )
        errors.append(commanded - motion.position)
        velocities.append(np.gradient(motion.position, motion.time, axis=0))
    error, velocity = np.concatenate(errors).T, np.concatenate(velocities).T
    stiffness = np.full(joints, np.nan)
    for joint in range(joints):
        moving = np.abs(velocity[joint]) > MOVING
        if np.count_nonzero(moving) < 50:
            continue
        columns = np.stack(
            [gravity[joint], np.sign(velocity[joint]), velocity[joint], np.ones_like(velocity[joint])], axis=1
        )[moving]
        slope, friction, lag, _ = np.linalg.lstsq(columns, error[joint][moving], rcond=None)[0]
        if slope > 0 and np.ptp(columns[:, 0]) * slope > 1e-3:
            stiffness[joint] = 1.0 / slope
        values[joint, INDEX["damping"]] = np.clip(lag, 5e-3, 0.5)
        values[joint, INDEX["coulomb"]] = np.clip(friction, 1e-4, 0.2)
    common = float(np.nanmedian(stiffness)) if np.isfinite(stiffness).any() else float(values[0, INDEX["stiffness"]])
    common = float(np.clip(common, 1e-2, 1e5))
    # Servos of one arm are mostly of one kind, and friction disturbs a single joint's ratio of sag to gravity.
    values[:, INDEX["stiffness"]] = stiffness = np.full(joints, common)
    values[:, INDEX["damping"]] *= stiffness
    values[:, INDEX["coulomb"]] *= stiffness
    # A servo's loop is overdamped: half of its lag would be its inertia at critical damping.
    values[:, INDEX["armature"]] = 0.1 * values[:, INDEX["damping"]] ** 2 / stiffness
    return values


def begun_fit(
    chosen: Lanes,
    judged: Lanes,
    values: FloatArray,
    free: BoolArray,
    centre: FloatArray,
    moving: BoolArray,
    held: BoolArray,
    least: float,
    declared: Mapping[tuple[int, str], float],
) -> tuple[FloatArray, BoolArray, FloatArray, BoolArray, list[dict[str, float]]]:
    """Values, free terms, prior, held terms (n, terms) and savings of first fits without and with what was declared.

    What was declared is held, unless the data clearly contradict it.
    """
    fits = []
    for known in ({}, declared)[: 1 + bool(declared)]:
        start, own_centre, own_held = values.copy(), centre.copy(), held.copy()
        gains: list[dict[str, float]] = [{} for _ in held]
        for (joint, name), value in known.items():
            start[joint, INDEX[name]], own_held[joint, INDEX[name]] = value, True
        rows = np.flatnonzero(moving)
        fitted = first_fit(chosen, judged, start, free & ~own_held, own_centre, rows, own_held, least, gains)
        fits.append((*fitted, own_centre, own_held, gains))
    return fits[believed(judged, [fit[0] for fit in fits], least)]


def believed(judged: Lanes, values: Sequence[FloatArray], least: float) -> int:
    """The last of values (n, terms), which is what was declared, unless pieces that were not fitted contradict it."""
    scale = error_scale(judged, values[0], least)
    costs = [float(joint_cost(evaluate(judged, own)[0], judged, scale, EVERY_ERROR).sum()) for own in values]
    return 0 if costs[0] < CONTRADICTED * costs[-1] else len(costs) - 1


def first_fit(
    chosen: Lanes,
    judged: Lanes,
    values: FloatArray,
    free: BoolArray,
    centre: FloatArray,
    moving: IndexArray,
    held: BoolArray,
    least: float,
    gains: list[dict[str, float]],
) -> tuple[FloatArray, BoolArray]:
    """Values of the terms that every joint has, without a limit and with each of several, whichever fits best.

    What limits how fast a joint follows changes what all other terms have to explain: it is settled before they are. A
    profile that is the wrong answer to a drive's limit stays the best one, once they have made up for it.
    """
    limit = INDEX["acceleration_limit"]
    plain = search(chosen, values, free, error_scale(chosen, values, least), centre, 10, EVERY_ERROR)
    plain = search(chosen, plain, free, error_scale(chosen, plain, least), centre, 15, EVERY_ERROR)
    scale = error_scale(chosen, plain, least)
    starts, searched, frees, able = [], [], [], []
    for group, levels in zip(FIRST_GROUPS, (ACCELERATIONS, SATURATIONS), strict=True):
        able.append(moving[~held[moving][:, members(group)].any(axis=1)])
        trial, trial_free = with_group(values, free, able[-1].tolist(), group)
        for level in levels:
            start = trial.copy()
            start[able[-1], members(group)] = level
            if group == "saturation":
                start[able[-1], members(group)] *= largest_torques(chosen, values)[able[-1]]
            starts.append(start)
            # a profile is held at first: all other terms would make up for a wrong one
            searched.append(free if group == "profile" else trial_free)
            frees.append(trial_free)
    # all starts side by side
    begun, many = np.concatenate(starts), len(starts)
    wide, every_free = repeated(some_pieces(chosen, STARTING_PIECES), many, len(values)), np.concatenate(frees)
    centres = np.where(every_free & ~np.tile(free, (many, 1)), to_search(begun), np.tile(centre, (many, 1)))
    begun = search(wide, begun, np.concatenate(searched), np.tile(scale, many), centres, 8, EVERY_ERROR)
    costs = joint_cost(evaluate(wide, begun)[0], wide, np.tile(scale, many), EVERY_ERROR).reshape(many, -1)
    # a profile and a drive's limit are distinguished by searches to their ends
    ended, rows = [], np.arange(len(values))
    for part in (slice(0, len(ACCELERATIONS)), slice(len(ACCELERATIONS), many)):
        cheapest = (part.start + _of_one_kind(costs[part], moving)) * len(values) + rows
        best, best_free, best_centre = begun[cheapest], every_free[cheapest], centres[cheapest]
        best = search(chosen, best, best_free, scale, best_centre, 10, EVERY_ERROR)
        best = search(chosen, best, best_free, error_scale(chosen, best, least), best_centre, 15, EVERY_ERROR)
        ended.append((best, best_free, best_centre))
    kind = _of_one_kind(
        np.array([joint_cost(evaluate(judged, end[0])[0], judged, scale, EVERY_ERROR) for end in ended]), moving
    )
    best, best_free, best_centre = (np.stack(arrays)[kind, rows] for arrays in zip(*ended, strict=True))
    offered = np.union1d(able[0], able[1]).tolist()
    saved = savings(judged, plain, best, offered, least, EVERY_ERROR)
    profiled = [joint for joint in saved if best_free[joint, limit]]
    left = np.array([joint for joint in able[0].tolist() if joint not in saved], dtype=np.intp)
    if len(left) and len(profiled) >= LIKE:
        # Servos of one arm are mostly of one kind: those that found no limit begin again with the others' profile.
        own = chosen.of(np.flatnonzero(np.isin(chosen.joint, left)))
        alike, alike_free = with_group(values, free, left.tolist(), "profile")
        for name in ("acceleration_limit", "delay"):
            alike[left, INDEX[name]] = np.median(best[profiled, INDEX[name]])
        only = alike_free & np.isin(np.arange(len(values)), left)[:, None]
        best_centre[left, limit] = to_search(alike)[left, limit]
        held_limit = only.copy()
        held_limit[:, limit] = False
        for freed in (held_limit, only):
            alike = search(own, alike, freed, scale, best_centre, 12, EVERY_ERROR)
        best[left], best_free[left] = alike[left], alike_free[left]
        saved = savings(judged, plain, best, offered, least, EVERY_ERROR)
    kept = list(saved)
    values, free = plain.copy(), free.copy()
    values[kept], free[kept], centre[kept] = best[kept], best_free[kept], best_centre[kept]
    for joint, share in saved.items():
        gains[joint]["profile" if best_free[joint, limit] else "saturation"] = share
    return values, free


def _of_one_kind(costs: FloatArray, moving: IndexArray) -> IndexArray:
    """(n,) the cheapest start of each joint by costs (starts, n): that of all, or one of its own if clearly better."""
    common = np.argmin(costs[:, moving].sum(axis=1))
    clearly = costs.min(axis=0) < (1.0 - OWN_START) * costs[common]
    return np.where(clearly, np.argmin(costs, axis=0), common)


def limited_by(lanes: Lanes, values: FloatArray, able: Sequence[int] | IndexArray, scale: FloatArray) -> None:
    """Give some joints a drive's limit, in place, the best start: one that no sample reaches has no slope."""
    starts, costs = np.array(SATURATIONS)[:, None] * largest_torques(lanes, values), []
    for start in starts:
        values[able, INDEX["torque_limit"]] = start[able]
        costs.append(joint_cost(evaluate(lanes, values)[0], lanes, scale, BLOCKED_LITTLE))
    values[able, INDEX["torque_limit"]] = np.choose(np.argmin(costs, axis=0), starts)[able]


def largest_torques(lanes: Lanes, values: FloatArray) -> FloatArray:
    """(n,) torques that the largest position errors of any piece would ask for, if the joint stood still."""
    reach = np.zeros(len(values))
    np.maximum.at(reach, lanes.joint, np.abs(lanes.command[lanes.history :] - lanes.start).max(axis=0))
    return np.asarray(values[:, INDEX["stiffness"]] * np.maximum(reach, 1e-3), dtype=np.float64)


def savings(
    judged: Lanes,
    before: FloatArray,
    after: FloatArray,
    able: Sequence[int],
    least: float,
    shape: float,
    share: float = LEAST_GAIN,
) -> dict[int, float]:
    """Joints whose cost on held-out pieces falls clearly, and by what share."""
    residual = evaluate(judged, before)[0]
    scale = robust_scale(residual, judged, len(before), least)
    old = _piece_costs(residual, judged, scale, shape)
    new = _piece_costs(evaluate(judged, after)[0], judged, scale, shape)
    saved = {}
    for joint in able:
        difference = old[joint] - new[joint]
        total = float(difference.sum())
        clear = difference[np.abs(difference) > CLEAR * np.median(np.abs(difference))]
        helps = any(
            float(changes[changes > 0].sum()) > -GAIN * float(changes[changes < 0].sum())
            for changes in (difference, clear)
        )
        if helps and total > share * float(old[joint].sum()):
            saved[joint] = total / float(old[joint].sum())
    return saved


def _piece_costs(residual: FloatArray, lanes: Lanes, scale: FloatArray, shape: float) -> list[FloatArray]:
    """Robust cost of each joint's pieces."""
    return [lane_cost(residual, lanes, scale, shape)[lanes.joint == joint] for joint in range(len(scale))]


def error_scale(lanes: Lanes, values: FloatArray, least: float) -> FloatArray:
    """(n,) of each joint's errors with these values, at least so much [rad or m]."""
    return robust_scale(evaluate(lanes, values)[0], lanes, len(values), least)
