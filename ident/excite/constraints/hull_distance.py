"""Distances of links along a path, also between its samples: of straight segments, of convex hulls.

A capsule around a mesh is often some cm thicker than the mesh. Its convex hull is never smaller than the mesh either,
and far tighter; it has no smooth distance, and each distance is asked of Coal on its own. So capsules judge first, and
hulls where capsules touch.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from drivers.core.arrays import FloatArray, true_runs
from ident.excite.constraints.placements import Capsule, moved_by, place_arm
from ident.model.dynamic_model import DynamicModel
from ident.model.kinematics.joints import ancestors

COAL_NEIGHBOURS = 255
"""Coal keeps the number of a vertex's neighbours in a byte (convex.hxx, `fillNeighbors`)."""
FEWER_VERTICES = 200
"""Vertices of the hull that replaces one too large for Coal: none of them can have too many neighbours."""

_TOUCHING = 1e-9
"""Segments closer than this [m] cross; the difference of their nearest points has no direction any more."""

Pair = tuple[int, int]

DISTANCE_TOLERANCE = 1e-6
"""[m] that every distance is less by: Coal stops its iterations there."""
_SHARE = 0.5
"""A distance is asked again when the links may have come nearer by this share of it."""
_EVERY_SAMPLE_DISTANCE = 2e-3
"""Below this distance [m] every sample is asked."""


@dataclass(frozen=True)
class Hull:
    """All points within `radius` of the convex hull of points that are fixed to a link."""

    link: int  # index of the link's joint; `BASE_INDEX` for the base
    points: FloatArray  # (V, 3) [m] in the link's frame
    triangles: tuple[tuple[int, int, int], ...] = ()  # (F, 3) of the points; none of a point or a segment
    radius: float = 0.0  # [m]

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


@dataclass(frozen=True)
class Nearest:
    """The nearest points of pairs of segments."""

    distance: FloatArray  # (K, N) [m]
    # first, second: (K, 3, N) [m], the points
    first: FloatArray
    second: FloatArray
    normal: FloatArray  # (K, 3, N) unit vectors from second to first; across both segments where they cross


def nearest_points(start1: FloatArray, end1: FloatArray, start2: FloatArray, end2: FloatArray) -> Nearest:
    """Nearest points of segments start1-end1 and start2-end2, ends (K, 3, N) [m]; a segment may be a point.

    The point that is nearest on the two infinite lines is moved to the ends of one segment, then of the other
    (Ericson, Real-Time Collision Detection, .5.1.9).
    """
    way1, way2 = end1 - start1, end2 - start2
    apart = start1 - start2
    a, e, b = _dot(way1, way1), _dot(way2, way2), _dot(way1, way2)
    c, f = _dot(way1, apart), _dot(way2, apart)
    area = a * e - b * b
    s = np.clip(_quotient(b * f - c * e, area, 1e-14 * a * e), 0.0, 1.0)
    t = np.clip(_quotient(b * s + f, e, 0.0), 0.0, 1.0)
    s = np.clip(_quotient(b * t - c, a, 0.0), 0.0, 1.0)
    first, second = start1 + s[:, None] * way1, start2 + t[:, None] * way2
    difference = first - second
    distance = np.sqrt(_dot(difference, difference))
    crossing = distance < _TOUCHING
    if np.any(crossing):
        difference = np.where(crossing[:, None], _across(way1, way2), difference)
    length = np.where(crossing, np.sqrt(_dot(difference, difference)), distance)
    return Nearest(distance, first, second, difference / length[:, None])


def _dot(left: FloatArray, right: FloatArray) -> FloatArray:
    return left[:, 0] * right[:, 0] + left[:, 1] * right[:, 1] + left[:, 2] * right[:, 2]


def _quotient(numerator: FloatArray, denominator: FloatArray, least: FloatArray | float) -> FloatArray:
    """Quotient, 0 where the denominator is not above `least` (parallel segments, or a point)."""
    usable = denominator > least
    return np.where(usable, numerator / np.where(usable, denominator, 1.0), 0.0)


def _across(way1: FloatArray, way2: FloatArray) -> FloatArray:
    """(K, 3, N) directions across both ways; across the longer one where they are parallel."""
    both = np.cross(way1, way2, axis=1)
    longer = np.where((_dot(way1, way1) >= _dot(way2, way2))[:, None], way1, way2)
    smallest = np.argmin(np.abs(longer), axis=1)
    helper = np.moveaxis(np.eye(3)[smallest], -1, 1)
    alone = np.cross(longer, helper, axis=1)
    point = np.where(_dot(alone, alone)[:, None] > 0.0, alone, np.array([0.0, 0.0, 1.0])[:, None])
    parallel = _dot(both, both) <= 1e-16 * _dot(way1, way1) * _dot(way2, way2)
    return np.where(parallel[:, None], point, both)


class HullDistances:
    """Distances between the hulls of links, pair by pair.

    Args:
        model: of the arm.
        hulls: of all its links.
    """

    def __init__(self, model: DynamicModel, hulls: Sequence[Hull]) -> None:
        self._model = model
        self._of_link: dict[int, list[tuple[Any, FloatArray, FloatArray]]] = {}
        self._reach: dict[int, float] = {}
        for hull in hulls:
            self._of_link.setdefault(hull.link, []).append(coal_shape(hull))
            self._reach[hull.link] = max(hull.reach, self._reach.get(hull.link, 0.0))
        self._moves = moved_by(model.joints)

    def between(self, pair: Pair, position: FloatArray) -> FloatArray:
        """(N,) [m] distance of two links at positions (dof, N), negative where they overlap: never more than it is."""
        import coal

        placements = place_arm(self._model, position)
        asked, answer = coal.DistanceRequest(), coal.DistanceResult()
        asked.enable_signed_distance = True
        shapes = [self._of_link[link] for link in pair]
        nearest = np.full(position.shape[1], np.inf)
        for sample in range(position.shape[1]):
            placed = [
                [
                    (shape, coal.Transform3s(rotation @ own, origin + rotation @ place))
                    for shape, own, place in shapes[side]
                ]
                for side, link in enumerate(pair)
                for rotation, origin in [(placements.rotation[link, :, :, sample], placements.origin[link, :, sample])]
            ]
            for hull, at_hull in placed[0]:
                for other, at_other in placed[1]:
                    answer.clear()
                    distance = coal.distance(hull, at_hull, other, at_other, asked, answer)
                    nearest[sample] = min(nearest[sample], distance)
        return nearest - DISTANCE_TOLERANCE

    def along(self, pair: Pair, position: FloatArray, wanted: npt.NDArray[np.bool_]) -> FloatArray:
        """Lower bounds (N,) [m] of the distance at samples of a path (dof, N), and until the next one.

        No point of one link moves past the other faster than the joints between them do, each times the greatest
        distance of the link from its axis. So a distance holds, less that way, for the samples that follow, and is
        asked anew only where the links may have come much nearer.

        Args:
            pair: of links.
            position: of the motors' joints, closely sampled.
            wanted: (N,) at which samples; infinite elsewhere, where links are known not to touch.
        """
        way = self.ways(pair, position)
        result = np.full(position.shape[1], np.inf)
        exact = np.zeros(position.shape[1], dtype=bool)
        for first, stop in true_runs(wanted):
            sample = first
            while sample < stop:
                distance = float(self.between(pair, position[:, sample : sample + 1])[0])
                result[sample], exact[sample] = distance, True
                gone, sample = way[sample], sample + 1
                while sample < stop and distance - gone - way[sample] > max(_SHARE * distance, _EVERY_SAMPLE_DISTANCE):
                    result[sample] = distance - gone
                    gone, sample = gone + way[sample], sample + 1
        # Until the next sample, links come nearer from both ends, together by the way between.
        following = np.append(result[1:], np.inf)
        following = np.where(np.isfinite(following), following, np.maximum(result - way, 0.0))
        return np.where(exact, np.minimum(result, 0.5 * (result + following - way)), result - way)

    def ways(self, pair: Pair, position: FloatArray) -> FloatArray:
        """Return how far (N,) [m] a point of one link may move, seen from the other, from each sample to the next."""
        tree = self._model.tree_position(position)
        steps = np.abs(np.diff(tree, axis=1, append=tree[:, -1:]))
        bends = np.abs(np.diff(tree, 2, axis=1))  # what a joint moves beyond a straight line, or there and back
        wide = np.zeros_like(steps)
        wide[:, :-2] = bends
        wide[:, 1:-1] = np.maximum(wide[:, 1:-1], bends)
        travelled = steps + 0.25 * wide
        relative = self._moves[pair[0]] - self._moves[pair[1]]
        total = np.zeros(position.shape[1])
        for joint in np.flatnonzero(relative).tolist():
            link = pair[0] if relative[joint] > 0 else pair[1]
            total += self._arm_length(joint, link, tree) * travelled[joint]
        return total

    def _arm_length(self, joint: int, link: int, tree: FloatArray) -> float:
        """The greatest distance [m] of a link's points from a joint's axis; 1 of a sliding joint."""
        joints = self._model.joints
        if joints[joint].prismatic:
            return 1.0
        length = self._reach[link]
        for beyond in [*ancestors(joints, link), link]:
            if beyond != joint and joint in ancestors(joints, beyond):
                travel = float(np.abs(tree[beyond]).max()) if joints[beyond].prismatic else 0.0
                length += float(np.linalg.norm(joints[beyond].translation)) + travel
        return length
