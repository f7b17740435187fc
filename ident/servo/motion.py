"""Commanded and measured positions of a servo arm on a grid, cut into pieces that are rolled out side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from daq.recording.commanded_motion import TARGET, CommandedMotion
from drivers.core.arrays import FloatArray, IndexArray
from drivers.core.errors import DataError
from ident.servo.links import ServoLinks
from ident.servo.rollout.lanes import THINNED, Lanes, Touch

STEP = 0.005
"""[s] Longest step of a roll-out."""

FINE_STEP, FINE = 0.0025, 4
"""[s] A sampling period is divided into so many steps, if they are no shorter: arms that are sampled fast move fast,
and with steps of 5 ms the motor inertias of an OpenArm come out 1.4 σ too small on average."""

HISTORY = 0.5
"""[s] of commands before a piece, for its delay."""

SETTLING = 1.0
"""[s] at the beginning of a piece that is not compared: its velocity and profile are not known."""

PIECE = 3.0
"""[s] of a piece that is compared."""

GAP = 0.25
"""[s] A longer pause between samples ends a motion."""

SHORTEST = 3.0
"""[s] of a motion that can be used."""

SMOOTHED, SMOOTHED_MORE = 0.06, 0.14
"""[s] spans of the local polynomials through measured positions that give velocities and accelerations."""


@dataclass(frozen=True, eq=False)
class ServoMotion:
    """A motion without gaps."""

    label: str  # of its recording
    begin: float  # of its first sample, in the recording's clock [s]
    step: float  # of the grid [s]
    time: FloatArray  # (N,) of the measured samples, from the first [s]
    position: FloatArray  # (N, n) measured [rad or m]
    # (history + K, n) that was in force on the mean of the step before each time of the grid, from `history` steps
    # before the first sample on [rad or m]
    command: FloatArray
    history: int  # number of steps

    @property
    def grid(self) -> FloatArray:
        """(K,) times [s]."""
        return np.asarray(np.arange(len(self.command) - self.history) * self.step, dtype=np.float64)

    def between(self, first: int, end: int) -> ServoMotion:
        """The motion from one sample to before another; its commands go on to have a history."""
        # not rounded up: the first sample would be before the beginning, and lost
        skipped = int(float(self.time[first]) / self.step)
        begin = min(skipped * self.step, float(self.time[first]))
        return replace(
            self,
            begin=self.begin + begin,
            time=self.time[first:end] - begin,
            position=self.position[first:end],
            command=self.command[skipped : self.history + round(float(self.time[end - 1]) / self.step) + 2],
        )


def servo_motions(recorded: CommandedMotion, label: str) -> list[ServoMotion]:
    """The motions of a recording, split where samples are missing.

    Raises:
        DataError: too short, too slow, or the commands do not cover the motion.
    """
    time = recorded.time
    if len(time) < 2 or time[-1] - time[0] < SHORTEST:
        seconds = float(time[-1] - time[0]) if len(time) else 0.0
        raise DataError(
            f"lasts {seconds:.3g} s; a servo model needs {SHORTEST:g} s", where=label, hint="leave this recording out"
        )
    period = float(np.median(np.diff(time)))
    if period > GAP / 2:
        raise DataError(f"has {1 / period:.3g} samples a second; a servo model needs {2 / GAP:g}", where=label)
    stamps = recorded.command_time
    late, early = float(stamps[0] - time[0]), float(time[-1] - stamps[-1])
    if max(late, early) > SETTLING:
        side = f"begin {late:.2f} s after" if late > early else f"end {early:.2f} s before"
        raise DataError(
            f"its commands {side} its positions do: check that both have one clock and belong to one motion",
            where=label,
            hint="cut the recording to where both exist, or import it again with stamps of one clock",
        )
    step = period / max(1, round(period / STEP), min(FINE, round(period / FINE_STEP)))
    motions = []
    ends = [0, *(np.flatnonzero(np.diff(time) > max(GAP, 5 * period)) + 1).tolist(), len(time)]
    for first, end in pairwise(ends):
        own = time[first:end]
        if end - first < 2 or own[-1] - own[0] < SHORTEST:
            continue
        history = int(np.ceil(HISTORY / step))
        count = int(np.ceil((own[-1] - own[0]) / step)) + 2
        times = own[0] + (np.arange(-history, count)) * step
        command = _in_force(stamps, recorded.commands[TARGET], times, step)
        motions.append(
            ServoMotion(label, float(own[0]), step, own - own[0], recorded.position[first:end].copy(), command, history)
        )
    if not motions:
        raise DataError(f"has no {SHORTEST:g} s without a gap", where=label)
    return motions


def _in_force(stamps: FloatArray, values: FloatArray, times: FloatArray, step: float) -> FloatArray:
    """Means (K, n) of commands over the step [s] before each time; a command holds until the next one is sent.

    A profile follows stairs later than the straight line between them, by more than the half period of their mean.
    """
    edges = np.concatenate([[min(stamps[0], times[0] - step)], stamps, [max(stamps[-1], times[-1])]])
    sums = np.cumsum(np.vstack([values[:1], values]) * np.diff(edges)[:, None], axis=0)
    whole = np.vstack([np.zeros_like(sums[:1]), sums])
    until, since = (
        np.stack([np.interp(ends, edges, column) for column in whole.T], axis=1) for ends in (times, times - step)
    )
    return np.asarray((until - since) / step, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class MotionLoad:
    """What the links do to the joints along a motion's grid, (K, n) each."""

    torque: FloatArray  # that gravity asks for, and what depends on velocities where joints move each other [N·m]
    slope: FloatArray  # derivative of gravity by each joint's own position [N·m/rad]
    inertia: FloatArray  # of the links about each joint [kg·m²]
    # (K / `THINNED`, n, n) the matrix of inertia, by which the joints move each other [kg·m²]; None where they do not,
    # or where the torque holds it
    between: FloatArray | None = None


def motion_load(
    links: ServoLinks,
    motion: ServoMotion,
    times: FloatArray,
    position: FloatArray,
    zero: FloatArray,
    velocity: FloatArray | None = None,
) -> MotionLoad:
    """The links along positions (N, n) at times (N,); `zero` (n,) is added to them for gravity.

    The torque is that of gravity at the moved position, less what a roll-out adds for `zero` itself. With velocities
    (N, n) the joints move each other.
    """
    moved = (position + zero).T
    torque = links.gravity(moved) if velocity is None else links.torque(moved, velocity.T, np.zeros_like(moved))
    _, slope, matrix = links.along(moved)
    grid, joints = motion.grid, len(moved)

    def on_grid(stamps: FloatArray, values: FloatArray) -> FloatArray:
        return np.stack([np.interp(grid, stamps, row) for row in values], axis=1)

    slopes, whole = on_grid(times, slope), on_grid(times, matrix.reshape(joints * joints, -1))
    inertia = whole[:, :: joints + 1]
    between = None if velocity is None else whole[::THINNED].reshape(-1, joints, joints)
    return MotionLoad(on_grid(times, torque) - zero * slopes, slopes, inertia, between)


def motion_touch(links: ServoLinks, link: str, motion: ServoMotion, times: FloatArray, position: FloatArray) -> Touch:
    """Heights and levers of a link's frame along positions (N, n) at times (N,), on a motion's grid; one piece.

    Without the joints' `zero`: gravity tells it too badly to move the surface's height by it.
    """
    height, lever = links.heights(links.model.link_names.index(link), position.T)
    grid = motion.grid

    def on_grid(stamps: FloatArray, values: FloatArray) -> FloatArray:
        return np.stack([np.interp(grid, stamps, row) for row in values], axis=1)

    return Touch(
        on_grid(times, position.T),
        np.stack([on_grid(times, row[None]) for row in height]),
        np.stack([on_grid(times, rows) for rows in lever]),
    )


def lanes_of(
    motions: Sequence[ServoMotion],
    loads: Sequence[MotionLoad],
    piece: float | None = PIECE,
    touches: Sequence[Touch] = (),
) -> Lanes:
    """Lanes of all joints of motions, cut into pieces [s]; whole where None.

    Samples of a piece's first `SETTLING` seconds do not count. `touches` are those of the motions, where a contact is
    looked for.
    """
    step, joints = min(motion.step for motion in motions), motions[0].position.shape[1]
    cuts = []
    for number, motion in enumerate(motions):
        end = float(motion.time[-1])
        length = end if piece is None else piece
        begin = min(0.0, float(motion.time[0]))  # of a part, the first sample lies up to half a step before
        while begin < end - SETTLING:
            cuts.append((number, begin, min(begin + SETTLING + length, end)))
            begin += length
    steps = max(int(np.ceil((last - begin) / step)) + 2 for _, begin, last in cuts)
    samples = max(
        int(np.count_nonzero((motions[number].time >= begin) & (motions[number].time <= last)))
        for number, begin, last in cuts
    )
    history = max(motion.history for motion in motions)
    width = len(cuts) * joints
    command = np.empty((history + steps, width))
    start, inertia = np.empty(width), np.empty((steps, width))
    torque, slope = np.empty((steps, width)), np.empty((steps, width))
    sample, measured = np.zeros((samples, width)), np.full((samples, width), np.nan)
    reference, height, lever = np.empty((steps, width)), np.empty((4, steps, len(cuts))), np.empty((4, steps, width))
    coupled = all(load.between is not None for load in loads)
    between = np.empty((-(-steps // THINNED) + 1 if coupled else 0, len(cuts), joints, joints))
    for number, (source, begin, last) in enumerate(cuts):
        motion, load = motions[source], loads[source]
        lanes = slice(number * joints, (number + 1) * joints)
        inside = np.flatnonzero((motion.time >= begin) & (motion.time <= last))
        origin = float(motion.time[inside[0]])
        grid = (origin + np.arange(-history, steps) * step) / motion.step
        place = np.clip(grid + motion.history, 0.0, len(motion.command) - 1.0)
        before = np.minimum(place.astype(np.intp), len(motion.command) - 2)
        part = (place - before)[:, None]
        command[:, lanes] = motion.command[before] * (1.0 - part) + motion.command[before + 1] * part
        rows = np.rint(place).astype(np.intp)
        own = np.clip(rows[history:] - motion.history, 0, len(load.torque) - 1)
        after = np.minimum(own + 1, len(load.torque) - 1)
        for on_steps, on_grid in ((torque, load.torque), (slope, load.slope), (inertia, load.inertia)):
            on_steps[:, lanes] = 0.5 * (on_grid[own] + on_grid[after])
        if load.between is not None and coupled:
            places = np.rint((origin + np.arange(len(between)) * THINNED * step) / (THINNED * motion.step))
            between[:, number] = load.between[np.clip(places, 0, len(load.between) - 1).astype(np.intp)]
        if touches:
            touch = touches[source]
            reference[:, lanes], lever[:, :, lanes] = touch.reference[own], touch.lever[:, own]
            height[:, :, number] = touch.height[:, own, 0]
        start[lanes] = motion.position[inside[0]]
        sample[: len(inside), lanes] = ((motion.time[inside] - origin) / step)[:, None]
        counted = motion.time[inside] - origin >= SETTLING
        measured[: len(inside), lanes] = np.where(counted[:, None], motion.position[inside], np.nan)
    return Lanes(
        step,
        np.tile(np.arange(joints), len(cuts)),
        np.repeat(np.arange(len(cuts)), joints),
        command,
        history,
        start,
        inertia,
        torque,
        slope,
        sample,
        measured,
        Touch(reference, height, lever) if touches else None,
        between if coupled else None,
    )


def lanes_with_touch(
    motions: Sequence[ServoMotion], links: ServoLinks, loads: Sequence[MotionLoad], link: str, piece: float = PIECE
) -> Lanes:
    """Pieces [s] of measured motions, with what a link may touch."""
    touches = [motion_touch(links, link, motion, motion.time, motion.position) for motion in motions]
    return lanes_of(motions, loads, piece, touches)


def measured_load(links: ServoLinks, motion: ServoMotion, zero: FloatArray) -> MotionLoad:
    """The links along a measured motion, whose joints move each other."""
    velocity = _smooth_derivative(motion, 1, SMOOTHED)
    return motion_load(links, motion, motion.time, motion.position, zero, velocity)


def known_load(load: MotionLoad, motion: ServoMotion) -> MotionLoad:
    """A measured motion's load with the joints' torques on each other in it.

    They are those of the accelerations of a smooth line through the positions, which has too little of a step's.
    """
    assert load.between is not None
    acceleration = _smooth_derivative(motion, 2, SMOOTHED_MORE)
    moving = np.stack([np.interp(motion.grid, motion.time, column) for column in acceleration.T], axis=1)
    pull = np.einsum("kij,kj->ki", np.repeat(load.between, THINNED, axis=0)[: len(moving)], moving)
    return replace(load, torque=load.torque + pull - load.inertia * moving, between=None)


def _smooth_derivative(motion: ServoMotion, order: int, span: float) -> FloatArray:
    """(N, n) derivative of the measured positions by local polynomials over a span [s]."""
    from scipy.signal import savgol_filter  # here, since `dynid excite` reads this module and needs no SciPy signals

    period = float(np.median(np.diff(motion.time)))
    length = max(5, round(span / period) | 1)
    derivative: FloatArray = savgol_filter(motion.position, length, 3, deriv=order, delta=period, axis=0)
    return derivative


def halves(lanes: Lanes, most: int) -> tuple[Lanes, Lanes]:
    """Every other of so many pieces at most, and the others."""
    pieces = _chosen(lanes, most)
    if len(pieces) < 2:
        return lanes, lanes
    return tuple(lanes.of(np.flatnonzero(np.isin(lanes.piece, pieces[part::2]))) for part in range(2))  # type: ignore[return-value]


def some_pieces(lanes: Lanes, most: int) -> Lanes:
    """Pieces, as many at most."""
    return lanes.of_pieces(_chosen(lanes, most))


def _chosen(lanes: Lanes, most: int) -> IndexArray:
    """Pieces: half of them evenly spread, half those whose commands change fastest, which show the limits."""
    pieces = np.unique(lanes.piece)
    if len(pieces) <= most:
        return pieces
    even = pieces[np.linspace(0, len(pieces) - 1, most // 2).astype(np.intp)]
    quickest = np.zeros(len(pieces))
    change = np.abs(np.diff(lanes.command, axis=0)).mean(axis=0)
    np.maximum.at(quickest, np.searchsorted(pieces, lanes.piece), change / np.maximum(_typical(change, lanes), 1e-12))
    others = np.setdiff1d(np.arange(len(pieces)), np.searchsorted(pieces, even))
    quick = pieces[others[np.argsort(-quickest[others], kind="stable")[: most - len(even)]]]
    return np.sort(np.concatenate([even, quick]))


def _typical(change: FloatArray, lanes: Lanes) -> FloatArray:
    """(L,) mean over each lane's joint."""
    sums = np.bincount(lanes.joint, weights=change)
    return np.asarray((sums / np.bincount(lanes.joint))[lanes.joint], dtype=np.float64)
