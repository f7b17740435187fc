"""Mistakes of sign, of column and of a factor that recordings have, each as columns to take instead."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, product
from typing import Literal

import numpy as np

from ident.assessment.instants import Columns

Signal = Literal["torque", "position", "both", "gravity", "time"]

MOST_JOINTS = 7
"""Joints up to which every pattern of the torques' signs is tried; of more joints two wrong signs at most."""

RATIOS = (0.5, 0.8, 1.25, 2.0, 2.0 * np.pi)
"""Factors on a position that are tried: of a gear ratio that is wrong, and of turns in place of radians."""

FARTHEST = 2
"""Joints between whose motors a coupling is sought, at most so far from each other, in arms of more joints than that;
in wrists they are neighbours."""


@dataclass(frozen=True)
class Mistake:
    """A sign or a pair of columns that is wrong, or gravity's sign."""

    name: str  # of the check that names it; empty for the recording as it is
    signal: Signal  # whose columns are wrong
    joints: tuple[int, ...]  # indices of the joints whose columns are wrong
    # columns that the torques and the positions are taken from instead
    torques: Columns
    positions: Columns
    # factor with which the second joint's motion turns the first one's motor; 0 of all other mistakes. Torques are the
    # motors', positions, or both
    coupling: float = 0.0


def as_recorded(count: int) -> Mistake:
    """No mistake."""
    return Mistake("", "both", (), _kept(count), _kept(count))


def other_gravity(count: int) -> list[Mistake]:
    """Torques without gravity, and gravity of the opposite sign; the columns as recorded."""
    names = ("gravity-missing", "gravity-opposite")
    return [Mistake(name, "gravity", (), _kept(count), _kept(count)) for name in names]


def reversed_time(count: int) -> Mistake:
    """Rows from the last one to the first: torques but those of friction are the same."""
    return Mistake("time-reversed", "time", (), _kept(count), _kept(count))


def ratios(count: int, joints: Sequence[int], turning: Sequence[int]) -> list[Mistake]:
    """A position, or position and torque, of another gear ratio than its motor's; all angles in turns."""
    kept, found = _kept(count), []
    for joint, ratio in product(joints, RATIOS):
        position, torque = (_times(count, (joint,), factor) for factor in (ratio, 1.0 / ratio))
        found.append(Mistake("position-scaled", "position", (joint,), kept, position))
        found.append(Mistake("position-scaled", "both", (joint,), torque, position))
    every = _times(count, turning, RATIOS[-1])
    return [*found, Mistake("position-scaled", "position", tuple(turning), kept, every)] if turning[1:] else found


def _times(count: int, joints: Sequence[int], factor: float) -> Columns:
    return Columns(tuple(range(count)), tuple(factor if joint in joints else 1.0 for joint in range(count)))


def mistakes(count: int, joints: Sequence[int]) -> list[Mistake]:
    """Signs, one exchange or the order of the columns wrong, of the torques, of the positions or of both.

    Args:
        count: n.
        joints: that moved and whose torques are used.
    """
    kept = _kept(count)
    found = [
        _mistake("torque-sign", "torque", several, _opposite(count, several), kept)
        for size in range(2, len(joints) if len(joints) <= MOST_JOINTS else 3)
        for several in combinations(joints, size)
    ]
    for signal in ("torque", "position", "both"):
        for joint in joints:
            found.append(_mistake(f"{_CHECKS[signal]}-sign", signal, (joint,), _opposite(count, (joint,)), kept))
        for pair in combinations(joints, 2):
            found.append(_mistake(f"{_CHECKS[signal]}s-exchanged", signal, pair, _exchanged(count, pair), kept))
        for order in _other_orders(joints) if len(joints) == count else ():
            moved = tuple(joint for joint in range(count) if order[joint] != joint)
            found.append(_mistake(f"{_CHECKS[signal]}s-exchanged", signal, moved, Columns(order, (1.0,) * count), kept))
    if len(joints) == count > 1:  # all signs of both are those of a mirrored arm, which is no mistake of a recording
        everyone = tuple(range(count))
        for signal in ("torque", "position"):
            found.append(_mistake(f"{signal}s-opposite", signal, everyone, _opposite(count, everyone), kept))
    return found


def couplings(count: int, joints: Sequence[int]) -> list[Mistake]:
    """Motors that turn with another joint, which the robot file does not say."""
    kept = _kept(count)
    return [
        Mistake("motors-coupled", signal, (one, other), kept, kept, factor)
        for one in joints
        for other in joints
        if one != other and (count <= MOST_JOINTS or abs(one - other) <= FARTHEST)
        for factor in (1.0, -1.0)
        for signal in _OF_MOTORS
    ]


_OF_MOTORS: tuple[Signal, ...] = ("torque", "position", "both")


def _other_orders(joints: Sequence[int]) -> list[tuple[int, ...]]:
    """Columns from the last joint to the first, or one beside their own (a column too many); pairs are left out."""
    ahead = tuple(joints)
    orders = {ahead[::-1], ahead[1:] + ahead[:1], ahead[-1:] + ahead[:-1]}
    return sorted(order for order in orders if sum(one != other for one, other in zip(order, ahead, strict=True)) > 2)


_CHECKS = {"torque": "torque", "position": "position", "both": "joint"}


def _mistake(name: str, signal: str, joints: tuple[int, ...], columns: Columns, kept: Columns) -> Mistake:
    torques = columns if signal in ("torque", "both") else kept
    positions = columns if signal in ("position", "both") else kept
    return Mistake(name, signal, joints, torques, positions)  # type: ignore[arg-type]


def _kept(count: int) -> Columns:
    return Columns(tuple(range(count)), (1.0,) * count)


def _opposite(count: int, joints: Sequence[int]) -> Columns:
    return _times(count, joints, -1.0)


def _exchanged(count: int, pair: tuple[int, int]) -> Columns:
    order = list(range(count))
    order[pair[0]], order[pair[1]] = pair[1], pair[0]
    return Columns(tuple(order), (1.0,) * count)
