"""The parameters of a servo joint: one table, which estimation, roll-out, result and exports read.

A joint follows a commanded position u, without a torque sensor:

    goal: r follows u(t − delay) as fast as `acceleration_limit` allows            (the servo's own profile)
    drive: τ = clip(stiffness·(r − q − bias), ±torque_limit)
    joint: (armature + M_ii)·q̈ = τ − damping·q̇ − friction − gravity(q + zero) − coupling
    friction = coulomb + load_friction·|τ| + (breakaway + load_breakaway·|τ|)·exp(−(q̇/stribeck_velocity)²), against q̇

With `backlash`, motor and joint are two bodies that meet plastically at its ends; the encoder is the joint's.
`damping` holds back-EMF, the position loop's derivative gain and viscous friction, which positions cannot tell apart.
Friction that grows with the transmitted torque: Marc Duclusaud et al., "Extended friction models for the physics
simulation of servo actuators", ICRA 2025.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import BoolArray, FloatArray
from drivers.core.ranges import Range


@dataclass(frozen=True)
class ServoTerm:
    """A parameter of a servo joint."""

    name: str  # in results and exports
    unit: str  # of a turning joint
    text: str  # what it is, in words
    start: float  # where a search starts
    absent: float  # the value without this term
    positive: bool  # whether it is searched by its logarithm
    spread: float  # σ of the weak prior about the start; in log units where positive
    group: str  # name under which an optional term is tried; empty for those that every joint has
    allowed: Range  # values


TERMS = (
    ServoTerm("stiffness", "N·m/rad", "gain of the position loop", 15.0, 0.0, True, 2.0, "", Range(1e-6, 1e7)),
    ServoTerm("damping", "N·m·s/rad", "against velocity", 0.8, 0.0, True, 2.0, "", Range(1e-9, 1e6)),
    ServoTerm("armature", "kg·m²", "motor inertia at the joint", 0.02, 0.0, True, 1.0, "", Range(1e-9, 1e4)),
    ServoTerm("coulomb", "N·m", "Coulomb friction", 0.2, 0.0, True, 2.0, "", Range(1e-9, 1e6)),
    ServoTerm("bias", "rad", "of the held position against the command", 0.0, 0.0, False, 0.05, "", Range(-1.0, 1.0)),
    ServoTerm("delay", "s", "from a command to its effect", 0.01, 0.0, False, 0.03, "", Range(-0.1, 1.0)),
    ServoTerm(
        "acceleration_limit", "rad/s²", "of the servo's profile", 40.0, 1e7, True, 3.0, "profile", Range(1e-3, 1e8)
    ),
    ServoTerm("load_friction", "", "share of the torque lost", 0.2, 0.0, True, 2.0, "load", Range(1e-9, 1e2)),
    ServoTerm("zero", "rad", "added to the encoder for gravity", 0.0, 0.0, False, 0.3, "zero", Range(-3.2, 3.2)),
    ServoTerm("breakaway", "N·m", "static beyond Coulomb friction", 0.1, 0.0, True, 2.0, "breakaway", Range(1e-9, 1e6)),
    ServoTerm("load_breakaway", "", "static share of the torque", 0.1, 0.0, True, 2.0, "breakaway", Range(1e-9, 1e2)),
    ServoTerm(
        "stribeck_velocity", "rad/s", "where breakaway fades", 0.03, 0.03, True, 1.0, "breakaway", Range(1e-4, 10.0)
    ),
    ServoTerm("torque_limit", "N·m", "of the drive", 3.0, 1e7, True, 2.0, "saturation", Range(1e-6, 1e8)),
    ServoTerm("dead_band", "rad", "of the position loop", 0.003, 0.0, True, 1.5, "dead band", Range(1e-7, 0.5)),
    ServoTerm("backlash", "rad", "between motor and joint", 0.003, 0.0, True, 1.5, "backlash", Range(1e-7, 0.5)),
)
"""All terms, in the order of every array of parameters."""

INDEX = {term.name: index for index, term in enumerate(TERMS)}
GROUPS = tuple(dict.fromkeys(term.group for term in TERMS if term.group))
"""Optional terms, in the order in which they are tried."""

_ABSENT = np.array([term.absent for term in TERMS])
_START = np.array([term.start for term in TERMS])
_POSITIVE = np.array([term.positive for term in TERMS])


def start_values(joints: int) -> FloatArray:
    """Values (joints, terms) from which a search starts, without optional terms."""
    optional = np.array([bool(term.group) for term in TERMS])
    return np.tile(np.where(optional, _ABSENT, _START), (joints, 1))


def members(group: str) -> list[int]:
    """Indices of a group's terms; of the terms that every joint has for the empty name."""
    return [index for index, term in enumerate(TERMS) if term.group == group]


def to_search(values: FloatArray) -> FloatArray:
    """Coordinates (…, terms) of a search: logarithms of the positive terms."""
    return np.where(_POSITIVE, np.log(np.where(_POSITIVE, np.maximum(values, 1e-300), 1.0)), values)


def from_search(coordinates: FloatArray) -> FloatArray:
    """Values (…, terms) of a search's coordinates, within what each term allows."""
    exponents = np.where(_POSITIVE, np.clip(coordinates, -80.0, 80.0), 0.0)
    values = np.where(_POSITIVE, np.exp(exponents), coordinates)
    return np.clip(values, [term.allowed.least for term in TERMS], [term.allowed.most for term in TERMS])


def with_group(values: FloatArray, free: BoolArray, joints: Sequence[int], group: str) -> tuple[FloatArray, BoolArray]:
    """Values and free terms (joints, terms) with a group added to some joints, at its start."""
    values, free = values.copy(), free.copy()
    for index in members(group):
        values[joints, index] = TERMS[index].start
        free[joints, index] = True
    return values, free


def without_group(values: FloatArray, free: BoolArray, joints: Sequence[int], group: str) -> None:
    """Take a group away from some joints, in place."""
    for index in members(group):
        values[joints, index] = TERMS[index].absent
        free[joints, index] = False
