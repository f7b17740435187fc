"""Conditions on physically consistent parameters: from an arm, its priors and the known values of its file."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from daq.robot.loader import RobotFile
from daq.robot.prior import TOTAL_MASS, Prior
from drivers.core.arrays import FloatArray
from drivers.core.errors import RobotFileError
from drivers.core.text import did_you_mean
from ident.estimators.feasible.centre_bounds import centre_bounds
from ident.estimators.feasible.interior_point import BoolArray, Conditions
from ident.estimators.feasible.prior import LinkPriors
from ident.estimators.feasible.pseudo_inertia import BASIS, pseudo_inertia
from ident.friction.table import REFERENCE_TEMPERATURE, TERM, Operands
from ident.model.base_parameters import BaseParameters, random_states
from ident.model.dynamic_model import DynamicModel
from ident.model.dynamics.inverse_dynamics import weights_in_offsets
from ident.model.joint_columns import joint_column
from ident.model.parameters import INERTIAL, LINK_SIZE, MASS, PAIR_SYMBOLS, StandardParameter
from ident.model.regressor import model_torque, regressor
from ident.regression.estimate import Estimate
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT

INTERIOR = 1e-3
"""A link's pseudo-inertia exceeds this share of its prior's, a joint's inertia and friction this share of its unit."""

BARRIER = 1e-3
"""Weight of the barriers of ranges, and of all barriers beside a Euclidean distance, over the prior's."""

TOTAL_MASS_STD = 1e-3
"""A known total mass is an equation with this relative standard deviation."""

ROTOR_SHARE = 1e-3
"""Unit of a motor's inertia over the greatest that its torque limit accelerates, where the data leave it open."""

OFFSET_SHARE = 0.3
"""Unit of an offset that no motion separates from a weight, over the joint's Coulomb friction."""

FRICTION_SHARE = 0.02
"""Unit of friction over the limit of the torque, at the limit of the velocity, where the data leave it open."""

PLAUSIBLE_RISE = 20.0
"""[K] of a joint's temperature over the reference."""

PLAUSIBLE = 10.0
"""Weight of plausible masses and centres over the prior's: with its default each counts as one equation of unit
variance. The prior's own distance grows in proportion to the mass only, and leaves a link of ten times its mass to a
small gain of the fit; these grow with its square."""

COASTING = 0.01
"""[s] in which friction alone stops no joint from its greatest velocity: the least inertia that a joint has. It is 15
to 3700 ms where recordings determine it (wrist of a TX40; shoulder of a Panda), 30 ms and more for the arms whose truth
is public. An integrator with steps of a tenth of it is stable."""

POSES = 24
"""Random states at which the least inertia of a joint holds, and a torque is predicted."""

TINY = float(np.finfo(np.float64).tiny)

LEAST_INERTIA = "least inertia"
"""What these conditions are called in messages."""


ROOT_RANK = 3e-8
"""Singular values of an estimate's root below this share of the largest are rounding: its square's are."""


@dataclass(frozen=True)
class FeasibilityProblem:
    """Scaled variables y with standard parameters x = scale · y, and the conditions on them."""

    scale: FloatArray  # (p,)
    conditions: Conditions  # of y
    names: tuple[str, ...]  # (k + g,) what each condition is called
    ranges: BoolArray  # (g,) whether each inequality comes from the file's `known`, `com_box` or `com_hull`
    start: FloatArray  # (p,) of y: the prior, known values in place
    free: BoolArray  # (p,) whether each variable is not known
    # rows, values: (r, p), (r,): equations of unit variance beside the data's: the distance from the prior
    rows: FloatArray
    values: FloatArray


def build_problem(  # noqa: C901, PLR0912, PLR0915 — the steps, in their order
    model: DynamicModel, robot_file: RobotFile, base: BaseParameters, estimate: Estimate, priors: LinkPriors
) -> FeasibilityProblem:
    """The problem of an arm.

    Raises:
        RobotFileError: `known` names no parameter of this arm, or a value that none can have; a shape is not found.
    """
    robot, parameters = robot_file.robot, model.parameters
    links, count = len(priors.links), len(parameters)
    pseudo = pseudo_inertia(priors.links)
    signs = np.array([_sign(parameter) for parameter in parameters])
    sizes, pulls = _joint_sizes(model, base, estimate, links)
    prior = np.concatenate([priors.links.ravel(), (signs * sizes)[LINK_SIZE * links :]])
    scale = np.concatenate([_units(pseudo).ravel(), np.where(signs < 0, -sizes, sizes)[LINK_SIZE * links :]])
    start, free = prior / scale, np.ones(count, dtype=np.bool_)
    joints = [index for index in range(LINK_SIZE * links, count) if signs[index]]
    rows = [np.eye(count)[index] for index in joints]
    limits, names, ranges = (
        [INTERIOR] * len(joints),
        [parameters[index].name for index in joints],
        [False] * len(joints),
    )
    plausible_rows, plausible_values = _plausible(priors, scale, robot.prior.weight)
    equations, values = list(plausible_rows), plausible_values.tolist()
    by_name = {parameter.name: index for index, parameter in enumerate(parameters)}
    masses = [LINK_SIZE * link + MASS for link in range(links)]
    known_inertias = [name for name in robot.known if name.startswith("Ia")]
    for name, stated in robot.known.items():
        where = f"{robot.name}: known.{name}"
        if name == TOTAL_MASS:
            row = np.zeros(count)
            row[masses] = scale[masses]
        elif name in by_name:
            row = np.eye(count)[by_name[name]] * scale[by_name[name]]
        else:
            hint = did_you_mean(name, [*by_name, TOTAL_MASS]) or f"one of {', '.join(by_name)}, {TOTAL_MASS}"
            raise RobotFileError("is no parameter of this arm", where=where, hint=hint)
        if stated.value is None:
            size = float(np.linalg.norm(row))
            for factor, limit in ((1.0, stated.min), (-1.0, stated.max)):
                if limit is not None:
                    rows.append(factor * row / size)
                    limits.append(factor * limit / size)
                    names.append(f"known.{name}")
                    ranges.append(True)
        elif name == TOTAL_MASS:
            if stated.value <= 0:
                raise RobotFileError(f"{stated.value:g} kg is not a mass", where=where)
            equations.append(row / (TOTAL_MASS_STD * stated.value))
            values.append(1.0 / TOTAL_MASS_STD)
        else:
            index = by_name[name]
            of_joint = index >= LINK_SIZE * links
            if (of_joint and signs[index] * stated.value < 0) or (index in masses and stated.value <= 0):
                raise RobotFileError(f"{stated.value:g} is not a possible value of a body or joint", where=where)
            start[index], free[index] = stated.value / scale[index], False
    for bound in centre_bounds(model, robot_file):
        first = LINK_SIZE * bound.link + INERTIAL.index("MX")
        for normal, offset in zip(bound.normals, bound.offsets, strict=True):
            row = np.zeros(count)
            row[first : first + 3], row[masses[bound.link]] = -normal, offset
            row *= scale / np.linalg.norm(row * scale)
            rows.append(row)
            limits.append(0.0)
            names.append(bound.name)
            ranges.append(True)
    for joint, row, least in _least_inertias(model, base, estimate, known_inertias):
        size = float(np.linalg.norm(row * scale))
        rows.append(row * scale / size)
        limits.append(least / size)
        names.append(f"{LEAST_INERTIA} of {joint}")
        ranges.append(False)
    kept = [place for place in range(len(rows)) if place >= len(joints) or free[joints[place]]]
    weight, entropic = robot.prior.weight, robot.prior.distance == "entropic"
    drawn = np.array([entropic and place < len(joints) for place in kept], dtype=np.bool_)
    shares = np.where(drawn, 1.0, BARRIER)
    matrix_weights = np.full(links, weight if entropic else BARRIER * weight)
    for index in range(count) if not entropic else [i for i in range(LINK_SIZE * links, count) if not signs[i]]:
        equations.append(np.sqrt(weight) * np.eye(count)[index])
        values.append(float(np.sqrt(weight) * prior[index] / scale[index]))
    variables = np.arange(LINK_SIZE * links, dtype=np.intp).reshape(links, LINK_SIZE)
    conditions = Conditions(
        variables=variables,
        basis=BASIS * scale[variables][:, :, None, None],
        least=INTERIOR * pseudo,
        pull=np.asarray(np.linalg.inv(pseudo) if entropic else np.zeros_like(pseudo), dtype=np.float64),
        rows=np.array([rows[place] for place in kept]).reshape(-1, count),
        limits=np.array([limits[place] for place in kept]),
        row_pull=np.array([pulls[joints[place]] if own else 0.0 for place, own in zip(kept, drawn, strict=True)]),
        weights=np.concatenate([matrix_weights, weight * shares]),
    )
    return FeasibilityProblem(
        scale=scale,
        conditions=conditions,
        names=(*(f"link of {name}" for name in model.link_names), *(names[place] for place in kept)),
        ranges=np.array([ranges[place] for place in kept], dtype=np.bool_),
        start=start,
        free=free,
        rows=np.array(equations).reshape(-1, count),
        values=np.array(values),
    )


def with_load(problem: FeasibilityProblem, prior: FloatArray, known: BoolArray, choices: Prior) -> FeasibilityProblem:
    """The problem with ten further variables, those of a load that is a body itself.

    With the load and the links that carry it, the links plus the load can exist, too.

    Args:
        problem: of the arm, p variables.
        prior: (10,) standard parameters of a body, known ones in place.
        known: (10,) which of them are known.
        choices: distance from the prior, and its weight.
    """
    old, count = problem.conditions, len(problem.start)
    entropic = choices.distance == "entropic"
    pseudo = pseudo_inertia(prior)
    scale = _units(pseudo[None])[0]
    wide = ((0, 0), (0, LINK_SIZE))
    rows, values = np.pad(problem.rows, wide), problem.values
    if not entropic:
        root = np.sqrt(choices.weight)
        rows = np.vstack([rows, np.pad(root * np.eye(LINK_SIZE), ((0, 0), (count, 0)))])
        values = np.concatenate([values, root * prior / scale])
    links = len(old.least)
    conditions = Conditions(
        variables=np.vstack([old.variables, count + np.arange(LINK_SIZE, dtype=np.intp)]),
        basis=np.concatenate([old.basis, (BASIS * scale[:, None, None])[None]]),
        least=np.concatenate([old.least, INTERIOR * pseudo[None]]),
        pull=np.concatenate([old.pull, (np.linalg.inv(pseudo) if entropic else np.zeros_like(pseudo))[None]]),
        rows=np.pad(old.rows, wide),
        limits=old.limits,
        row_pull=old.row_pull,
        weights=np.insert(old.weights, links, choices.weight * (1.0 if entropic else BARRIER)),
    )
    return FeasibilityProblem(
        scale=np.concatenate([problem.scale, scale]),
        conditions=conditions,
        names=(*problem.names[:links], "load", *problem.names[links:]),
        ranges=problem.ranges,
        start=np.concatenate([problem.start, prior / scale]),
        free=np.concatenate([problem.free, ~known]),
        rows=rows,
        values=values,
    )


def _plausible(priors: LinkPriors, scale: FloatArray, weight: float) -> tuple[FloatArray, FloatArray]:
    """Equations (4k, p) and values (4k,) of links' masses and first moments: those of the prior, as far as they may be.

    A first moment is compared with that of the link's mass at the prior's centre, so that the equation stays linear.
    """
    rows, values = np.zeros((4 * len(priors.links), len(scale))), np.zeros(4 * len(priors.links))
    for link, (prior, mass_std, centre_std) in enumerate(
        zip(priors.links, priors.mass_std, priors.centre_std, strict=True)
    ):
        mass = LINK_SIZE * link + MASS
        rows[4 * link, mass], values[4 * link] = 1.0 / mass_std, prior[MASS] / mass_std
        for axis in range(3):
            rows[4 * link + 1 + axis, mass - 3 + axis] = 1.0 / (mass_std * centre_std)
            rows[4 * link + 1 + axis, mass] = -prior[MASS - 3 + axis] / prior[MASS] / (mass_std * centre_std)
    root = np.sqrt(PLAUSIBLE * weight)
    return root * rows * scale, root * values


def _least_inertias(
    model: DynamicModel, base: BaseParameters, estimate: Estimate, known: Collection[str]
) -> Iterator[tuple[str, FloatArray, float]]:
    """A joint's name, the combination (p,) of standard parameters that is its inertia at a pose, and its least value.

    The joints whose inertia the robot file states are left out.
    """
    parameters = model.parameters
    friction = friction_rates(model, [base.columns[column] for column in estimate.active], estimate.values)
    carrying = np.array([p.kind in ("inertial", "motor_inertia") or p.symbol == "Iac" for p in parameters])
    joints = [
        joint for joint in range(model.dof) if f"Ia{model.active[joint] + 1}" not in known and friction[joint] != 0.0
    ]
    position, _, _ = random_states(model, POSES)
    positions = np.tile(position, len(joints))
    still, heat = np.zeros_like(positions), np.full_like(positions, REFERENCE_TEMPERATURE)
    # Each joint in turn accelerates by 1, at all poses.
    unit = np.repeat(np.eye(model.dof)[:, joints], POSES, axis=1)
    weightless = replace(model, gravity=np.zeros(3))
    motors = regressor(weightless, positions, still, unit, range(len(parameters)), heat)
    for place, joint in enumerate(joints):
        of_poses = motors[:, :, place * POSES : (place + 1) * POSES]
        rows = of_poses[joint]
        if not model.transmission.direct:
            rows = np.einsum("m,mpN->pN", model.transmission.coupling[:, joint], of_poses)
        for row in np.unique(np.round(np.where(carrying[:, None], rows, 0.0), 9), axis=1).T:
            yield model.joint_names[joint], row, COASTING * float(friction[joint])


def friction_rates(model: DynamicModel, columns: Sequence[int], values: FloatArray) -> FloatArray:
    """Viscous and Coulomb friction (n,) of the motors at their greatest velocity, over it [N·m·s/rad]; 0 at least.

    Args:
        model: the arm.
        columns: (c,) of standard parameters.
        values: (c,) theirs.
    """
    rates = np.zeros(model.dof)
    for column, value in zip(columns, values, strict=True):
        parameter = model.parameters[column]
        if parameter.kind in ("viscous", "coulomb"):
            row, of_column = model.active.index(parameter.joint), joint_column(model, parameter)
            greatest = model.limits[row].velocity
            torque = value * (greatest**of_column.shape if of_column.quantity == "viscous" else 1.0)
            rates[row] += max(0.0, float(torque)) / greatest
    return rates


def _sign(parameter: StandardParameter) -> float:
    """1 or -1 for a parameter that must have this sign, 0 for one that may have either.

    Friction of a coupled joint brakes where it is negative (SR400 eq. 8).
    """
    if parameter.kind == "coupling" and PAIR_SYMBOLS[parameter.symbol] != "motor_inertia":
        return -1.0
    return 1.0 if parameter.kind not in TERM or TERM[parameter.kind].brakes else 0.0


def _joint_sizes(
    model: DynamicModel, base: BaseParameters, estimate: Estimate, links: int
) -> tuple[FloatArray, FloatArray]:
    """Units (p,) of the joints' own parameters, and (p,) of the pull: 1 over a plausible value in that unit.

    Where an inertia is confounded with a link's, the pull is faint, and the link's condition decides.
    """
    parameters = model.parameters
    sizes, pulls = np.ones(len(parameters)), np.ones(len(parameters))
    torques = _greatest_torques(model, base, estimate)
    for index, parameter in enumerate(parameters[LINK_SIZE * links :], start=LINK_SIZE * links):
        motor = model.active.index(parameter.joint)
        limits, torque = model.limits[motor], torques[motor]
        if parameter.symbol in ("Ia", "Iac"):
            sizes[index] = ROTOR_SHARE * torque / limits.acceleration
            pulls[index] = ROTOR_SHARE
        else:
            sizes[index] = FRICTION_SHARE * torque / _signal_size(model, parameter, torque, limits.velocity)
    # The diagonal of pinv(RᵀR) itself may come out a rounding below 0 where the rank is low.
    deviations = np.linalg.norm(np.linalg.pinv(estimate.root, rcond=ROOT_RANK), axis=1)
    errors = np.sqrt(np.clip(np.nan_to_num(np.diag(estimate.covariance), nan=np.inf), 0.0, None))
    for place, (column, value) in enumerate(zip(estimate.active, estimate.values, strict=True)):
        index = base.columns[column]
        if parameters[index].kind != "inertial" and np.count_nonzero(base.projection[column]) == 1:
            sign, deviation = _sign(parameters[index]), float(deviations[place])
            share = ROTOR_SHARE if parameters[index].symbol in ("Ia", "Iac") else FRICTION_SHARE
            # A joint that hardly moved has no more friction than its motor overcomes, whatever the estimate.
            most = max(sizes[index] / share, abs(value) - WITHIN_95_PERCENT * float(errors[place]))
            sizes[index] = min(max(sign * value if sign else abs(value), deviation), most)
            pulls[index] = 1.0
    for index, size in offset_sizes(model, base, estimate).items():
        sizes[index] = min(sizes[index], size)
    return sizes, pulls


def offset_sizes(model: DynamicModel, base: BaseParameters, estimate: Estimate) -> dict[int, float]:
    """Plausible sizes [N] of offsets that no motion separates from a weight, by the offset's index.

    A weight is far larger than the offset, which is friction that differs by direction.
    """
    dry = {
        model.parameters[base.columns[column]].joint: abs(value)
        for column, value in zip(estimate.active, estimate.values, strict=True)
        if base.kinds[column] == "coulomb"
    }
    offsets = [base.columns[column] for column in weights_in_offsets(model, base).values()]
    of_joint = {index: dry.get(model.parameters[index].joint, 0.0) for index in offsets}
    return {index: OFFSET_SHARE * friction for index, friction in of_joint.items() if friction > 0.0}


def _greatest_torques(model: DynamicModel, base: BaseParameters, estimate: Estimate) -> list[float]:
    """The motors' limits [N·m or N]; where the file states none, the greatest torque that the estimate predicts."""
    columns = [base.columns[column] for column in estimate.active]
    position, velocity, acceleration = random_states(model, POSES)
    heat = np.full_like(position, REFERENCE_TEMPERATURE)
    predicted = model_torque(model, columns, estimate.values, position, velocity, acceleration, heat)
    return [
        limits.torque if limits.torque is not None else max(float(np.abs(row).max()), TINY)
        for limits, row in zip(model.limits, predicted, strict=True)
    ]


def _signal_size(model: DynamicModel, parameter: StandardParameter, torque: float, velocity: float) -> float:
    """Return what a friction parameter is multiplied with at the limits of the torque and the velocity."""
    if parameter.kind == "coupling":
        return velocity if PAIR_SYMBOLS[parameter.symbol] == "viscous" else 1.0
    term, shape = TERM[parameter.kind], joint_column(model, parameter).shape
    if term.needs == "position":
        return 1.0
    # Dry friction is largest where a motion begins, all other friction at the greatest velocity.
    rate = np.array(0.0 if term.dry else velocity)
    kelvin = np.array(REFERENCE_TEMPERATURE + PLAUSIBLE_RISE)
    return float(np.abs(term.signal(Operands(rate, 1.0, shape, np.array(torque), kelvin))))


def _units(pseudo: FloatArray) -> FloatArray:
    """Units (k, 10) of links' parameters: the mass of the prior, times its radius of gyration once or twice."""
    mass = pseudo[:, 3, 3]
    radius = np.sqrt(np.trace(pseudo[:, :3, :3], axis1=1, axis2=2) / mass)
    return np.column_stack([*[mass * radius**2] * 6, *[mass * radius] * 3, mass])
