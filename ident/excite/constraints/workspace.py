"""Constraint of an excitation: where the arm may be (AUBO eq. 21, r_min..r_max and h_min..h_max) and may not.

The radius of a point is its distance from the base frame's z axis, its height is z in the base frame. The largest
radius and both heights hold for the tool point and for the ends of all capsules' segments of the moving links, and so
for every point on these segments (not for the links' thickness); the smallest radius holds for the tool point alone,
since every arm begins at its axis. Half-spaces and boxes are kept out by the capsules with their thickness. The base
and points that no joint moves (a shoulder on the first axis) are where they are and do not count; where a link that
moves begins in such a point inside of what it is kept out of, no motion is possible, and the file is refused.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from daq.motion.trajectories import Motion
from daq.robot.loader import RobotFile
from daq.robot.obstacles import Obstacle, obstacles_of
from daq.robot.workspace import Box, HalfSpace, Workspace
from drivers.core.arrays import FloatArray, IndexArray
from drivers.core.errors import RobotFileError
from ident.excite.constraints.collision_geometry import DISTANCE_SCALE, ArmGeometry
from ident.excite.constraints.placements import Placements, moved_by, place_arm, tool_point, wrench
from ident.excite.constraints.soft_maximum import soft_maximum
from ident.excite.path import JointPath
from ident.model.base_parameters import random_states
from ident.model.dynamic_model import DynamicModel, build_model
from ident.model.kinematics.joints import BASE_INDEX

_HALVINGS = 24

SAMPLES_AT_ONCE = 2000
"""Samples of a long path that are worked on together."""

_ON_AXIS = 1e-12  # [m]
STILL = 1e-9
"""[rad or m]: a joint that moves by less does not follow."""
CONFIGURATIONS = 500
"""Random ones that show what is so by construction."""

_SAMPLES = 2000


@dataclass(frozen=True)
class Distances:
    """Signed distances to what must not be touched, negative inside it."""

    value: FloatArray  # (K, N) [m]
    point: FloatArray  # (K, 3, N) [m], the points of the links that are nearest
    gradient: FloatArray  # (K, 3, N) derivatives by these points


def above_plane(points: FloatArray, half_space: HalfSpace) -> Distances:
    """Distances of points (K, 3, N) to a plane, positive on the side that its normal points to."""
    normal = np.array(half_space.normal) / np.linalg.norm(half_space.normal)
    value = np.einsum("i,kit->kt", normal, points) - half_space.offset
    return Distances(value, points, np.broadcast_to(normal[:, None], points.shape))


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


@dataclass(frozen=True)
class _Limit:
    name: str
    links: IndexArray  # (K,), of the distances
    distances: Callable[[Placements], Distances]
    obstacle: Obstacle | None = None

    @property
    def clearance(self) -> float:
        return 0.0 if self.obstacle is None else self.obstacle.clearance


@dataclass(frozen=True)
class Clearance:
    """How near the arm comes to an obstacle, or to another limit of the workspace, along a path."""

    name: str  # of the obstacle or limit
    obstacle: Obstacle | None  # None of another limit
    kept: float  # distance that is kept [m]
    distance: FloatArray  # (N,) of the nearest link [m], to an obstacle thickness included; negative beyond the limit
    link: IndexArray  # (N,) number of that link


class WorkspaceLimits:
    """Limits of the arm's space; each value uses 1 − (distance − clearance)/`DISTANCE_SCALE` of its limit."""

    def __init__(
        self, model: DynamicModel, geometry: ArmGeometry, workspace: Workspace, obstacles: Sequence[Obstacle]
    ) -> None:
        """Prepare for an arm.

        Raises:
            RobotFileError: a link is inside of what it is kept out of, in every configuration.
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
            for name, sign, height in (("smallest", 1.0, low), ("largest", -1.0, high)):
                plane = HalfSpace(normal=(0.0, 0.0, sign), offset=sign * height)
                limits.append(_Limit(f"{name} height of the arm", links, _to_plane(links, points, plane)))
        limits += [_obstacle(model, geometry, moving, obstacle) for obstacle in obstacles]
        self._limits = tuple(limit for limit in limits if len(limit.links))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the limits, such as `largest radius of the arm`."""
        return tuple(limit.name for limit in self._limits)

    def use(self, path: JointPath) -> FloatArray:
        """(m,) largest use on the grid."""
        nearest = np.full(len(self._limits), np.inf)
        for start in range(0, path.time.size, SAMPLES_AT_ONCE):
            placements = place_arm(self._model, path.position[:, start : start + SAMPLES_AT_ONCE])
            distances = [float(limit.distances(placements).value.min()) - limit.clearance for limit in self._limits]
            nearest = np.minimum(nearest, distances)
        return 1.0 - nearest / DISTANCE_SCALE

    def clearances(self, path: JointPath) -> tuple[Clearance, ...]:
        """The distance to every obstacle and limit along a path."""
        distance = np.empty((len(self._limits), path.time.size))
        link = np.empty((len(self._limits), path.time.size), dtype=np.intp)
        for start in range(0, path.time.size, SAMPLES_AT_ONCE):
            chunk = slice(start, start + SAMPLES_AT_ONCE)
            placements = place_arm(self._model, path.position[:, chunk])
            for row, limit in enumerate(self._limits):
                value = limit.distances(placements).value
                distance[row, chunk], link[row, chunk] = value.min(axis=0), limit.links[value.argmin(axis=0)]
        return tuple(
            Clearance(
                limit.obstacle.name if limit.obstacle else limit.name,
                limit.obstacle,
                limit.clearance,
                distance[row],
                link[row],
            )
            for row, limit in enumerate(self._limits)
        )

    def smooth_use(self, path: JointPath, sharpness: float) -> tuple[FloatArray, FloatArray]:
        """Smooth upper bound (m,) and its derivatives (m, 3, n, N)."""
        placements = place_arm(self._model, path.position)
        bounds = np.empty(len(self._limits))
        gradient = np.zeros((len(self._limits), 3, *path.position.shape))
        for row, limit in enumerate(self._limits):
            distances = limit.distances(placements)
            used = 1.0 - (distances.value - limit.clearance) / DISTANCE_SCALE
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
    moving = _reach(model, links, places) > STILL
    return places[moving], links[moving]


def _moving_capsules(model: DynamicModel, geometry: ArmGeometry) -> IndexArray:
    """Indices of the capsules of which some joint moves an end."""
    reach = np.maximum(_reach(model, geometry.links, geometry.starts), _reach(model, geometry.links, geometry.ends))
    return np.flatnonzero(reach > STILL)


def _refuse_inescapable(
    model: DynamicModel, geometry: ArmGeometry, capsules: IndexArray, places: FloatArray, obstacle: Obstacle
) -> None:
    links, radii = geometry.links[capsules], geometry.radii[capsules]
    points = place_arm(model, np.zeros((model.dof, 1))).points(links, places)
    if isinstance(obstacle.shape, Box):
        distances = box_distances(points, points, obstacle.shape)
    else:
        distances = above_plane(points, obstacle.shape)
    still = _reach(model, links, places) <= STILL
    inside = np.flatnonzero(still & (distances.value[:, 0] - radii < obstacle.clearance))
    if len(inside):
        name = model.joints[links[inside[0]]].name
        raise RobotFileError(
            f"the link of joint '{name}' begins at a point that no joint moves and that is, with its radius of "
            f"{radii[inside[0]]:g} m, already within the clearance of {obstacle.clearance:g} m: no motion is possible",
            where=f"{model.name}: {obstacle.where}",
            hint="move the limit, or correct workspace.link_radius",
        )


def _reach(model: DynamicModel, links: IndexArray, places: FloatArray) -> FloatArray:
    """Return how far each point (K,) gets from where it is first, at random configurations [m]."""
    points = place_arm(model, random_states(model, 50)[0]).points(links, places)
    return np.asarray(np.abs(points - points[..., :1]).max(axis=(1, 2)) * (links != BASE_INDEX))


def _radius(points: FloatArray, limit: float, sign: int) -> Distances:
    """Distances of points (K, 3, N) to the cylinder about the z axis: outside it for sign 1, inside for −1."""
    radius = np.hypot(points[:, 0], points[:, 1])
    away = np.zeros_like(points)
    away[:, :2] = sign * points[:, :2] / np.maximum(radius, _ON_AXIS)[:, None]
    return Distances(sign * (radius - limit), points, away)


def _obstacle(model: DynamicModel, geometry: ArmGeometry, moving: IndexArray, obstacle: Obstacle) -> _Limit:
    name = f"clearance to {obstacle.name}"
    if isinstance(obstacle.shape, Box):
        box = obstacle.shape
        _refuse_inescapable(model, geometry, np.tile(moving, 2), _ends(geometry, moving), obstacle)
        links, radii = geometry.links[moving], geometry.radii[moving][:, None]

        def to_box(placements: Placements) -> Distances:
            start = placements.points(links, geometry.starts[moving])
            distances = box_distances(start, placements.points(links, geometry.ends[moving]), box)
            return Distances(distances.value - radii, distances.point, distances.gradient)

        return _Limit(name, links, to_box, obstacle)

    # The point of a segment that is nearest to a plane is one of its ends.
    plane, capsules, places = obstacle.shape, np.tile(moving, 2), _ends(geometry, moving)
    if obstacle.mounting:
        clear = _can_be_clear(model, geometry, capsules, places, obstacle, plane)
        capsules, places = capsules[clear], places[clear]
    else:
        _refuse_inescapable(model, geometry, capsules, places, obstacle)
    links, thickness = geometry.links[capsules], geometry.radii[capsules]
    return _Limit(name, links, _to_plane(links, places, plane, thickness), obstacle)


def _to_plane(
    links: IndexArray, places: FloatArray, plane: HalfSpace, thickness: FloatArray | float = 0.0
) -> Callable[[Placements], Distances]:
    radii = np.broadcast_to(thickness, len(links))[:, None]

    def distances(placements: Placements) -> Distances:
        distances = above_plane(placements.points(links, places), plane)
        return Distances(distances.value - radii, distances.point, distances.gradient)

    return distances


def _ends(geometry: ArmGeometry, capsules: IndexArray) -> FloatArray:
    """(2K, 3) [m] first all starts, then all ends, in the links' frames."""
    return np.concatenate([geometry.starts[capsules], geometry.ends[capsules]])


def _can_be_clear(
    model: DynamicModel,
    geometry: ArmGeometry,
    capsules: IndexArray,
    places: FloatArray,
    obstacle: Obstacle,
    plane: HalfSpace,
) -> npt.NDArray[np.bool_]:
    """Return which ends (K,) of capsules the joints raise, some configuration clear of the mounting surface.

    Raises:
        RobotFileError: the centre of one is below the surface in every configuration.
    """
    links = geometry.links[capsules]
    placements = place_arm(model, random_states(model, CONFIGURATIONS)[0])
    height = above_plane(placements.points(links, places), plane).value
    highest = height.max(axis=1)
    below = np.flatnonzero(highest < -STILL)
    if len(below):
        name, depth = model.joints[links[below[0]]].name, -highest[below[0]]
        raise RobotFileError(
            f"the link of joint '{name}' reaches {depth:.3g} m below {obstacle.name} in every configuration",
            where=f"{model.name}: {obstacle.where}",
            hint="give the height of the mounting surface as workspace.floor, or mounting: free",
        )
    # Of what stays at its height, such as a shoulder, a motion changes nothing.
    return np.asarray((highest >= geometry.radii[capsules] + obstacle.clearance) & (np.ptp(height, axis=1) > STILL))


def surroundings_warning(robot_file: RobotFile, motion: Motion) -> str | None:
    """Lowest height of the joints and the tool point, where the file sets no bound; None where it sets one."""
    workspace = robot_file.robot.workspace
    if workspace.height is not None or obstacles_of(robot_file.robot):
        return None
    model = build_model(robot_file)
    position, _, _ = motion.evaluate(np.linspace(0.0, motion.duration, _SAMPLES))
    placements = place_arm(model, position)
    tool = tool_point(model, placements, workspace.tool)
    lowest = min(float(placements.origin[:-1, 2].min()), float(tool[2].min()))
    return (
        "the robot file names neither a mounting surface nor heights nor obstacles: this motion descends to "
        f"{lowest:.2f} m in the base frame. State what the arm is mounted on ('model': mounting) and what stands "
        "around it ('workspace': keep_out)"
    )
