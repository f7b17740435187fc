"""Roll-outs of servo joints by NumPy, where no compiler is: the same steps as `ident/compiled/servo.c`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from drivers.core.arrays import BoolArray, FloatArray, IndexArray
from ident.servo.rollout.goals import Goals
from ident.servo.rollout.lanes import THINNED, Lanes, RollOut, at_samples
from ident.servo.terms import INDEX, TERMS

TOUCH_DAMPING = 0.01
"""[s] Damping of a contact over its stiffness."""

SWEEPS, SETTLED = 200, 1e-9
"""Rounds at most over the joints of a step and what they touch, and the change [rad/s or N] at which they agree."""


def roll_out_numpy(
    lanes: Lanes, values: FloatArray, parameters: tuple[IndexArray, IndexArray], goals: Goals, together: Together
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
        errors = goals.errors(index, position + p["bias"])
        now = inertia[index], resistance[index], lanes.load[index], offset[index]
        step = _step(half, p, *now, errors, goals.late, velocity, present)
        middle, gone = _turned(velocity, step.velocity, step.friction, step.divisor)
        if together.touched or lanes.between is not None:
            middle, gone, force[index] = together.settled(step, index, resistance[index], position, velocity)
        after = np.where((velocity != 0.0) | (middle != 0.0), 2.0 * middle - velocity, 0.0)
        if lanes.between is not None:
            changed = (middle - velocity).reshape(-1, together.joints)
            pull[index] = np.einsum("pij,pj->pi", together.matrix(index), changed).ravel() / half
        velocity, position = after, position + h * gone
    terms, owners = parameters
    pieces = width // together.joints
    slopes = np.zeros((pieces, 0, together.joints, 0))
    if len(terms):
        columns = np.unique(terms)
        errors = goals.errors(slice(None), path + p["bias"])
        step = _step(half, p, inertia, resistance, lanes.load + pull, offset, errors, goals.late, velocities)
        rows = {TERMS[term].name: row for row, term in enumerate(columns)}
        tangents = _tangents(_Known(lanes, p, rows, step, velocities, goals, together), inertia)
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
    """What a step computes, (…, L) each.

    The drive's torque and its direction; the stiffness that acts, and its shares before and after the goal changes; the
    part of the torque that is at the drive's limit; what a wider dead band takes away and a later goal adds; and the
    velocity in the middle.
    """

    torque: FloatArray
    toward: FloatArray
    acting: FloatArray
    shares: tuple[FloatArray, FloatArray]
    limited: FloatArray
    sided: FloatArray
    later: FloatArray
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
    errors: tuple[FloatArray, FloatArray],
    late: FloatArray,
    velocity: FloatArray,
    present: _Present = _ALL,
) -> _Step:
    """Half a step, of h [s], or those of a path's steps, from position errors and velocities (…, L) before it.

    The error is the first for the `late` share of the step, and then the other: a drive's limit holds for each, not for
    their mean. `resistance` is the inertia with what damping adds in it; `offset` what the encoder's zero adds.
    What the derivatives need of terms that are not `present` has no meaning.
    """
    ahead, shares, torques = h * velocity, [], []
    torque, limited, sided = np.zeros_like(velocity), np.zeros_like(velocity), np.zeros_like(velocity)
    for error, part in zip(errors, (late, 1.0 - late), strict=True):
        middle = error - ahead  # which tells whether a drive is at its limit
        side, share, linear = np.sign(middle), part * p["stiffness"], p["stiffness"] * middle
        if present.dead_band:
            outside = np.abs(middle) - p["dead_band"]
            linear = p["stiffness"] * side * np.maximum(outside, 0.0)
            share = np.where(outside > 0.0, share, 0.0)
        own = linear
        if present.limit:
            own = np.minimum(np.maximum(linear, -p["torque_limit"]), p["torque_limit"])
            limited = limited + np.where(own == linear, 0.0, part * own)
            share = np.where(own == linear, share, 0.0)
        if present.dead_band:
            sided = sided + share * side
        torque = torque + part * own
        torques.append(own)
        shares.append(share)
    acting, toward = shares[0] + shares[1], np.sign(torque)
    torque = torque + acting * ahead  # as at the beginning, from where the step is implicit
    momentum = inertia * velocity + h * (torque - load - offset)
    loaded = toward * torque if present.load or present.breakaway else torque
    friction, lost = p["coulomb"], np.zeros_like(p["coulomb"])
    if present.load:
        friction, lost = friction + p["load_friction"] * loaded, p["load_friction"]
    faded = velocity
    if present.breakaway:
        faded = np.exp(-((velocity / p["stribeck_velocity"]) ** 2))
        friction = friction + (p["breakaway"] + p["load_breakaway"] * loaded) * faded
        lost = lost + p["load_breakaway"] * faded
    friction, resting = h * friction, velocity == 0.0
    moving, direction = ~resting | (np.abs(momentum) > friction), np.sign(np.where(resting, momentum, velocity))
    # friction follows the torque that is left after the step, as the drive does
    passed = np.maximum(1.0 - direction * toward * lost, 0.0)
    divisor = resistance + h * h * acting * passed
    after = np.where(moving, (momentum - direction * friction) / divisor, 0.0)
    return _Step(
        torque,
        toward,
        acting,
        (shares[0], shares[1]),
        limited,
        sided,
        torques[0] - torques[1],
        lost,
        divisor,
        faded,
        passed,
        momentum,
        friction,
        moving,
        direction,
        after,
    )


class Together:
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
        """Velocities (L,) in the middle of a step and their means over it, and forces (P,) of the surface."""
        h, shape = self._half, self._middle.shape
        given = step.momentum, step.friction, step.toward, step.acting, step.share, velocity, self.lever[index]
        momentum, friction, toward, acting, share, before, lever = (each.reshape(shape) for each in given)
        above = self.clear[index] + np.sum(lever * position.reshape(shape), axis=1)
        matrix, resisting, middle = self.matrix(index), resistance.reshape(shape), self._middle
        hardness, damping = self.surface
        divisor, gone = np.empty(shape), np.empty(shape)
        for _ in range(SWEEPS):
            last, pressed = middle.copy(), self._pressed
            for joint in range(self.joints):
                pushed = momentum[:, joint] + h * lever[:, joint] * pressed
                pushed = pushed + np.einsum("pj,pj->p", matrix[:, joint], before - middle)
                resting = before[:, joint] == 0.0
                direction = np.sign(np.where(resting, pushed, before[:, joint]))
                passed = np.maximum(1.0 - direction * toward[:, joint] * share[:, joint], 0.0)
                divisor[:, joint] = resisting[:, joint] + h * h * acting[:, joint] * passed
                moving = ~resting | (np.abs(pushed) > friction[:, joint])
                alone = np.where(moving, (pushed - direction * friction[:, joint]) / divisor[:, joint], 0.0)
                middle[:, joint], gone[:, joint] = _turned(
                    before[:, joint], alone, friction[:, joint], divisor[:, joint]
                )
            if self.touched:
                rate, give = (lever * middle).sum(axis=1), np.sum(lever**2 * (h / divisor) * (middle != 0.0), axis=1)
                lacking = -hardness * (above + h * rate) - damping * rate - pressed
                self._pressed = np.maximum(pressed + lacking / (1.0 + (h * hardness + damping) * give), 0.0)
            if max(np.max(np.abs(middle - last)), np.max(np.abs(self._pressed - pressed))) < SETTLED:
                break
        return middle.ravel().copy(), gone.ravel(), self._pressed

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


@dataclass(frozen=True, eq=False)
class _Known:
    """A path that is known, along which derivatives are linear in each other; `rows` of its terms by name."""

    lanes: Lanes
    p: dict[str, FloatArray]
    rows: dict[str, int]
    step: _Step
    velocity: FloatArray
    goals: Goals
    together: Together

    def fading(self, middle: FloatArray | float) -> FloatArray:
        """(K, L) by how much friction's part of the momentum falls with velocity, with its direction."""
        h, p, step = 0.5 * self.lanes.step, self.p, self.step
        loaded = step.toward * (step.torque - h * step.acting * middle)
        static = (p["breakaway"] + p["load_breakaway"] * loaded) * step.faded
        return np.asarray(h * static * 2.0 * self.velocity / p["stribeck_velocity"] ** 2, dtype=np.float64)

    def by_terms(self, passed: FloatArray, direction: FloatArray | float, middle: FloatArray | float) -> FloatArray:
        """How the momentum in the middle of each step changes with a joint's own terms (F, K, L)."""
        h, p, step = 0.5 * self.lanes.step, self.p, self.step
        torque, push = step.torque - h * step.acting * middle, h * passed
        loaded, drag = step.toward * torque, -direction * h
        partials: dict[str, Callable[[], FloatArray]] = {
            "delay": lambda: push * step.later / self.lanes.step,
            "bias": lambda: -push * step.acting,
            "dead_band": lambda: -push * step.sided * p["dead_band"],
            "stiffness": lambda: push * (torque - step.limited),
            "torque_limit": lambda: push * step.limited,
            "coulomb": lambda: drag * p["coulomb"],
            "load_friction": lambda: drag * p["load_friction"] * loaded,
            "breakaway": lambda: drag * p["breakaway"] * step.faded,
            "load_breakaway": lambda: drag * p["load_breakaway"] * loaded * step.faded,
            "stribeck_velocity": lambda: -direction * self.fading(middle) * self.velocity,
            "zero": lambda: -h * self.lanes.load_slope,
            "armature": lambda: p["armature"] * (self.velocity - middle),
            "damping": lambda: -h * p["damping"] * middle,
        }
        if (by_limit := self.goals.by_limit) is not None:
            changed = step.shares[0] * by_limit[:-1] + step.shares[1] * by_limit[1:]
            partials["acceleration_limit"] = lambda: push * changed
        return self._in_rows(partials)

    def resisting(self) -> FloatArray:
        """How what resists a joint changes with its own terms (F, K, L)."""
        h, p, step = 0.5 * self.lanes.step, self.p, self.step
        curved = h**2 * step.acting
        return self._in_rows(
            {
                "stiffness": lambda: curved * step.passed,
                "damping": lambda: h * p["damping"],
                "armature": lambda: p["armature"],
                "load_friction": lambda: -curved * step.direction * step.toward * p["load_friction"],
                "load_breakaway": lambda: -curved * step.direction * step.toward * p["load_breakaway"] * step.faded,
            }
        )

    def of_owners(self, own: FloatArray) -> FloatArray:
        """Derivatives (n·F, …, L) by the terms of each joint of a piece, where its joints move each other."""
        if self.lanes.between is None:
            return own
        count = self.together.joints
        each = np.zeros((count, *own.shape))
        for joint in range(count):
            each[joint, ..., joint::count] = own[..., joint::count]
        return each.reshape(-1, *own.shape[1:])

    def _in_rows(self, partials: dict[str, Callable[[], FloatArray]]) -> FloatArray:
        found = np.zeros((len(self.rows), *self.velocity.shape))
        for name in self.rows.keys() & partials.keys():
            found[self.rows[name]] = partials[name]()
        return found


def _tangents(known: _Known, inertia: FloatArray) -> FloatArray:
    """Derivatives (F, K, L) of the positions on the grid; (n·F, K, L) where joints move each other.

    Of the velocity in the middle of a step, from those of position and velocity before it, d_middle =
    kept·d_velocity + pulled·d_position + driven. The coefficients of all steps are computed at once.
    """
    lanes, step, velocity, together = known.lanes, known.step, known.velocity, known.together
    h, gate = 0.5 * lanes.step, step.moving / step.divisor
    kept = gate * (inertia + step.direction * known.fading(step.velocity))
    pulled = -gate * h * step.passed * step.acting
    driven = known.of_owners(gate * known.by_terms(step.passed, step.direction, step.velocity))
    turning = velocity * (2.0 * step.velocity - velocity) * step.moving < 0.0
    turned = _turn_slopes(known, turning) if turning.any() else None
    d_position, d_velocity = np.zeros_like(driven[:, 0]), np.zeros_like(driven[:, 0])
    change = np.empty_like(d_position)
    for index in range(len(velocity)):
        d_middle = kept[index] * d_velocity
        d_middle += np.multiply(d_position, pulled[index], out=change)
        d_middle += driven[:, index]
        if lanes.between is not None:
            d_middle = together.solved(index, step, d_middle, d_velocity)
        driven[:, index] = d_position  # what this step was driven by is needed no more
        d_after = (2.0 * d_middle - d_velocity) * step.moving[index]
        if turned is not None and turning[index].any():
            d_middle, d_after = turned(index, d_position, d_velocity, d_middle, d_after)
        d_velocity = d_after
        d_position += np.multiply(d_middle, lanes.step, out=change)
    return driven


def _turn_slopes(
    known: _Known, turning: BoolArray
) -> Callable[[int, FloatArray, FloatArray, FloatArray, FloatArray], tuple[FloatArray, FloatArray]]:
    """What turns (K, L) make of derivatives (F, L) in a step.

    Of that step's number, those of position and velocity before it, and of mean and last velocity without the turn.
    """
    step = known.step
    bent = step.toward * step.share
    rubs = 0.5 * (known.by_terms(1.0 + bent, -1.0, 0.0) - known.by_terms(1.0 - bent, 1.0, 0.0))
    by_place, by_rate = -0.5 * known.lanes.step * bent * step.acting, -known.fading(0.0)
    resisting = known.resisting()

    def slopes(
        index: int, d_position: FloatArray, d_velocity: FloatArray, d_middle: FloatArray, d_after: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        now, friction, resists = known.velocity[index], step.friction[index], step.divisor[index]
        after = 2.0 * step.velocity[index] - now
        turn = _Turn.of(now, after, friction, resists)
        d_half = 0.5 * (d_velocity - d_after)
        d_friction = known.of_owners(rubs[:, index]) + by_place[index] * d_position + by_rate[index] * d_velocity
        d_fall = np.sign(now) * d_half * resists + np.abs(turn.half) * known.of_owners(resisting[:, index])
        d_back = np.where(turn.back > 0.0, 2.0 * (friction * d_fall / turn.fall - d_friction) / turn.fall, 0.0)
        squares = 2.0 * now * d_velocity - after**2 * d_back - 2.0 * turn.back * after * d_after
        d_gone = squares / (4.0 * turn.half) - turn.gone * d_half / turn.half
        d_turned = turn.back * d_after + after * d_back
        return np.where(turning[index], d_gone, d_middle), np.where(turning[index], d_turned, d_after)

    return slopes


class _Turn(NamedTuple):
    """Joints (L,) that come to rest within a step: friction reverses with them, or holds them there from then on.

    Half of their fall of velocity if friction did not turn, the impulse that this takes, the share of their velocity
    after it that they move back with, and their mean velocity.
    """

    half: FloatArray
    fall: FloatArray
    back: FloatArray
    gone: FloatArray

    @classmethod
    def of(cls, velocity: FloatArray, after: FloatArray, friction: FloatArray, resists: FloatArray) -> _Turn:
        """Turns from velocities before a step and, if friction did not turn, after it; no meaning elsewhere."""
        half = np.where(velocity * after < 0.0, 0.5 * (velocity - after), 1.0)
        fall = np.abs(half) * resists
        back = np.maximum(1.0 - 2.0 * friction / fall, 0.0)
        return cls(half, fall, back, (velocity**2 - back * after**2) / (4.0 * half))


def _turned(
    velocity: FloatArray, middle: FloatArray, friction: FloatArray, resists: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Half of velocities (L,) before and after a step, and their means over it, from a middle without turns (L,)."""
    after = 2.0 * middle - velocity
    turning = velocity * after < 0.0
    if not turning.any():
        return middle, middle
    turn = _Turn.of(velocity, after, friction, resists)
    return np.where(turning, 0.5 * (velocity + turn.back * after), middle), np.where(turning, turn.gone, middle)
