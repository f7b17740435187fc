"""Build the arm's transmission from `model.loops` and `model.coupling` of a robot file, checked against its geometry.

A parallelogram of the joints a, b, c, d (b hangs on a, d on c, all axes parallel) keeps the link behind b parallel to
the one behind c, and the link behind d parallel to the one behind a. With the angles about a common direction, that is

    σ_a q_a + σ_b q_b − σ_c q_c = φ_c − φ_b          σ_c q_c + σ_d q_d − σ_a q_a = φ_a − φ_d

where σ is 1 for an axis along that direction and −1 for one against it, and φ the direction of each side at position
zero: of the side behind a to the origin of b, behind b to the closing frame, and so on. Solved for the two joints
without a motor, and tried at random positions: the closing frames must meet. Loops with `passive` joints have no such
equations; module `build_closed_loops` closes them numerically, together with the linear equations of the others.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache, partial

import numpy as np

from daq.robot.loader import RobotFile
from daq.robot.loops import BASE, ClosingFrame, Loop, coupling_matrix
from daq.robot.schema import MdhRow, Robot
from drivers.core.arrays import FloatArray
from drivers.core.errors import RobotFileError
from ident.linear_algebra.vectors import axis_rotation
from ident.model.kinematics.joints import BASE_INDEX, Joint, Placement, ancestors, composed
from ident.model.kinematics.loop_text import length, loop_name
from ident.model.kinematics.mdh import mdh_placement
from ident.model.kinematics.transmission import LinearTransmission, Transmission, direct_transmission

CLOSING_TOLERANCE = 1e-6
"""Largest distance [m] of the closing frames at any position; files print lengths to this."""

CLOSING_ANGLE = 1e-6
"""How far [rad] their axes may be from parallel."""

TRIED_POSITIONS = 50
PARALLEL = 1e-9
SINGULAR = 1e-9
LOOPS_KEPT = 8
"""Arms with general closed loops that are remembered: to follow loops everywhere takes up to a second, and one command
builds the model of its arm several times."""


def build_transmission(robot_file: RobotFile, joints: tuple[Joint, ...]) -> Transmission:
    """The transmission of an arm.

    Raises:
        RobotFileError: the loops do not determine the joints without a motor, or do not close (with the error).
    """
    robot = robot_file.robot
    if not robot.model.loops and not robot.model.coupling:
        return direct_transmission(len(joints))
    where = f"{robot_file.where}: model.loops"
    joint_index = {joint.name: index for index, joint in enumerate(joints)}
    active = tuple(joint_index[name] for name in robot.joint_names)
    equations, right = _linear_equations(robot.model.loops, joints, joint_index, where)
    general = [loop for loop in robot.model.loops if loop.passive is not None]
    if general:
        from ident.model.kinematics.linkages.build import (
            build_closed_loops,  # only arms that have such loops pay for it
        )

        nothing = np.zeros((len(joints), len(active))), np.zeros(len(joints))
        ends = [loop_ends(loop, joint_index) for loop in general]
        build = partial(
            build_closed_loops,
            robot,
            joints,
            (equations, right),
            [(end, other) for end, other in ends],
            _linear(robot, active, *nothing),
            where,
        )
        said = repr((robot.model, robot.joints, robot.drives, robot.friction, robot_file.urdf_text, where))
        transmission: Transmission = _closed_loops(_Said(said, build))
    else:
        transmission = _linear(robot, active, *_solved_equations(equations, right, joints, active, where))
    low, high = (np.array(limit) for limit in zip(*(limits.position for limits in robot.joints), strict=True))
    positions = np.random.default_rng(0).uniform(low[:, None], high[:, None], (len(active), TRIED_POSITIONS))
    for loop in robot.model.loops:
        if loop.closing is not None:
            _check_closed(loop, joints, joint_index, transmission.tree_position(positions), where)
    return transmission


@dataclass(frozen=True)
class _Said:
    """What a robot file says of closed loops, equal where the words are; and what builds them."""

    words: str
    build: Callable[[], Transmission] = field(compare=False)


@lru_cache(maxsize=LOOPS_KEPT)
def _closed_loops(said: _Said) -> Transmission:
    return said.build()


def _linear(robot: Robot, active: tuple[int, ...], follow: FloatArray, offset: FloatArray) -> LinearTransmission:
    """Motors and pairs as the robot file says, with this G (n, a) and b (n,)."""
    coupling = coupling_matrix(robot.model.coupling, robot.joint_names)
    coupled = np.count_nonzero(coupling, axis=1) > 1
    exceptions = [robot.friction.joints.get(name) for name in robot.joint_names]
    return LinearTransmission(
        active=active,
        follow=follow,
        offset=offset,
        coupling=coupling,
        pair_friction=tuple(
            bool(several) and (exception is None or exception.pair is not False)
            for several, exception in zip(coupled, exceptions, strict=True)
        ),
        pair_inertia=tuple(robot.drive(name).pair_inertia for name in robot.joint_names),
    )


def _linear_equations(
    loops: tuple[Loop, ...], joints: tuple[Joint, ...], joint_index: dict[str, int], where: str
) -> tuple[FloatArray, FloatArray]:
    """E (l, n) and e (l,) of the equations and parallelograms, E·q_tree = e."""
    rows, right = [], []
    for loop in loops:
        if loop.joint is not None:
            row = np.zeros(len(joints))
            row[joint_index[loop.joint]] = 1.0
            for name, factor in (loop.equation or {}).items():
                row[joint_index[name]] -= factor
            rows.append(row)
            right.append(loop.offset)
        elif loop.parallelogram is not None:
            for row, value in _parallelogram_equations(loop, joints, joint_index, where):
                rows.append(row)
                right.append(value)
    return np.array(rows).reshape(-1, len(joints)), np.array(right)


def _solved_equations(
    equations: FloatArray, right: FloatArray, joints: tuple[Joint, ...], active: tuple[int, ...], where: str
) -> tuple[FloatArray, FloatArray]:
    """G (n, a) and b (n,) from all equations E·q_tree = e, solved for the joints without a motor."""
    passive = [index for index in range(len(joints)) if index not in active]
    follow, offset = np.zeros((len(joints), len(active))), np.zeros(len(joints))
    follow[list(active), range(len(active))] = 1.0
    if not passive:
        return follow, offset
    of_passive = equations[:, passive]
    if np.linalg.svd(of_passive, compute_uv=False)[-1] < SINGULAR:
        names = ", ".join(joints[index].name for index in passive)
        raise RobotFileError(f"the equations do not determine the positions of {names}", where=where)
    solved = np.linalg.solve(of_passive, equations[:, list(active)])
    follow[passive] = _exact(np.asarray(-solved, dtype=np.float64))
    offset[passive] = np.linalg.solve(of_passive, right)
    for index in passive:
        if not joints[index].prismatic:
            offset[index] = _principal(offset[index])
    return follow, offset


def _parallelogram_equations(
    loop: Loop, joints: tuple[Joint, ...], joint_index: dict[str, int], where: str
) -> list[tuple[FloatArray, float]]:
    """Two rows of E (n,) and e."""
    if loop.parallelogram is None:
        raise ValueError("the loop is not a parallelogram")
    names = loop.parallelogram
    text = f"parallelogram {', '.join(names)}"
    a, b, c, d = (joint_index[name] for name in names)
    if joints[b].parent != a or joints[d].parent != c or joints[a].parent != joints[c].parent:
        raise RobotFileError(
            f"{text}: the second joint must hang on the first, the fourth on the third, and the first and the third on "
            "the same link",
            where=where,
        )
    if any(joints[index].prismatic for index in (a, b, c, d)):
        raise RobotFileError(f"{text}: all four joints must be revolute", where=where)
    ends = loop_ends(loop, joint_index)
    if {index for index, _ in ends} != {b, d}:
        raise RobotFileError(
            f"{text}: one closing frame must have the antecedent {names[1]}, the other {names[3]}", where=where
        )
    closing_points = dict(ends)
    frames = place_tree(joints, np.zeros(len(joints)))
    axis = frames[a][0] @ joints[a].axis
    signs = {}
    for index in (a, b, c, d):
        along = float(axis @ frames[index][0] @ joints[index].axis)
        if abs(abs(along) - 1.0) > PARALLEL:
            raise RobotFileError(f"{text}: the axis of {joints[index].name} is not parallel to the first", where=where)
        signs[index] = math.copysign(1.0, along)
    origin = {index: frames[index][1] for index in (a, b, c, d)}
    tip = {index: composed(frames[index], closing_points[index])[1] for index in (b, d)}
    sides = {a: origin[b] - origin[a], b: tip[b] - origin[b], c: origin[d] - origin[c], d: tip[d] - origin[d]}
    first = np.linalg.svd(axis[None, :])[2][1]
    second = np.cross(axis, first)
    angle = {}
    for index, side in sides.items():
        x, y = float(first @ side), float(second @ side)
        if math.hypot(x, y) < CLOSING_TOLERANCE:
            raise RobotFileError(f"{text}: the side behind {joints[index].name} has no length", where=where)
        angle[index] = math.atan2(y, x)
    equations = []
    for near, far, opposite in ((a, b, c), (c, d, a)):
        row = np.zeros(len(joints))
        row[near], row[far], row[opposite] = signs[near], signs[far], -signs[opposite]
        equations.append((row, angle[opposite] - angle[far]))
    return equations


def loop_ends(loop: Loop, joint_index: dict[str, int]) -> list[tuple[int, Placement]]:
    """The closing frames: index of the joint behind which each is fixed, and its placement in that joint's frame."""
    index_of = {**joint_index, BASE: BASE_INDEX}
    return [(index_of[frame.antecedent], _placement(frame)) for frame in loop.closing or ()]


def _check_closed(
    loop: Loop, joints: tuple[Joint, ...], joint_index: dict[str, int], positions: FloatArray, where: str
) -> None:
    """Refuse a loop whose closing frames do not meet at tree positions (n, N)."""
    name = loop_name(loop)
    apart = turned = 0.0
    for position in positions.T:
        frames = [*place_tree(joints, position), (np.eye(3), np.zeros(3))]  # the base's is number BASE_INDEX
        (first, second) = (composed(frames[index], placement) for index, placement in loop_ends(loop, joint_index))
        apart = max(apart, float(np.linalg.norm(first[1] - second[1])))
        turned = max(turned, float(np.linalg.norm(np.cross(first[0][:, 2], second[0][:, 2]))))
    if apart > CLOSING_TOLERANCE:
        raise RobotFileError(
            f"{name} does not close: its closing frames are up to {length(apart)} apart",
            where=where,
            hint="opposite sides must be equally long: check the lengths in 'model.mdh' and in 'closing'",
        )
    if turned > CLOSING_ANGLE and loop.opened != "spherical":
        raise RobotFileError(
            f"{name} does not close: its closing frames' axes are up to {math.degrees(turned):.3g}° from parallel",
            where=where,
            hint="check the angles in 'closing'",
        )


def place_tree(joints: tuple[Joint, ...], position: FloatArray) -> list[Placement]:
    """Placement in the base frame of every joint's frame at tree positions (n,) [rad or m]."""
    frames: list[Placement] = []
    for joint, value in zip(joints, position, strict=True):
        if joint.prismatic:
            own = (joint.rotation, joint.translation + joint.rotation @ joint.axis * value)
        else:
            own = (joint.rotation @ axis_rotation(joint.axis, value), joint.translation)
        frames.append(own if joint.parent == BASE_INDEX else composed(frames[joint.parent], own))
    return frames


def main_chain(joints: tuple[Joint, ...], active: tuple[int, ...]) -> tuple[int, ...]:
    """Indices of the joints from the base to the link that is the most joints away: the arm without its rods.

    Of several such links it is the first one behind an `active` joint, else the first.
    """
    chains = [(*ancestors(joints, index), index) for index in range(len(joints))]
    return max(chains, key=lambda chain: (len(chain), chain[-1] in active))


def _placement(frame: ClosingFrame) -> Placement:
    return mdh_placement(MdhRow(joint="closing", **frame.model_dump()))


def _principal(angle: float) -> float:
    """The same angle in (−π, π]."""
    return math.pi - (math.pi - angle) % (2.0 * math.pi)


def _exact(matrix: FloatArray) -> FloatArray:
    """Integers without the rounding of the solution."""
    nearest = np.round(matrix)
    return np.where(np.abs(matrix - nearest) < 1e-12, nearest, matrix)
