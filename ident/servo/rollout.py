"""Roll-out of servo joints on commands, many pieces of motion side by side, with derivatives by their parameters.

Every joint is one equation, with the rigid body's torques known along the motion: gear ratios are high, and the other
joints act through gravity and coupling, which `ident.servo.arm_rollout` brings up to date between two roll-outs. A step
is the implicit midpoint rule: half a step implicit in damping, stiffness and friction (soft threshold, so that sticking
is exact), and its velocity over the whole step. It is stable with any step, and neither ahead of the joint nor damped.
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

TOUCH_ROUNDS = 4
"""Newton steps at most to the force of a contact, whose joints stick and slip."""


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

    def of_pieces(self, pieces: IndexArray) -> Lanes:
        """All lanes of some pieces, by number, with what they touch."""
        chosen = np.flatnonzero(np.isin(self.piece, pieces))
        if self.touch is None:
            return self.of(chosen)
        kept = np.flatnonzero(np.isin(np.unique(self.piece), pieces))
        touch = Touch(self.touch.reference[:, chosen], self.touch.height[:, :, kept], self.touch.lever[:, :, chosen])
        return replace(self.of(chosen), touch=touch)

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
    return replace(wide, joint=wide.joint + offsets, touch=touch)


def roll_out(
    lanes: Lanes, values: FloatArray, free: IndexArray | None = None, surface: FloatArray | None = None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Positions on the grid, their derivatives without contact, and the force of the contact.

    Args:
        lanes: K steps, L lanes.
        values: (terms, L) parameters of each lane.
        free: (F,) indices of the terms to derive by; none where None.
        surface: (5, P) height [m] and stiffness [N/m] of what each piece may touch, and the point (3) [m] that touches;
            nothing is touched where None.

    Returns:
        (K, L) positions [rad or m]; (F, K, L) derivatives by the search's coordinates (logarithms of positive terms);
        (K, P) forces [N], without columns where nothing is touched.
    """
    free = np.zeros(0, dtype=np.intp) if free is None else free
    rows = {TERMS[term].name: row for row, term in enumerate(free)}
    p = {name: values[index] for name, index in INDEX.items()}
    goals, d_goals = _goals(lanes, p["delay"], p["acceleration_limit"], rows)
    if surface is None and (library := kernels().long) is not None:
        return *_compiled(library, lanes, values, free, goals, d_goals), np.zeros((len(goals), 0))
    inertia = p["armature"] + lanes.inertia
    offset = p["zero"] * lanes.load_slope
    h, (count, width) = lanes.step, lanes.load.shape
    half = 0.5 * h
    resistance = inertia + half * p["damping"]
    position, velocity = lanes.start.copy(), np.zeros(width)
    path, velocities = np.empty((count, width)), np.empty((count, width))
    contact = None if surface is None or lanes.touch is None else _Surface(lanes, lanes.touch, surface)
    force = np.zeros((count, 0 if contact is None else contact.pieces))
    present = _Present.of(p)
    for index in range(count):
        path[index], velocities[index] = position, velocity
        error = goals[index] - position - p["bias"]
        step = _step(
            half, p, inertia[index], resistance[index], lanes.load[index], offset[index], error, velocity, present
        )
        if contact is not None:
            step = contact.pushed(step, index, position, force[index])
        velocity = np.where(step.moving, 2.0 * step.velocity - velocity, 0.0)
        position = position + h * step.velocity
    if not len(free):
        return path, np.zeros((0, count, width)), force
    step = _step(half, p, inertia, resistance, lanes.load, offset, goals - path - p["bias"], velocities)
    return path, _tangents(lanes, p, rows, inertia, step, velocities, d_goals), force


def _compiled(
    library: Any, lanes: Lanes, values: FloatArray, free: IndexArray, goals: FloatArray, d_goals: dict[int, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Positions (K, L) and derivatives (F, K, L), by the library's C code."""
    count, width = lanes.load.shape
    by_goals = np.zeros((len(free), count, width))
    for row, derivative in d_goals.items():
        by_goals[row] = derivative
    given = [values, lanes.inertia, lanes.load, lanes.load_slope, lanes.start, goals]
    arrays = [np.ascontiguousarray(array, dtype=np.float64) for array in given]
    terms = np.ascontiguousarray(free, dtype=np.int_)
    path, tangents = np.empty((count, width)), np.empty((len(free), count, width))
    library.servo_roll_out(
        c_long(count),
        c_long(width),
        c_double(lanes.step),
        *(c_void_p(address(array)) for array in arrays),
        c_long(len(free)),
        *(c_void_p(address(array)) for array in (terms, by_goals, path, tangents)),
    )
    return path, tangents


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
    return _Step(outside, side, torque, acting, divisor, faded, passed, momentum, friction, moving, direction, after)


class _Surface:
    """What pieces of motion may touch."""

    def __init__(self, lanes: Lanes, touch: Touch, surface: FloatArray) -> None:
        """Prepare lanes; `surface` as of `roll_out`."""
        weights = np.concatenate([np.ones((1, surface.shape[1])), surface[2:]])
        self.pieces = surface.shape[1]
        self.joints = len(lanes.joint) // self.pieces
        self._step = lanes.step
        self._clear = np.einsum("ckp,cp->kp", touch.height, weights) - surface[0]
        self._lever = np.einsum("ckl,cl->kl", touch.lever, np.repeat(weights, self.joints, axis=1))
        self._reference = touch.reference
        self._stiffness = surface[1]

    def pushed(self, step: _Step, index: int, position: FloatArray, force: FloatArray) -> _Step:
        """The step with what the surface adds; its forces (P,) are written into `force`."""
        lever, h = self._lever[index], 0.5 * self._step
        clear = self._clear[index] + self._sum(lever * (position - self._reference[index]))
        if np.all(clear > 0.02):
            return step
        hardness, damping = self._stiffness, TOUCH_DAMPING * self._stiffness
        give = lever * lever * (h / step.divisor)
        velocity, moving, direction = step.velocity, step.moving, step.direction
        for _ in range(TOUCH_ROUNDS):
            rate = self._sum(lever * velocity)
            lacking = -hardness * (clear + h * rate) - damping * rate - force
            change = lacking / (1.0 + (h * hardness + damping) * self._sum(np.where(moving, give, 0.0)))
            after = np.maximum(force + change, 0.0)
            if not np.any(np.abs(after - force) > 1e-6 * (1.0 + force)):
                break
            force[:] = after
            momentum = step.momentum + h * lever * np.repeat(force, self.joints)
            moving, direction = np.abs(momentum) > step.friction, np.sign(momentum)
            velocity = np.where(moving, (momentum - direction * step.friction) / step.divisor, 0.0)
        return step._replace(velocity=velocity, moving=moving, direction=direction)

    def _sum(self, values: FloatArray) -> FloatArray:
        summed: FloatArray = values.reshape(self.pieces, self.joints).sum(axis=1)
        return summed


def _tangents(
    lanes: Lanes,
    p: dict[str, FloatArray],
    rows: dict[str, int],
    inertia: FloatArray,
    step: _Step,
    velocity: FloatArray,
    d_goals: dict[int, FloatArray],
) -> FloatArray:
    """Derivatives (F, K, L) of the positions on the grid.

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
    d_position, d_velocity = np.zeros_like(driven[:, 0]), np.zeros_like(driven[:, 0])
    change = np.empty_like(d_position)
    for index in range(len(velocity)):
        d_middle = kept[index] * d_velocity
        d_middle += np.multiply(d_position, pulled[index], out=change)
        d_middle += driven[:, index]
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
