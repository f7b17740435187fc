"""Constraint of an excitation: where the arm may be (AUBO eq. 21, r_min..r_max and h_min..h_max) and may not.

The radius of a point is its distance from the base frame's z axis, its height is z in the base frame. The largest
radius and both heights hold for the tool point and for the ends of all capsules' segments of the moving links, and so
for every point on these segments (not for the links' thickness); the smallest radius holds for the tool point alone,
since every arm begins at its axis. Half-spaces and boxes are kept out by the capsules with their thickness. The base
and points that no joint moves (a shoulder on the first axis) are where they are and do not count; where a link that
moves begins in such a point inside of what it is kept out of, no motion is possible, and the file is refused.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from daq.robot.workspace import Box, HalfSpace, Workspace
from drivers.errors import RobotFileError
from drivers.streams import FloatArray
from ident.excite.constraints.collision_geometry import DISTANCE_SCALE, ArmGeometry
from ident.excite.constraints.placements import IndexArray, Placements, moved_by, place_arm, wrench
from ident.excite.constraints.soft_maximum import soft_maximum
from ident.excite.path import Path
from ident.model.base_parameters import random_states
from ident.model.dynamic_model import DynamicModel
from ident.model.joints import BASE_INDEX

SAMPLES_AT_ONCE = 2000
"""Samples of a long path that are worked on together."""

_ON_AXIS = 1e-12  # [m]
_HALVINGS = 24
_STILL = 1e-9  # [m]


@dataclass(frozen=True)
class Distances:
    """Signed distances to what must not be touched, negative inside it.

    Attributes:
        value: (K, N) [m].
        point: (K, 3, N) [m], the points of the links that are nearest.
        gradient: (K, 3, N) derivatives by these points.
    """

    value: FloatArray
    point: FloatArray
    gradient: FloatArray


@dataclass(frozen=True)
class _Limit:
    name: str
    links: IndexArray  # (K,), of the distances
    distances: Callable[[Placements], Distances]


class WorkspaceLimits:
    """Where the arm may be; each value uses 1 − distance/`DISTANCE_SCALE` of its limit."""

    def __init__(self, model: DynamicModel, geometry: ArmGeometry, workspace: Workspace) -> None:
        """Prepare for an arm.

        Raises:
            RobotFileError: a link is inside of what it is kept out of, whatever the joints do.
        """
        self._model = model
        self._moves = moved_by(model.joints)
        points, links = _moving_points(model, geometry, workspace)
        tool = np.array([workspace.tool])
        last = np.array([model.tool_link])
        moving = _moving_capsules(model, geometry)
        limits = []
        if workspace.radius is not None:
            least, largest = workspace.radius
            if least > 0:
                limits.append(
                    _Limit("smallest radius of the tool point", last, lambda p: _radius(p.points(last, tool), least, 1))
                )
            limits.append(
                _Limit("largest radius of the arm", links, lambda p: _radius(p.points(links, points), largest, -1))
            )
        if workspace.height is not None:
            low, high = workspace.height
            up = HalfSpace(normal=(0.0, 0.0, 1.0), offset=low)
            down = HalfSpace(normal=(0.0, 0.0, -1.0), offset=-high)
            limits.append(_Limit("smallest height of the arm", links, lambda p: _above(p.points(links, points), up)))
            limits.append(_Limit("largest height of the arm", links, lambda p: _above(p.points(links, points), down)))
        _refuse_inescapable(model, geometry, moving, workspace)
        for index, keep_out in enumerate(workspace.keep_out):
            if keep_out.half_space is not None:
                limits.append(_half_space(geometry, moving, keep_out.half_space, f"half-space keep_out[{index}]"))
            elif keep_out.box is not None:
                limits.append(_box(geometry, moving, keep_out.box, f"box keep_out[{index}]"))
        self._limits = tuple(limit for limit in limits if len(limit.links))

    @property
    def names(self) -> tuple[str, ...]:
        """As in `largest radius of the arm`."""
        return tuple(limit.name for limit in self._limits)

    def use(self, path: Path) -> FloatArray:
        """(m,) largest use on the grid."""
        nearest = np.full(len(self._limits), np.inf)
        for start in range(0, path.time.size, SAMPLES_AT_ONCE):
            placements = place_arm(self._model, path.position[:, start : start + SAMPLES_AT_ONCE])
            distances = [float(limit.distances(placements).value.min()) for limit in self._limits]
            nearest = np.minimum(nearest, distances)
        return 1.0 - nearest / DISTANCE_SCALE

    def smooth_use(self, path: Path, sharpness: float) -> tuple[FloatArray, FloatArray]:
        """Smooth upper bound (m,) and its derivatives (m, 3, n, N)."""
        placements = place_arm(self._model, path.position)
        bounds = np.empty(len(self._limits))
        gradient = np.zeros((len(self._limits), 3, *path.position.shape))
        for row, limit in enumerate(self._limits):
            distances = limit.distances(placements)
            used = 1.0 - distances.value / DISTANCE_SCALE
            bounds[row], weights = soft_maximum(used.ravel(), sharpness)
            force = distances.gradient * (-weights.reshape(used.shape) / DISTANCE_SCALE)[:, None]
            turned = np.einsum("jat,kat->kjt", placements.screw, wrench(distances.point, force))
            of_tree = np.einsum("kj,kjt->jt", self._moves[limit.links], turned)
            gradient[row, 0] = self._model.active_gradient(path.position, of_tree)
        return bounds, gradient


def _moving_points(model: DynamicModel, geometry: ArmGeometry, workspace: Workspace) -> tuple[FloatArray, IndexArray]:
    """The tool point and the capsules' ends that some joint moves: places (K, 3) in their links' frames, links (K,)."""
    places = np.concatenate([np.array([workspace.tool]), geometry.starts, geometry.ends])
    links = np.concatenate([[model.tool_link], geometry.links, geometry.links])
    both = np.unique(np.column_stack([links, places]), axis=0)
    links, places = both[:, 0].astype(np.intp), both[:, 1:]
    moving = _reach(model, links, places) > _STILL
    return places[moving], links[moving]


def _moving_capsules(model: DynamicModel, geometry: ArmGeometry) -> IndexArray:
    """Numbers of the capsules of which some joint moves an end."""
    reach = np.maximum(_reach(model, geometry.links, geometry.starts), _reach(model, geometry.links, geometry.ends))
    return np.flatnonzero(reach > _STILL)


def _refuse_inescapable(model: DynamicModel, geometry: ArmGeometry, moving: IndexArray, workspace: Workspace) -> None:
    at_zero = place_arm(model, np.zeros((model.dof, 1)))
    links, radii = geometry.links[moving], geometry.radii[moving]
    for places in (geometry.starts[moving], geometry.ends[moving]):
        points = at_zero.points(links, places)
        still = _reach(model, links, places) <= _STILL
        for index, keep_out in enumerate(workspace.keep_out):
            if keep_out.half_space is not None:
                distances = _above(points, keep_out.half_space)
            elif keep_out.box is not None:
                distances = box_distances(points, points, keep_out.box)
            inside = np.flatnonzero(still & (distances.value[:, 0] - radii < 0.0))
            if len(inside):
                name = model.joints[links[inside[0]]].name
                raise RobotFileError(
                    f"the link of joint '{name}' begins in a point that no joint moves, and with its radius of "
                    f"{radii[inside[0]]:g} m it is inside already: no motion is possible",
                    where=f"{model.name}: workspace.keep_out[{index}]",
                    hint="move the limit, or correct workspace.link_radius",
                )


def _reach(model: DynamicModel, links: IndexArray, places: FloatArray) -> FloatArray:
    """How far each point (K,) gets from where it is first, at random configurations [m]."""
    points = place_arm(model, random_states(model, 50)[0]).points(links, places)
    return np.asarray(np.abs(points - points[..., :1]).max(axis=(1, 2)) * (links != BASE_INDEX))


def _radius(points: FloatArray, limit: float, sign: int) -> Distances:
    """Distances of points (K, 3, N) to the cylinder about the z axis: outside it for sign 1, inside for −1."""
    radius = np.hypot(points[:, 0], points[:, 1])
    away = np.zeros_like(points)
    away[:, :2] = sign * points[:, :2] / np.maximum(radius, _ON_AXIS)[:, None]
    return Distances(sign * (radius - limit), points, away)


def _above(points: FloatArray, half_space: HalfSpace) -> Distances:
    """Distances of points (K, 3, N) to a plane, positive on the side that its normal points to."""
    normal = np.array(half_space.normal) / np.linalg.norm(half_space.normal)
    value = np.einsum("i,kit->kt", normal, points) - half_space.offset
    return Distances(value, points, np.broadcast_to(normal[:, None], points.shape))


def _half_space(geometry: ArmGeometry, moving: IndexArray, half_space: HalfSpace, name: str) -> _Limit:
    # The point of a segment that is nearest to a plane is one of its ends.
    links = np.tile(geometry.links[moving], 2)
    places = np.concatenate([geometry.starts[moving], geometry.ends[moving]])
    radii = np.tile(geometry.radii[moving], 2)[:, None]

    def distances(placements: Placements) -> Distances:
        distances = _above(placements.points(links, places), half_space)
        return Distances(distances.value - radii, distances.point, distances.gradient)

    return _Limit(name, links, distances)


def _box(geometry: ArmGeometry, moving: IndexArray, box: Box, name: str) -> _Limit:
    links, radii = geometry.links[moving], geometry.radii[moving][:, None]

    def distances(placements: Placements) -> Distances:
        start = placements.points(links, geometry.starts[moving])
        distances = box_distances(start, placements.points(links, geometry.ends[moving]), box)
        return Distances(distances.value - radii, distances.point, distances.gradient)

    return _Limit(name, links, distances)


def box_distances(start: FloatArray, end: FloatArray, box: Box) -> Distances:
    """Signed distances of segments to a box; their ends are (K, 3, N) [m].

    Along a segment the signed distance is convex, so that its minimum is found by halving. Where the minimum is a kink
    (a segment that goes through the box), the derivative is that mean of both sides' that has no slope along the
    segment.
    """
    middle = 0.5 * (np.array(box.lower) + np.array(box.upper))[:, None]
    half = 0.5 * (np.array(box.upper) - np.array(box.lower))[:, None]
    way = end - start

    def at(share: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        point = start + share[:, None] * way
        value, gradient = _to_box(point - middle, half)
        return value, point, gradient, np.asarray((gradient * way).sum(axis=1))

    low, high = np.zeros_like(start[:, 0]), np.ones_like(start[:, 0])
    for _ in range(_HALVINGS):
        share = 0.5 * (low + high)
        beyond = at(share)[3] > 0.0
        low, high = np.where(beyond, low, share), np.where(beyond, share, high)
    value, point, before, falling = at(low)
    value_after, point_after, after, rising = at(high)
    between = (falling < 0.0) & (rising > 0.0)
    change = np.where(between, rising - falling, 1.0)
    fraction = np.where(between, -falling / change, np.where(falling >= 0.0, 0.0, 1.0))
    # Where the two slopes meet: halving alone would leave the error of the last step.
    to_kink = np.clip((value - value_after + rising * (high - low)) / change, 0.0, high - low)
    to_end = fraction == 1.0
    value = np.where(to_end, value_after, value + np.where(between, falling * to_kink, 0.0))
    return Distances(
        value, np.where(to_end[:, None], point_after, point), before + fraction[:, None] * (after - before)
    )


def _to_box(offset: FloatArray, half: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Signed distance (K, N) of points (K, 3, N) from a box's middle to its surface, and its derivatives (K, 3, N)."""
    beyond = np.abs(offset) - half
    outside = np.maximum(beyond, 0.0)
    distance = np.sqrt((outside**2).sum(axis=1))
    away = distance > 0.0
    direction = outside / np.where(away, distance, 1.0)[:, None]
    nearest_face = np.moveaxis(np.eye(3)[np.argmax(beyond, axis=1)], -1, 1)
    gradient = np.sign(offset) * np.where(away[:, None], direction, nearest_face)
    return np.where(away, distance, beyond.max(axis=1)), gradient
