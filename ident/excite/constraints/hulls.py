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

COAL_NEIGHBOURS = 255
"""Coal keeps the number of a vertex's neighbours in a byte (convex.hxx, `fillNeighbors`)."""
FEWER_VERTICES = 200
"""Of a hull in whose place another one is taken: none of them can have more neighbours than Coal takes."""


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
    """The convex hull of points (V, 3) [m]; None where they lie in a plane, which has no inside.

    Where more triangles meet in a vertex than Coal takes (the cap of a finely drawn cylinder), a hull of fewer vertices
    around it.
    """
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(points)
        if np.bincount(hull.simplices.ravel()).max() > COAL_NEIGHBOURS:
            hull = ConvexHull(_fewer_around(points[hull.vertices]))
    except (QhullError, ValueError):  # fewer than four points, or flat
        return None
    number = {int(vertex): index for index, vertex in enumerate(hull.vertices)}
    triangles = tuple((number[a], number[b], number[c]) for a, b, c in hull.simplices.tolist())
    return Hull(link, hull.points[hull.vertices], triangles)


def _fewer_around(points: FloatArray) -> FloatArray:
    """`FEWER_VERTICES` points (V, 3) [m] whose convex hull holds all the points given: some of these, moved outward."""
    from scipy.spatial import ConvexHull

    # Spread as if the body were as thick as it is wide, so that both sides of a thin disc are among them.
    spread = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[0]
    chosen = [0]
    distance = np.full(len(points), np.inf)
    while len(chosen) < FEWER_VERTICES:
        distance = np.minimum(distance, np.linalg.norm(spread - spread[chosen[-1]], axis=1))
        chosen.append(int(distance.argmax()))
    kept = points[chosen]
    middle = kept.mean(axis=0)
    planes = ConvexHull(kept).equations
    inside = planes[:, :3] @ middle + planes[:, 3]  # negative: below the plane
    beyond = (planes[:, :3] @ (points - middle).T / -inside[:, None]).max()
    return np.asarray(middle + (kept - middle) * (beyond + 1e-12))


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
