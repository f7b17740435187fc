"""Roll-out of servo joints on commands, many pieces of motion side by side, with derivatives by their parameters.

Every joint is one equation, with gravity known along the motion. The joints of a piece move each other by the inertia
between them, which is known along the motion, too: a step solves them together, or, where only single joints are
looked at, takes the torque between them as known. A step is the implicit midpoint rule: half a step implicit in
damping, stiffness and friction (soft threshold, so that sticking is exact), and its velocity over the whole step. It is
stable with any step, and neither ahead of the joint nor damped. A joint that comes to rest within a step sticks or
turns there, and a goal that changes within a step meets the drive's limit before and after: with the friction or the
limit of the whole step's mean, errors would fall with the step only, and the cost would jump with the parameters.
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
"""Inertia between joints is evaluated at every fourth step: it changes slowly."""

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
    """Goals (K + 1, L) of profiles, and their derivatives by a limit; None where not asked for.

    During a step, its own row is the goal for the `late` (L,) share, and the next row for the rest.
    """

    path: FloatArray
    late: FloatArray
    by_limit: FloatArray | None

    def errors(self, steps: int | slice, position: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Position errors (…, L) before and after the goal changes in some steps, from positions (…, L) before them."""
        older, newer = (self.path[:-1], self.path[1:])
        return older[steps] - position, newer[steps] - position


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
        *map(call.given, (values, lanes.inertia, lanes.load, lanes.load_slope, lanes.start, goals.path, goals.late)),
        *(call.given(lanes.between), c_long(THINNED), call.given(pull if coupled else None)),
        *(call.given(array if touched else None) for array in (together.clear, together.lever, together.surface)),
        *(call.given(force if touched else None), c_long(len(terms))),
        *(call.given(owners, np.int_), call.given(terms, np.int_)),
        *(call.given(goals.by_limit), c_long(samples)),
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
    goals: _Goals
    together: _Together

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


def at_samples(lanes: Lanes, path: FloatArray) -> FloatArray:
    """Values (…, S, L) at the measured samples, between those on the grid (…, K, L)."""
    before = np.clip(np.floor(lanes.sample).astype(np.intp), 0, path.shape[-2] - 2)
    part = lanes.sample - before
    lane = np.arange(path.shape[-1])
    sampled: FloatArray = path[..., before, lane] * (1.0 - part) + path[..., before + 1, lane] * part
    return sampled


def _goals(lanes: Lanes, delay: FloatArray, steepest: FloatArray, names: Collection[str]) -> _Goals:
    """Goals of the servos' profiles, and their derivatives by the limit where `names` holds it.

    A profile starts at once, however small a part of a command has come: goals are delayed, not commands. Goals are
    means over the step, as commands are. A profile that switches between its limits has no smooth derivative by them:
    differences over a finite span stand for it.
    """
    limited = "acceleration_limit" in names
    if (library := kernels().long) is not None:
        call, shape = _Call(), lanes.load.shape
        path, late = np.empty((shape[0] + 1, shape[1])), np.empty(shape[1])
        by_limit = np.empty_like(path) if limited else None
        sizes = (c_long(lanes.history), c_long(shape[0]), c_long(shape[1]), c_double(lanes.step))
        given = map(call.given, (lanes.command, delay, steepest, path, late, by_limit))
        library.servo_goals(*sizes, c_double(STEEPNESS_SPAN), c_double(UNLIMITED), *given)
        return _Goals(path, late, by_limit)
    factor = np.exp(STEEPNESS_SPAN)
    limits = [steepest, *([steepest * factor, steepest / factor] if limited else [])]
    wide, steep = np.tile(lanes.command, (1, len(limits))), np.concatenate(limits)
    ends = profile_goals(wide, lanes.step, steep)
    wide[1:] = np.where(steep < UNLIMITED, 0.5 * (ends[1:] + ends[:-1]), wide[1:])
    lateness = delay / lanes.step
    whole = np.floor(lateness)
    newer = lanes.history - whole.astype(np.intp)
    places = np.clip(newer + np.arange(len(lanes.load) + 1)[:, None], 0, len(lanes.command) - 1)
    lane = np.arange(len(delay))
    reached = [own[places, lane] for own in np.split(wide, len(limits), axis=1)]
    by_limit = (reached[1] - reached[2]) / (2 * STEEPNESS_SPAN) if limited else None
    return _Goals(reached[0], lateness - whole, by_limit)


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
