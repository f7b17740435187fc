"""Fit of a servo arm: a start by linear regression, terms that held-out pieces ask for, values with 95 % intervals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers.core.arrays import BoolArray, FloatArray, IndexArray
from ident.servo.contact import ServoContact, away, find_contact, in_contact
from ident.servo.first_fit import FIRST_GROUPS, LIKE, begun_fit, error_scale, limited_by, regressed_values, savings
from ident.servo.links import ServoLinks
from ident.servo.motion import (
    PIECE,
    MotionLoad,
    ServoMotion,
    halves,
    known_load,
    lanes_with_touch,
    measured_load,
    some_pieces,
)
from ident.servo.rollout.lanes import Lanes
from ident.servo.rollout.rollout import with_pull
from ident.servo.search import BLOCKED_LITTLE, EVERY_ERROR, evaluate, intervals, joint_cost, search
from ident.servo.terms import GROUPS, INDEX, TERMS, members, to_search, with_group, without_group

PIECES = 160
"""Pieces at most with which terms are chosen; the final fit takes `FINAL_PIECES`."""

FINAL_PIECES = 200

WANTED_PIECES, LONGEST_PIECE = 60, 12.0
"""The final fit of long recordings has longer pieces [s], as long as there are so many: a model is judged by
whole motions, and a piece begins at the measured position, which hides where friction would have stopped the joint."""

LATE_GAIN, ZERO_GAIN = 0.05, 0.25
"""The same of a limit or a dead band, and of a zero, or of a profile beside a drive's limit: an offset makes up for
some of what any joint's friction lacks, at other torques and for these motions only; a slow profile, for a limit."""

LITTLE, FADING = 0.02, 0.1
"""Starts of load_breakaway and of the Stribeck velocity [rad/s]."""

LATE = ("load_breakaway", "stribeck_velocity")
"""Terms that are held in the first fit: a joint that breaks away from a large friction within a small velocity jumps,
and no search comes back from there."""

FRICTION = ("load", "breakaway")
"""Groups that are fitted from the beginning, and taken away where nothing asks for them: without them all torques of a
joint grow until its bias and Coulomb friction take their part, and no search comes back from there. What the arm
touches is looked for after them, and before a zero could stand for it."""

RESTING = 5.0
"""Encoder steps below which a joint is not commanded to move."""

TORQUES = ("stiffness", "damping", "armature", "coulomb", "breakaway", "torque_limit")
"""Terms that grow together where nothing ties the torques of a joint to N·m."""

LEAST_MOTOR = 0.1
"""Share of a joint's inertia that is its motor's, at least: gears make it count."""

TORQUE_FACTORS = tuple(2.0 ** (power / 4) for power in range(-8, 9))
"""Between the torques of a joint and those of an assumed stiffness, in a first search."""

Progress = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class ServoFit:
    """Parameters of an arm of servos."""

    values: FloatArray  # (n, terms)
    # low, high: (n, terms) ends of the 95 % intervals; nan of terms that were not searched
    low: FloatArray
    high: FloatArray
    free: BoolArray  # (n, terms) terms that were searched
    seen: BoolArray  # (n, terms) whether the data tell the term; False where it is absent or held
    held: BoolArray  # (n, terms) values that were given or assumed, not searched
    assumed: frozenset[tuple[int, int]]  # those of `held` that were assumed, as (joint, term)
    moving: BoolArray  # (n,) joints that are commanded to move
    covariance: tuple[FloatArray, ...]  # per joint, of its searched terms in the search's coordinates
    # per joint, the share of the held-out cost that each optional term saved; kept ones only
    gains: tuple[Mapping[str, float], ...]
    pieces: int  # number of pieces of motion in the fit
    left: FloatArray  # (n,) median absolute errors of these pieces [rad or m]
    contact: ServoContact | None  # what the arm touches; None without a sign of it


def fit_servo(
    motions: Sequence[ServoMotion],
    links: ServoLinks,
    resolution: FloatArray,
    given: Mapping[tuple[int, str], float],
    declared: Mapping[tuple[int, str], float],
    tool: tuple[str, FloatArray],
    progress: Progress,
) -> ServoFit:
    """Fit every joint, and what the arm touches.

    Args:
        motions: of one arm.
        links: of the arm.
        resolution: (n,) steps of the encoders [rad or m].
        given: known values by joint and term, which are held.
        declared: the same by the settings of the servos, held unless the data clearly contradict.
        tool: the link and its point (3,) [m] that may touch something.
        progress: called with the name of each step.
    """
    joints = motions[0].position.shape[1]
    progress("links along the motion")
    loads = [measured_load(links, motion, np.zeros(joints)) for motion in motions]
    lanes = lanes_with_touch(motions, links, list(map(known_load, loads, motions)), tool[0])
    values, held = regressed_values(motions, links), np.zeros((joints, len(TERMS)), dtype=np.bool_)
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
    values, free, centre, held, gains = begun_fit(chosen, judged, values, free, centre, moving, held, least, declared)
    free |= late
    heavy = np.isin(np.arange(joints), weighted)
    scaled = (heavy & moving) | held[:, [INDEX[name] for name in TORQUES]].any(axis=1)
    inertia = np.array([lanes.inertia[:, lanes.joint == joint].mean() for joint in range(joints)])
    values, free, held, assumed = _tied(values, free, held, centre, (scaled, moving), inertia, given)
    values = search(chosen, values, free, error_scale(chosen, values, least), centre, 10, BLOCKED_LITTLE)
    state = _State(lanes, lanes, 0.0, (np.zeros(joints), loads), values, free, held, assumed, None, gains)
    _settle_terms(state, (chosen, judged), motions, links, (centre, heavy, moving), tool, least, progress)
    _lanes_again(state, motions, links, tool[0])
    progress("final fit")
    pieces = some_pieces(state.kept, FINAL_PIECES)
    longer = _longer_pieces(state, pieces, motions, links, tool[0])
    _drop_profiles(state, with_pull(pieces, state.values), centre, least)
    _free_torques(state, pieces, moving, inertia, least)
    state.values = _of_whole_arm(longer, state, centre, least)
    interval = intervals(pieces, state.values, state.free, least)
    if _pruned(state, interval[3]) | _tied_again(state, interval[2], (centre, moving), inertia, given):
        progress("final fit without what nothing shows")
        state.values = _together(longer, state, state.values, centre, least)
        interval = intervals(pieces, state.values, state.free, least)
    low, high, seen, _, covariance = interval
    count, contact = len(np.unique(pieces.piece)), state.contact
    if contact is not None:
        progress("contact")
        contact = find_contact(state.lanes, state.values, *tool, least, contact)
    values, free, held, assumed = state.values, state.free, state.held, state.assumed
    errors = np.abs(evaluate(pieces, values)[0])
    left = np.array([np.nanmedian(errors[:, pieces.joint == joint]) for joint in range(joints)])
    known = (values, low, high, free, seen, held, assumed, moving, covariance)
    return ServoFit(*known, tuple(gains), count, left, contact)


def _free_torques(state: _State, lanes: Lanes, moving: BoolArray, inertia: FloatArray, least: float) -> None:
    """Search the assumed stiffnesses, too, in place: links that change their pose, or other joints, may tie them."""
    stiffness = INDEX["stiffness"]
    again = np.array([joint for joint, term in state.assumed if term == stiffness and moving[joint]], dtype=np.intp)
    if len(again):
        state.free, state.held = state.free.copy(), state.held.copy()
        state.free[again, stiffness], state.held[again, stiffness] = True, False
        state.assumed -= {(joint, stiffness) for joint in again.tolist()}
        state.values = _scaled_torques(with_pull(lanes, state.values), state.values, again, inertia, least)


def _tied_again(
    state: _State,
    seen: BoolArray,
    joints: tuple[FloatArray, BoolArray],
    inertia: FloatArray,
    given: Mapping[tuple[int, str], float],
) -> bool:
    """Assume the stiffnesses that were searched but are not seen, in place; prior (n, terms) and moving (n,) joints."""
    (centre, moving), stiffness = joints, INDEX["stiffness"]
    loose = state.free[:, stiffness] & ~seen[:, stiffness]
    if not loose.any():
        return False
    which = (~loose, moving)
    state.values, state.free, state.held, more = _tied(
        state.values, state.free, state.held, centre, which, inertia, given
    )
    state.assumed |= more
    return True


@dataclass(eq=False)
class _State:
    """A fit under way: the arm's values and terms as of `ServoFit`, what terms saved, and the lanes."""

    lanes: Lanes
    kept: Lanes  # without contact
    piece: float  # [s] of the lanes; 0 while the joints' torques on each other are those of the measured motion
    loads: tuple[FloatArray, Sequence[MotionLoad]]  # of the links, and the encoders' zeros (n,) that they are for
    values: FloatArray
    free: BoolArray
    held: BoolArray
    assumed: frozenset[tuple[int, int]]
    contact: ServoContact | None
    gains: list[dict[str, float]]


def _settle_terms(
    state: _State,
    parts: tuple[Lanes, Lanes],
    motions: Sequence[ServoMotion],
    links: ServoLinks,
    joints: tuple[FloatArray, BoolArray, BoolArray],
    tool: tuple[str, FloatArray],
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
    progress("testing for breakaway")
    _drop_breakaway(state, chosen, judged, centre, least)
    progress("comparing the servos")
    _like_the_others(state, chosen, judged, centre, held, moving, least)
    progress("testing for a contact surface")
    state.contact = find_contact(state.lanes, state.values, *tool, least)
    chosen, judged = _lanes_again(state, motions, links, tool[0])
    scale = error_scale(chosen, state.values, least)
    state.values = search(chosen, state.values, state.free, scale, centre, 10, BLOCKED_LITTLE)
    for group in GROUPS:
        if group in FRICTION or group == "backlash":
            continue
        offered = moving & weighted if group == "zero" else moving
        if group == "profile":
            offered = moving & state.free[:, INDEX["torque_limit"]]
        able = np.flatnonzero(offered & ~(held | state.free)[:, members(group)].any(axis=1))
        if not len(able):
            continue
        progress(f"testing the term {group}")
        share = ZERO_GAIN if group in ("zero", "profile") else LATE_GAIN
        # as many steps without the term: what a longer search saves is not the term's
        scale = error_scale(chosen, state.values, least)
        state.values = search(chosen, state.values, state.free, scale, centre, 12, BLOCKED_LITTLE)
        trial = _tried(chosen, state.values, state.free, centre, able.tolist(), group, least)
        saved = savings(judged, state.values, trial[0], able.tolist(), least, BLOCKED_LITTLE, share)
        _keep_trial(state, centre, trial, list(saved))
        for joint, saving in saved.items():
            state.gains[joint][group] = saving
        if group == "zero" and saved:
            chosen, judged = _lanes_again(state, motions, links, tool[0])
    if state.contact is not None:
        state.contact = find_contact(state.lanes, state.values, *tool, least, state.contact)
        _without_contact(state)


def _drop_breakaway(state: _State, chosen: Lanes, judged: Lanes, centre: FloatArray, least: float) -> None:
    """Take breakaway away, in place, where pieces that were not fitted need none: it would take the load's friction."""
    able = np.flatnonzero(state.free[:, members("breakaway")].any(axis=1)).tolist()
    values, free = state.values.copy(), state.free.copy()
    without_group(values, free, able, "breakaway")
    scale = error_scale(chosen, state.values, least)
    values = search(chosen, values, free, scale, centre, 12, BLOCKED_LITTLE)
    state.values = search(chosen, state.values, state.free, scale, centre, 12, BLOCKED_LITTLE)
    needed = savings(judged, values, state.values, able, least, BLOCKED_LITTLE)
    _keep_trial(state, centre, (values, free, centre), [joint for joint in able if joint not in needed])


def _drop_profiles(state: _State, lanes: Lanes, centre: FloatArray, least: float) -> None:
    """Take profiles away, in place, where for most joints a drive's limit alone explains all pieces nearly as well.

    Half of the pieces may not show which of both it is, and no search leaves what other terms have made up for.
    Servos of one arm are mostly of one kind: where most need their profiles, all have them.
    """
    profile, limit = INDEX["acceleration_limit"], INDEX["torque_limit"]
    able = np.flatnonzero(state.free[:, profile] & ~state.held[:, limit])
    if not len(able):
        return
    own = np.isin(np.arange(len(centre)), able)[:, None]
    scale, free, values, prior = error_scale(lanes, state.values, least), state.free.copy(), state.values.copy(), centre
    without_group(values, free, able.tolist(), "profile")
    limited_by(lanes, values, able[~free[able, limit]], scale)
    free[able, limit] = True
    prior = np.where(free & ~state.free, to_search(values), centre)
    for _ in range(2):
        values = search(lanes, values, free & own, scale, prior, 12, BLOCKED_LITTLE)
        state.values = search(lanes, state.values, state.free & own, scale, centre, 12, BLOCKED_LITTLE)
    needed = savings(lanes, values, state.values, able.tolist(), least, BLOCKED_LITTLE, LATE_GAIN)
    if 2 * len(needed) < len(able):
        _keep_trial(state, centre, (values, free, prior), [joint for joint in able.tolist() if joint not in needed])


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
    limit = INDEX["torque_limit"]
    if not state.free[nearest, [limit, INDEX["acceleration_limit"]]].any():  # it was not driven so far: they were
        limited = state.free[rows, limit]
        free[rows[limited], limit], common[limited, limit] = True, state.values[rows[limited], limit]
    scaled[rows] = np.where(held[rows], scaled[rows], common)
    prior[rows] = np.where(optional & free[rows], to_search(common), prior[rows])
    for shape in (EVERY_ERROR, BLOCKED_LITTLE):
        scaled = search(chosen, scaled, free, error_scale(chosen, scaled, least), prior, 15, shape)
    state.values = search(chosen, state.values, state.free, error_scale(chosen, state.values, least), centre, 15, shape)
    saved = savings(judged, state.values, scaled, rows.tolist(), least, BLOCKED_LITTLE)
    _keep_trial(state, centre, (scaled, free, prior), list(saved))
    for joint, share in saved.items():
        kept = [group for group in FIRST_GROUPS if state.free[joint, members(group)].any()]
        state.gains[joint] = {group: state.gains[joint].get(group, share) for group in kept}


def _keep_trial(
    state: _State, centre: FloatArray, trial: tuple[FloatArray, BoolArray, FloatArray], joints: list[int]
) -> None:
    """Take a trial's values, free terms and prior for some joints, in place."""
    state.values, state.free = state.values.copy(), state.free.copy()
    state.values[joints], state.free[joints], centre[joints] = trial[0][joints], trial[1][joints], trial[2][joints]


def _lanes_again(
    state: _State, motions: Sequence[ServoMotion], links: ServoLinks, link: str, piece: float = PIECE
) -> tuple[Lanes, Lanes]:
    """Lanes anew, with torques between the joints as the fit moves them; pieces to fit and to judge."""
    zero = state.values[:, INDEX["zero"]].copy()
    same = np.array_equal(zero, state.loads[0])
    if not same:
        state.loads = (zero, [measured_load(links, motion, zero) for motion in motions])
    if not same or piece != state.piece:
        state.lanes, state.piece = lanes_with_touch(motions, links, state.loads[1], link, piece), piece
    return _without_contact(state)


def _without_contact(state: _State) -> tuple[Lanes, Lanes]:
    """Pieces to fit and to judge, without the samples that the contact bends."""
    state.kept = state.lanes
    if state.contact is not None:
        bent = in_contact(state.lanes, state.values, state.contact)
        state.kept = replace(state.lanes, measured=np.where(bent, np.nan, state.lanes.measured))
    return halves(with_pull(state.kept, state.values), PIECES)


def _longer_pieces(state: _State, final: Lanes, motions: Sequence[ServoMotion], links: ServoLinks, link: str) -> Lanes:
    """Longer pieces where the recordings are long, without what the contact bends; `final` where they are not."""
    piece = min(sum(float(motion.time[-1]) for motion in motions) / WANTED_PIECES, LONGEST_PIECE)
    if piece <= PIECE:
        return final
    _lanes_again(state, motions, links, link, piece)
    return state.kept


def _scaled_torques(
    lanes: Lanes, values: FloatArray, joints: IndexArray, inertia: FloatArray, least: float
) -> FloatArray:
    """Values (n, terms) with all torques of some joints times whichever factor fits best, at the same inertia (n,)."""
    scale, best, found = error_scale(lanes, values, least), np.full(len(values), np.inf), values.copy()
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
    scale = error_scale(known, state.values, least)
    values = search(known, state.values, state.free, scale, centre, 10, BLOCKED_LITTLE)
    return _together(lanes, state, values, centre, least)


def _together(lanes: Lanes, state: _State, values: FloatArray, centre: FloatArray, least: float) -> FloatArray:
    """The same from values (n, terms) of the whole arm."""
    return search(lanes, values, state.free, error_scale(lanes, values, least), centre, 16, BLOCKED_LITTLE)


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
    scale = error_scale(chosen, values, least)
    if group == "saturation":
        limited_by(chosen, trial, able, scale)
    trial_centre = np.where(trial_free & ~free, to_search(trial), centre)
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


def _pruned(state: _State, wide: BoolArray) -> bool:
    """Take away the optional terms of which all data together tell nothing (n, terms), in place."""
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
