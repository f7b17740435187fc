"""Torques of a payload that is an argument: a body on the last link, rigidly held."""

from __future__ import annotations

from drivers.core.arrays import FloatArray
from ident.export.c_code.axes import Axes, inertial_column
from ident.export.c_code.expressions import Expression, Graph
from ident.export.c_code.recursion import LinkMotion


def payload_torque(graph: Graph, motion: LinkMotion, axes: Axes, follow: FloatArray) -> tuple[Expression, ...]:
    """Torques (n,) at the joints with a motor, linear in the payload's standard parameters (SR400 .4.4).

    The symbols are `payload0` to `payload9`: mass, centre of mass x y z in the link's frame, inertia xx xy xz yy yz zz
    about the centre of mass.

    Args:
        graph: of all expressions.
        motion: of the link that carries it.
        axes: of the joints, in the link's frame.
        follow: (joints, n) G = ∂q_tree/∂q_active.
    """
    mass, x, y, z, xx, xy, xz, yy, yz, zz = (graph.symbol(f"payload{number}") for number in range(10))
    standard = (
        xx + mass * (y * y + z * z),
        xy - mass * (x * y),
        xz - mass * (x * z),
        yy + mass * (x * x + z * z),
        yz - mass * (y * z),
        zz + mass * (x * x + y * y),
        mass * x,
        mass * y,
        mass * z,
        mass,
    )
    totals = [graph.constant(0.0)] * follow.shape[1]
    for kind, value in enumerate(standard):
        column = inertial_column(graph, motion, axes, kind, follow)
        totals = [total + entry * value for total, entry in zip(totals, column, strict=True)]
    return tuple(totals)
