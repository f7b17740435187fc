"""The check of a motion before it is played: the constraints of a design, along any motion."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from daq.motion.motion_check import MotionFigures, SmallestClearance
from daq.motion.trajectories import Motion
from daq.robot.loader import RobotFile
from drivers.core.arrays import BoolArray, FloatArray
from drivers.core.errors import MotionRefusedError
from drivers.core.text import percent_text
from ident.excite.constraints.collision_geometry import link_name
from ident.excite.constraints.constraints import constraints_of, unchecked_pairs
from ident.excite.constraints.placements import place_arm, tool_point
from ident.excite.constraints.self_collision import SelfCollision
from ident.excite.constraints.torque_limits import TORQUE_SHARE, TorqueLimits
from ident.excite.constraints.workspace import SAMPLES_AT_ONCE, WorkspaceLimits
from ident.excite.path import JointPath
from ident.excite.prior import find_prior
from ident.model.dynamic_model import build_model

GRID_RATE = 1000.0
"""Grid [Hz] of the motion itself."""
APPROACH_RATE = 200.0
"""Grid [Hz] of the approach, which uses a tenth of the velocity limits."""
MOST_SAMPLES = 400_000
"""A motion of more than 400 s without repetition is checked on a grid that is coarser than 1 kHz."""
TOLERANCE = 1e-3
"""Tolerance of distances [m] and limit utilisations: a design was checked on another grid."""


@dataclass(frozen=True)
class _Watched:
    """A distance over time."""

    what: str  # an obstacle, a limit of the workspace, or another link
    kind: Literal["obstacle", "limit", "link"]  # which of them
    links: Sequence[str]  # (N,) names of the links that come nearest
    distance: FloatArray  # (N,) [m]
    kept: float  # at least this much [m]

    def breach(self, sample: int, time: float) -> str:
        """The violation at a sample, the first of those that come too near."""
        smallest, link = float(self.distance.min()), self.links[sample]
        if self.kind == "limit":
            return f"link {link} passes the {self.what} at {time:.2f} s, by up to {-smallest:.3f} m"
        if smallest < 0.0:
            return f"link {link} enters {self.what} at {time:.2f} s, up to {-smallest:.3f} m deep"
        nearest = f"link {link} comes too near to {self.what} at {time:.2f} s, down to {smallest:.3f} m"
        return f"{nearest}; {self.kept:.3g} m is kept"


class ArmMotionCheck:
    """Keeps an arm clear of its mounting surface, obstacles and itself, and within its torque limits."""

    def __init__(self, robot_file: RobotFile, prior: str | Path | None = None, *, self_collision: bool = True) -> None:
        """Prepare for an arm; the parameters of the result.json `prior`, or of the file's truth, predict its torque.

        Raises:
            DynidError: the geometry or the result cannot be used.
        """
        self._robot = robot_file.robot
        self._model = build_model(robot_file)
        parameters = find_prior(robot_file, prior).parameters
        constraints = constraints_of(robot_file, self._model, parameters, self_collision)
        self._workspace = [limits for limits in constraints if isinstance(limits, WorkspaceLimits)]
        self._pairs = [limits for limits in constraints if isinstance(limits, SelfCollision)]
        self._unchecked = unchecked_pairs(robot_file, self._model)
        self._torque = [limits for limits in constraints if isinstance(limits, TorqueLimits)]

    def trajectory(self, motion: Motion, where: str) -> MotionFigures:
        """Check a motion on a grid of 1 kHz.

        Raises:
            MotionRefusedError: names link, obstacle and time, or joint, torque and time.
        """
        return self._check(motion, GRID_RATE, where, from_here=False)

    def refusal(self, motion: Motion) -> str:
        """Return why `trajectory` would refuse a motion, in words; empty where it does not."""
        try:
            self.trajectory(motion, "")
        except MotionRefusedError as error:
            return error.message
        return ""

    def approach(self, motion: Motion) -> MotionFigures:
        """Check the approach on a grid of 200 Hz; links that are too near already must not come nearer.

        Raises:
            MotionRefusedError: as above.
        """
        return self._check(motion, APPROACH_RATE, "the approach to the start pose", from_here=True)

    def clear(self, position: FloatArray) -> BoolArray:
        """Return whether an arm at rest in poses (n, N) keeps what a motion must keep: distances and torques (N,)."""
        still = np.zeros_like(position)
        path = JointPath(np.arange(position.shape[1], dtype=np.float64), position, still, still)
        fine = np.ones(position.shape[1], dtype=bool)
        for watched in self._watched(path):
            fine &= watched.distance >= watched.kept - TOLERANCE
        for limits in self._torque:
            fine &= np.all(np.abs(limits.use_over_time(path)) <= 1.0 + TOLERANCE, axis=0)
        return fine

    def _check(self, motion: Motion, rate: float, where: str, *, from_here: bool) -> MotionFigures:
        time = _grid(motion, rate, where)
        path = JointPath(time, *motion.evaluate(time))
        clearances = []
        for watched in self._watched(path):
            kept = min(watched.kept, float(watched.distance[0])) if from_here else watched.kept
            breaches = np.flatnonzero(watched.distance < kept - TOLERANCE)
            nearest = int(watched.distance.argmin())
            smallest = float(watched.distance[nearest])
            if len(breaches):
                first = int(breaches[0])
                raise MotionRefusedError(watched.breach(first, float(time[first])), where=where, hint=_HINT)
            clearances.append(SmallestClearance(watched.what, watched.links[nearest], smallest, float(time[nearest])))
        torque_joint, torque_share = self._check_torque(path, where, from_here=from_here)
        lowest, farthest, tool_speed = self._tool(path)
        shares = np.abs(path.velocity).max(axis=1) / np.array([joint.velocity for joint in self._robot.joints])
        return MotionFigures(
            duration=motion.duration,
            lowest=lowest,
            farthest=farthest,
            tool_speed=tool_speed,
            fastest_joint=self._robot.joint_names[int(shares.argmax())],
            speed_share=float(shares.max()),
            clearances=tuple(sorted(clearances, key=lambda clearance: clearance.distance)),
            torque_joint=torque_joint,
            torque_share=torque_share,
            unchecked=self._unchecked,
        )

    def _watched(self, path: JointPath) -> Iterator[_Watched]:
        for limits in self._workspace:
            for clearance in limits.clearances(path):
                names = [link_name(self._model, link) for link in clearance.link]
                kind: Literal["obstacle", "limit"] = "limit" if clearance.obstacle is None else "obstacle"
                yield _Watched(clearance.name, kind, names, clearance.distance, clearance.kept)
        for collision in self._pairs:
            # Only the pair that comes nearest tells something of a motion; any pair may be the one that breaks it.
            pairs, distances = collision.clearances(path)
            named = [tuple(link_name(self._model, link) for link in pair) for pair in pairs]
            for row in [*np.flatnonzero(distances.min(axis=1) < -TOLERANCE), int(distances.min(axis=1).argmin())]:
                first, second = named[row]
                yield _Watched(f"link {first}", "link", [second] * path.time.size, distances[row], 0.0)

    def _check_torque(self, path: JointPath, where: str, *, from_here: bool) -> tuple[str, float | None]:
        joint, share = "", None
        for limits in self._torque:
            used = np.abs(limits.use_over_time(path))
            allowed = np.maximum(1.0, used[:, :1]) if from_here else 1.0
            row, sample = (int(index) for index in np.unravel_index(int((used - allowed).argmax()), used.shape))
            if (used - allowed)[row, sample] > TOLERANCE:
                needed = f"{percent_text(TORQUE_SHARE * float(used[row, sample]), 2)} of its torque limit"
                raise MotionRefusedError(
                    f"joint {limits.joint_names[row]} is predicted to need {needed} at {path.time[sample]:.2f} s; at "
                    f"most {percent_text(TORQUE_SHARE)} is allowed",
                    where=where,
                    hint="slow down the motion, for example with --speed-scale, or correct the arm's parameters",
                )
            row = int(used.max(axis=1).argmax())
            joint, share = limits.joint_names[row], TORQUE_SHARE * float(used[row].max())
        return joint, share

    def _tool(self, path: JointPath) -> tuple[float, float, float]:
        """Lowest height and farthest distance of the tool point [m], and its largest speed [m/s]."""
        tool = np.empty((3, path.time.size))
        for start in range(0, path.time.size, SAMPLES_AT_ONCE):
            chunk = slice(start, start + SAMPLES_AT_ONCE)
            placements = place_arm(self._model, path.position[:, chunk])
            tool[:, chunk] = tool_point(self._model, placements, self._robot.workspace.tool)
        gravity = np.array(self._robot.model.gravity)
        size = float(np.linalg.norm(gravity))
        up = -gravity / size if size > 0.0 else np.array([0.0, 0.0, 1.0])
        speed = np.linalg.norm(np.diff(tool, axis=1), axis=0) / np.diff(path.time)
        return float((up @ tool).min()), float(np.linalg.norm(tool, axis=0).max()), float(speed.max())


def _grid(motion: Motion, rate: float, where: str) -> FloatArray:
    """Times (N,) [s] at a rate, of a part of the motion that is repeated only once.

    Raises:
        MotionRefusedError: they would be more than `MOST_SAMPLES` at `APPROACH_RATE`.
    """
    pieces = motion.pieces()
    widths = pieces.end - pieces.start
    total = float(widths.sum())
    if total * APPROACH_RATE > MOST_SAMPLES:
        raise MotionRefusedError(
            f"lasts {total:.0f} s without repetition; at most {MOST_SAMPLES / APPROACH_RATE:.0f} s can be checked",
            where=where,
            hint="divide it into several motions",
        )
    rate = min(max(rate, 200.0 / total), MOST_SAMPLES / total)
    grids = [
        np.linspace(start, end, int(np.ceil(rate * (end - start))) + 1)
        for start, end in zip(pieces.start, pieces.end, strict=True)
    ]
    return np.unique(np.concatenate(grids))


_HINT = "change the motion, or correct mounting and workspace of the robot file"
