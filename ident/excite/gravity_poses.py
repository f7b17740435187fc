"""A motion for gravity: poses, each passed slowly upwards and downwards by all joints, chosen to tell the parameters.

At equal positions and opposite velocities friction of either kind has opposite signs, so that the mean of both passes
is the gravity torque and the motor's offset, and half their difference is the friction. A quintic stroke forth and back
also has equal accelerations at equal positions, and of opposite sign on both sides of its middle: inertia drops out of
the mean over the stroke. Coriolis torques do not; the joints' directions differ at random from pose to pose, so that
those of pairs of joints have a mean of 0.

The poses maximise the determinant of the information matrix of the gravity parameters (D-optimal), which by the
equivalence theorem of Kiefer and Wolfowitz (1960) also keeps the largest variance of the predicted torque small. The
search is Fedorov's exchange among random poses in which the arm is clear of everything.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from daq.motion.motion_check import MotionFigures
from daq.motion.trajectories import QUINTIC_ACCELERATION, QUINTIC_VELOCITY, PointToPoint
from daq.robot.loader import RobotFile
from drivers.core.arrays import FloatArray
from drivers.core.errors import MotionRefusedError, UsageError
from drivers.core.text import did_you_mean
from ident.excite.choices import FEWEST_POSES, GravityChoices
from ident.excite.families.moving_joints import ONE_TURN, middle_of_range
from ident.excite.motion_check import ArmMotionCheck
from ident.excite.prior import PriorKnowledge
from ident.model.base_parameters import gravity_base, gravity_columns, gravity_rows, resting_model

STROKE, SLIDE = 0.2, 0.05
"""Length of a pass [rad, m]: a few periods of a gear's ripple, and gravity is nearly constant along it."""

RANGE_SHARE = 0.2
"""… at most this share of the joint's range."""

SLOW, SLOW_SLIDE = 0.1, 0.03
"""Peak velocity of a pass [rad/s, m/s]: above the stick-slip of most arms. Coriolis torques, which are the same in both
directions, grow with its square."""

TRAVEL_SHARE = 0.4
"""Share of the velocity and acceleration limits on the way from pose to pose."""

DWELL = 0.3
"""Rest between two moves [s]."""

CANDIDATES = 400
_TRIES = 5
"""Batches of so many random poses that are drawn before an arm counts as having no room."""
_LINE = 60
"""Samples of a way from pose to pose when it is searched; the whole motion is checked at 1 kHz."""
_VIA = 12
"""Candidates that a detour is tried through."""
_EXCHANGES = 6
_RIDGE = 1e-9


@dataclass(frozen=True, eq=False)
class GravityMotion:
    """The motion, and what it is expected to tell."""

    motion: PointToPoint  # from the first pose to the first pose
    poses: FloatArray  # (K, n) in the order of the motion; the first is visited again at the end [rad or m]
    half_stroke: FloatArray  # (n,) distance from a pose to the ends of its passes [rad or m]
    pass_time: float  # [s] of one pass
    # (n,) expected σ of each joint's gravity torque, root mean square over poses of the arm [N·m or N]
    sigma: FloatArray
    undetermined: tuple[str, ...]  # parameters that none of the poses tells
    silent: tuple[str, ...]  # names of the joints that gravity does not act on
    dropped: int  # number of chosen poses that no free way leads to
    figures: MotionFigures  # of the check that every motion passes before it is played


def gravity_motion(
    robot_file: RobotFile, check: ArmMotionCheck, prior: PriorKnowledge, choices: GravityChoices
) -> GravityMotion:
    """Design the motion.

    Raises:
        UsageError: no such joint, or no pose with room around it keeps clear of everything.
        MotionRefusedError: no free way leads from pose to pose.
    """
    model = resting_model(robot_file)
    base = gravity_base(model)
    moving = _moving(robot_file, choices)
    half, pass_time = _strokes(robot_file, moving)
    candidates, toward = _candidates(robot_file, check, choices, moving, half)
    rows = gravity_rows(model, base, candidates)
    deviation = prior.noise / np.sqrt(_independent_values(prior.rate, pass_time))
    weighted = rows[:, moving] / deviation[moving][:, None]
    scale = np.sqrt(np.mean(weighted**2, axis=(0, 1)))
    weighed = np.flatnonzero(scale > 0.0)
    chosen = _d_optimal(weighted[:, :, weighed] / scale[weighed], min(choices.poses, len(candidates)))
    route, via, dropped = _route(check, candidates, chosen, toward)
    motion = _motion(robot_file, candidates, route, via, toward, pass_time)
    figures = check.trajectory(motion, "the motion for gravity")
    seen = weighted[route][:, :, weighed].reshape(-1, len(weighed)) / scale[weighed]
    covariance, lost = _covariance(seen)
    predicted = rows[:, :, weighed] / scale[weighed]
    sigma = np.sqrt(np.mean(np.einsum("knb,bc,knc->kn", predicted, covariance, predicted), axis=0))
    names = [base.names[index] for index in weighed[lost]]
    silent_columns = gravity_columns(base)
    silent = [
        name
        for joint, name in enumerate(model.joint_names)
        if not np.any(np.abs(rows[:, joint, silent_columns]) > _RIDGE)
    ]
    return GravityMotion(
        motion=motion,
        poses=candidates[route],
        half_stroke=half,
        pass_time=pass_time,
        sigma=sigma,
        undetermined=(*(base.names[index] for index in range(base.count) if index not in weighed), *names),
        silent=tuple(silent),
        dropped=dropped,
        figures=figures,
    )


def _moving(robot_file: RobotFile, choices: GravityChoices) -> list[int]:
    names = robot_file.robot.joint_names
    for name in choices.joints or ():
        if name not in names:
            raise UsageError(
                f"no joint of {robot_file.robot.name} is called '{name}'",
                where="--joints",
                hint=did_you_mean(name, names),
            )
    if choices.joints is not None and not len(choices.joints):
        raise UsageError("no joint moves", hint="name at least one with --joints, or leave it out for all")
    return [index for index, name in enumerate(names) if choices.joints is None or name in choices.joints]


def _strokes(robot_file: RobotFile, moving: Sequence[int]) -> tuple[FloatArray, float]:
    """Half of each joint's pass (n,), 0 of one that rests, and the time of a pass [s]."""
    robot = robot_file.robot
    half, times = np.zeros(robot.dof), []
    for index in moving:
        limits, slides = robot.joints[index], robot.sliding[index]
        low, high = limits.position
        length = min(SLIDE if slides else STROKE, RANGE_SHARE * (high - low))
        half[index] = 0.5 * length
        peak = min(SLOW_SLIDE if slides else SLOW, TRAVEL_SHARE * limits.velocity)
        times += [
            QUINTIC_VELOCITY * length / peak,
            float(np.sqrt(QUINTIC_ACCELERATION * length / (TRAVEL_SHARE * limits.acceleration))),
        ]
    return half, max(times)


def _independent_values(rate: float, pass_time: float) -> float:
    """Independent values in the mean of two passes: half of their samples lie under the window's weight."""
    return max(1.0, rate * pass_time)


def _candidates(
    robot_file: RobotFile, check: ArmMotionCheck, choices: GravityChoices, moving: Sequence[int], half: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Poses (K, n) that keep the limits and clear of everything along both passes, and half a pass at each (K, n).

    Raises:
        UsageError: there are too few.
    """
    joints = robot_file.robot.joints
    generator = np.random.default_rng(choices.seed)
    middle = np.array([middle_of_range(*joint.position) for joint in joints])
    room = np.zeros(len(joints))
    for index in moving:
        low, high = joints[index].position
        room[index] = 0.5 * min((1.0 - choices.margin) * (high - low), ONE_TURN) - half[index]
    kept: list[FloatArray] = []
    ways: list[FloatArray] = []
    for _ in range(_TRIES):
        poses = middle + generator.uniform(-1.0, 1.0, (CANDIDATES, len(joints))) * room
        toward = generator.choice([-1.0, 1.0], poses.shape) * half
        along = poses[:, None] + np.linspace(-1.0, 1.0, 5)[:, None] * toward[:, None]
        clear = check.clear(along.reshape(-1, len(joints)).T).reshape(CANDIDATES, -1)
        kept.append(poses[clear.all(axis=1)])
        ways.append(toward[clear.all(axis=1)])
        if sum(map(len, kept)) >= CANDIDATES // 2:
            break
    candidates = np.concatenate(kept)[:CANDIDATES]
    if len(candidates) < FEWEST_POSES:
        raise UsageError(
            f"only {len(candidates)} of {_TRIES * CANDIDATES} random poses are clear of floor, obstacles and the arm "
            "itself",
            where=robot_file.robot.name,
            hint="correct 'workspace' and the joint limits of the robot file, or give --joints",
        )
    return candidates, np.concatenate(ways)[:CANDIDATES]


def _d_optimal(rows: FloatArray, count: int) -> list[int]:
    """Indices of `count` of the poses whose rows (K, m, b) have the largest information: greedy, then exchanges."""
    size = rows.shape[2]
    information = _RIDGE * np.eye(size)
    chosen: list[int] = []

    def gains(matrix: FloatArray) -> FloatArray:
        """Logarithm (K,) of the factor by which each pose multiplies the determinant."""
        inner = rows @ np.linalg.solve(matrix, np.swapaxes(rows, 1, 2).reshape(len(rows), size, -1))
        return np.asarray(np.linalg.slogdet(np.eye(rows.shape[1]) + inner)[1])

    for _ in range(count):
        gain = gains(information)
        gain[chosen] = -np.inf
        chosen.append(int(gain.argmax()))
        information = information + rows[chosen[-1]].T @ rows[chosen[-1]]
    for _ in range(_EXCHANGES):
        changed = False
        for place, old in enumerate(chosen):
            without = information - rows[old].T @ rows[old]
            gain = gains(without)
            others = [pose for pose in chosen if pose != old]
            gain[others] = -np.inf
            new = int(gain.argmax())
            if gain[new] > gain[old] + 1e-6:
                chosen[place], changed = new, True
                information = without + rows[new].T @ rows[new]
        if not changed:
            break
    return chosen


def _route(
    check: ArmMotionCheck, candidates: FloatArray, chosen: Sequence[int], toward: FloatArray
) -> tuple[list[int], list[list[int]], int]:
    """The chosen poses in an order of short, free ways, what each is reached through, and how many have no free way.

    The last way is the one back to the first pose.
    """
    remaining, route, via = list(chosen[1:]), [chosen[0]], [list[int]()]
    while remaining:
        here = route[-1]
        far = np.abs(candidates[remaining] - candidates[here]).max(axis=1)
        for place in np.argsort(far):
            through = _free_way(check, candidates, here, remaining[place], toward, detour=False)
            if through is not None:
                break
        else:
            place = int(np.argmin(far))
            through = _free_way(check, candidates, here, remaining[place], toward, detour=True)
        pose = remaining.pop(int(place))
        if through is not None:
            route.append(pose)
            via.append(through)
    while len(route) > 1:
        back = _free_way(check, candidates, route[-1], route[0], toward, detour=True)
        if back is not None:
            via[0] = back
            break
        route.pop()
        via.pop()
    if len(route) < min(FEWEST_POSES, len(chosen)):
        raise MotionRefusedError(
            f"free paths lead to only {len(route)} of {len(chosen)} poses",
            hint="correct 'workspace' of the robot file, or give another --seed",
        )
    return route, via, len(chosen) - len(route)


def _free_way(
    check: ArmMotionCheck, candidates: FloatArray, begin: int, end: int, toward: FloatArray, *, detour: bool
) -> list[int] | None:
    """Candidates that a free way leads through; none where the straight one is free; None where there is no way."""
    share = np.linspace(0.0, 1.0, _LINE)[:, None]

    def free(pose: int, other: int) -> bool:
        line = candidates[pose] + share * (candidates[other] - candidates[pose])
        beside = [line + side for half in (toward[pose], toward[other]) for side in (-half, half)]
        return bool(np.all(check.clear(np.concatenate(beside).T)))

    if free(begin, end):
        return []
    if not detour:
        return None
    length = np.abs(candidates - candidates[begin]).max(axis=1) + np.abs(candidates - candidates[end]).max(axis=1)
    for pose in np.argsort(length)[: _VIA + 2]:
        if pose not in (begin, end) and free(begin, int(pose)) and free(int(pose), end):
            return [int(pose)]
    return None


def _motion(
    robot_file: RobotFile,
    candidates: FloatArray,
    route: Sequence[int],
    via: Sequence[Sequence[int]],
    toward: FloatArray,
    pass_time: float,
) -> PointToPoint:
    """Every pose forth and back, every second one from above, so that slow changes do not have one direction."""
    velocity = TRAVEL_SHARE * np.array([joint.velocity for joint in robot_file.robot.joints])
    acceleration = TRAVEL_SHARE * np.array([joint.acceleration for joint in robot_file.robot.joints])
    points: list[FloatArray] = []
    durations: list[float] = []

    def go(point: FloatArray) -> None:
        if points:
            way = np.abs(point - points[-1])
            durations.append(
                float(
                    max(
                        np.max(QUINTIC_VELOCITY * way / velocity),
                        np.sqrt(np.max(QUINTIC_ACCELERATION * way / acceleration)),
                    )
                )
            )
        points.append(point)

    for place, pose in enumerate([*route, route[0]]):
        for through in via[place % len(route)] if place else ():
            go(candidates[through])
        near = toward[pose] if place % 2 else -toward[pose]
        go(candidates[pose] + near)
        for side in (-near, near):
            points.append(candidates[pose] + side)
            durations.append(pass_time)
    return PointToPoint(np.array(points), np.array(durations), DWELL)


def _covariance(rows: FloatArray) -> tuple[FloatArray, list[int]]:
    """Covariance (b, b) of the parameters of rows of unit noise (m, b), and the columns that they do not tell."""
    _, singular, axes = np.linalg.svd(rows, full_matrices=False)
    kept = singular > 1e-6 * singular[0]
    covariance = (axes[kept].T / singular[kept] ** 2) @ axes[kept]
    lost = (
        np.flatnonzero(np.linalg.norm(axes[kept], axis=0) < 1.0 - 1e-6) if len(singular) else np.arange(rows.shape[1])
    )
    return np.asarray(covariance), [int(index) for index in lost]
