"""The recursive Newton-Euler equations as expressions: motion of the links, their forces, torques of the joints.

Of link j with angular velocity ω, angular acceleration α and acceleration a of its frame's origin, gravity subtracted:

    U = [α]× + [ω]×²        f = a·M + U·h        n = I·α + ω × I·ω + h × a        h = (MX, MY, MZ)

(Khalil and Kleinfinger's customised algorithm.) The parameters may be base parameters: those that are regrouped are 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from drivers.core.arrays import FloatArray
from ident.export.c_code.expressions import Expression, Graph
from ident.export.c_code.frames import JointFrame
from ident.export.c_code.vectors import Matrix, Vector, add, apply, constant_vector, cross, dot, scale
from ident.model.kinematics.joints import BASE_INDEX
from ident.model.parameters import INERTIAL


@dataclass(frozen=True)
class LinkMotion:
    """Motion of a link's frame, in that frame.

    Attributes:
        velocity: ω.
        acceleration: α.
        products: xx, yy, zz, xy, xz, yz of the components of ω.
        swing: U.
        linear: a.
    """

    velocity: Vector
    acceleration: Vector
    products: dict[str, Expression]
    swing: Matrix
    linear: Vector


@dataclass(frozen=True)
class LinkWrench:
    """Force and moment at a frame's origin, in that frame."""

    force: Vector
    moment: Vector


def link_motions(graph: Graph, frames: Sequence[JointFrame], gravity: FloatArray) -> list[LinkMotion]:
    """Motion of every link of the tree; gravity (3,) [m/s²] in the base frame."""
    none = constant_vector(graph, (0.0, 0.0, 0.0))
    base = link_motion(none, none, constant_vector(graph, -gravity))
    motions: list[LinkMotion] = []
    for frame in frames:
        parent = _motion_of(frame.joint.parent, motions, base)
        velocity, acceleration = frame.to_joint(parent.velocity), frame.to_joint(parent.acceleration)
        linear = frame.to_joint(add(parent.linear, apply(parent.swing, frame.translation)))
        rates = frame.velocity, frame.acceleration
        if frame.shortcut is not None:
            before = _motion_of(frames[frame.joint.parent].joint.parent, motions, base)
            velocity, acceleration = before.velocity, before.acceleration
            for step in frame.shortcut.steps:
                velocity, acceleration = apply(step, velocity), apply(step, acceleration)
            rates = frame.shortcut.velocity, frame.shortcut.acceleration
        own_velocity, own_acceleration = (scale(frame.joint.axis, rate) for rate in rates)
        turned = cross(velocity, own_velocity)
        if frame.joint.prismatic:
            linear = add(add(linear, own_acceleration), add(turned, turned))
        else:
            acceleration = add(add(acceleration, own_acceleration), turned)
            velocity = add(velocity, own_velocity)
        motions.append(link_motion(velocity, acceleration, linear))
    return motions


def _motion_of(index: int, motions: Sequence[LinkMotion], base: LinkMotion) -> LinkMotion:
    return base if index == BASE_INDEX else motions[index]


def link_motion(velocity: Vector, acceleration: Vector, linear: Vector) -> LinkMotion:
    """Complete a link's motion with what follows from ω and α."""
    x, y, z = velocity
    ax, ay, az = acceleration
    products = {"xx": x * x, "yy": y * y, "zz": z * z, "xy": x * y, "xz": x * z, "yz": y * z}
    xx, yy, zz, xy, xz, yz = products.values()
    swing = ((-(yy + zz), xy - az, xz + ay), (xy + az, -(xx + zz), yz - ax), (xz - ay, yz + ax, -(xx + yy)))
    return LinkMotion(velocity, acceleration, products, swing, linear)


def link_wrench(motion: LinkMotion, inertial: Sequence[float] | FloatArray) -> LinkWrench:
    """What moves a link with ten parameters (10,), as the numbers of `INERTIAL`."""
    xx, xy, xz, yy, yz, zz, *_, mass = (float(value) for value in inertial)
    graph = motion.linear[0].graph
    first_moment = constant_vector(graph, inertial[6:9])
    ax, ay, az = motion.acceleration
    square, swing = motion.products, motion.swing
    force = add(scale(motion.linear, graph.constant(mass)), apply(swing, first_moment))
    moment = (
        ax * xx + square["yz"] * (zz - yy) - swing[2][0] * xy + swing[1][0] * xz + (square["yy"] - square["zz"]) * yz,
        ay * yy + square["xz"] * (xx - zz) + swing[2][1] * xy - swing[0][1] * yz + (square["zz"] - square["xx"]) * xz,
        az * zz + square["xy"] * (yy - xx) - swing[1][2] * xz + swing[0][2] * yz + (square["xx"] - square["yy"]) * xy,
    )
    return LinkWrench(force, add(moment, cross(first_moment, motion.linear)))


def unit_wrench(motion: LinkMotion, kind: int) -> LinkWrench:
    """What moves a link whose parameter number `kind` of ten is 1 and the others 0."""
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
            totals[parent] = LinkWrench(
                add(totals[parent].force, passed.force), add(totals[parent].moment, passed.moment)
            )
    return torques[::-1]


def to_parent(frame: JointFrame, wrench: LinkWrench) -> LinkWrench:
    """The same wrench at the origin of the parent's frame."""
    force = frame.to_parent(wrench.force)
    return LinkWrench(force, add(frame.to_parent(wrench.moment), cross(frame.translation, force)))


def along_axis(frame: JointFrame, wrench: LinkWrench) -> Expression:
    """What the joint's drive must give of a wrench."""
    axis = constant_vector(wrench.force[0].graph, frame.joint.axis)
    return dot(axis, wrench.force if frame.joint.prismatic else wrench.moment)


@dataclass(frozen=True)
class Composite:
    """A link and all that hangs on it, in the link's frame: inertia about the origin, first moment, mass."""

    inertia: Matrix
    first_moment: Vector
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
        axis = constant_vector(graph, frame.joint.axis)
        if frame.joint.prismatic:
            wrench = LinkWrench(scale(axis, body.mass), cross(body.first_moment, axis))
        else:
            wrench = LinkWrench(cross(axis, body.first_moment), apply(body.inertia, axis))
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
    x, y, z = (constant_vector(graph, row) for row in ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)))
    return Composite((x, y, z), constant_vector(graph, parameters[6:9]), graph.constant(float(parameters[9])))


def _moved(frame: JointFrame, body: Composite) -> Composite:
    """The body in the parent's axes and about its origin."""
    inertia, first = frame.tensor_to_parent(body.inertia), frame.to_parent(body.first_moment)
    offset = frame.translation
    shift = scale(offset, body.mass)
    # r → r + P in Σ m (|r|²·1 − r rᵀ): with h' = h + M·P/2, both mixed terms and the squares come in one product.
    half = add(first, scale(shift, body.mass.graph.constant(0.5)))
    doubled = add(half, half)
    along = dot(doubled, offset)
    rows: list[list[Expression]] = [list(row) for row in inertia]
    for i in range(3):
        rows[i][i] = rows[i][i] + (along - doubled[i] * offset[i])
        for j in range(i):
            rows[i][j] = rows[j][i] = rows[i][j] - (half[i] * offset[j] + half[j] * offset[i])
    x, y, z = ((row[0], row[1], row[2]) for row in rows)
    return Composite((x, y, z), add(first, shift), body.mass)


def _joined(composite: Composite, other: Composite) -> Composite:
    x, y, z = (add(row, other_row) for row, other_row in zip(composite.inertia, other.inertia, strict=True))
    return Composite((x, y, z), add(composite.first_moment, other.first_moment), composite.mass + other.mass)
