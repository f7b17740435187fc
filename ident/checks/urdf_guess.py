"""What a URDF lets guess of an arm: bodies, poses, and friction and motors of arms of this strength."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from daq.robot.loader import RobotFile
from daq.robot.new_robot import ArmGuess, JointTruth
from daq.robot.schema import TruthLink
from drivers.core.arrays import FloatArray
from drivers.core.errors import RobotFileError
from ident.estimators.feasible.prior import LinkPriors, link_priors, uniform_ball
from ident.estimators.feasible.pseudo_inertia import body_of
from ident.excite.motion_check import ArmMotionCheck
from ident.model.dynamic_model import DynamicModel, build_model
from ident.model.dynamics.rigid_arm import RigidArm, rigid_arm
from ident.model.kinematics.urdf import urdf_inertias

POSES = 300
"""Random poses that are looked at."""

VISCOUS, COULOMB, MOTOR_INERTIA, NOISE = 0.02, 0.06, 0.0094, 0.007
"""Per torque limit: viscous friction [s/rad], Coulomb friction, motor inertia [s²/rad], torque noise.

Those of the built-in UR5e: 3.0 to 4.0 N·m·s/rad, 7.8 to 9.3 N·m, 1.41 kg·m² and 1.05 N·m at 150 N·m.
"""

NEEDED, MOST_NEEDED = 2.0, 3.0
"""A joint's strength where its torque limit is unknown, and at most, over the largest torque that the arm needs."""

AT_ONCE, MOST_TRIED = 8, 64
"""Poses whose clearance is asked for together, and in all: meshes take 20 ms a pose."""

REFINEMENTS, STEPS = (0.5, 0.3, 0.2, 0.1, 0.05, 0.02, 0.01), 60
"""Widths [rad or m] of the random steps, one after the other, and their number, from a pose that gravity loads less."""

TORQUE_FREE = 0.02
"""Share of a joint's torque below which gravity does not count."""


def guess_of_urdf(robot_file: RobotFile, *, limited: bool) -> ArmGuess:
    """Bodies, friction and poses of an arm that is described by a URDF; no poses where the limits are not the arm's.

    Raises:
        RobotFileError: the URDF and the file's joints do not fit together.
    """
    model = build_model(robot_file)
    bodies, origins = _bodies(model, robot_file)
    arm = rigid_arm(model, bodies.ravel(), np.zeros(model.dof))
    positions = _candidates(model)
    joints = dict(zip(model.joint_names, _joints(model, arm, positions), strict=True))
    links = {
        name: (truth_link(body), origin) for name, body, origin in zip(model.link_names, bodies, origins, strict=True)
    }
    if not limited:
        return ArmGuess(links, joints)
    check, free = _motion_check(robot_file)
    strength = np.array([joint.noise for joint in joints.values()]) / NOISE
    return ArmGuess(links, joints, dict(_poses(model, arm, check, positions, strength)), free)


def _bodies(model: DynamicModel, robot_file: RobotFile) -> tuple[FloatArray, list[str]]:
    """Standard parameters (k, 10) of the links, each of a body that can exist, and where each is from, in words."""
    priors: LinkPriors = link_priors(model, robot_file, np.zeros((0, len(model.parameters))), np.zeros(0))
    read = urdf_inertias(robot_file, model.link_names)
    bodies, origins = priors.links.copy(), []
    for index, (source, stated) in enumerate(zip(priors.sources, read, strict=True)):
        if source == "urdf":
            origins.append("the URDF's")
        elif stated is None:
            origins.append("assumed: the URDF states no mass")
        else:
            bodies[index] = uniform_ball(stated[0], stated[1])
            origins.append("the URDF's mass and centre; its inertia is impossible, that of a ball is assumed")
    return bodies, origins


def truth_link(body: FloatArray) -> TruthLink:
    """The link of a truth that ten standard parameters (10,) with a positive mass describe."""
    of_link = body_of(body)
    x, y, z = of_link.com
    xx, xy, xz, yy, yz, zz = of_link.inertia.values()
    return TruthLink(mass=of_link.mass, com=(x, y, z), inertia=(xx, xy, xz, yy, yz, zz))


def _candidates(model: DynamicModel) -> FloatArray:
    """Positions (n, N) within the limits: zero where it is, mid-range, and random ones in their inner 80 %."""
    low, high = np.array([limits.position for limits in model.limits]).T
    middle, half = 0.5 * (low + high), 0.4 * np.minimum(high - low, 2 * np.pi)
    random = np.random.default_rng(0).uniform(-1.0, 1.0, (model.dof, POSES))
    return np.column_stack([np.clip(0.0, low, high), middle, middle[:, None] + half[:, None] * random])


def _joints(model: DynamicModel, arm: RigidArm, positions: FloatArray) -> Iterator[JointTruth]:
    """Friction and motor of joints that are strong enough for gravity and an acceleration within the limits."""
    still, signs = np.zeros(model.dof), np.random.default_rng(1).choice([-1.0, 1.0], positions.shape)
    acceleration = np.array([limits.acceleration for limits in model.limits])
    needed = np.max(
        [
            np.abs(arm.inverse(candidate, still, sign * acceleration))
            for candidate, sign in zip(positions.T, signs.T, strict=True)
        ],
        axis=0,
    )
    gravity = np.max([np.abs(arm.gravity(position)) for position in positions.T], axis=0)
    for limits, most, weight in zip(model.limits, needed, gravity, strict=True):
        stated = limits.torque if limits.torque is not None and limits.torque >= weight else NEEDED * most
        strength = max(min(stated, MOST_NEEDED * most), 1e-6)
        yield JointTruth(
            VISCOUS * strength, COULOMB * strength, MOTOR_INERTIA * strength, NOISE * strength, float(weight)
        )


def _motion_check(robot_file: RobotFile) -> tuple[ArmMotionCheck, bool]:
    """Return what judges poses, and whether no mounting surface can be assumed."""
    try:
        return ArmMotionCheck(robot_file), False
    except RobotFileError:
        model = robot_file.robot.model.model_copy(update={"mounting": "free"})
        robot = robot_file.robot.model_copy(update={"model": model})
        return ArmMotionCheck(robot_file.model_copy(update={"robot": robot})), True


def _poses(
    model: DynamicModel, arm: RigidArm, check: ArmMotionCheck, positions: FloatArray, strength: FloatArray
) -> Iterator[tuple[str, tuple[Sequence[float], str]]]:
    """Home, where it can be reached, a start, and a pose with little gravity torque where neither of these is one."""
    low, high = np.array([limits.position for limits in model.limits]).T

    def rounded(position: FloatArray) -> tuple[float, ...]:
        return tuple((np.clip(np.round(position, 3), low, high) + 0.0).tolist())

    def first_clear(candidates: FloatArray) -> FloatArray | None:
        for first in range(0, min(candidates.shape[1], MOST_TRIED), AT_ONCE):
            some = candidates[:, first : first + AT_ONCE]
            clear = np.flatnonzero(check.clear(some))
            if clear.size:
                return np.asarray(some[:, clear[0]])
        return None

    def load(candidates: FloatArray) -> FloatArray:
        """The largest share (N,) of a joint's strength that holds the arm."""
        return np.array([np.max(np.abs(arm.gravity(candidate)) / strength) for candidate in candidates.T])

    zero, middle = positions[:, [0]], positions[:, [1]]
    if first_clear(zero) is not None:
        words = "as near to 0 as the limits allow" if zero.any() else "every joint at 0"
        yield "home", (rounded(zero[:, 0]), f"{words}; compare it with the pendant")
    nearest = np.linalg.norm((positions - middle) / (high - low)[:, None], axis=0).argsort()
    start = first_clear(positions[:, nearest])
    words = "mid-range; not clear of the floor or of itself" if start is None else "clear of floor and itself"
    start = middle[:, 0] if start is None else start
    yield "start", (rounded(start), words)

    if min(load(np.column_stack([zero[:, 0], start]))) < TORQUE_FREE:
        return
    random, tried = np.random.default_rng(2), []
    for best in positions[:, load(positions).argsort()[:AT_ONCE]].T:
        for width in REFINEMENTS:
            steps = width * random.standard_normal((model.dof, STEPS))
            near = np.column_stack([best, np.clip(best[:, None] + steps, low[:, None], high[:, None])])
            best = near[:, load(near).argmin()]
        tried.append(best)
    refined = np.array(tried).T
    unloaded = first_clear(refined[:, load(refined).argsort()])
    if unloaded is not None:
        share = float(load(unloaded[:, None])[0])
        words = "gravity loads no joint" if share < TORQUE_FREE else "gravity loads the joints little"
        yield "unloaded", (rounded(unloaded), f"{words}, {100.0 * share:.2g} % of a joint's torque at most")
