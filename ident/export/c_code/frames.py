"""The joints of an arm as expressions: how vectors and inertia tensors pass from a link to the next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers.core.arrays import FloatArray
from ident.export.c_code.expressions import Expression, ExpressionArray, Graph, cosine, sine
from ident.linear_algebra.vectors import axis_rotation
from ident.model.dynamic_model import DynamicModel
from ident.model.kinematics.joints import BASE_INDEX, Joint
from ident.model.kinematics.transmission import LinearTransmission
from ident.model.newton_euler import rotation_coefficients

EXACT_ENTRY_TOLERANCE = 1e-15
"""Entries of a rotation that are closer than this to 0 or ±1 are made exact; it is the rounding of a sine."""


@dataclass(frozen=True)
class Shortcut:
    """The orientation of a frame straight from that of its grandparent, over two joints about parallel axes.

    In a parallelogram the sum of their angles is simpler than either: the forearm turns as the rod's motor does, and
    what both compute is shared.
    """

    # rotations that take a vector of the grandparent's frame to this one, one after the other
    steps: tuple[ExpressionArray, ...]
    # velocity, acceleration: of both joints together
    velocity: Expression
    acceleration: Expression


@dataclass(frozen=True)
class JointFrame:
    """A joint's frame in its parent's."""

    joint: Joint  # of the tree
    translation: ExpressionArray  # of the origin, in the parent's frame
    angle: Expression  # of a revolute joint, without its constant part
    # velocity, acceleration: of the joint
    velocity: Expression
    acceleration: Expression
    # rotation from the joint's frame at `angle` zero to the parent's; the identity where `turn` holds it
    constant: ExpressionArray
    turn: ExpressionArray  # rotation about the joint's axis; the identity of a prismatic joint
    # number of the coordinate axis that `turn` leaves alone, with the sine and cosine of the angle about it; None where
    # there is none
    planar: tuple[int, Expression, Expression] | None
    shortcut: Shortcut | None = None  # where there is one

    def to_joint(self, vector: ExpressionArray) -> ExpressionArray:
        """A vector of the parent's frame in the joint's."""
        return np.asarray(self.turn.T @ (self.constant.T @ vector))

    def to_parent(self, vector: ExpressionArray) -> ExpressionArray:
        """A vector of the joint's frame in the parent's."""
        return np.asarray(self.constant @ (self.turn @ vector))

    def tensor_to_parent(self, tensor: ExpressionArray) -> ExpressionArray:
        """A symmetric tensor of the joint's frame in the parent's axes."""
        turned = _turned(self.turn, tensor) if self.planar is None else _turned_in_plane(*self.planar, tensor)
        return _turned(self.constant, turned)


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
    if not isinstance(model.transmission, LinearTransmission):
        raise TypeError("the joints without a motor do not follow linearly")
    follow, offset = model.transmission.follow, model.transmission.offset
    frames: list[JointFrame] = []
    for joint, start, row in zip(model.joints, offset, follow, strict=True):
        motion = [combination(graph, row, signal) for signal in (position, velocity, acceleration)]
        frame = _joint_frame(graph, joint, float(start), *motion)
        if joint.parent != BASE_INDEX:
            frame = replace(frame, shortcut=_shortcut(graph, frames[joint.parent], frame))
        frames.append(frame)
    return tuple(frames)


def combination(graph: Graph, factors: FloatArray, signals: Sequence[Expression]) -> Expression:
    """Σ factor · signal."""
    total = graph.constant(0.0)
    for factor, signal in zip(factors, signals, strict=True):
        total = total + signal * float(factor)
    return total


def _joint_frame(
    graph: Graph, joint: Joint, start: float, position: Expression, velocity: Expression, acceleration: Expression
) -> JointFrame:
    translation, identity = graph.constants(joint.translation), graph.constants(np.eye(3))
    if joint.prismatic:
        along = graph.constants(_exact(joint.rotation @ joint.axis)) * (position + start)
        still, constant = graph.constant(0.0), graph.constants(_exact(joint.rotation))
        return JointFrame(joint, translation + along, still, velocity, acceleration, constant, identity, None)
    # The constant part of the angle goes into the constant rotation: sin(q + π/2) is then cos q.
    joint = replace(joint, rotation=_exact(joint.rotation @ axis_rotation(joint.axis, start)))
    aligned = [index for index in range(3) if abs(abs(joint.axis[index]) - 1.0) < EXACT_ENTRY_TOLERANCE]
    if not aligned:
        turn = _skew_rotation(sine(position), cosine(position), joint)
        return JointFrame(joint, translation, position, velocity, acceleration, identity, turn, None)
    planar = _planar(joint, aligned[0], position)
    turn, constant = _plane_rotation(graph, *planar), graph.constants(joint.rotation)
    return JointFrame(joint, translation, position, velocity, acceleration, constant, turn, planar)


def _planar(joint: Joint, axis: int, angle: Expression) -> tuple[int, Expression, Expression]:
    return axis, sine(angle) * float(np.sign(joint.axis[axis])), cosine(angle)


def _shortcut(graph: Graph, parent: JointFrame, frame: JointFrame) -> Shortcut | None:
    """The shortcut over a joint and its parent if their axes are parallel and the sum of their angles is one angle."""
    if parent.planar is None or frame.planar is None:
        return None
    angle = parent.angle + frame.angle
    if graph.nodes[angle.node].kind not in ("symbol", "constant"):
        return None
    if not np.array_equal(frame.joint.rotation @ frame.joint.axis, parent.joint.axis):
        return None
    turn = _plane_rotation(graph, *_planar(parent.joint, parent.planar[0], angle))
    return Shortcut(
        steps=(parent.constant.T, turn.T, frame.constant.T),
        velocity=parent.velocity + frame.velocity,
        acceleration=parent.acceleration + frame.acceleration,
    )


def _skew_rotation(s: Expression, c: Expression, joint: Joint) -> ExpressionArray:
    """Rotation from the joint's frame to the parent's, its constant part included."""
    steady, of_sine, of_cosine = (s.graph.constants(matrix.T) for matrix in rotation_coefficients(joint))
    return np.asarray(of_sine * s + of_cosine * c + steady)


def _plane_rotation(graph: Graph, axis: int, s: Expression, c: Expression) -> ExpressionArray:
    matrix = graph.constants(np.eye(3))
    first, second = (axis + 1) % 3, (axis + 2) % 3
    matrix[first, first] = matrix[second, second] = c
    matrix[first, second], matrix[second, first] = -s, s
    return matrix


def _turned(rotation: ExpressionArray, tensor: ExpressionArray) -> ExpressionArray:
    """R·T·Rᵀ of a symmetric T."""
    columns = [tensor @ row for row in rotation]
    return np.array([[rotation[max(i, j)] @ columns[min(i, j)] for j in range(3)] for i in range(3)], dtype=object)


def _turned_in_plane(axis: int, s: Expression, c: Expression, tensor: ExpressionArray) -> ExpressionArray:
    """R·T·Rᵀ of a symmetric T for a rotation about a coordinate axis, with the fewest products."""
    first, second = (axis + 1) % 3, (axis + 2) % 3
    across = tensor[first, second]
    swing = s * (tensor[first, first] - tensor[second, second]) + c * (across * 2.0)
    turned = tensor.copy()
    turned[first, first] = tensor[first, first] - s * swing
    turned[second, second] = tensor[second, second] + s * swing
    turned[first, second] = turned[second, first] = c * swing - across
    turned[axis, first] = turned[first, axis] = c * tensor[axis, first] - s * tensor[axis, second]
    turned[axis, second] = turned[second, axis] = s * tensor[axis, first] + c * tensor[axis, second]
    return turned


def _exact(values: FloatArray) -> FloatArray:
    """Entries within rounding of 0 and ±1 made exact."""
    nearest = np.round(values)
    return np.where(np.abs(values - nearest) < EXACT_ENTRY_TOLERANCE, nearest, values)
