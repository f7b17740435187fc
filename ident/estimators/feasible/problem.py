"""Conditions on physically consistent parameters: from an arm, its priors and the known values of its file."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from daq.robot.loader import RobotFile
from daq.robot.prior import TOTAL_MASS, Prior
from drivers.closest import did_you_mean
from drivers.errors import RobotFileError
from drivers.streams import FloatArray
from ident.estimators.feasible.centre_bounds import centre_bounds
from ident.estimators.feasible.interior_point import BoolArray, Conditions
from ident.estimators.feasible.prior import LinkPriors
from ident.estimators.feasible.pseudo_inertia import BASIS, pseudo_inertia
from ident.model.base_parameters import BaseParameters
from ident.model.dynamic_model import DynamicModel
from ident.model.friction_terms import REFERENCE_TEMPERATURE, TEMPERATURE_KINDS, temperature_factor
from ident.model.joint_columns import joint_column
from ident.model.parameters import INERTIAL, PAIR_SYMBOLS, StandardParameter
from ident.regression.estimate import Estimate

MARGIN = 1e-3
"""A link's pseudo-inertia exceeds this share of its prior's, a joint's inertia and friction this share of its unit."""

BARRIER = 1e-3
"""Weight of the barriers of ranges, and of all barriers beside a Euclidean distance, over the prior's."""

TOTAL_MASS_STD = 1e-3
"""A known total mass is an equation with this relative standard deviation."""

ROTOR_SHARE = 1e-3
"""Unit of a motor's inertia over the greatest that its torque limit accelerates, where the data leave it open."""

FRICTION_SHARE = 0.02
"""Unit of friction over the limit of the torque, at the limit of the velocity, where the data leave it open."""

PLAUSIBLE_RISE = 20.0
"""[K] of a joint's temperature over the reference."""

UNKNOWN_TORQUE = 100.0
"""[N·m] limit of joints whose file names none."""

LINK_SIZE = len(INERTIAL)

ROOT_RANK = 3e-8
"""Singular values of an estimate's root below this share of the largest are rounding: its square's are."""


@dataclass(frozen=True)
class Problem:
    """Scaled variables y with standard parameters x = scale · y, and the conditions on them.

    Attributes:
        scale: (p,).
        conditions: of y.
        names: (k + g,) what each condition is called.
        ranges: (g,) whether each inequality comes from the file's `known`, `com_box` or `com_hull`.
        start: (p,) of y: the prior, known values in place.
        free: (p,) whether each variable is not known.
        rows, values: (r, p), (r,): equations of unit variance beside the data's: the distance from the prior.
    """

    scale: FloatArray
    conditions: Conditions
    names: tuple[str, ...]
    ranges: BoolArray
    start: FloatArray
    free: BoolArray
    rows: FloatArray
    values: FloatArray


def build_problem(
    model: DynamicModel, robot_file: RobotFile, base: BaseParameters, estimate: Estimate, priors: LinkPriors
) -> Problem:
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
    limits, names, ranges = [MARGIN] * len(joints), [parameters[index].name for index in joints], [False] * len(joints)
    equations: list[FloatArray] = []
    values: list[float] = []
    by_name = {parameter.name: index for index, parameter in enumerate(parameters)}
    masses = [LINK_SIZE * link + INERTIAL.index("M") for link in range(links)]
    for name, known in robot.known.items():
        where = f"{robot.name}: known.{name}"
        if name == TOTAL_MASS:
            row = np.zeros(count)
            row[masses] = scale[masses]
        elif name in by_name:
            row = np.eye(count)[by_name[name]] * scale[by_name[name]]
        else:
            hint = did_you_mean(name, [*by_name, TOTAL_MASS]) or f"one of {', '.join(by_name)}, {TOTAL_MASS}"
            raise RobotFileError("is no parameter of this arm", where=where, hint=hint)
        if known.value is None:
            size = float(np.linalg.norm(row))
            for factor, limit in ((1.0, known.min), (-1.0, known.max)):
                if limit is not None:
                    rows.append(factor * row / size)
                    limits.append(factor * limit / size)
                    names.append(f"known.{name}")
                    ranges.append(True)
        elif name == TOTAL_MASS:
            if known.value <= 0:
                raise RobotFileError(f"{known.value:g} kg is no mass", where=where)
            equations.append(row / (TOTAL_MASS_STD * known.value))
            values.append(1.0 / TOTAL_MASS_STD)
        else:
            index = by_name[name]
            if signs[index] * known.value < 0 or (index in masses and known.value <= 0):
                raise RobotFileError(f"{known.value:g} is no value that a body or a joint can have", where=where)
            start[index], free[index] = known.value / scale[index], False
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
    kept = [place for place in range(len(rows)) if place >= len(joints) or free[joints[place]]]
    weight, entropic = robot.prior.weight, robot.prior.distance == "entropic"
    shares = np.array([BARRIER if ranges[place] or not entropic else 1.0 for place in kept])
    matrix_weights = np.full(links, weight if entropic else BARRIER * weight)
    for index in range(count) if not entropic else [i for i in range(LINK_SIZE * links, count) if not signs[i]]:
        equations.append(np.sqrt(weight) * np.eye(count)[index])
        values.append(float(np.sqrt(weight) * prior[index] / scale[index]))
    variables = np.arange(LINK_SIZE * links, dtype=np.intp).reshape(links, LINK_SIZE)
    conditions = Conditions(
        variables=variables,
        basis=BASIS * scale[variables][:, :, None, None],
        least=MARGIN * pseudo,
        pull=np.asarray(np.linalg.inv(pseudo) if entropic else np.zeros_like(pseudo), dtype=np.float64),
        rows=np.array([rows[place] for place in kept]).reshape(-1, count),
        limits=np.array([limits[place] for place in kept]),
        row_pull=np.array([0.0 if ranges[place] or not entropic else pulls[joints[place]] for place in kept]),
        weights=np.concatenate([matrix_weights, weight * shares]),
    )
    return Problem(
        scale=scale,
        conditions=conditions,
        names=(*(f"link of {name}" for name in model.link_names), *(names[place] for place in kept)),
        ranges=np.array([ranges[place] for place in kept], dtype=np.bool_),
        start=start,
        free=free,
        rows=np.array(equations).reshape(-1, count),
        values=np.array(values),
    )


def with_load(problem: Problem, prior: FloatArray, known: BoolArray, choices: Prior) -> Problem:
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
        least=np.concatenate([old.least, MARGIN * pseudo[None]]),
        pull=np.concatenate([old.pull, (np.linalg.inv(pseudo) if entropic else np.zeros_like(pseudo))[None]]),
        rows=np.pad(old.rows, wide),
        limits=old.limits,
        row_pull=old.row_pull,
        weights=np.insert(old.weights, links, choices.weight * (1.0 if entropic else BARRIER)),
    )
    return Problem(
        scale=np.concatenate([problem.scale, scale]),
        conditions=conditions,
        names=(*problem.names[:links], "load", *problem.names[links:]),
        ranges=problem.ranges,
        start=np.concatenate([problem.start, prior / scale]),
        free=np.concatenate([problem.free, ~known]),
        rows=rows,
        values=values,
    )


def _sign(parameter: StandardParameter) -> float:
    """1 or -1 for a parameter that must have this sign, 0 for one that may have either.

    Friction of a coupled joint brakes where it is negative (SR400 eq. 8).
    """
    if parameter.kind == "offset" or parameter.kind in TEMPERATURE_KINDS:
        return 0.0
    if parameter.kind == "coupling" and PAIR_SYMBOLS[parameter.symbol] != "motor_inertia":
        return -1.0
    return 1.0


def _joint_sizes(
    model: DynamicModel, base: BaseParameters, estimate: Estimate, links: int
) -> tuple[FloatArray, FloatArray]:
    """Units (p,) of the joints' own parameters, and (p,) of the pull: 1 over a plausible value in that unit.

    Where an inertia is confounded with a link's, the pull is faint, and the link's condition decides.
    """
    parameters = model.parameters
    sizes, pulls = np.ones(len(parameters)), np.ones(len(parameters))
    for index, parameter in enumerate(parameters[LINK_SIZE * links :], start=LINK_SIZE * links):
        limits = model.limits[model.active.index(parameter.joint)]
        torque = limits.torque if limits.torque is not None else UNKNOWN_TORQUE
        if parameter.symbol in ("Ia", "Iac"):
            sizes[index] = ROTOR_SHARE * torque / limits.acceleration
            pulls[index] = ROTOR_SHARE
        else:
            sizes[index] = FRICTION_SHARE * torque / _signal_size(model, parameter, torque, limits.velocity)
    # The diagonal of pinv(RᵀR) itself may come out a rounding below 0 where the rank is low.
    deviations = np.linalg.norm(np.linalg.pinv(estimate.root, rcond=ROOT_RANK), axis=1)
    for place, (column, value) in enumerate(zip(estimate.active, estimate.values, strict=True)):
        index = base.columns[column]
        if parameters[index].kind != "inertial" and np.count_nonzero(base.projection[column]) == 1:
            sign = _sign(parameters[index])
            sizes[index] = max(sign * value if sign else abs(value), float(deviations[place]))
            pulls[index] = 1.0
    return sizes, pulls


def _signal_size(model: DynamicModel, parameter: StandardParameter, torque: float, velocity: float) -> float:
    """What a friction parameter is multiplied with at the limits of the torque and the velocity."""
    if parameter.kind == "coupling":
        return velocity if PAIR_SYMBOLS[parameter.symbol] == "viscous" else 1.0
    column = joint_column(model, parameter)
    if column.quantity == "viscous":
        return float(velocity**column.shape)
    if column.quantity == "load":
        return float(torque**column.shape)
    if column.quantity in TEMPERATURE_KINDS:
        factor = temperature_factor(column.quantity, np.array(REFERENCE_TEMPERATURE + PLAUSIBLE_RISE))
        return float(np.sqrt(velocity) * np.abs(factor))
    return 1.0


def _units(pseudo: FloatArray) -> FloatArray:
    """Units (k, 10) of links' parameters: the mass of the prior, times its radius of gyration once or twice."""
    mass = pseudo[:, 3, 3]
    radius = np.sqrt(np.trace(pseudo[:, :3, :3], axis1=1, axis2=2) / mass)
    return np.column_stack([*[mass * radius**2] * 6, *[mass * radius] * 3, mass])
