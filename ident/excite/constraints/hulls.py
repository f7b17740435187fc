"""Convex hulls of links' shapes: where the capsules around them overlap, they say how far apart the links are.

A capsule around a mesh is often some cm thicker than the mesh. Its convex hull is never smaller than the mesh either,
and far tighter; it has no smooth distance, and each distance is asked of Coal on its own. So capsules judge first, and
hulls where capsules touch.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from drivers.core.arrays import FloatArray
from ident.excite.constraints.capsules import Capsule


@dataclass(frozen=True)
class Hull:
    """All points within `radius` of the convex hull of points that are fixed to a link.

    Attributes:
        link: index of the link's joint; `BASE_INDEX` for the base.
        points: (V, 3) [m] in the link's frame.
        triangles: (F, 3) of the points; none of a point or a segment.
        radius: [m].
    """

    link: int
    points: FloatArray
    triangles: tuple[tuple[int, int, int], ...] = ()
    radius: float = 0.0

    @property
    def reach(self) -> float:
        """Distance of its farthest point from the origin of the link's frame [m]."""
        return float(np.linalg.norm(self.points, axis=1).max()) + self.radius


def hull_of_points(link: int, points: FloatArray) -> Hull | None:
    """The convex hull of points (V, 3) [m]; None where they lie in a plane, which has no inside."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):  # fewer than four points, or flat
        return None
    number = {int(vertex): index for index, vertex in enumerate(hull.vertices)}
    triangles = tuple((number[a], number[b], number[c]) for a, b, c in hull.simplices.tolist())
    return Hull(link, points[hull.vertices], triangles)


def hull_of_capsule(capsule: Capsule) -> Hull:
    """A capsule as a hull."""
    return Hull(capsule.link, np.array([capsule.start, capsule.end]), (), capsule.radius)


def coal_shape(hull: Hull) -> tuple[Any, FloatArray, FloatArray]:
    """Coal's shape of a hull, and its place in the link's frame: rotation (3, 3) and origin (3,) [m].

    The shape of a mesh is made of the triangles: Coal's own Qhull ends the process where points are flat.
    """
    import coal

    if hull.triangles:
        points, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
        for point in hull.points:
            points.append(point)
        for corners in hull.triangles:
            triangles.append(coal.Triangle(*corners))
        return coal.Convex(points, triangles), np.eye(3), np.zeros(3)
    way = hull.points[-1] - hull.points[0]
    length = float(np.linalg.norm(way))
    middle = 0.5 * (hull.points[0] + hull.points[-1])
    if length == 0.0:
        return coal.Sphere(hull.radius), np.eye(3), middle
    z = way / length
    x = np.linalg.svd(z[None, :])[2][1]
    return coal.Capsule(hull.radius, length), np.column_stack([x, np.cross(z, x), z]), middle
