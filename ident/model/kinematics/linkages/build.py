"""Build `ClosedLoops` from the general loops of a robot file: start, branch, and checks within the position limits.

The start that the file gives is corrected until the loops close. From there the branch is followed to random positions
and corners of the joint limits, and from one to another of them: it must close everywhere, pass no dead point, and come
to the same positions on every way.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product

import numpy as np

from daq.robot.loops import Loop
from daq.robot.schema import Robot
from drivers.core.arrays import FloatArray
from drivers.core.errors import RobotFileError
from drivers.core.text import counted
from drivers.core.units import joint_unit
from ident.model.kinematics.joints import Joint, Placement
from ident.model.kinematics.linkages.closed_loops import ClosedLoops
from ident.model.kinematics.linkages.closing_chain import ClosingChain, closing_chain
from ident.model.kinematics.linkages.loop_equations import LONGEST_WAY, MISSED, LoopEquations
from ident.model.kinematics.loop_text import length, loop_name
from ident.model.kinematics.transmission import LinearTransmission

KNOWN_POSITIONS = 300
"""Random positions within the limits that are tried and remembered."""

MOST_CORNERS = 64
START_STEPS = 200
START_AWAY = 0.5
"""How far [rad or m] a joint may lie from the start that the file gives once the loops close."""

RANK = 1e-8
"""Singular values of the closing equations' derivatives below this share of the largest count as zero."""

DEAD_POINT = 1e-3
"""The smallest singular value of J_p over its largest at which the joints without a motor no longer follow."""

SAME = 1e-6
"""Difference [rad or m] up to which two ways lead to the same position."""

CONSTANT_CHANGE = 1e-9
"""Change of an entry of G over all positions up to which it is constant."""

REASONS = 20
"""Positions that do not close, among which the worst is searched."""


def build_closed_loops(
    robot: Robot,
    joints: tuple[Joint, ...],
    linear: tuple[FloatArray, FloatArray],
    ends: Sequence[tuple[tuple[int, Placement], tuple[int, Placement]]],
    motors: LinearTransmission,
    where: str,
) -> ClosedLoops:
    """The transmission of an arm some of whose loops are given by their closing frames alone.

    Args:
        robot: the arm.
        joints: its tree.
        linear: E (l, n) and e (l,) of the joints that follow by equations.
        ends: the closing frames of every general loop, in the file's order.
        motors: active joints, coupling and the pairs' columns; what follows counts as not known yet.
        where: name of the loops in error messages.

    Raises:
        RobotFileError: the loops do not close, do not fix the joints that follow, or change their branch.
    """
    loops = [loop for loop in robot.model.loops if loop.passive is not None]
    names = tuple(joint.name for joint in joints)
    chains = tuple(
        closing_chain(loop_name(loop), joints, end, spherical=loop.opened == "spherical")
        for loop, end in zip(loops, ends, strict=True)
    )
    for loop, chain in zip(loops, chains, strict=True):
        _check_within(loop, chain, names, where)
    passive = tuple(index for index in range(len(joints)) if index not in motors.active)
    count = sum(chain.rows for chain in chains) + len(linear[1])
    raw = LoopEquations(motors.active, passive, chains, *linear, np.eye(count), 1.0)
    wanted = _wanted_start(robot, loops, names)
    units = [joint_unit("rad", sliding=joint.prismatic) for joint in joints]
    start = _closed_start(raw, wanted, names, units, where)
    equations = _independent(raw, start, names, where)
    _check_travel(robot, equations, start, names, where)
    targets = _targets(robot, equations, motors.active)
    followed = _followed_everywhere(equations, start, targets, names, units, where)
    follow = equations.at(followed).follow()
    whole = np.zeros((len(joints), len(motors.active), followed.shape[1]))
    whole[list(passive)] = follow
    whole[list(motors.active), range(len(motors.active))] = 1.0
    varies = np.ptp(whole, axis=2) > CONSTANT_CHANGE
    constant = whole.mean(axis=2)
    nearest = np.round(constant)
    constant = np.where(np.abs(constant - nearest) < CONSTANT_CHANGE, nearest, constant)
    return ClosedLoops(
        active=motors.active,
        coupling=motors.coupling,
        pair_friction=motors.pair_friction,
        pair_inertia=motors.pair_inertia,
        names=names,
        equations=equations,
        start=start,
        known=followed,
        constant=np.where(varies, 0.0, constant),
        varies=varies,
    )


def _check_within(loop: Loop, chain: ClosingChain, names: tuple[str, ...], where: str) -> None:
    inside = [names[index] for index in chain.joints]
    for name in loop.passive or {}:
        if name not in inside:
            raise RobotFileError(
                f"{chain.name}: joint {name} does not lie between its closing frames, so that closing it does not "
                f"move that joint; between them lie {', '.join(inside) or 'none'}",
                where=where,
            )


def _wanted_start(robot: Robot, loops: Sequence[Loop], names: tuple[str, ...]) -> FloatArray:
    """Tree position (n,) that the file gives; motors in the middle of their limits by default."""
    tree = np.zeros(len(names))
    for limits in robot.joints:
        tree[names.index(limits.name)] = 0.5 * sum(limits.position)
    for loop in loops:
        for name, value in {**(loop.passive or {}), **loop.at}.items():
            tree[names.index(name)] = value
    return tree


def _closed_start(
    equations: LoopEquations, wanted: FloatArray, names: tuple[str, ...], units: Sequence[str], where: str
) -> FloatArray:
    """The tree position (n,) next to `wanted` at which all loops close, motors where they are."""
    passive = list(equations.passive)
    with np.errstate(all="ignore"):  # lengths beyond all numbers
        start = _nearest_closing(equations, wanted)
        missed = _worst(equations, start)
    if missed is not None:
        raise RobotFileError(
            f"{missed} at its start ({_at(equations, start, names)})",
            where=where,
            hint="check the lengths and angles in 'model' and 'closing', 'at', and the start values in 'passive'",
        )
    away = start - wanted
    for index in passive:
        if abs(away[index]) > START_AWAY and any(index in chain.joints for chain in equations.chains):
            raise RobotFileError(
                f"the loop of {names[index]} closes only {abs(away[index]):.3g} {units[index]} away from the start "
                f"that 'passive' gives: at {names[index]} = {start[index]:.4g}, in place of {wanted[index]:.4g} "
                f"({_at(equations, start, names)})",
                where=where,
                hint="give the start of the intended assembly more exactly",
            )
    return start


def _nearest_closing(equations: LoopEquations, wanted: FloatArray) -> FloatArray:
    """Least squares of all closing equations over the passive joints, from `wanted` (n,) (Levenberg-Marquardt)."""
    passive = list(equations.passive)
    tree, damping = wanted.copy(), 1e-3
    residual, jacobian = _all_rows(equations, tree)
    for _ in range(START_STEPS):
        square = jacobian.T @ jacobian
        lift = damping * max(float(np.trace(square)), 1e-12) * np.eye(len(passive))
        step = np.linalg.solve(square + lift, jacobian.T @ residual)
        trial = tree.copy()
        trial[passive] -= step
        trial_residual, derivatives = _all_rows(equations, trial)
        if float(trial_residual @ trial_residual) < float(residual @ residual):
            tree, residual, jacobian, damping = trial, trial_residual, derivatives, 0.2 * damping
        elif np.max(np.abs(step)) < 1e-14 or damping > 1e12:
            break
        else:
            damping = max(5.0 * damping, 1e-12)
        if np.max(np.abs(residual)) < 1e-15:
            break
    return tree


def _all_rows(equations: LoopEquations, tree: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Φ (r,) and its derivatives (r, p) by the passive joints at one tree position (n,)."""
    closing = equations.at(tree[:, None])
    return closing.residual[:, 0], closing.full[:, list(equations.passive), 0]


def _worst(equations: LoopEquations, tree: FloatArray) -> str | None:
    """Return which loop does not close at a tree position (n,), and by how much; None where all do."""
    for chain, state in zip(equations.chains, equations.at(tree[:, None]).states, strict=True):
        apart = float(np.linalg.norm(state.value[0]))
        if not np.isfinite(apart):
            return f"{chain.name} does not close: its closing frames stay too far apart to compute with"
        if apart > MISSED:
            return f"{chain.name} does not close: its closing frames stay {length(apart)} apart"
        turned = 0.0 if chain.spherical else float(np.linalg.norm(state.value[1, :2]))
        if turned > MISSED:
            return (
                f"{chain.name} does not close: its closing frames' axes stay "
                f"{math.degrees(math.asin(min(turned, 1.0))):.3g}° from parallel"
            )
    return None


def _independent(raw: LoopEquations, start: FloatArray, names: tuple[str, ...], where: str) -> LoopEquations:
    """The equations with as many independent rows as joints follow."""
    passive = list(raw.passive)
    following = ", ".join(names[index] for index in passive)
    jacobian = raw.at(start[:, None]).full[..., 0]
    rank = _rank(jacobian)
    elsewhere = start[:, None] + np.random.default_rng(0).uniform(-1.0, 1.0, (len(start), 1))
    if rank > len(passive) or _rank(raw.at(elsewhere).full[..., 0]) < len(passive):
        raise RobotFileError(
            f"the closing equations determine {counted(rank, 'joint')}, but {len(passive)} have no motor ({following})",
            where=where,
            hint=(
                "fewer joints can follow: give the others a motor, or lock them"
                if rank < len(passive)
                else "more joints must follow, or the opened joint is spherical ('opened: spherical'), or the axes of "
                "the loop are not quite parallel"
            ),
        )
    left, values, _ = np.linalg.svd(jacobian[:, passive])
    if values[-1] < DEAD_POINT * values[0]:
        raise RobotFileError(
            f"the start is a dead point: there {following} do not follow the motors ({_at(raw, start, names)})",
            where=where,
            hint="choose another start with 'at', and position limits that stay away from this one",
        )
    rows = left[:, : len(passive)].T
    sign = float(np.sign(np.linalg.det(rows @ jacobian[:, passive])))
    return LoopEquations(raw.active, raw.passive, raw.chains, raw.linear, raw.right, rows, sign)


def _check_travel(
    robot: Robot, equations: LoopEquations, start: FloatArray, names: tuple[str, ...], where: str
) -> None:
    for limits in robot.joints:
        index = names.index(limits.name)
        ends = (*limits.position, start[index])
        travel = max(ends) - min(ends)
        if travel > LONGEST_WAY and any(index in chain.joints for chain in equations.chains):
            raise RobotFileError(
                f"joint {limits.name} may move by {travel:.3g} {limits.unit('rad')}; a loop is followed over "
                f"{LONGEST_WAY:g} at most",
                where=where,
                hint="narrow its position limits, or choose a start within them with 'at'",
            )


def _rank(jacobian: FloatArray) -> int:
    values = np.linalg.svd(jacobian, compute_uv=False)
    return int(np.count_nonzero(values > RANK * values[0]))


def _targets(robot: Robot, equations: LoopEquations, active: tuple[int, ...]) -> FloatArray:
    """Positions (a, K) of the motors' joints: random ones, and the corners of the limits of those that move a loop."""
    low, high = (np.array(limit) for limit in zip(*(limits.position for limits in robot.joints), strict=True))
    generator = np.random.default_rng(0)
    drawn = generator.uniform(low[:, None], high[:, None], (len(low), KNOWN_POSITIONS))
    moving = [i for i, joint in enumerate(active) if any(joint in chain.joints for chain in equations.chains)]
    corners = list(product((0, 1), repeat=len(moving)))
    if len(corners) > MOST_CORNERS:
        corners = [corners[i] for i in generator.choice(len(corners), MOST_CORNERS, replace=False)]
    at_corners = np.repeat((0.5 * (low + high))[:, None], len(corners), axis=1)
    at_corners[moving] = np.where(np.array(corners).T, high[moving, None], low[moving, None])
    return np.concatenate([drawn, at_corners], axis=1)


def _followed_everywhere(
    equations: LoopEquations,
    start: FloatArray,
    targets: FloatArray,
    names: tuple[str, ...],
    units: Sequence[str],
    where: str,
) -> FloatArray:
    """Tree positions (n, K) that close at the targets (a, K), on one branch whatever the way."""
    followed = equations.followed(start, targets)
    short = np.flatnonzero(followed.reached < 1.0)
    if short.size:
        raise _refused(equations, followed.tree[:, short], targets[:, short], names, where)
    tree = followed.tree
    _check_dead_points(equations, tree, names, where)
    other = equations.followed(tree, np.roll(targets, 1, axis=1))
    expected = np.roll(tree, 1, axis=1)
    short = np.flatnonzero(other.reached < 1.0)
    if short.size:
        raise _refused(equations, other.tree[:, short], np.roll(targets, 1, axis=1)[:, short], names, where)
    apart = np.abs(other.tree - expected)
    joint, worst = divmod(int(np.argmax(apart)), apart.shape[1])
    if apart[joint, worst] > SAME:
        raise RobotFileError(
            f"how the loops close depends on the path of the arm: at {_at(equations, expected[:, worst], names)} two "
            f"ways end with {names[joint]} {apart[joint, worst]:.3g} {units[joint]} apart",
            where=where,
            hint="narrow the position limits to one side of the dead point between them",
        )
    return tree


def _check_dead_points(equations: LoopEquations, tree: FloatArray, names: tuple[str, ...], where: str) -> None:
    values = equations.at(tree).singular_values()
    ratio = values[:, -1] / values[:, 0]
    worst = int(np.argmin(ratio))
    if ratio[worst] < DEAD_POINT:
        raise _dead_point(equations, tree[:, worst], names, where)


def _refused(
    equations: LoopEquations, last: FloatArray, targets: FloatArray, names: tuple[str, ...], where: str
) -> RobotFileError:
    """Return why the branch ends at tree positions (n, K) on the way to targets (a, K): the worst of those examined."""
    worst: tuple[float, RobotFileError] | None = None
    for here, target in zip(last.T[:REASONS], targets.T[:REASONS], strict=True):
        tree = here.copy()
        tree[list(equations.active)] = target
        nearest = _nearest_closing(equations, tree)
        residual = float(np.max(np.abs(_all_rows(equations, nearest)[0])))
        if worst is not None and residual <= worst[0]:
            continue
        missed = _worst(equations, nearest)
        if missed is None:
            reason = _dead_point(equations, here, names, where)
        else:
            reason = RobotFileError(
                f"{missed} at {_at(equations, tree, names)}, within the position limits",
                where=where,
                hint=f"on the way there it closes as far as {_at(equations, here, names)}: narrow the position limits",
            )
        worst = residual, reason
    if worst is None:
        raise ValueError("the branch does not end")
    return worst[1]


def _dead_point(equations: LoopEquations, tree: FloatArray, names: tuple[str, ...], where: str) -> RobotFileError:
    following = ", ".join(names[index] for index in equations.passive)
    return RobotFileError(
        f"a dead point lies within the position limits, at {_at(equations, tree, names)}: there {following} do not "
        "follow the motors, and behind it the loop can fold to either side",
        where=where,
        hint="narrow the position limits to one side of it",
    )


def _at(equations: LoopEquations, tree: FloatArray, names: tuple[str, ...]) -> str:
    """The joints with a motor that move a loop, as in `a = 0.3, c = 1.2`."""
    moving = [index for index in equations.active if any(index in chain.joints for chain in equations.chains)]
    return ", ".join(f"{names[index]} = {tree[index]:.4g}" for index in moving) or "no motor moves it"
