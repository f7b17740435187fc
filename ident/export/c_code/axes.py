"""The base regressor as expressions: the joints' axes in every link's frame, times what moves a unit parameter.

With (w, v) the motion of a link's frame that a unit velocity of a joint causes, the joint's torque for a force f and a
moment n at that frame is v·f + w·n. Where joints without a motor follow, the axes of a motor's joint add up.
"""

from __future__ import annotations

from collections.abc import Sequence

from drivers.core.arrays import FloatArray
from ident.export.c_code.expressions import Expression, Graph
from ident.export.c_code.frames import JointFrame
from ident.export.c_code.recursion import LinkMotion, unit_wrench
from ident.export.c_code.vectors import Vector, add, constant_vector, cross, dot, scale
from ident.model.kinematics.joints import BASE_INDEX

Axes = dict[int, tuple[Vector, Vector]]
"""(w, v) by the number of the joint in the tree."""


def link_axes(graph: Graph, frames: Sequence[JointFrame]) -> list[Axes]:
    """For every link, the axes of the joints that it hangs on, in its frame."""
    none = constant_vector(graph, (0.0, 0.0, 0.0))
    axes: list[Axes] = []
    for index, frame in enumerate(frames):
        own: Axes = {}
        if frame.joint.parent != BASE_INDEX:
            for joint, (angular, linear) in axes[frame.joint.parent].items():
                moved = add(linear, cross(angular, frame.translation))
                own[joint] = frame.to_joint(angular), frame.to_joint(moved)
        axis = constant_vector(graph, frame.joint.axis)
        own[index] = (none, axis) if frame.joint.prismatic else (axis, none)
        axes.append(own)
    return axes


def inertial_column(graph: Graph, motion: LinkMotion, axes: Axes, kind: int, follow: FloatArray) -> list[Expression]:
    """Torques (n,) at the joints with a motor for a unit of a link's parameter number `kind` of ten.

    Args:
        graph: of all expressions.
        motion: of the link.
        axes: in the link's frame.
        kind: as in `INERTIAL`.
        follow: (joints, n) G = ∂q_tree/∂q_active.
    """
    wrench = unit_wrench(motion, kind)
    none = constant_vector(graph, (0.0, 0.0, 0.0))
    column = []
    for motor in range(follow.shape[1]):
        angular, linear = none, none
        for joint, (w, v) in axes.items():
            share = graph.constant(float(follow[joint, motor]))
            angular, linear = add(angular, scale(w, share)), add(linear, scale(v, share))
        column.append(dot(linear, wrench.force) + dot(angular, wrench.moment))
    return column
