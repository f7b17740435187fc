"""Roll-out of servo joints on commands, many pieces of motion side by side, with derivatives by their parameters.

Every joint is one equation, with gravity known along the motion. The joints of a piece move each other by the inertia
between them, which is known along the motion, too: a step solves them together, or, where only single joints are
looked at, takes the torque between them as known. A step is the implicit midpoint rule: half a step implicit in
damping, stiffness and friction (soft threshold, so that sticking is exact), and its velocity over the whole step. It is
stable with any step, and neither ahead of the joint nor damped.
"""

from __future__ import annotations

from collections.abc import Callable
from ctypes import c_double, c_long, c_void_p
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from drivers.core.arrays import BoolArray, FloatArray, IndexArray
from ident.compiled.library import address, kernels
from ident.servo.terms import INDEX, TERMS

STEEPNESS_SPAN = 0.03
"""Half of the difference that gives derivatives by the logarithm of an acceleration limit."""

DELAY_SPAN = 1.5
"""The same by a delay, in steps."""

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

    def of(self, chosen: IndexArray) -> Lanes:
        """Some of the lanes."""
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
        tangents: (F, K, L) derivatives of the path without contact by the search's coordinates (logarithms of positive
            terms); (n·F, K, L) where joints move each other, by the terms of each joint of a piece in turn.
        force: (K, P) of the contact [N], without columns where nothing is touched.
        pull: (K, L) torque that the other joints ask for [N·m], without columns where none moves another.
    """

    path: FloatArray
    tangents: FloatArray
    force: FloatArray
    pull: FloatArray


def roll_out(
    lanes: Lanes, values: FloatArray, free: IndexArray | None = None, surface: FloatArray | None = None
) -> RollOut:
    """Roll lanes out on their commands.

    Args:
        lanes: K steps, L lanes.
        values: (terms, L) parameters of each lane.
        free: (F,) indices of the terms to derive by; none where None.
        surface: (5, P) height [m] and stiffness [N/m] of what each piece may touch, and the point (3) [m] that touches;
            nothing is touched where None.
    """
    free = np.zeros(0, dtype=np.intp) if free is None else free
    rows = {TERMS[term].name: row for row, term in enumerate(free)}
    p = {name: values[index] for name, index in INDEX.items()}
    goals, d_goals = _goals(lanes, p["delay"], p["acceleration_limit"], rows)
    together = _Together(lanes, surface)
    if (library := kernels().long) is not None:
        return _compiled(library, lanes, values, free, goals, d_goals, together)
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
        error = goals[index] - position - p["bias"]
        step = _step(
            half, p, inertia[index], resistance[index], lanes.load[index], offset[index], error, velocity, present
        )
        middle, moving = step.velocity, step.moving
        if together.touched or lanes.between is not None:
            middle, pull[index], force[index] = together.settled(step, index, resistance[index], position, velocity)
            moving = middle != 0.0
        velocity = np.where(moving, 2.0 * middle - velocity, 0.0)
        position = position + h * middle
    tangents = np.zeros((0, count, width))
    if len(free):
        error = goals - path - p["bias"]
        step = _step(half, p, inertia, resistance, lanes.load + pull, offset, error, velocities)
        tangents = _tangents(lanes, p, rows, inertia, step, velocities, d_goals, together)
    none = slice(None) if lanes.between is not None else slice(0)
    return RollOut(path, tangents, force if surface is not None else force[:, :0], pull[:, none])


def with_pull(lanes: Lanes, values: FloatArray) -> Lanes:
    """Lanes whose joints' torques on each other are known: those of a roll-out with values (n, terms)."""
    if lanes.between is None:
        return lanes
    return replace(lanes, load=lanes.load + roll_out(lanes, values[lanes.joint].T).pull, between=None)


def _compiled(
    library: Any,
    lanes: Lanes,
    values: FloatArray,
    free: IndexArray,
    goals: FloatArray,
    d_goals: dict[int, FloatArray],
    together: _Together,
) -> RollOut:
    """The same by the library's C code."""
    count, width = lanes.load.shape
    by_goals = np.zeros((len(free), count, width))
    for row, derivative in d_goals.items():
        by_goals[row] = derivative
    coupled, touched = lanes.between is not None, together.touched
    owners = together.joints if coupled else 1
    path, tangents = np.empty((count, width)), np.empty((owners * len(free), count, width))
    pull, force = np.empty((count, width if coupled else 0)), np.empty((count, together.pieces if touched else 0))
    kept = []  # what C reads lives until it has

    def given(array: FloatArray | IndexArray | None, kind: Any = np.float64) -> c_void_p:
        if array is None:
            return c_void_p(None)
        kept.append(np.ascontiguousarray(array, dtype=kind))
        return c_void_p(address(kept[-1]))

    known = [values, lanes.inertia, lanes.load, lanes.load_slope, lanes.start, goals]
    library.servo_roll_out(
        *(c_long(size) for size in (count, width // together.joints, together.joints)),
        c_double(lanes.step),
        *(given(array) for array in known),
        *(given(lanes.between), c_long(THINNED), c_void_p(address(pull)) if coupled else c_void_p(None)),
        *(given(array if touched else None) for array in (together.clear, together.lever, together.surface)),
        *(c_void_p(address(force)) if touched else c_void_p(None), c_long(len(free))),
        *(given(free, np.int_), given(by_goals), c_void_p(address(path)), c_void_p(address(tangents))),
    )
    return RollOut(path, tangents, force, pull)


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
    rows: dict[str, int],
    inertia: FloatArray,
    step: _Step,
    velocity: FloatArray,
    d_goals: dict[int, FloatArray],
    together: _Together,
) -> FloatArray:
    """Derivatives (F, K, L) of the positions on the grid; (n·F, K, L) where joints move each other.

    Along a known path they are linear in each other: of the velocity in the middle of a step, from those of position
    and velocity before it, d_middle = kept·d_velocity + pulled·d_position + driven. The coefficients of all steps are
    computed at once.
    """
    h = 0.5 * lanes.step
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

    for row, derivative in d_goals.items():
        driven[row] = -pulled * derivative
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


def _goals(
    lanes: Lanes, delay: FloatArray, steepest: FloatArray, rows: dict[str, int]
) -> tuple[FloatArray, dict[int, FloatArray]]:
    """Goals (K, L) of the servos' profiles in each step, and their derivatives by the rows that are asked for.

    A profile starts at once, however small a part of a command has come: goals are delayed, not commands. Goals are
    means over the step, as commands are. A profile
    that switches between its limits has no smooth derivative by them: differences over a finite span stand for it.
    """
    limit, factor = "acceleration_limit", np.exp(STEEPNESS_SPAN)
    limits = [steepest, *([steepest * factor, steepest / factor] if limit in rows else [])]
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
    derivatives = {}
    if "delay" in rows:
        derivatives[rows["delay"]] = delayed[0][1] / lanes.step
    if limit in rows:
        derivatives[rows[limit]] = (delayed[1][0] - delayed[2][0]) / (2 * STEEPNESS_SPAN)
    return delayed[0][0], derivatives


def profile_goals(command: FloatArray, step: float, steepest: FloatArray) -> FloatArray:
    """Goals (K, L) of the servos' profiles at each time of commands (K, L): as fast there as accelerations (L,) allow.

    They brake so as to stop at the command, and are at rest at the first.
    """
    if np.all(steepest >= UNLIMITED):
        return command
    goals = np.empty(command.shape)
    if (library := kernels().long) is not None:
        given = [np.ascontiguousarray(array, dtype=np.float64) for array in (command, steepest)]
        sizes = c_long(len(command)), c_long(command.shape[1]), c_double(step)
        library.servo_profile(*sizes, *(c_void_p(address(array)) for array in (*given, goals)))
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
