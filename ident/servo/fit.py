"""Fit of a servo arm: a start by linear regression, terms that held-out pieces ask for, values with 95 % intervals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers.core.arrays import BoolArray, FloatArray, IndexArray
from ident.servo.contact import Contact, away, find_contact, in_contact
from ident.servo.links import ServoLinks
from ident.servo.motion import PIECE, ServoMotion, halves, lanes_with_touch, measured_load, some_pieces
from ident.servo.rollout import Lanes, repeated, with_pull
from ident.servo.search import (
    BLOCKED_LITTLE,
    EVERY_ERROR,
    Intervals,
    evaluate,
    intervals,
    joint_cost,
    lane_cost,
    robust_scale,
    search,
    search_arm,
)
from ident.servo.terms import GROUPS, INDEX, TERMS, members, start_values, to_search, with_group, without_group

PIECES = 160
"""Pieces at most with which terms are chosen; the final fit takes `FINAL_PIECES`."""

FINAL_PIECES = 200

WANTED_PIECES, LONGEST_PIECE = 60, 12.0
"""Of long recordings, the pieces of the final fit are longer [s], as long as there are so many: a model is judged by
whole motions, and a piece begins at the measured position, which hides where friction would have stopped the joint."""

STARTING_PIECES = 40
"""Pieces at most in the first searches from several limits of acceleration."""

LIKE = 2
"""Joints with a profile, at least, from which on another is taken to have one alike."""

GAIN = 1.3
"""What a term saves on held-out pieces, over what it costs on others: no t-test, since a limit of acceleration shows in
few pieces, and there clearly."""

LEAST_GAIN = 0.01
"""Share of the cost of held-out pieces that a profile must save."""

LATE_GAIN, ZERO_GAIN = 0.05, 0.25
"""The same of a limit or a dead band, and of a zero: an offset makes up for some of what any joint's friction lacks, at
other torques and for these motions only."""

ACCELERATIONS = (5.0, 10.0, 20.0, 40.0, 80.0, 160.0)
"""[rad/s²] Starts of a profile's limit."""

LITTLE, FADING = 0.02, 0.1
"""Starts of load_breakaway and of the Stribeck velocity [rad/s]."""

LATE = ("load_breakaway", "stribeck_velocity")
"""Terms that are held in the first fit: a joint that breaks away from a large friction within a small velocity jumps,
and no search comes back from there."""

SATURATIONS = (0.1, 0.2, 0.4)
"""Starts of a drive's limit, over the torque that the largest position error would ask for."""

FIRST_GROUPS = ("profile", "saturation")
"""Optional terms of which one is settled with those that every joint has: either limits how fast a joint follows."""

FRICTION = ("load", "breakaway")
"""Groups that are fitted from the beginning, and taken away where nothing asks for them: without them all torques of a
joint grow until its bias and Coulomb friction take their part, and no search comes back from there. What the arm
touches is looked for after them, and before a zero could stand for it."""

CLEAR = 3.0
"""Times the median change of a held-out piece's cost from which on a change counts for `GAIN`."""

RESTING = 5.0
"""Encoder steps below which a joint is not commanded to move."""

TORQUES = ("stiffness", "damping", "armature", "coulomb", "breakaway", "torque_limit")
"""Terms that grow together where nothing ties the torques of a joint to N·m."""

LEAST_MOTOR = 0.1
"""Share of a joint's inertia that is its motor's, at least: gears make it count."""

TORQUE_FACTORS = tuple(2.0 ** (power / 4) for power in range(-8, 9))
"""Between the torques of a joint and those of an assumed stiffness, in a first search."""

MOVING = 0.02
"""[rad/s] of a joint in the regression that gives the start."""

Progress = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class ServoFit:
    """Parameters of an arm of servos.

    Attributes:
        values: (n, terms).
        low, high: (n, terms) ends of the 95 % intervals; nan of terms that were not searched.
        free: (n, terms) terms that were searched.
        seen: (n, terms) whether the data tell the term; False where it is absent or held.
        held: (n, terms) values that were given or assumed, not searched.
        assumed: those of `held` that were assumed, as (joint, term).
        moving: (n,) joints that are commanded to move.
        covariance: per joint, of its searched terms in the search's coordinates.
        gains: per joint, the share of the held-out cost that each optional term saved; kept ones only.
        pieces: number of pieces of motion in the fit.
        contact: what the arm touches; None without a sign of it.
    """

    values: FloatArray
    low: FloatArray
    high: FloatArray
    free: BoolArray
    seen: BoolArray
    held: BoolArray
    assumed: frozenset[tuple[int, int]]
    moving: BoolArray
    covariance: tuple[FloatArray, ...]
    gains: tuple[Mapping[str, float], ...]
    pieces: int
    contact: Contact | None


def fit_servo(
    motions: Sequence[ServoMotion],
    links: ServoLinks,
    resolution: FloatArray,
    given: Mapping[tuple[int, str], float],
    tool: tuple[int, FloatArray],
    progress: Progress,
) -> ServoFit:
    """Fit every joint, and what the arm touches.

    Args:
        motions: of one arm.
        links: of the arm.
        resolution: (n,) steps of the encoders [rad or m].
        given: known values by joint and term, which are held.
        tool: the link and its point (3,) [m] that may touch something.
        progress: called with the name of each step.
    """
    joints = motions[0].position.shape[1]
    progress("links along the motion")
    loads = [measured_load(links, motion, np.zeros(joints), known=True) for motion in motions]
    lanes = lanes_with_touch(motions, links, loads, tool[0])
    values, held = _start(motions, links), np.zeros((joints, len(TERMS)), dtype=np.bool_)
    for (joint, name), value in given.items():
        values[joint, INDEX[name]], held[joint, INDEX[name]] = value, True
    free = np.zeros_like(held)
    free[:, members("")] = True
    free &= ~held
    moving = np.max([np.ptp(motion.command, axis=0) for motion in motions], axis=0) > RESTING * resolution
    free[~moving] = False
    for group in FRICTION:
        able = np.flatnonzero(moving & ~held[:, members(group)].any(axis=1)).tolist()
        values, free = with_group(values, free, able, group)
        values = _beside_coulomb(values, able, group)
    late = free & np.isin(np.arange(len(TERMS)), [INDEX[name] for name in LATE])
    free &= ~late
    centre, least = to_search(values), float(np.min(resolution))
    weighted = links.weighted(np.concatenate([motion.position for motion in motions]).T)
    chosen, judged = halves(away(lanes, tool[1]), PIECES)
    progress("first fit")
    gains: list[dict[str, float]] = [{} for _ in range(joints)]
    values, free = _first_fit(chosen, judged, values, free, centre, np.flatnonzero(moving), held, least, gains)
    free |= late
    heavy = np.isin(np.arange(joints), weighted)
    scaled = (heavy & moving) | held[:, [INDEX[name] for name in TORQUES]].any(axis=1)
    inertia = np.array([lanes.inertia[:, lanes.joint == joint].mean() for joint in range(joints)])
    values, free, held, assumed = _tied(values, free, held, centre, (scaled, moving), inertia, given)
    values = search(chosen, values, free, _scale(chosen, values, least), centre, 10, BLOCKED_LITTLE)
    state = _State(lanes, lanes, values, free, held, assumed, None, gains)
    _settle_terms(state, (chosen, judged), motions, links, (centre, heavy, moving), tool, least, progress)
    _coupled_again(state, motions, links, tool[0])
    progress("final fit")
    final = some_pieces(state.kept, FINAL_PIECES)
    state.values = _of_whole_arm(final, state, centre, least)
    longer = _longer_pieces(state, final, motions, links, tool[0])
    if longer is not final:
        state.values = _of_whole_arm(longer, state, centre, least)
    if _pruned(final, state, least):
        state.values = _of_whole_arm(longer, state, centre, least)
    progress("torques of joints without gravity")
    low, high, seen, _, covariance = _settle_torques(state, final, longer, (centre, moving), inertia, given, least)
    pieces, contact = len(np.unique(final.piece)), state.contact
    if contact is not None:
        progress("contact")
        contact = find_contact(state.lanes, state.values, *tool, least, contact)
    values, free, held, assumed = state.values, state.free, state.held, state.assumed
    return ServoFit(values, low, high, free, seen, held, assumed, moving, covariance, tuple(gains), pieces, contact)


def _settle_torques(
    state: _State,
    final: Lanes,
    longer: Lanes,
    joints: tuple[FloatArray, BoolArray],
    inertia: FloatArray,
    given: Mapping[tuple[int, str], float],
    least: float,
) -> Intervals:
    """Find what ties the torques that gravity does not: inertia of links that change their pose, or other joints.

    Args:
        state: changed in place.
        final: pieces that intervals come from.
        longer: pieces of the last fit.
        joints: prior (n, terms), whether a joint moves (n,).
        inertia: (n,) of the links about each joint, on average.
        given: known values.
        least: smallest scale of errors.
    """
    (centre, moving), stiffness = joints, INDEX["stiffness"]
    again = np.array([joint for joint, term in state.assumed if term == stiffness and moving[joint]], dtype=np.intp)
    if len(again):
        state.free, state.held = state.free.copy(), state.held.copy()
        state.free[again, stiffness], state.held[again, stiffness] = True, False
        state.assumed -= {(joint, stiffness) for joint in again.tolist()}
        state.values = _scaled_torques(with_pull(final, state.values), state.values, again, inertia, least)
        state.values = _of_whole_arm(longer, state, centre, least)
    found = intervals(final, state.values, state.free, least)
    loose = state.free[:, stiffness] & ~found[2][:, stiffness]
    if not loose.any():
        return found
    scaled = (~loose, moving)
    state.values, state.free, state.held, more = _tied(
        state.values, state.free, state.held, centre, scaled, inertia, given
    )
    state.assumed |= more
    state.values = _of_whole_arm(longer, state, centre, least)
    return intervals(final, state.values, state.free, least)


@dataclass(eq=False)
class _State:
    """A fit under way: lanes, those without contact; the arm's values and terms as of `ServoFit`; what terms saved."""

    lanes: Lanes
    kept: Lanes
    values: FloatArray
    free: BoolArray
    held: BoolArray
    assumed: frozenset[tuple[int, int]]
    contact: Contact | None
    gains: list[dict[str, float]]


def _settle_terms(
    state: _State,
    parts: tuple[Lanes, Lanes],
    motions: Sequence[ServoMotion],
    links: ServoLinks,
    joints: tuple[FloatArray, BoolArray, BoolArray],
    tool: tuple[int, FloatArray],
    least: float,
    progress: Progress,
) -> None:
    """Try the optional terms one after the other, and a contact among them.

    Args:
        state: changed in place.
        parts: pieces to fit and pieces to judge, away from what the arm may touch.
        motions: of the arm.
        links: of the arm.
        joints: prior (n, terms), whether gravity loads a joint (n,), whether it moves (n,).
        tool: the link and its point that may touch something.
        least: smallest scale of errors.
        progress: called with the name of each step.
    """
    (centre, weighted, moving), held = joints, state.held
    chosen, judged = parts
    progress("are the servos alike?")
    _like_the_others(state, chosen, judged, centre, held, moving, least)
    progress("does the arm touch something?")
    state.contact = find_contact(state.lanes, state.values, *tool, least)
    chosen, judged = _coupled_again(state, motions, links, tool[0])
    scale = _scale(chosen, state.values, least)
    state.values = search(chosen, state.values, state.free, scale, centre, 10, BLOCKED_LITTLE)
    for group in GROUPS:
        if group in FRICTION:
            continue
        offered = moving & weighted if group == "zero" else moving
        if group == "profile":
            offered = moving & state.free[:, INDEX["torque_limit"]]
        able = np.flatnonzero(offered & ~(held | state.free)[:, members(group)].any(axis=1))
        if not len(able):
            continue
        progress(f"is there a {group}?")
        share = ZERO_GAIN if group == "zero" else LATE_GAIN
        # as many steps without the term: what a longer search saves is not the term's
        scale = _scale(chosen, state.values, least)
        state.values = search(chosen, state.values, state.free, scale, centre, 12, BLOCKED_LITTLE)
        trial = _tried(chosen, state.values, state.free, centre, able.tolist(), group, least)
        saved = _savings(judged, state.values, trial[0], able.tolist(), least, BLOCKED_LITTLE, share)
        _taken(state, centre, trial, list(saved))
        for joint, saving in saved.items():
            state.gains[joint][group] = saving
        if group == "zero" and saved:
            chosen, judged = _coupled_again(state, motions, links, tool[0])
    if state.contact is not None:
        state.contact = find_contact(state.lanes, state.values, *tool, least, state.contact)
        _left(state)


def _like_the_others(
    state: _State, chosen: Lanes, judged: Lanes, centre: FloatArray, held: BoolArray, able: BoolArray, least: float
) -> None:
    """Begin again with what the nearest joint has, and keep it where pieces that were not fitted are nearer, in place.

    Servos of one arm are mostly of one kind, and a search may have ended in a minimum that is none of theirs: an
    inertia that a delay stands for, say. Such a joint would spoil a median of all.
    """
    rows = np.flatnonzero(able)
    if len(rows) <= LIKE:
        return
    torques, optional = [INDEX[name] for name in TORQUES], np.array([bool(term.group) for term in TERMS])
    scaled, free, prior = state.values.copy(), state.free.copy(), centre.copy()
    residual = evaluate(judged, state.values)[0]
    nearest = rows[np.argmin(joint_cost(residual, judged, np.full(len(scaled), least), EVERY_ERROR)[rows])]
    common = np.tile(state.values[nearest], (len(rows), 1))
    present = [term for term in torques if state.values[nearest, term] != TERMS[term].absent]
    ratio = state.values[rows, INDEX["stiffness"]] / state.values[nearest, INDEX["stiffness"]]
    common[:, present] *= ratio[:, None]
    free[rows] = np.where(optional, state.free[nearest], free[rows]) & ~held[rows]
    scaled[rows] = np.where(held[rows], scaled[rows], common)
    prior[rows] = np.where(optional & free[rows], to_search(common), prior[rows])
    for shape in (EVERY_ERROR, BLOCKED_LITTLE):
        scaled = search(chosen, scaled, free, _scale(chosen, scaled, least), prior, 15, shape)
    state.values = search(chosen, state.values, state.free, _scale(chosen, state.values, least), centre, 15, shape)
    saved = _savings(judged, state.values, scaled, rows.tolist(), least, BLOCKED_LITTLE)
    _taken(state, centre, (scaled, free, prior), list(saved))
    for joint, share in saved.items():
        kept = [group for group in FIRST_GROUPS if state.free[joint, members(group)].any()]
        state.gains[joint] = {group: state.gains[joint].get(group, share) for group in kept}


def _taken(
    state: _State, centre: FloatArray, trial: tuple[FloatArray, BoolArray, FloatArray], joints: list[int]
) -> None:
    """Take a trial's values, free terms and prior for some joints, in place."""
    state.values, state.free = state.values.copy(), state.free.copy()
    state.values[joints], state.free[joints], centre[joints] = trial[0][joints], trial[1][joints], trial[2][joints]


def _coupled_again(
    state: _State, motions: Sequence[ServoMotion], links: ServoLinks, link: int, piece: float = PIECE
) -> tuple[Lanes, Lanes]:
    """Lanes anew, with torques between the joints as the fit moves them; pieces to fit and to judge."""
    loads = [measured_load(links, motion, state.values[:, INDEX["zero"]]) for motion in motions]
    state.lanes = lanes_with_touch(motions, links, loads, link, piece)
    return _left(state)


def _left(state: _State) -> tuple[Lanes, Lanes]:
    """Pieces to fit and to judge, without the samples that the contact bends."""
    state.kept = state.lanes
    if state.contact is not None:
        bent = in_contact(state.lanes, state.values, state.contact)
        state.kept = replace(state.lanes, measured=np.where(bent, np.nan, state.lanes.measured))
    return halves(with_pull(state.kept, state.values), PIECES)


def _longer_pieces(state: _State, final: Lanes, motions: Sequence[ServoMotion], links: ServoLinks, link: int) -> Lanes:
    """Longer pieces where the recordings are long, without what the contact bends; `final` where they are not."""
    piece = min(sum(float(motion.time[-1]) for motion in motions) / WANTED_PIECES, LONGEST_PIECE)
    if piece <= PIECE:
        return final
    _coupled_again(state, motions, links, link, piece)
    return state.kept


def _start(motions: Sequence[ServoMotion], links: ServoLinks) -> FloatArray:
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


def _scaled_torques(
    lanes: Lanes, values: FloatArray, joints: IndexArray, inertia: FloatArray, least: float
) -> FloatArray:
    """Values (n, terms) with all torques of some joints times whichever factor fits best, at the same inertia (n,)."""
    scale, best, found = _scale(lanes, values, least), np.full(len(values), np.inf), values.copy()
    for factor in TORQUE_FACTORS:
        trial = _times(values, joints, factor, inertia)
        able = joints[trial[joints, INDEX["armature"]] > 0.0]
        cost = joint_cost(evaluate(lanes, np.where(trial > 0.0, trial, values))[0], lanes, scale, EVERY_ERROR)
        better = able[cost[able] < best[able]]
        best[better], found[better] = cost[better], trial[better]
    return found


def _times(values: FloatArray, joints: IndexArray, factor: float, inertia: FloatArray) -> FloatArray:
    """Values (n, terms) with all torques of some joints times a factor, and with them the sum of both inertias."""
    values, motor = values.copy(), INDEX["armature"]
    for joint in joints.tolist():
        whole = factor * (values[joint, motor] + inertia[joint])
        present = [INDEX[name] for name in TORQUES if values[joint, INDEX[name]] != TERMS[INDEX[name]].absent]
        values[joint, present] *= factor
        values[joint, motor] = whole - inertia[joint]
    return values


def _of_whole_arm(lanes: Lanes, state: _State, centre: FloatArray, least: float) -> FloatArray:
    """Values of least cost of the whole arm, from those of its joints one by one."""
    known = with_pull(lanes, state.values)
    scale = _scale(known, state.values, least)
    values = search(known, state.values, state.free, scale, centre, 10, BLOCKED_LITTLE)
    return search_arm(lanes, values, state.free, _scale(lanes, values, least), centre, 30, BLOCKED_LITTLE)


def _scale(lanes: Lanes, values: FloatArray, least: float) -> FloatArray:
    return robust_scale(evaluate(lanes, values)[0], lanes, len(values), least)


def _tried(
    chosen: Lanes,
    values: FloatArray,
    free: BoolArray,
    centre: FloatArray,
    able: Sequence[int],
    group: str,
    least: float,
) -> tuple[FloatArray, BoolArray, FloatArray]:
    """Values, free terms and prior (n, terms) with a group added to some joints, fitted."""
    trial, trial_free = with_group(values, free, able, group)
    if group == "saturation":
        trial[able, INDEX["torque_limit"]] = 0.5 * _largest_torques(chosen, values)[able]
    trial_centre, scale = np.where(trial_free & ~free, to_search(trial), centre), _scale(chosen, values, least)
    return search(chosen, trial, trial_free, scale, trial_centre, 12, BLOCKED_LITTLE), trial_free, trial_centre


def _beside_coulomb(values: FloatArray, able: Sequence[int], group: str) -> FloatArray:
    """A group of friction beside Coulomb friction that was found without it."""
    values = values.copy()
    if group == "load":
        values[able, INDEX["coulomb"]] *= 0.5
    else:
        values[able, INDEX["breakaway"]] = 0.3 * values[able, INDEX["coulomb"]]
        values[able, INDEX["load_breakaway"]], values[able, INDEX["stribeck_velocity"]] = LITTLE, FADING
    return values


def _piece_costs(residual: FloatArray, lanes: Lanes, scale: FloatArray, shape: float) -> list[FloatArray]:
    """Robust cost of each joint's pieces."""
    return [lane_cost(residual, lanes, scale, shape)[lanes.joint == joint] for joint in range(len(scale))]


def _first_fit(
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
    plain = search(chosen, values, free, _scale(chosen, values, least), centre, 10, EVERY_ERROR)
    plain = search(chosen, plain, free, _scale(chosen, plain, least), centre, 15, EVERY_ERROR)
    scale = _scale(chosen, plain, least)
    starts, searched, frees, able = [], [], [], []
    for group, levels in zip(FIRST_GROUPS, (ACCELERATIONS, SATURATIONS), strict=True):
        able.append(moving[~held[moving][:, members(group)].any(axis=1)])
        trial, trial_free = with_group(values, free, able[-1].tolist(), group)
        for level in levels:
            start = trial.copy()
            start[able[-1], members(group)] = level
            if group == "saturation":
                start[able[-1], members(group)] *= _largest_torques(chosen, values)[able[-1]]
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
    which = np.argmin(costs, axis=0)
    cheapest = which * len(values) + np.arange(len(values))
    best, best_free, best_centre = begun[cheapest], every_free[cheapest], centres[cheapest]
    best = search(chosen, best, best_free, scale, best_centre, 10, EVERY_ERROR)
    best = search(chosen, best, best_free, _scale(chosen, best, least), best_centre, 15, EVERY_ERROR)
    offered = np.union1d(able[0], able[1]).tolist()
    saved = _savings(judged, plain, best, offered, least, EVERY_ERROR)
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
        saved = _savings(judged, plain, best, offered, least, EVERY_ERROR)
    rows = list(saved)
    values, free = plain.copy(), free.copy()
    values[rows], free[rows], centre[rows] = best[rows], best_free[rows], best_centre[rows]
    for joint, share in saved.items():
        gains[joint]["profile" if best_free[joint, limit] else "saturation"] = share
    return values, free


def _largest_torques(lanes: Lanes, values: FloatArray) -> FloatArray:
    """(n,) torques that the largest position errors of any piece would ask for, if the joint stood still."""
    reach = np.zeros(len(values))
    np.maximum.at(reach, lanes.joint, np.abs(lanes.command[lanes.history :] - lanes.start).max(axis=0))
    return np.asarray(values[:, INDEX["stiffness"]] * np.maximum(reach, 1e-3), dtype=np.float64)


def _savings(
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


def _pruned(lanes: Lanes, state: _State, least: float) -> bool:
    """Take away the optional terms of which all data together tell nothing, in place."""
    wide = intervals(lanes, state.values, state.free, least)[3]
    state.values, state.free, pruned = state.values.copy(), state.free.copy(), False
    for group in GROUPS:
        own = members(group)
        for joint in range(len(wide)) if group != "load" else ():  # without it Coulomb friction would take its part
            if state.free[joint, own].any() and wide[joint, own][state.free[joint, own]].all():
                without_group(state.values, state.free, [joint], group)
                state.gains[joint].pop(group, None)
                pruned = True
    return pruned


def _tied(
    values: FloatArray,
    free: BoolArray,
    held: BoolArray,
    centre: FloatArray,
    which: tuple[BoolArray, BoolArray],
    inertia: FloatArray,
    given: Mapping[tuple[int, str], float],
) -> tuple[FloatArray, BoolArray, BoolArray, frozenset[tuple[int, int]]]:
    """Joints whose torque scale nothing shows get the stiffness of those that show it, the others' geometric mean.

    Only gravity, or a term that is known, ties a position loop to N·m: without it, all of a joint's torques can grow
    together, and with them the sum of its motor's inertia and the links' (n,), which is known: a stiffness that would
    leave less than `LEAST_MOTOR` of that sum to the motor is not assumed. A joint that never moves gets all terms of
    the others. `which` joints show their scale, and which move.
    """
    stiffness, motor, (scaled, moving) = INDEX["stiffness"], INDEX["armature"], which
    showing = np.flatnonzero(scaled & moving & free[:, stiffness])
    showing = np.flatnonzero(scaled & moving) if not len(showing) else showing
    common = float(np.exp(np.mean(np.log(values[showing, stiffness])))) if len(showing) else TERMS[stiffness].start
    values, free, held = values.copy(), free.copy(), held.copy()
    assumed = set()
    others = np.flatnonzero(moving)
    for joint in np.flatnonzero(~scaled).tolist():
        if not moving[joint]:
            for index in members(""):
                if (joint, TERMS[index].name) in given:
                    continue
                if TERMS[index].positive:
                    values[joint, index] = float(np.exp(np.mean(np.log(values[others, index]))))
                free[joint, index], held[joint, index] = False, True
                assumed.add((joint, index))
        if held[joint, stiffness] and (joint, TERMS[stiffness].name) in given:
            continue
        ratio = common / values[joint, stiffness]
        whole = ratio * (values[joint, motor] + inertia[joint])
        if moving[joint] and whole - inertia[joint] < LEAST_MOTOR * whole:
            continue
        present = [INDEX[name] for name in TORQUES if values[joint, INDEX[name]] != TERMS[INDEX[name]].absent]
        values[joint, present] *= ratio
        centre[joint, present] += np.log(ratio)
        if moving[joint]:
            values[joint, motor] = whole - inertia[joint]
        free[joint, stiffness], held[joint, stiffness] = False, True
        assumed.add((joint, stiffness))
    return values, free, held, frozenset(assumed)
