"""Constraint of an excitation: the links stay clear of each other."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np
import numpy.typing as npt

from drivers.core.arrays import FloatArray
from ident.excite.constraints.collision_geometry import DISTANCE_SCALE, ArmGeometry, link_name
from ident.excite.constraints.hull_distance import HullDistances, Nearest, nearest_points
from ident.excite.constraints.placements import Placements, moved_by, place_arm, wrench
from ident.excite.constraints.soft_maximum import soft_maximum
from ident.excite.constraints.workspace import CONFIGURATIONS, SAMPLES_AT_ONCE, STILL
from ident.excite.path import JointPath
from ident.model.base_parameters import random_states
from ident.model.dynamic_model import DynamicModel
from ident.model.kinematics.joints import BASE_INDEX

ALWAYS_CLOSE = 0.95
"""Links that are close in at least this share of random configurations, over full turns, are so by construction."""

OVERLAP_DISTANCE = 0.02
"""Links nearer than this [m] by construction are not checked: their capsules always overlap."""


HULL_DISTANCE = 5e-3
"""Where capsules are nearer than this [m], the links' convex hulls are asked."""

_TRAVEL = 1.0
"""A sliding joint is moved by at least this much [m] to either side of the middle of its range."""

Pair = tuple[int, int]


@dataclass(frozen=True)
class LinkPairs:
    """Pairs of links by number (`BASE_INDEX` is the base), and what becomes of them."""

    checked: tuple[Pair, ...]  # pairs with a least distance
    neighbours: tuple[Pair, ...]  # joined by a joint
    # left out since their capsules touch or nearly touch in nearly every configuration, whatever the limits
    close: tuple[Pair, ...]
    ignored: tuple[Pair, ...]  # left out by the robot file
    by_hull: tuple[Pair, ...] = ()  # those whose capsules touch by construction, but whose shapes' convex hulls do not


def link_pairs(model: DynamicModel, geometry: ArmGeometry, ignore: Iterable[tuple[str, str]] = ()) -> LinkPairs:
    """Sort all pairs of links; `ignore` names those that may touch."""
    ignored_names = {frozenset(names) for names in ignore}
    neighbours, ignored, others = [], [], []
    for first, second in combinations((BASE_INDEX, *range(len(model.joints))), 2):
        if model.joints[second].parent == first:
            neighbours.append((first, second))
        elif frozenset((link_name(model, first), link_name(model, second))) in ignored_names:
            ignored.append((first, second))
        else:
            others.append((first, second))
    positions = _anywhere(model)
    distance = _PairDistances(model, geometry, others).smallest(place_arm(model, positions))
    always_close = (distance < OVERLAP_DISTANCE).mean(axis=1) >= ALWAYS_CLOSE
    close = [pair for pair, near in zip(others, always_close, strict=True) if near]
    hulls = HullDistances(model, geometry.hulls)
    by_hull = [
        pair
        for pair in (close if geometry.hulls else ())
        if (hulls.between(pair, positions) < OVERLAP_DISTANCE).mean() < ALWAYS_CLOSE
    ]
    return LinkPairs(
        checked=tuple(pair for pair, near in zip(others, always_close, strict=True) if not near),
        neighbours=tuple(neighbours),
        close=tuple(pair for pair in close if pair not in by_hull),
        ignored=tuple(ignored),
        by_hull=tuple(by_hull),
    )


def _anywhere(model: DynamicModel) -> FloatArray:
    """Random positions (n, N) over full turns, or a wide travel: joint limits hide what links do beyond them.

    Joints that move a loop stay within their limits, where the loop closes: beyond them its bars would go through each
    other. The others go anywhere.
    """
    share = np.random.default_rng(0).uniform(-1.0, 1.0, (model.dof, CONFIGURATIONS))
    within, moving = random_states(model, CONFIGURATIONS)[0], _moves_loops(model)
    for row, (joint, limits) in enumerate(zip(model.active, model.limits, strict=True)):
        low, high = limits.position
        if moving[row]:
            share[row] = within[row]
        elif model.joints[joint].prismatic:
            share[row] = 0.5 * (low + high) + share[row] * max(0.5 * (high - low), _TRAVEL)
        else:
            share[row] *= np.pi
    return share


def _moves_loops(model: DynamicModel) -> npt.NDArray[np.bool_]:
    """Return which of the joints with a motor (n,) move joints without one."""
    passive = [joint for joint in range(len(model.joints)) if joint not in model.active]
    if not passive:
        return np.zeros(model.dof, dtype=bool)
    here, there = random_states(model, 2)[0].T
    # One joint after the other goes from one position within the limits to another.
    positions = np.where(np.eye(model.dof, dtype=bool), there, here).T
    followed = model.tree_position(np.column_stack([here, positions]))[passive]
    return np.asarray(np.any(np.abs(followed[:, 1:] - followed[:, :1]) > STILL, axis=0))


class _PairDistances:
    """Distances of all capsules of one link to all of another, for some pairs of links."""

    def __init__(self, model: DynamicModel, geometry: ArmGeometry, pairs: Iterable[Pair]) -> None:
        self._geometry = geometry
        of_link = {link: np.flatnonzero(geometry.links == link) for link in (BASE_INDEX, *range(len(model.joints)))}
        moves = moved_by(model.joints)
        first, second, sizes, relative = [], [], [], []
        for link, other in pairs:
            mine, theirs = np.meshgrid(of_link[link], of_link[other], indexing="ij")
            first.append(mine.ravel())
            second.append(theirs.ravel())
            sizes.append(mine.size)
            # A joint below both links moves them together: their distance stays.
            relative.append(moves[link] - moves[other])
        nothing = [np.zeros(0, dtype=np.intp)]
        self.first, self.second = np.concatenate(first or nothing), np.concatenate(second or nothing)
        self.starts = np.concatenate([[0], np.cumsum(sizes)]).astype(np.intp)
        self.relative = np.array(relative).reshape(len(sizes), len(model.joints))
        self._radii = (geometry.radii[self.first] + geometry.radii[self.second])[:, None]

    def nearest(self, placements: Placements) -> tuple[FloatArray, Nearest]:
        """Distances (K, N) [m] of all pairs of capsules, negative where they overlap, and their segments' nearest."""
        starts = placements.points(self._geometry.links, self._geometry.starts)
        ends = placements.points(self._geometry.links, self._geometry.ends)
        nearest = nearest_points(starts[self.first], ends[self.first], starts[self.second], ends[self.second])
        return nearest.distance - self._radii, nearest

    def smallest(self, placements: Placements) -> FloatArray:
        """(m, N) [m] of each pair of links."""
        distance, _ = self.nearest(placements)
        if not len(distance):
            return distance
        return np.asarray(np.minimum.reduceat(distance, self.starts[:-1], axis=0))


class SelfCollision:
    """The distance of every checked pair of links; contact uses all of the limit (see `DISTANCE_SCALE`)."""

    def __init__(self, model: DynamicModel, geometry: ArmGeometry, pairs: LinkPairs) -> None:
        self._model = model
        self.pairs = pairs
        self._distances = _PairDistances(model, geometry, pairs.checked)
        self._hulls = HullDistances(model, geometry.hulls) if geometry.hulls else None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the limits, such as `distance of link forearm from base`; links go by the joints that move them."""
        named = [
            (link_name(self._model, first), link_name(self._model, second)) for first, second in self.pairs.checked
        ]
        return tuple(f"distance of link {second} from {first}" for first, second in named)

    def use(self, path: JointPath) -> FloatArray:
        """(m,) largest use on the grid."""
        nearest = np.full(len(self.pairs.checked), np.inf)
        for start in range(0, path.time.size, SAMPLES_AT_ONCE):
            placements = place_arm(self._model, path.position[:, start : start + SAMPLES_AT_ONCE])
            nearest = np.minimum(nearest, self._distances.smallest(placements).min(axis=1))
        return 1.0 - nearest / DISTANCE_SCALE

    def distances(self, path: JointPath) -> FloatArray:
        """(m, N) [m] distance of each checked pair along a path, negative where its links overlap."""
        distance = np.empty((len(self.pairs.checked), path.time.size))
        for start in range(0, path.time.size, SAMPLES_AT_ONCE):
            chunk = slice(start, start + SAMPLES_AT_ONCE)
            distance[:, chunk] = self._distances.smallest(place_arm(self._model, path.position[:, chunk]))
        return distance

    def clearances(self, path: JointPath) -> tuple[tuple[Pair, ...], FloatArray]:
        """The pairs that are kept apart, and lower bounds (m, N) [m] of their distances along a path.

        Where capsules touch, convex hulls are asked, and the motion between samples is counted. A linkage is in its
        closed configuration.
        """
        distance = self.distances(path)
        if self._hulls is None:
            return self.pairs.checked, distance
        for row, pair in enumerate(self.pairs.checked):
            # A hull is within its capsules: where they are clear until the next sample, it need not be asked.
            touching = distance[row] < HULL_DISTANCE + self._hulls.ways(pair, path.position)
            if touching.any():
                distance[row] = np.where(touching, self._hulls.along(pair, path.position, touching), distance[row])
        everywhere = np.ones(path.time.size, dtype=bool)
        by_hull = [self._hulls.along(pair, path.position, everywhere) for pair in self.pairs.by_hull]
        rows = np.array(by_hull).reshape(len(by_hull), path.time.size)
        return (*self.pairs.checked, *self.pairs.by_hull), np.concatenate([distance, rows])

    def smooth_use(self, path: JointPath, sharpness: float) -> tuple[FloatArray, FloatArray]:
        """Smooth upper bound (m,) and its derivatives (m, 3, n, N): ∂d/∂q = nᵀ(J_1 − J_2) at the nearest points."""
        placements = place_arm(self._model, path.position)
        distance, nearest = self._distances.nearest(placements)
        used = 1.0 - distance / DISTANCE_SCALE
        starts = self._distances.starts
        bounds = np.empty(len(starts) - 1)
        weights = np.empty_like(used)
        for row, (start, end) in enumerate(pairwise(starts)):
            bounds[row], flat = soft_maximum(used[start:end].ravel(), sharpness)
            weights[start:end] = flat.reshape(used[start:end].shape)
        gradient = np.zeros((len(bounds), 3, *path.position.shape))
        if len(bounds):
            force = nearest.normal * (-weights / DISTANCE_SCALE)[:, None]
            # The normal goes through both nearest points: its moment is the same at either.
            of_pairs = np.add.reduceat(wrench(nearest.first, force), starts[:-1], axis=0)
            turned = np.einsum("jat,mat->mjt", placements.screw, of_pairs)
            of_tree = self._distances.relative[:, :, None] * turned
            gradient[:, 0] = self._model.active_gradient(path.position, of_tree)
        return bounds, gradient
