"""A motion for a servo model: a ladder of amplitudes for the first recording, then what narrows the intervals most.

The information of a piece of motion about a joint's parameters is that of its roll-out's derivatives (as in
identification) over the positions' error, which is correlated over `CORRELATED` seconds. Pieces are taken greedily, by
what they narrow per second of motion, until every parameter is known as well as wanted, or the time is used up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from daq.motion.motion_check import MotionFigures
from daq.motion.trajectories import SampledMotion
from daq.robot.loader import RobotFile
from drivers.core.arrays import BoolArray, FloatArray
from drivers.core.errors import MotionRefusedError, UsageError
from ident.excite.choices import ServoMotionChoices
from ident.excite.motion_check import ArmMotionCheck
from ident.excite.servo_segments import KINDS, LADDER, PERIOD, Room, ServoSegment, joined, segment, way
from ident.servo.links import ServoLinks, servo_links
from ident.servo.motion import SETTLING, ServoMotion, lanes_of, motion_load
from ident.servo.result import ServoResult
from ident.servo.search import evaluate
from ident.servo.terms import INDEX, TERMS

POSES = 4
"""Poses about which pieces are made, beside the middle of the range."""

POSE_SHARE = 0.6
"""Share of the range that the poses are drawn from."""

POSE_TRIES = 200

CORRELATED = 0.25
"""[s] over which the errors of a roll-out are alike: so much motion counts as one sample."""

LEAST_GAIN = 1e-3
"""[1/s] Fall of the cost, a sum of logarithms of intervals, below which more motion is not worth its time."""

SIGMAS = 1.96
"""Half of a 95 % interval."""


@dataclass(frozen=True)
class ServoForecast:
    """What a motion does to a parameter; half-widths of 95 % intervals, of logarithms where it is positive [%]."""

    # joint, parameter: names
    joint: str
    parameter: str
    now: float  # before the motion; None without a model
    then: float  # after it, as expected
    wanted: float  # that is enough


@dataclass(frozen=True, eq=False)
class ServoExcitation:
    """The motion, and what it is expected to tell."""

    motion: SampledMotion | None  # None where the model is good enough already
    position: FloatArray  # (K, n) every `PERIOD` [rad or m]
    segments: tuple[ServoSegment, ...]  # pieces in their order
    forecast: tuple[ServoForecast, ...]  # of the parameters that were wide; empty without a model
    enough: bool  # whether all are expected to be as narrow as wanted
    figures: MotionFigures | None  # of the check that every motion passes before it is played

    @property
    def counts(self) -> str:
        """How many pieces of each kind there are."""
        kinds = [piece.kind for piece in self.segments]
        return ", ".join(f"{kind} ×{kinds.count(kind)}" for kind in KINDS if kind in kinds)


def servo_excitation(
    robot_file: RobotFile, check: ArmMotionCheck, result: ServoResult | None, choices: ServoMotionChoices
) -> ServoExcitation:
    """Design the motion that follows on the identification so far; a first one where there is none.

    Raises:
        UsageError: no pose or no motion is clear of everything, or the model is of another arm.
        MotionRefusedError: the ways between the poses are not clear.
    """
    room = _room(robot_file, choices.margin)
    if result is not None:
        earlier = _Known(result, choices.wanted / 100.0)
        if not earlier.wide(earlier.information).any():
            return ServoExcitation(None, np.empty((0, len(room.low))), (), (), True, None)
    poses = _poses(robot_file, check, room, choices.seed)
    pieces = _clear_pieces(check, poses, room, choices.seed)
    if result is None:
        chosen = _ladder(pieces, poses, room, choices.length)
        forecast: tuple[ServoForecast, ...] = ()
    else:
        shown = earlier.shown_by(servo_links(robot_file), pieces)
        chosen, forecast = _narrowing(earlier, pieces, shown, poses, room, choices.length)
    position = joined(chosen, poses, room)
    time = np.asarray(np.arange(len(position)) * PERIOD, dtype=np.float64)
    motion = SampledMotion(time, position.T)
    figures = check.trajectory(motion, "the motion for a servo model")
    enough = bool(forecast) and all(entry.then <= entry.wanted for entry in forecast)
    return ServoExcitation(motion, position, tuple(chosen), forecast, enough, figures)


def _room(robot_file: RobotFile, margin: float) -> Room:
    joints = robot_file.robot.joints
    low, high = (np.array(ends, dtype=np.float64) for ends in zip(*(joint.position for joint in joints), strict=True))
    kept = 0.5 * margin * (high - low)
    share = 1.0 - margin
    return Room(
        low + kept,
        high - kept,
        share * np.array([joint.velocity for joint in joints]),
        share * np.array([joint.acceleration for joint in joints]),
    )


def _poses(robot_file: RobotFile, check: ArmMotionCheck, room: Room, seed: int) -> FloatArray:
    """Poses (P, n) clear of everything, the first nearest to the middle of the range, each reached from it freely.

    Raises:
        UsageError: there is none.
    """
    generator = np.random.default_rng([seed, len(room.low)])
    quarter = 0.25 * (room.high - room.low)
    middle = np.clip(np.zeros(len(room.low)), room.low + quarter, room.high - quarter)
    spread = 0.5 * POSE_SHARE * np.minimum(room.high - room.low, np.pi)
    drawn = np.clip(middle + generator.uniform(-1, 1, (POSE_TRIES, len(middle))) * spread, room.low, room.high)
    candidates = np.concatenate([middle[None], drawn])
    clear = candidates[check.clear(candidates.T)]
    if not len(clear):
        raise UsageError(
            f"none of {len(candidates)} poses is clear of floor, obstacles and the arm itself",
            where=robot_file.robot.name,
            hint="correct 'workspace' and the joint limits of the robot file",
        )
    kept = [clear[0]]
    for pose in clear[1:]:
        if len(kept) == POSES + 1:
            break
        if bool(check.clear(way(kept[0], pose, room)[::4].T).all()):
            kept.append(pose)
    return np.array(kept)


def _clear_pieces(check: ArmMotionCheck, poses: FloatArray, room: Room, seed: int) -> list[ServoSegment]:
    """Pieces of every kind, amplitude and pose in which the arm is clear; kind by kind and amplitude by amplitude.

    Raises:
        UsageError: there is none.
    """
    made = [
        segment(kind, share, number, pose, room, seed)
        for share in LADDER
        for number, pose in enumerate(poses)
        for kind in KINDS
    ]
    stacked = np.concatenate([piece.position[::4] for piece in made])
    clear = np.all(check.clear(stacked.T).reshape(len(made), -1), axis=1).tolist()
    pieces = [piece for piece, fine in zip(made, clear, strict=True) if fine]
    if not pieces:
        raise UsageError("every piece of motion comes too near to something", hint="correct 'workspace'")
    return pieces


def _seconds(pieces: Sequence[ServoSegment], poses: FloatArray, room: Room) -> float:
    return len(joined(pieces, poses, room)) * PERIOD


def _ladder(pieces: list[ServoSegment], poses: FloatArray, room: Room, length: float) -> list[ServoSegment]:
    """Pieces of all kinds in turn, pose after pose and amplitude after amplitude, as long as there is time."""
    turns = [[piece for piece in pieces if piece.kind == kind] for kind in KINDS]
    chosen: list[ServoSegment] = []
    for turn in range(round(length)):
        for own in turns:
            if not own:
                continue
            # The largest amplitudes tell most: they come first.
            longer = [*chosen, own[-1 - turn % len(own)]]
            if _seconds(longer, poses, room) > length:
                return chosen or longer
            chosen = longer
    return chosen


class _Known:
    """What is known of the parameters, in the search's coordinates, joint by joint.

    Attributes:
        free: (n, terms) parameters that were searched.
        information: per joint (f, f), of its searched terms.
        limit: per joint (f,) half-widths that are enough.
    """

    def __init__(self, result: ServoResult, wanted: float) -> None:
        self.result = result
        self.free: BoolArray = np.zeros((len(result.joints), len(TERMS)), dtype=np.bool_)
        self.information: list[FloatArray] = []
        self.limit: list[FloatArray] = []
        for row, order in enumerate(result.searched):
            columns = [INDEX[name] for name in order]
            self.free[row, columns] = True
            covariance = np.array(result.covariance[row], dtype=np.float64).reshape(len(order), -1)
            spread = np.array([TERMS[column].spread for column in columns])
            # A direction that nothing shows is known by its weak prior alone.
            inverse = np.linalg.pinv(covariance, hermitian=True)
            self.information.append(np.asarray(inverse + np.diag(spread**-2.0), dtype=np.float64))
            own = [wanted if TERMS[column].positive else wanted * TERMS[column].spread for column in columns]
            self.limit.append(np.array(own))

    def half_widths(self, information: Sequence[FloatArray]) -> list[FloatArray]:
        """Per joint (f,), over what is enough."""
        return [
            SIGMAS * np.sqrt(np.diag(np.linalg.inv(matrix))) / limit if len(limit) else limit
            for matrix, limit in zip(information, self.limit, strict=True)
        ]

    def wide(self, information: Sequence[FloatArray]) -> BoolArray:
        """Return whether each parameter's interval is wider than wanted, all joints one after the other."""
        return np.concatenate(self.half_widths(information)) > 1.0

    def cost(self, information: Sequence[FloatArray]) -> float:
        """Sum over the parameters of the logarithm by which they are too wide."""
        return float(np.sum(np.log(np.maximum(np.concatenate(self.half_widths(information)), 1.0))))

    def shown_by(self, links: ServoLinks, pieces: Sequence[ServoSegment]) -> list[list[FloatArray]]:
        """Information (f, f) of each piece about each joint."""
        values, joints = self.result.values, len(self.result.joints)
        motions = [_held_before(piece.position) for piece in pieces]
        zero = values[:, INDEX["zero"]]
        loads = [motion_load(links, motion, motion.time, motion.position, zero) for motion in motions]
        lanes = lanes_of(motions, loads, None)
        _, tangents = evaluate(lanes, values, self.free)
        columns = np.flatnonzero(self.free.any(axis=0))
        counted = np.isfinite(lanes.measured)
        sigma = np.maximum(np.array(self.result.resolution), np.array(self.result.fit.rollout_error)) * 1.25
        weight = PERIOD / CORRELATED
        segments = []
        for number in range(len(pieces)):
            own = []
            for joint in range(joints):
                lane = int(np.flatnonzero((lanes.joint == joint) & (lanes.piece == number))[0])
                rows = np.searchsorted(columns, np.flatnonzero(self.free[joint]))
                slope = tangents[lane][counted[:, lane]][:, rows].T / sigma[joint]
                own.append(weight * slope @ slope.T)
            segments.append(own)
        return segments


def _held_before(position: FloatArray) -> ServoMotion:
    """A piece as a motion after it was held for as long as a roll-out settles."""
    held = round(SETTLING / PERIOD)
    command = np.concatenate([np.repeat(position[:1], held, axis=0), position])
    history = round(0.5 / PERIOD)
    time = np.asarray(np.arange(len(command)) * PERIOD, dtype=np.float64)
    factor = round(PERIOD / _STEP)
    grid = np.arange(-history * factor, (len(command) + 1) * factor) * _STEP
    fine = np.stack([np.interp(grid, time, column) for column in command.T], axis=1)
    return ServoMotion("a piece", 0.0, _STEP, time, command, fine, history * factor)


_STEP = 0.01
"""[s] of a piece's roll-out."""


def _narrowing(
    earlier: _Known,
    pieces: list[ServoSegment],
    shown: list[list[FloatArray]],
    poses: FloatArray,
    room: Room,
    length: float,
) -> tuple[list[ServoSegment], tuple[ServoForecast, ...]]:
    """Pieces that narrow wide parameters most per second, and what is to be expected of them.

    Raises:
        MotionRefusedError: no piece tells anything of what is still wide.
    """
    information = [matrix.copy() for matrix in earlier.information]
    chosen: list[ServoSegment] = []
    while earlier.wide(information).any():
        before = earlier.cost(information)
        best: tuple[float, int] | None = None
        used = _seconds(chosen, poses, room)
        for number, piece in enumerate(pieces):
            longer = _seconds([*chosen, piece], poses, room)
            if longer > length:
                continue
            after = earlier.cost([old + new for old, new in zip(information, shown[number], strict=True)])
            rate = (before - after) / max(longer - used, PERIOD)
            if best is None or rate > best[0]:
                best = rate, number
        if best is None or best[0] < LEAST_GAIN:
            break
        chosen.append(pieces[best[1]])
        information = [old + new for old, new in zip(information, shown[best[1]], strict=True)]
    if not chosen:
        raise MotionRefusedError(
            "no piece of motion within the limits narrows the intervals that are still wide",
            where=earlier.result.robot,
            hint="raise --wanted or --length, or the robot file's limits of velocity and acceleration",
        )
    return chosen, _forecast(earlier, information)


def _forecast(earlier: _Known, information: Sequence[FloatArray]) -> tuple[ServoForecast, ...]:
    now, then = earlier.half_widths(earlier.information), earlier.half_widths(information)
    rows = []
    for row, (joint, order) in enumerate(zip(earlier.result.joints, earlier.result.searched, strict=True)):
        for place, name in enumerate(order):
            if now[row][place] > 1.0:
                limit = earlier.limit[row][place]
                unit = 1.0 if TERMS[INDEX[name]].positive else TERMS[INDEX[name]].spread
                scale = 100.0 * limit / unit
                rows.append(
                    ServoForecast(
                        joint, name, float(scale * now[row][place]), float(scale * then[row][place]), float(scale)
                    )
                )
    return tuple(rows)
