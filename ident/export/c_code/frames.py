"""The joints of an arm as expressions: how vectors and inertia tensors pass from a link to the next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.streams import FloatArray
from ident.export.c_code.expressions import Expression, Graph, cosine, sine
from ident.export.c_code.vectors import (
    Matrix,
    Vector,
    add,
    apply,
    constant_matrix,
    constant_vector,
    dot,
    scale,
    transpose,
)
from ident.linear_algebra.vectors import axis_rotation
from ident.model.dynamic_model import DynamicModel
from ident.model.joints import Joint
from ident.model.newton_euler import rotation_coefficients
from ident.model.transmission import LinearTransmission

ROUNDING = 1e-15
"""Entries of a rotation that are closer than this to 0 or ±1 are made exact; it is the rounding of a sine."""


@dataclass(frozen=True)
class JointFrame:
    """A joint's frame in its parent's.

    Attributes:
        joint: of the tree; its rotation and translation at position zero of `turn`.
        translation: of the origin, in the parent's frame.
        velocity, acceleration: of the joint.
        constant: rotation from the joint's frame at position zero to the parent's.
        turn: rotation about the joint's axis; None of a prismatic joint.
        planar: number of the coordinate axis that `turn` leaves alone, with the sine and cosine of the angle about it;
            None where the axis is skew, and then `turn` holds the constant rotation too.
    """

    joint: Joint
    translation: Vector
    velocity: Expression
    acceleration: Expression
    constant: Matrix
    turn: Matrix | None
    planar: tuple[int, Expression, Expression] | None

    def to_joint(self, vector: Vector) -> Vector:
        """A vector of the parent's frame in the joint's."""
        if self.turn is not None and self.planar is None:
            return apply(transpose(self.turn), vector)
        steady = apply(transpose(self.constant), vector)
        return steady if self.turn is None else apply(transpose(self.turn), steady)

    def to_parent(self, vector: Vector) -> Vector:
        """A vector of the joint's frame in the parent's."""
        if self.turn is not None and self.planar is None:
            return apply(self.turn, vector)
        return apply(self.constant, vector if self.turn is None else apply(self.turn, vector))

    def tensor_to_parent(self, tensor: Matrix) -> Matrix:
        """A symmetric tensor of the joint's frame in the parent's axes."""
        if self.turn is not None and self.planar is None:
            return _turned(self.turn, tensor)
        if self.planar is not None:
            tensor = _turned_in_plane(*self.planar, tensor)
        return _turned(self.constant, tensor)


def joint_frames(
    graph: Graph,
    model: DynamicModel,
    position: Sequence[Expression],
    velocity: Sequence[Expression],
    acceleration: Sequence[Expression],
) -> tuple[JointFrame, ...]:
    """The frames of the tree's joints for positions, velocities and accelerations (n,) of the joints with a motor.

    Joints without a motor must follow linearly.
    """
    follow, offset = np.eye(len(model.joints)), np.zeros(len(model.joints))
    if model.transmission is not None:
        if not isinstance(model.transmission, LinearTransmission):
            raise TypeError("the joints without a motor do not follow linearly")
        follow, offset = model.transmission.follow, model.transmission.offset
    motions = [[combination(graph, row, signal) for signal in (position, velocity, acceleration)] for row in follow]
    return tuple(
        _joint_frame(graph, joint, float(start), *motion)
        for joint, start, motion in zip(model.joints, offset, motions, strict=True)
    )


def combination(graph: Graph, factors: FloatArray, signals: Sequence[Expression]) -> Expression:
    """Σ factor · signal."""
    total = graph.constant(0.0)
    for factor, signal in zip(factors, signals, strict=True):
        total = total + signal * float(factor)
    return total


def _joint_frame(
    graph: Graph, joint: Joint, start: float, position: Expression, velocity: Expression, acceleration: Expression
) -> JointFrame:
    translation = constant_vector(graph, joint.translation)
    if joint.prismatic:
        along = scale(_exact(joint.rotation @ joint.axis), position + start)
        constant = constant_matrix(graph, _exact(joint.rotation))
        return JointFrame(joint, add(translation, along), velocity, acceleration, constant, None, None)
    # The constant part of the angle goes into the constant rotation: sin(q + π/2) is then cos q.
    if start != 0.0:
        joint = Joint(
            joint.name,
            joint.parent,
            joint.prismatic,
            joint.rotation @ axis_rotation(joint.axis, start),
            joint.translation,
            joint.axis,
        )
    s, c = sine(position), cosine(position)
    aligned = [index for index in range(3) if abs(abs(joint.axis[index]) - 1.0) < ROUNDING]
    if aligned:
        index = aligned[0]
        planar = (index, s * float(np.sign(joint.axis[index])), c)
        turn = _plane_rotation(graph, *planar)
        return JointFrame(
            joint, translation, velocity, acceleration, constant_matrix(graph, _exact(joint.rotation)), turn, planar
        )
    turn = _skew_rotation(s, c, joint)
    return JointFrame(joint, translation, velocity, acceleration, constant_matrix(graph, joint.rotation), turn, None)


def _skew_rotation(s: Expression, c: Expression, joint: Joint) -> Matrix:
    """Rotation from the joint's frame to the parent's, its constant part included."""
    steady, of_sine, of_cosine = (part.T for part in rotation_coefficients(joint))
    rows = [
        [s * float(of_sine[i, j]) + c * float(of_cosine[i, j]) + float(steady[i, j]) for j in range(3)]
        for i in range(3)
    ]
    return _matrix(rows)


def _plane_rotation(graph: Graph, axis: int, s: Expression, c: Expression) -> Matrix:
    rows = [[graph.constant(float(i == j)) for j in range(3)] for i in range(3)]
    first, second = (axis + 1) % 3, (axis + 2) % 3
    rows[first][first] = rows[second][second] = c
    rows[first][second], rows[second][first] = -s, s
    return _matrix(rows)


def _turned(rotation: Matrix, tensor: Matrix) -> Matrix:
    """R·T·Rᵀ of a symmetric T."""
    columns = [apply(tensor, row) for row in rotation]
    return _matrix([[dot(rotation[max(i, j)], columns[min(i, j)]) for j in range(3)] for i in range(3)])


def _turned_in_plane(axis: int, s: Expression, c: Expression, tensor: Matrix) -> Matrix:
    """R·T·Rᵀ of a symmetric T for a rotation about a coordinate axis, with the fewest products."""
    first, second = (axis + 1) % 3, (axis + 2) % 3
    across = tensor[first][second]
    swing = s * (tensor[first][first] - tensor[second][second]) + c * (across * 2.0)
    rows = [list(row) for row in tensor]
    rows[first][first] = tensor[first][first] - s * swing
    rows[second][second] = tensor[second][second] + s * swing
    rows[first][second] = rows[second][first] = c * swing - across
    rows[axis][first] = rows[first][axis] = c * tensor[axis][first] - s * tensor[axis][second]
    rows[axis][second] = rows[second][axis] = s * tensor[axis][first] + c * tensor[axis][second]
    return _matrix(rows)


def _matrix(rows: list[list[Expression]]) -> Matrix:
    x, y, z = ((row[0], row[1], row[2]) for row in rows)
    return x, y, z


def _exact(values: FloatArray) -> FloatArray:
    """Entries within rounding of 0 and ±1 made exact."""
    nearest = np.round(values)
    return np.where(np.abs(values - nearest) < ROUNDING, nearest, values)
