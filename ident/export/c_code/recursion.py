"""The recursive Newton-Euler equations as expressions: motion of the links, their forces, torques of the joints.

Of link j with angular velocity ω, angular acceleration α and acceleration a of its frame's origin, gravity subtracted:

    U = [α]× + [ω]×²        f = a·M + U·h        n = I·α + ω × I·ω + h × a        h = (MX, MY, MZ)

(Khalil and Kleinfinger's customised algorithm.) The parameters may be base parameters: those that are regrouped are 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import FloatArray
from ident.export.c_code.expressions import Expression, ExpressionArray, Graph
from ident.export.c_code.frames import JointFrame
from ident.model.kinematics.joints import BASE_INDEX
from ident.model.parameters import INERTIAL


@dataclass(frozen=True)
class LinkMotion:
    """Motion of a link's frame, in that frame."""

    velocity: ExpressionArray  # ω
    acceleration: ExpressionArray  # α
    products: dict[str, Expression]  # xx, yy, zz, xy, xz, yz of the components of ω
    swing: ExpressionArray  # U
    linear: ExpressionArray  # a


@dataclass(frozen=True)
class LinkWrench:
    """Force and moment at a frame's origin, in that frame."""

    force: ExpressionArray
    moment: ExpressionArray


def link_motions(graph: Graph, frames: Sequence[JointFrame], gravity: FloatArray) -> list[LinkMotion]:
    """Motion of every link of the tree; gravity (3,) [m/s²] in the base frame."""
    none = graph.constants(np.zeros(3))
    base = link_motion(none, none, graph.constants(-gravity))
    motions: list[LinkMotion] = []
    for frame in frames:
        parent = _motion_of(frame.joint.parent, motions, base)
        velocity, acceleration = frame.to_joint(parent.velocity), frame.to_joint(parent.acceleration)
        linear = frame.to_joint(parent.linear + parent.swing @ frame.translation)
        rates = frame.velocity, frame.acceleration
        if frame.shortcut is not None:
            before = _motion_of(frames[frame.joint.parent].joint.parent, motions, base)
            velocity, acceleration = before.velocity, before.acceleration
            for step in frame.shortcut.steps:
                velocity, acceleration = step @ velocity, step @ acceleration
            rates = frame.shortcut.velocity, frame.shortcut.acceleration
        own_velocity, own_acceleration = (graph.constants(frame.joint.axis) * rate for rate in rates)
        turned = np.cross(velocity, own_velocity)
        if frame.joint.prismatic:
            linear = (linear + own_acceleration) + (turned + turned)
        else:
            acceleration = acceleration + own_acceleration + turned
            velocity = velocity + own_velocity
        motions.append(link_motion(velocity, acceleration, linear))
    return motions


def _motion_of(index: int, motions: Sequence[LinkMotion], base: LinkMotion) -> LinkMotion:
    return base if index == BASE_INDEX else motions[index]


def link_motion(velocity: ExpressionArray, acceleration: ExpressionArray, linear: ExpressionArray) -> LinkMotion:
    """Complete a link's motion with what follows from ω and α."""
    x, y, z = velocity
    ax, ay, az = acceleration
    products = {"xx": x * x, "yy": y * y, "zz": z * z, "xy": x * y, "xz": x * z, "yz": y * z}
    xx, yy, zz, xy, xz, yz = products.values()
    rows = (-(yy + zz), xy - az, xz + ay), (xy + az, -(xx + zz), yz - ax), (xz - ay, yz + ax, -(xx + yy))
    swing = np.array(rows, dtype=object)
    return LinkMotion(velocity, acceleration, products, swing, linear)


def link_wrench(motion: LinkMotion, inertial: Sequence[float] | FloatArray) -> LinkWrench:
    """Return what moves a link with ten parameters (10,), as the numbers of `INERTIAL`."""
    xx, xy, xz, yy, yz, zz, *_, mass = (float(value) for value in inertial)
    graph = motion.linear[0].graph
    first_moment = graph.constants(inertial[6:9])
    ax, ay, az = motion.acceleration
    square, swing = motion.products, motion.swing
    force = motion.linear * mass + swing @ first_moment
    moment = (
        ax * xx + square["yz"] * (zz - yy) - swing[2][0] * xy + swing[1][0] * xz + (square["yy"] - square["zz"]) * yz,
        ay * yy + square["xz"] * (xx - zz) + swing[2][1] * xy - swing[0][1] * yz + (square["zz"] - square["xx"]) * xz,
        az * zz + square["xy"] * (yy - xx) - swing[1][2] * xz + swing[0][2] * yz + (square["xx"] - square["yy"]) * xy,
    )
    return LinkWrench(force, moment + np.cross(first_moment, motion.linear))


def unit_wrench(motion: LinkMotion, kind: int) -> LinkWrench:
    """Return what moves a link whose parameter number `kind` of ten is 1 and the others 0."""
    return link_wrench(motion, [float(kind == number) for number in range(len(INERTIAL))])


def tree_torques(frames: Sequence[JointFrame], wrenches: Sequence[LinkWrench]) -> list[Expression]:
    """Torques or forces of the tree's joints from what moves each link."""
    totals = list(wrenches)
    torques: list[Expression] = []
    for index in range(len(frames) - 1, -1, -1):
        frame, own = frames[index], totals[index]
        torques.append(along_axis(frame, own))
        parent = frame.joint.parent
        if parent != BASE_INDEX:
            passed = to_parent(frame, own)
            totals[parent] = LinkWrench(totals[parent].force + passed.force, totals[parent].moment + passed.moment)
    return torques[::-1]


def to_parent(frame: JointFrame, wrench: LinkWrench) -> LinkWrench:
    """The same wrench at the origin of the parent's frame."""
    force = frame.to_parent(wrench.force)
    return LinkWrench(force, frame.to_parent(wrench.moment) + np.cross(frame.translation, force))


def along_axis(frame: JointFrame, wrench: LinkWrench) -> Expression:
    """Return what the joint's drive must give of a wrench."""
    along: Expression = frame.joint.axis @ (wrench.force if frame.joint.prismatic else wrench.moment)
    return along


@dataclass(frozen=True)
class Composite:
    """A link and all that hangs on it, in the link's frame: inertia about the origin, first moment, mass."""

    inertia: ExpressionArray
    first_moment: ExpressionArray
    mass: Expression


def tree_inertia(
    graph: Graph, frames: Sequence[JointFrame], inertial: Sequence[FloatArray]
) -> dict[tuple[int, int], Expression]:
    """Entries (i, j), j ≤ i, of the tree's inertia matrix that are not zero; ten parameters (10,) for each link."""
    bodies = [_body(graph, parameters) for parameters in inertial]
    for index in range(len(frames) - 1, -1, -1):
        parent = frames[index].joint.parent
        if parent != BASE_INDEX:
            bodies[parent] = _joined(bodies[parent], _moved(frames[index], bodies[index]))
    entries = {}
    for index, (frame, body) in enumerate(zip(frames, bodies, strict=True)):
        axis = graph.constants(frame.joint.axis)
        if frame.joint.prismatic:
            wrench = LinkWrench(axis * body.mass, np.cross(body.first_moment, axis))
        else:
            wrench = LinkWrench(np.cross(axis, body.first_moment), body.inertia @ axis)
        below = index
        while True:
            entries[index, below] = along_axis(frames[below], wrench)
            parent = frames[below].joint.parent
            if parent == BASE_INDEX:
                break
            wrench, below = to_parent(frames[below], wrench), parent
    return entries


def _body(graph: Graph, parameters: FloatArray) -> Composite:
    xx, xy, xz, yy, yz, zz = parameters[:6]
    inertia = graph.constants([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return Composite(inertia, graph.constants(parameters[6:9]), graph.constant(float(parameters[9])))


def _moved(frame: JointFrame, body: Composite) -> Composite:
    """The body in the parent's axes and about its origin."""
    inertia, first = frame.tensor_to_parent(body.inertia), frame.to_parent(body.first_moment)
    offset = frame.translation
    shift = offset * body.mass
    # r → r + P in Σ m (|r|²·1 − r rᵀ): with h' = h + M·P/2, both mixed terms and the squares come in one product.
    half = first + shift * 0.5
    doubled = half + half
    along = doubled @ offset
    moved = inertia.copy()
    for i in range(3):
        moved[i, i] = inertia[i, i] + (along - doubled[i] * offset[i])
        for j in range(i):
            moved[i, j] = moved[j, i] = inertia[i, j] - (half[i] * offset[j] + half[j] * offset[i])
    return Composite(moved, first + shift, body.mass)


def _joined(composite: Composite, other: Composite) -> Composite:
    inertia, first = composite.inertia + other.inertia, composite.first_moment + other.first_moment
    return Composite(inertia, first, composite.mass + other.mass)
