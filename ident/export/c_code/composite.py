"""The joint-space inertia matrix from composite bodies, as expressions (Walker and Orin's third method)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from drivers.core.arrays import FloatArray
from ident.export.c_code.expressions import Expression, Graph
from ident.export.c_code.frames import JointFrame
from ident.export.c_code.recursion import Wrench, along_axis, to_parent
from ident.export.c_code.vectors import Matrix, Vector, add, apply, constant_vector, cross, dot, scale
from ident.model.kinematics.joints import BASE_INDEX


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
            wrench = Wrench(scale(axis, body.mass), cross(body.first_moment, axis))
        else:
            wrench = Wrench(cross(axis, body.first_moment), apply(body.inertia, axis))
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


def _joined(one: Composite, other: Composite) -> Composite:
    x, y, z = (add(row, other_row) for row, other_row in zip(one.inertia, other.inertia, strict=True))
    return Composite((x, y, z), add(one.first_moment, other.first_moment), one.mass + other.mass)
