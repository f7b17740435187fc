"""What may be wrong in a robot file, how far it is off, and the arm with it changed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from drivers.core.arrays import FloatArray
from ident.model.dynamic_model import DynamicModel

ZERO_LENGTH = 1e-4
"""[m]; shorter components of a translation are taken for 0 on purpose."""

UNKNOWN_DIRECTION = (0.48, 0.6, -0.64)
"""A direction of gravity (unit vector) that is special for no arm: every parameter that some gravity shows acts."""

SHIFTS = ("length", "scale", "zero", "late")
"""Kinds of unknowns that change the model's positions."""

Kind = Literal["gain", "gains", "length", "scale", "lengths", "zero", "late", "gravity"]


@dataclass(frozen=True)
class Unknown:
    """A number of the robot file, or gravity's direction."""

    # kind of the unknown; `late` is a joint's position against all else that was recorded, `scale` is a factor common
    # to all lengths, `lengths` are all that the data show, together, and `gains` all but that of `joint`
    kind: Kind
    # number in the tree for a length, among the motors for a gain, a zero or a late position, -1 for gravity and all
    # lengths
    joint: int = -1
    axis: int | None = None  # of the parent's frame along which the joint's origin shifts; None but for a length


@dataclass(frozen=True, eq=False)
class Deviation:
    """How far an unknown is from what the robot file says."""

    unknown: Unknown  # which
    # model torque over recorded torque minus 1, shift [m], factor on all lengths minus 1, angle [rad or m], time by
    # which it is late [s], or the angle [rad] between gravity's direction and the file's
    value: float
    std: float  # its standard deviation, the equations being independent
    likelihood: float  # doubled log-likelihood ratio against the file's value, likewise
    parameters: FloatArray  # (b,) base parameters that go with it
    model: DynamicModel  # with it; the columns of `parameters` are its base parameters `columns`
    columns: tuple[int, ...]  # (b,) standard columns
    # of several lengths or gains, each with its value and the standard deviation
    parts: tuple[tuple[Unknown, float, float], ...] = ()

    @property
    def gains(self) -> dict[int, float]:
        """Model torque over recorded torque minus 1, by joint whose gain deviates."""
        alone = (self.unknown, self.value, self.std)
        return {part.joint: value for part, value, _ in self.parts or (alone,) if part.kind == "gain"}


def shifted_origins(model: DynamicModel) -> list[tuple[int, int]]:
    """Joints and axes of their parents' frames along which their origins have a length; none where loops close."""
    if model.transmission.closed:
        return []
    return [
        (number, axis)
        for number, joint in enumerate(model.joints)
        for axis in range(3)
        if abs(joint.translation[axis]) > ZERO_LENGTH
    ]


def shifted(model: DynamicModel, joint: int, axis: int, step: float) -> DynamicModel:
    """The arm with a joint's origin shifted in its parent's frame [m]."""
    translation = model.joints[joint].translation.copy()
    translation[axis] += step
    joints = list(model.joints)
    joints[joint] = replace(joints[joint], translation=translation)
    return replace(model, joints=tuple(joints))


def scaled(model: DynamicModel, factor: float) -> DynamicModel:
    """The arm with all lengths between its joints multiplied by a factor."""
    return replace(model, joints=tuple(replace(one, translation=factor * one.translation) for one in model.joints))


def in_unknown_gravity(model: DynamicModel) -> DynamicModel:
    """The arm in a gravity that shows every parameter that some gravity shows."""
    return replace(model, gravity=float(np.linalg.norm(model.gravity)) * np.array(UNKNOWN_DIRECTION))


def tangents(direction: FloatArray) -> FloatArray:
    """Two unit vectors (2, 3) across a direction (3,) and across each other."""
    return np.asarray(np.linalg.svd(direction[None])[2][1:])
