"""Poses in which an arm may rest and begin to move: those that every limit leaves room around."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError
from drivers.core.text import percent_text
from ident.excite.constraints.soft_maximum import soft_maximum
from ident.excite.families.moving_joints import MovingJoints
from ident.excite.path import JointPath
from ident.excite.search.problem import DesignProblem

POSES = 8
"""Descents that end without a feasible pose before a design is refused."""
_DRAWS = 15
"""Random poses that a descent's start is chosen from."""
_SHARPNESS = 20.0
_ITERATIONS = 15
_CREEP = 1e-6
"""Share of the velocity limits, of 1 rad/s at most: an arm that begins to move has all of its Coulomb friction."""


class NoFeasiblePoseError(UsageError):
    """None of the candidate poses keeps all limits."""


@dataclass(frozen=True)
class CandidatePose:
    """A pose and what it uses of the limits."""

    position: FloatArray  # (moving joints,) [rad or m]
    use: FloatArray  # (limits,) at rest and at the beginning of a motion either way


def pose_path(joints: MovingJoints, position: FloatArray) -> JointPath:
    """A pose (moving joints,) at rest, and moving both ways very slowly."""
    still = np.zeros((joints.count, 3))
    velocity = _CREEP * np.minimum(joints.velocity, 1.0)[:, None] * np.array([0.0, 1.0, -1.0])
    return joints.path(np.arange(3.0), still + position[:, None], velocity, still)


def feasible_pose(
    problem: DesignProblem, first: FloatArray, seed: Sequence[int], tick: Callable[[], None] = lambda: None
) -> CandidatePose:
    """A pose with margin to all limits: the first descent of the largest utilisation that ends at a feasible one.

    The first descent begins at `first` [rad or m], the others at random. What `tick` raises ends all.

    Raises:
        NoFeasiblePoseError: there is none; names the limit that excludes all candidates, if one does.
    """
    joints = problem.family.joints
    generator = np.random.default_rng([*seed, 1])
    tried = _Tried(problem, tick)
    begin = first
    for _ in range(POSES):
        pose = _descent(problem, joints, begin, tried)
        if float(pose.use.max(initial=0.0)) <= problem.allowed:
            return pose
        draws = joints.middle + joints.half * generator.uniform(-1.0, 1.0, (_DRAWS, joints.count))
        begin = min((tried.pose(joints, draw) for draw in draws), key=lambda pose: float(pose.use.max())).position
    raise NoFeasiblePoseError(
        tried.conclusion, hint="check the joint limits, 'workspace' and the tool of the robot file, or give --joints"
    )


class _Tried:
    """The candidate poses, and the least utilisation of each limit among them."""

    def __init__(self, problem: DesignProblem, tick: Callable[[], None]) -> None:
        self._problem = problem
        self._tick = tick
        self._count = 0
        self._least = np.full(len(problem.limits), np.inf)
        self._best: FloatArray | None = None

    def pose(self, joints: MovingJoints, position: FloatArray) -> CandidatePose:
        """Evaluate a pose (moving joints,)."""
        self._tick()
        use = self._problem.use_along(pose_path(joints, position))
        self._count += 1
        self._least = np.fmin(self._least, use)
        if self._best is None or use.max(initial=0.0) < self._best.max(initial=0.0):
            self._best = use
        return CandidatePose(position, use)

    @property
    def conclusion(self) -> str:
        """Return which limit excludes them, in one line."""
        names, allowed = self._problem.limits, percent_text(self._problem.allowed)
        worst = int(np.argmax(self._least))
        if self._least[worst] > self._problem.allowed:
            return (
                f"no feasible motion: each of {self._count} poses tried uses at least "
                f"{percent_text(float(self._least[worst]), 4)} of the {names[worst]}, the margin allows {allowed}"
            )
        assert self._best is not None
        worst = int(np.argmax(self._best))
        return (
            f"no feasible motion: none of {self._count} poses tried keeps all limits at once; the best uses "
            f"{percent_text(float(self._best[worst]), 4)} of the {names[worst]}, the margin allows {allowed}"
        )


def _descent(problem: DesignProblem, joints: MovingJoints, begin: FloatArray, tried: _Tried) -> CandidatePose:
    """The pose of the smallest largest utilisation that a local search reaches."""
    best = tried.pose(joints, begin)

    def smooth(scaled: FloatArray) -> tuple[float, FloatArray]:
        nonlocal best
        position = joints.middle + joints.half * scaled
        pose = tried.pose(joints, position)
        if pose.use.max(initial=0.0) < best.use.max(initial=0.0):
            best = pose
        path = pose_path(joints, position)
        uses = [constraint.smooth_use(path, _SHARPNESS) for constraint in problem.constraints]
        values = np.concatenate([value for value, _ in uses])
        rows = np.concatenate([gradient[:, 0, joints.rows].sum(axis=-1) for _, gradient in uses])
        bound, shares = soft_maximum(values, _SHARPNESS)
        return float(bound), np.asarray((shares @ rows) * joints.half)

    if problem.limits:
        minimize(
            smooth,
            (begin - joints.middle) / joints.half,
            jac=True,
            method="L-BFGS-B",
            options={"maxiter": _ITERATIONS, "maxfun": 2 * _ITERATIONS},
        )
    return best
