"""Roll-out of servo joints on commands, many pieces of motion side by side, with derivatives by their parameters.

Every joint is one equation, with gravity known along the motion. The joints of a piece move each other by the inertia
between them, which is known along the motion, too: a step solves them together, or, where only single joints are
looked at, takes the torque between them as known. A step is the implicit midpoint rule: half a step implicit in
damping, stiffness and friction (soft threshold, so that sticking is exact), and its velocity over the whole step. It is
stable with any step, and neither ahead of the joint nor damped.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from ctypes import c_double, c_long, c_void_p
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from drivers.core.arrays import BoolArray, FloatArray, IndexArray
from ident.compiled.library import address, kernels
from ident.servo.terms import INDEX, TERMS

STEEPNESS_SPAN = 0.03
"""Half of the difference that gives derivatives by the logarithm of an acceleration limit."""

UNLIMITED = 1e6
"""[rad/s²] From this acceleration on, a profile is its target."""

TOUCH_DAMPING = 0.01
"""[s] Damping of a contact over its stiffness."""

THINNED = 4
"""Inertia and the slope of gravity are evaluated at every fourth sample, and inertia between joints at every fourth
step: they change slowly."""

SWEEPS, SETTLED = 200, 1e-9
"""Rounds at most over the joints of a step and what they touch, and the change [rad/s or N] at which they agree."""


@dataclass(frozen=True, eq=False)
class Touch:
    """Where a point of a link is along pieces of motion, linear in the point; P pieces, all n joints of each in turn.

    Attributes:
        reference: (K, L) positions along which it holds [rad or m].
        height: (4, K, P) of the link's origin and of its axes' unit vectors [m].
        lever: (4, K, L) derivatives of the heights by each joint's position.
    """

    reference: FloatArray
    height: FloatArray
    lever: FloatArray


@dataclass(frozen=True, eq=False)
class Lanes:
    """Pieces of motion of single joints, side by side on a grid of `step` seconds.

    Attributes:
        step: [s].
        joint: (L,) index of each lane's joint.
        piece: (L,) index of the piece of motion that it is of.
        command: (history + K, L) commanded positions, from `history` steps before the piece [rad or m].
        history: number of steps.
        start: (L,) measured positions at the beginning.
        inertia: (K, L) of the links about the joint [kg·m²].
        load: (K, L) gravity and coupling, as the torque that the joint must give [N·m].
        load_slope: (K, L) derivative of gravity by the joint's own position [N·m/rad].
        sample: (S, L) where the measured samples are on the grid, as fractions of steps.
        measured: (S, L) positions; nan where a sample does not count.
        touch: of the point that may touch something; None where the lanes are not those of whole arms.
        between: (K / `THINNED`, P, n, n) inertia of each piece's joints [kg·m²], by which they move each other; None
            where its torques are in `load`.
    """

    step: float
    joint: IndexArray
    piece: IndexArray
    command: FloatArray
    history: int
    start: FloatArray
    inertia: FloatArray
    load: FloatArray
    load_slope: FloatArray
    sample: FloatArray
    measured: FloatArray
    touch: Touch | None = None
    between: FloatArray | None = None

    def of_pieces(self, pieces: IndexArray) -> Lanes:
        """All lanes of some pieces, by number, with what they touch."""
        chosen = np.flatnonzero(np.isin(self.piece, pieces))
        kept, touch = np.flatnonzero(np.isin(np.unique(self.piece), pieces)), self.touch
        if touch is not None:
            touch = Touch(touch.reference[:, chosen], touch.height[:, :, kept], touch.lever[:, :, chosen])
        return replace(self.of(chosen), touch=touch, between=None if self.between is None else self.between[:, kept])

    def consecutive(self, pieces: slice, joints: int) -> Lanes:
        """Pieces that lie side by side, of so many lanes each, without what they touch."""
        between = None if self.between is None else self.between[:, pieces]
        return replace(self.of(slice(pieces.start * joints, pieces.stop * joints)), between=between)

    def of(self, chosen: IndexArray | slice) -> Lanes:
        """Some of the lanes, on their own."""
        return Lanes(
            self.step,
            self.joint[chosen],
            self.piece[chosen],
            self.command[:, chosen],
            self.history,
            self.start[chosen],
            self.inertia[:, chosen],
            self.load[:, chosen],
            self.load_slope[:, chosen],
            self.sample[:, chosen],
            self.measured[:, chosen],
        )


def repeated(lanes: Lanes, times: int, joints: int) -> Lanes:
    """The lanes several times side by side, as those of further joints: a few long steps cost less than many."""
    wide = lanes.of(np.tile(np.arange(len(lanes.joint)), times))
    offsets = np.repeat(np.arange(times) * joints, len(lanes.joint))
    touch = lanes.touch
    if touch is not None:
        touch = Touch(
            np.tile(touch.reference, (1, times)),
            np.tile(touch.height, (1, 1, times)),
            np.tile(touch.lever, (1, 1, times)),
        )
    between = None if lanes.between is None else np.tile(lanes.between, (1, times, 1, 1))
    return replace(wide, joint=wide.joint + offsets, touch=touch, between=between)


class RollOut(NamedTuple):
    """What a roll-out gives.

    Attributes:
        path: (K, L) positions on the grid [rad or m].
        slopes: (P, S, n, F) derivatives of the path without contact at the samples of each piece and joint, by F
            parameters in the search's coordinates (logarithms of positive terms).
        force: (K, P) of the contact [N], without columns where nothing is touched.
        pull: (K, L) torque that the other joints ask for [N·m], without columns where none moves another.
    """

    path: FloatArray
    slopes: FloatArray
    force: FloatArray
    pull: FloatArray


def roll_out(
    lanes: Lanes,
    values: FloatArray,
    terms: IndexArray | None = None,
    owners: IndexArray | None = None,
    surface: FloatArray | None = None,
) -> RollOut:
    """Roll lanes out on their commands.

    Args:
        lanes: K steps, L lanes. Where none moves another, each is a piece of its own.
        values: (terms, L) parameters of each lane.
        terms: (F,) indices of the terms to derive by; none where None.
        owners: (F,) the joint of a piece whose term it is; 0 where None.
        surface: (5, P) height [m] and stiffness [N/m] of what each piece may touch, and the point (3) [m] that touches;
            nothing is touched where None.
    """
    terms = np.zeros(0, dtype=np.intp) if terms is None else terms
    owners = np.zeros_like(terms) if owners is None else owners
    delay, steepest = values[INDEX["delay"]], values[INDEX["acceleration_limit"]]
    goals = _goals(lanes, delay, steepest, {TERMS[term].name for term in terms})
    together = _Together(lanes, surface)
    if (library := kernels().long) is not None:
        return _compiled(library, lanes, values, (terms, owners), goals, together)
    return _by_numpy(lanes, values, (terms, owners), goals, together)


def with_pull(lanes: Lanes, values: FloatArray) -> Lanes:
    """Lanes whose joints' torques on each other are known: those of a roll-out with values (n, terms)."""
    if lanes.between is None:
        return lanes
    return replace(lanes, load=lanes.load + roll_out(lanes, values[lanes.joint].T).pull, between=None)


class _Goals(NamedTuple):
    """Goals (K, L) of profiles in each step, and their derivatives by delay and limit; None where not asked for."""

    path: FloatArray
    by_delay: FloatArray | None
    by_limit: FloatArray | None


def _compiled(
    library: Any,
    lanes: Lanes,
    values: FloatArray,
    parameters: tuple[IndexArray, IndexArray],
    goals: _Goals,
    together: _Together,
) -> RollOut:
    """The same by the library's C code."""
    (count, width), (terms, owners) = lanes.load.shape, parameters
    coupled, touched, joints = lanes.between is not None, together.touched, together.joints
    pieces, samples = width // joints, len(lanes.sample)
    path, pull = np.empty((count, width)), np.empty((count, width if coupled else 0))
    slopes = np.empty((pieces, samples if len(terms) else 0, joints, len(terms)))
    force = np.empty((count, together.pieces if touched else 0))
    call = _Call()
    library.servo_roll_out(
        *(c_long(size) for size in (count, pieces, joints)),
        c_double(lanes.step),
        *map(call.given, (values, lanes.inertia, lanes.load, lanes.load_slope, lanes.start, goals.path)),
        *(call.given(lanes.between), c_long(THINNED), call.given(pull if coupled else None)),
        *(call.given(array if touched else None) for array in (together.clear, together.lever, together.surface)),
        *(call.given(force if touched else None), c_long(len(terms))),
        *(call.given(owners, np.int_), call.given(terms, np.int_)),
        *(call.given(goals.by_delay), call.given(goals.by_limit), c_long(samples)),
        *(call.given(lanes.sample[:, ::joints]), call.given(path), call.given(slopes)),
    )
    return RollOut(path, slopes, force, pull)


class _Call:
    """Arrays of a call of the library, which live until it has ended."""

    def __init__(self) -> None:
        """Without arrays."""
        self._kept: list[Any] = []

    def given(self, array: FloatArray | IndexArray | None, kind: Any = np.float64) -> c_void_p:
        """The address of an array, which is copied if C could not read it; that of None is NULL."""
        if array is None:
            return c_void_p(None)
        self._kept.append(np.ascontiguousarray(array, dtype=kind))
        return c_void_p(address(self._kept[-1]))


def _by_numpy(
    lanes: Lanes, values: FloatArray, parameters: tuple[IndexArray, IndexArray], goals: _Goals, together: _Together
) -> RollOut:
    """The same by NumPy."""
    p = {name: values[index] for name, index in INDEX.items()}
    inertia = p["armature"] + lanes.inertia
    offset = p["zero"] * lanes.load_slope
    h, (count, width) = lanes.step, lanes.load.shape
    half = 0.5 * h
    resistance = inertia + half * p["damping"]
    position, velocity = lanes.start.copy(), np.zeros(width)
    path, velocities, pull = np.empty((count, width)), np.empty((count, width)), np.zeros((count, width))
    force = np.zeros((count, together.pieces))
    present = _Present.of(p)
    for index in range(count):
        path[index], velocities[index] = position, velocity
        error = goals.path[index] - position - p["bias"]
        step = _step(
            half, p, inertia[index], resistance[index], lanes.load[index], offset[index], error, velocity, present
        )
        middle, moving = step.velocity, step.moving
        if together.touched or lanes.between is not None:
            middle, pull[index], force[index] = together.settled(step, index, resistance[index], position, velocity)
            moving = middle != 0.0
        velocity = np.where(moving, 2.0 * middle - velocity, 0.0)
        position = position + h * middle
    terms, owners = parameters
    pieces = width // together.joints
    slopes = np.zeros((pieces, 0, together.joints, 0))
    if len(terms):
        columns = np.unique(terms)
        error = goals.path - path - p["bias"]
        step = _step(half, p, inertia, resistance, lanes.load + pull, offset, error, velocities)
        tangents = _tangents(lanes, p, columns, inertia, step, velocities, goals, together)
        sampled = at_samples(lanes, tangents[np.searchsorted(columns, terms) + owners * len(columns)])
        slopes = np.moveaxis(sampled.reshape(len(terms), -1, pieces, together.joints), (1, 2, 3, 0), (1, 0, 2, 3))
    none = slice(None) if lanes.between is not None else slice(0)
    return RollOut(path, slopes, force if together.touched else force[:, :0], pull[:, none])


class _Present(NamedTuple):
    """Which optional terms some lane has; the others are not computed, step by step."""

    dead_band: bool = True
    limit: bool = True
    load: bool = True
    breakaway: bool = True

    @classmethod
    def of(cls, p: dict[str, FloatArray]) -> _Present:
        """The terms that parameters have."""
        return cls(
            bool(np.any(p["dead_band"])),
            bool(np.any(p["torque_limit"] < TERMS[INDEX["torque_limit"]].absent)),
            bool(np.any(p["load_friction"])),
            bool(np.any(p["breakaway"]) or np.any(p["load_breakaway"])),
        )


_ALL = _Present()


class _Step(NamedTuple):
    """What a step computes, (…, L) each: the drive's torque, whether it acts freely, and the velocity after it."""

    outside: BoolArray
    side: FloatArray
    torque: FloatArray
    acting: FloatArray
    share: FloatArray
    divisor: FloatArray
    faded: FloatArray
    passed: FloatArray
    momentum: FloatArray
    friction: FloatArray
    moving: BoolArray
    direction: FloatArray
    velocity: FloatArray


def _step(
    h: float,
    p: dict[str, FloatArray],
    inertia: FloatArray,
    resistance: FloatArray,
    load: FloatArray,
    offset: FloatArray,
    error: FloatArray,
    velocity: FloatArray,
    present: _Present = _ALL,
) -> _Step:
    """Half a step, of h [s], or those of a path's steps, from position errors and velocities (…, L) before it.

    `resistance` is the inertia with what damping adds in it; `offset` the load that the encoder's zero adds. What
    the derivatives need of terms that are not `present` has no meaning.
    """
    if present.dead_band:
        outside, side = np.abs(error) > p["dead_band"], np.sign(error)
        linear = p["stiffness"] * np.where(outside, error - side * p["dead_band"], 0.0)
    else:
        outside, side, linear = error != 0.0, error, p["stiffness"] * error
    if present.limit:
        torque = np.minimum(np.maximum(linear, -p["torque_limit"]), p["torque_limit"])
        acting = np.where(outside & (torque == linear), p["stiffness"], 0.0)
    else:
        torque, acting = linear, p["stiffness"] * outside
    momentum = inertia * velocity + h * (torque - load - offset)
    loaded = np.abs(torque) if present.load or present.breakaway else torque
    friction, share = p["coulomb"], np.zeros_like(p["coulomb"])
    if present.load:
        friction, share = friction + p["load_friction"] * loaded, p["load_friction"]
    faded = velocity
    if present.breakaway:
        faded = np.exp(-((velocity / p["stribeck_velocity"]) ** 2))
        friction = friction + (p["breakaway"] + p["load_breakaway"] * loaded) * faded
        share = share + p["load_breakaway"] * faded
    friction = h * friction
    moving, direction = np.abs(momentum) > friction, np.sign(momentum)
    # friction follows the torque that is left after the step, as the drive does
    passed = np.maximum(1.0 - direction * np.sign(torque) * share, 0.0)
    divisor = resistance + h * h * acting * passed
    after = np.where(moving, (momentum - direction * friction) / divisor, 0.0)
    return _Step(
        outside, side, torque, acting, share, divisor, faded, passed, momentum, friction, moving, direction, after
    )


class _Together:
    """Joints of a piece of motion that move each other, by the inertia between them or by what they touch."""

    def __init__(self, lanes: Lanes, surface: FloatArray | None) -> None:
        """Prepare lanes; `surface` as of `roll_out`."""
        self.touched = surface is not None and lanes.touch is not None
        together = self.touched or lanes.between is not None
        self.pieces = len(np.unique(lanes.piece)) if together else len(lanes.joint)
        if surface is not None and lanes.touch is not None:
            self.pieces = surface.shape[1]
        self.joints = len(lanes.joint) // self.pieces
        self._half, self._between = 0.5 * lanes.step, lanes.between
        self._middle = np.zeros((self.pieces, self.joints))
        self._pressed = np.zeros(self.pieces)
        self.lever, self.surface = np.zeros(lanes.load.shape), np.zeros((2, self.pieces))
        self.clear = np.zeros((len(lanes.load), self.pieces))
        if surface is not None and lanes.touch is not None:
            weights = np.concatenate([np.ones((1, self.pieces)), surface[2:]])
            touch = lanes.touch
            self.lever = np.einsum("ckl,cl->kl", touch.lever, np.repeat(weights, self.joints, axis=1))
            reached = (self.lever * touch.reference).reshape(len(self.lever), self.pieces, self.joints).sum(axis=2)
            self.clear = np.einsum("ckp,cp->kp", touch.height, weights) - surface[0] - reached
            self.surface = np.stack([surface[1], TOUCH_DAMPING * surface[1]])

    def settled(
        self, step: _Step, index: int, resistance: FloatArray, position: FloatArray, velocity: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Velocities (L,) in the middle of a step, torques (L,) between the joints, and forces (P,) of the surface."""
        h, shape = self._half, self._middle.shape
        given = step.momentum, step.friction, step.torque, step.acting, step.share, velocity, self.lever[index]
        momentum, friction, torque, acting, share, before, lever = (each.reshape(shape) for each in given)
        above = self.clear[index] + np.sum(lever * position.reshape(shape), axis=1)
        matrix, resisting, middle = self.matrix(index), resistance.reshape(shape), self._middle
        hardness, damping = self.surface
        divisor = np.empty(shape)
        for _ in range(SWEEPS):
            last, pressed = middle.copy(), self._pressed
            for joint in range(self.joints):
                pushed = momentum[:, joint] + h * lever[:, joint] * pressed
                pushed = pushed + np.einsum("pj,pj->p", matrix[:, joint], before - middle)
                direction = np.sign(pushed)
                passed = np.maximum(1.0 - direction * np.sign(torque[:, joint]) * share[:, joint], 0.0)
                divisor[:, joint] = resisting[:, joint] + h * h * acting[:, joint] * passed
                moving = np.abs(pushed) > friction[:, joint]
                middle[:, joint] = np.where(moving, (pushed - direction * friction[:, joint]) / divisor[:, joint], 0.0)
            if self.touched:
                rate, give = (lever * middle).sum(axis=1), np.sum(lever**2 * (h / divisor) * (middle != 0.0), axis=1)
                lacking = -hardness * (above + h * rate) - damping * rate - pressed
                self._pressed = np.maximum(pressed + lacking / (1.0 + (h * hardness + damping) * give), 0.0)
            if max(np.max(np.abs(middle - last)), np.max(np.abs(self._pressed - pressed))) < SETTLED:
                break
        pull = np.einsum("pij,pj->pi", matrix, middle - before) / h
        return middle.ravel().copy(), pull.ravel(), self._pressed

    def matrix(self, index: int) -> FloatArray:
        """(P, n, n) inertia between joints in a step, 0 on the diagonal."""
        if self._between is None:
            return np.zeros((self.pieces, self.joints, self.joints))
        row, part = divmod(index, THINNED)
        matrix = self._between[row]
        if part:
            matrix = matrix + part / THINNED * (self._between[row + 1] - matrix)
        return np.asarray(matrix * (1.0 - np.eye(self.joints)), dtype=np.float64)

    def solved(self, index: int, step: _Step, d_middle: FloatArray, d_velocity: FloatArray) -> FloatArray:
        """Derivatives (F, L) of the middle's velocities, from those (F, L) that each joint would have on its own."""
        shape = (len(d_middle), self.pieces, self.joints)
        matrix, moving, divisor = self.matrix(index), step.moving[index], step.divisor[index]
        asked = d_middle * divisor + moving * np.einsum("pij,fpj->fpi", matrix, d_velocity.reshape(shape)).reshape(
            d_middle.shape
        )
        mask = moving.reshape(shape[1:])
        whole = matrix * mask[:, :, None] * mask[:, None, :]
        whole[:, range(self.joints), range(self.joints)] = divisor.reshape(shape[1:])
        found = np.linalg.solve(whole, np.moveaxis(asked.reshape(shape), 0, 2))
        return np.asarray(np.moveaxis(found, 2, 0).reshape(d_middle.shape), dtype=np.float64)


def _tangents(
    lanes: Lanes,
    p: dict[str, FloatArray],
    terms: IndexArray,
    inertia: FloatArray,
    step: _Step,
    velocity: FloatArray,
    goals: _Goals,
    together: _Together,
) -> FloatArray:
    """Derivatives (F, K, L) of the positions on the grid; (n·F, K, L) where joints move each other.

    Along a known path they are linear in each other: of the velocity in the middle of a step, from those of position
    and velocity before it, d_middle = kept·d_velocity + pulled·d_position + driven. The coefficients of all steps are
    computed at once.
    """
    h, rows = 0.5 * lanes.step, {TERMS[term].name: row for row, term in enumerate(terms)}
    freely = step.acting > 0
    gate = step.moving / step.divisor
    torque = step.torque - h * step.acting * step.velocity
    loaded = np.sign(step.torque) * torque
    pull = gate * h * step.passed
    static = (p["breakaway"] + p["load_breakaway"] * loaded) * step.faded
    slope = h * static * 2.0 * velocity / p["stribeck_velocity"] ** 2
    kept, pulled = gate * (inertia + step.direction * slope), -pull * step.acting
    opposed = -gate * step.direction * h
    driven = np.zeros((len(rows), *velocity.shape))

    def add(name: str, partial: Callable[[], FloatArray]) -> None:
        if name in rows:
            driven[rows[name]] = partial()

    for name, derivative in (("delay", goals.by_delay), ("acceleration_limit", goals.by_limit)):
        if derivative is not None:
            driven[rows[name]] = -pulled * derivative
    add("bias", lambda: pulled)
    add("dead_band", lambda: pulled * step.side * p["dead_band"])
    add("stiffness", lambda: pull * np.where(freely, torque, 0.0))
    add("torque_limit", lambda: pull * np.where(step.outside & ~freely, step.torque, 0.0))
    add("coulomb", lambda: opposed * p["coulomb"])
    add("load_friction", lambda: opposed * p["load_friction"] * loaded)
    add("breakaway", lambda: opposed * p["breakaway"] * step.faded)
    add("load_breakaway", lambda: opposed * p["load_breakaway"] * loaded * step.faded)
    add("stribeck_velocity", lambda: opposed * static * 2.0 * (velocity / p["stribeck_velocity"]) ** 2)
    add("zero", lambda: -gate * h * lanes.load_slope)
    add("armature", lambda: gate * p["armature"] * (velocity - step.velocity))
    add("damping", lambda: -gate * h * p["damping"] * step.velocity)
    if lanes.between is not None:
        own, count = driven, together.joints
        driven = np.zeros((count, *own.shape))
        for joint in range(count):
            driven[joint, :, :, joint::count] = own[:, :, joint::count]
        driven = driven.reshape(-1, *own.shape[1:])
    d_position, d_velocity = np.zeros_like(driven[:, 0]), np.zeros_like(driven[:, 0])
    change = np.empty_like(d_position)
    for index in range(len(velocity)):
        d_middle = kept[index] * d_velocity
        d_middle += np.multiply(d_position, pulled[index], out=change)
        d_middle += driven[:, index]
        if lanes.between is not None:
            d_middle = together.solved(index, step, d_middle, d_velocity)
        driven[:, index] = d_position  # what this step was driven by is needed no more
        d_velocity = np.subtract(2.0 * d_middle, d_velocity, out=d_velocity) * step.moving[index]
        d_position += np.multiply(d_middle, lanes.step, out=change)
    return driven


def at_samples(lanes: Lanes, path: FloatArray) -> FloatArray:
    """Values (…, S, L) at the measured samples, between those on the grid (…, K, L)."""
    before = np.clip(np.floor(lanes.sample).astype(np.intp), 0, path.shape[-2] - 2)
    part = lanes.sample - before
    lane = np.arange(path.shape[-1])
    sampled: FloatArray = path[..., before, lane] * (1.0 - part) + path[..., before + 1, lane] * part
    return sampled


def _goals(lanes: Lanes, delay: FloatArray, steepest: FloatArray, names: Collection[str]) -> _Goals:
    """Goals of the servos' profiles, and their derivatives by those of delay and limit that `names` holds.

    A profile starts at once, however small a part of a command has come: goals are delayed, not commands. Goals are
    means over the step, as commands are. A profile
    that switches between its limits has no smooth derivative by them: differences over a finite span stand for it.
    """
    limited = "acceleration_limit" in names
    if (library := kernels().long) is not None:
        call, shape = _Call(), lanes.load.shape
        path, by_delay = np.empty(shape), np.empty(shape) if "delay" in names else None
        by_limit = np.empty(shape) if limited else None
        sizes = (c_long(lanes.history), c_long(shape[0]), c_long(shape[1]), c_double(lanes.step))
        given = map(call.given, (lanes.command, delay, steepest, path, by_delay, by_limit))
        library.servo_goals(*sizes, c_double(STEEPNESS_SPAN), c_double(UNLIMITED), *given)
        return _Goals(path, by_delay, by_limit)
    factor = np.exp(STEEPNESS_SPAN)
    limits = [steepest, *([steepest * factor, steepest / factor] if limited else [])]
    wide, steep = np.tile(lanes.command, (1, len(limits))), np.concatenate(limits)
    ends = profile_goals(wide, lanes.step, steep)
    wide[1:] = np.where(steep < UNLIMITED, 0.5 * (ends[1:] + ends[:-1]), wide[1:])
    lateness = delay / lanes.step
    whole = np.floor(lateness)
    newer = lanes.history - whole.astype(np.intp)
    places = np.clip(newer + np.arange(len(lanes.load) + 1)[:, None], 0, len(lanes.command) - 1)
    lane, late, delayed = np.arange(len(delay)), lateness - whole, []
    for own in np.split(wide, len(limits), axis=1):
        reached = own[places, lane]
        older = reached[:-1] - reached[1:]
        delayed.append((reached[1:] + late * older, older))
    return _Goals(
        delayed[0][0],
        delayed[0][1] / lanes.step if "delay" in names else None,
        (delayed[1][0] - delayed[2][0]) / (2 * STEEPNESS_SPAN) if limited else None,
    )


def profile_goals(command: FloatArray, step: float, steepest: FloatArray) -> FloatArray:
    """Goals (K, L) of the servos' profiles at each time of commands (K, L): as fast there as accelerations (L,) allow.

    They brake so as to stop at the command, and are at rest at the first.
    """
    if np.all(steepest >= UNLIMITED):
        return command
    goals = np.empty(command.shape)
    if (library := kernels().long) is not None:
        sizes, call = (c_long(len(command)), c_long(command.shape[1]), c_double(step)), _Call()
        library.servo_profile(*sizes, *map(call.given, (command, steepest, goals)))
        return goals
    half, most = 0.5 * step * steepest, step * steepest
    goals[0] = goal = command[0]
    pace = np.zeros_like(goal)
    twice, square = 2.0 * steepest, half * half
    for index in range(1, len(command)):
        ahead = command[index] - goal
        distance = np.abs(ahead)
        # never past the target in one step
        braking = np.minimum(np.sqrt(twice * distance + square) - half, distance / step)
        pace = np.minimum(np.maximum(np.copysign(braking, ahead), pace - most), pace + most)
        goal = goal + step * pace
        goals[index] = goal - 0.5 * step * pace  # a sum of velocities after their steps is half a step ahead
    return goals
