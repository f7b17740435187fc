"""Design of an excitation trajectory: the problem, its search, the motion that is played."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from daq.motion.trajectories import Motion
from daq.robot.loader import RobotFile
from drivers.core.arrays import FloatArray
from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.errors import IdentificationError, UsageError
from drivers.core.text import did_you_mean
from ident.excite.choices import DesignChoices
from ident.excite.constraints.constraints import constraints_of, constraints_within_limits, criterion_within_limits
from ident.excite.constraints.self_collision import SelfCollision
from ident.excite.criteria import (
    Criterion,
    Measure,
    MotionSize,
    RegressorCriterion,
    condition,
    d_optimal,
    deviations,
    e_optimal,
    moments_apart,
    plain_condition,
)
from ident.excite.families.fourier import FourierFamily, FourierQuinticFamily
from ident.excite.families.moving_joints import Family, MovingJoints, middle_of_range
from ident.excite.families.points import PointsFamily
from ident.excite.families.sines import SinesFamily
from ident.excite.motion_check import ArmMotionCheck
from ident.excite.prior import PriorKnowledge
from ident.excite.search.acceptance import accepted, shrunk_to_fit
from ident.excite.search.poses import NoFeasiblePoseError
from ident.excite.search.problem import DesignProblem, ErrorBars
from ident.excite.search.search import SearchChoices, SearchResult, search
from ident.linear_algebra.independent_columns import independent_columns
from ident.model.base_parameters import BaseParameters, base_parameters
from ident.model.dynamic_model import DynamicModel, build_model
from ident.model.parameters import INERTIAL
from ident.model.regressor import RegressorKernel, motion_factor
from ident.regression.least_squares import EXCITATION_TOLERANCE

POINTS_PER_WAVE = 20
"""Grid points of the design in the shortest period of a motion."""
DEVIATION_FLOOR = 0.02
"""Floor of a parameter's size, as a share of the largest of its kind: near 0 an RSD is meaningless."""
_TRIALS = 5
"""Random motions that decide which columns a family can excite."""
_MEASURES: dict[str, Measure] = {
    "condition": condition,
    "plain-condition": plain_condition,
    "d-optimal": d_optimal,
    "e-optimal": e_optimal,
}


@dataclass(frozen=True)
class Design:
    """A designed excitation."""

    choices: DesignChoices  # its options
    motion: Motion  # as played, from rest to rest
    cost: float  # exp of the criterion along one repetition at full speed: a condition number where it is one
    condition: float  # column-normalised condition number of the base regressor there
    use: FloatArray  # (m,) utilisation of every limit along the played motion, on the dense grid; at most 1
    limits: tuple[str, ...]  # (m,) their names
    search: SearchResult  # its outcome


def design(
    robot_file: RobotFile,
    prior: PriorKnowledge,
    choices: DesignChoices,
    search_choices: SearchChoices,
    earlier: Motion | None = None,
    progress: Callable[[SearchResult], None] = lambda result: None,
    clock: Clock = SYSTEM_CLOCK,
) -> Design:
    """Design an excitation trajectory; Ctrl-C ends the search with the best so far.

    With several processes the caller's main module must be importable without side effects (`if __name__ == …`).

    Raises:
        UsageError: an option is not possible, or no pose keeps all limits; names the limit.
        IdentificationError: a search process crashed, with a number of starts.
        KeyboardInterrupt: Ctrl-C before a feasible motion was found.
    """
    begun = clock.now()
    problem = build_problem(robot_file, prior, choices)
    first = problem.family.encode(earlier) if earlier is not None else None
    make = partial(build_problem, robot_file, prior, choices)
    try:
        searched = search(problem, make, search_choices, first, progress, clock, begun)
    except NoFeasiblePoseError as error:
        raise UsageError(error.message, where=robot_file.robot.name, hint=error.hint) from error
    if searched.best is None:
        raise KeyboardInterrupt
    variables = searched.best.variables
    checked = accepted(problem, variables, final=True)
    if checked is None:  # on the finer grid of that check
        fitting = shrunk_to_fit(problem, variables, problem.family.middle(variables), final=True)
        if fitting is None:
            said = problem.refusal(problem.family.motion(variables))
            raise IdentificationError(
                f"dynid record would refuse the design: {said}",
                hint="give a larger --margin, or change mounting and workspace of the robot file",
            )
        checked = accepted(problem, fitting, final=True)
        assert checked is not None, "it has already passed this check"
    return Design(
        choices=choices,
        motion=checked.motion,
        cost=float(np.exp(problem.cost(checked.variables))),
        condition=problem.condition(checked.variables),
        use=checked.use,
        limits=problem.limits,
        search=searched,
    )


def build_problem(robot_file: RobotFile, prior: PriorKnowledge, choices: DesignChoices) -> DesignProblem:
    """The problem of a design.

    Raises:
        UsageError: a choice is not possible for this arm.
    """
    model = build_model(robot_file)
    family = build_family(model, choices)
    time = family.grid(POINTS_PER_WAVE * _waves(choices))
    limits = constraints_of(robot_file, model, prior.parameters, self_collision=choices.self_collision)
    constraints = constraints_within_limits(model, limits)
    check = ArmMotionCheck(robot_file, self_collision=choices.self_collision)
    columns = excitable_columns(model, family, _wanted(model, base_parameters(model), choices))
    criterion = criterion_within_limits(model, build_criterion(model, columns, prior, choices))
    conditioning = criterion_within_limits(model, RegressorCriterion(model, columns, condition))
    error_bars = _error_bars(model, columns, prior, choices)
    by_hull = any(isinstance(limit, SelfCollision) and limit.pairs.by_hull for limit in limits)
    return DesignProblem(
        family, criterion, conditioning, constraints, time, 1.0 - choices.margin, error_bars, check.refusal, by_hull
    )


def build_family(model: DynamicModel, choices: DesignChoices) -> Family:
    """The family of motions of a design."""
    moving = _moving(model, choices.joints)
    rest = np.array([middle_of_range(*limits.position) for limits in model.limits])
    common = (MovingJoints(model.limits, moving, rest), choices.period)
    if choices.kind == "fourier":
        return FourierFamily(*common, choices.harmonics, choices.periods, choices.ramp)
    if choices.kind == "fourier-quintic":
        return FourierQuinticFamily(*common, choices.harmonics, choices.periods)
    if choices.kind == "sines":
        return SinesFamily(*common, choices.harmonics, choices.ramp)
    return PointsFamily(*common, choices.points)


def build_criterion(
    model: DynamicModel, columns: tuple[int, ...], prior: PriorKnowledge, choices: DesignChoices
) -> Criterion:
    """The criterion of a design over the standard columns that its family can excite.

    Raises:
        UsageError: `deviations` without prior parameters.
    """
    if choices.criterion == "motion-size":
        return MotionSize()
    weights: FloatArray | None = None
    measure: Measure
    if choices.criterion in ("d-optimal", "e-optimal", "deviations"):
        weights = 1.0 / prior.noise
    if choices.criterion == "deviations":
        measure = deviations(_sizes(base_parameters(model), prior, columns, choices))
    elif choices.criterion == "moments":
        symbols = [model.parameters[column].symbol for column in columns]
        first = tuple(i for i, symbol in enumerate(symbols) if symbol in INERTIAL[6:])
        second = tuple(i for i, symbol in enumerate(symbols) if symbol in INERTIAL[:6])
        measure = moments_apart(first, second)
    else:
        measure = _MEASURES[choices.criterion]
    return RegressorCriterion(model, columns, measure, weights)


def excitable_columns(model: DynamicModel, family: Family, columns: Sequence[int]) -> tuple[int, ...]:
    """Those of the standard columns that random motions of the family excite, each independently of those before.

    Raises:
        UsageError: it excites none of them.
    """
    generator = np.random.default_rng(0)
    kernel = RegressorKernel(model, columns)
    factors = []
    for _ in range(_TRIALS):
        variables = family.random(generator)
        path = family.path(variables, family.grid(10 * len(columns)))
        factors.append(motion_factor(kernel, path.position, path.velocity, path.acceleration))
    stacked = np.concatenate(factors)
    longest = float(np.linalg.norm(stacked, axis=0).max(initial=0.0))
    kept = independent_columns(stacked, range(len(columns)), EXCITATION_TOLERANCE * longest)
    if not kept:
        raise UsageError("the joints that move excite no parameter", where=model.name)
    return tuple(columns[i] for i in kept)


def _wanted(model: DynamicModel, base: BaseParameters, choices: DesignChoices) -> tuple[int, ...]:
    if not choices.loaded:
        return base.columns
    last = model.tool_link
    return tuple(range(10 * last, 10 * last + 10))


def _error_bars(
    model: DynamicModel, columns: tuple[int, ...], prior: PriorKnowledge, choices: DesignChoices
) -> ErrorBars | None:
    if prior.parameters is None or choices.loaded:
        return None
    base = base_parameters(model)
    names = dict(zip(base.columns, base.names, strict=True))
    repetitions = choices.periods if choices.kind.startswith("fourier") else 1
    return ErrorBars(
        RegressorCriterion(model, columns, d_optimal, 1.0 / prior.noise),
        [names[column] for column in columns],
        _sizes(base, prior, columns, choices),
        prior.rate * choices.period * repetitions,
    )


def _sizes(base: BaseParameters, prior: PriorKnowledge, columns: Sequence[int], choices: DesignChoices) -> FloatArray:
    """Size of each parameter, which its standard deviation is compared with."""
    if choices.loaded:
        raise UsageError(
            "the criterion 'deviations' needs the parameters' values, which a payload does not have yet",
            hint="with --loaded use condition or d-optimal",
        )
    if prior.parameters is None:
        raise UsageError(
            "the criterion 'deviations' needs prior parameters", hint="give --prior result.json, or use condition"
        )
    values = np.abs(prior.parameters)
    sizes = {}
    for column, value, kind in zip(base.columns, values, base.kinds, strict=True):
        largest = max(v for v, k in zip(values, base.kinds, strict=True) if k == kind)
        sizes[column] = max(value, DEVIATION_FLOOR * largest)
    wanted = np.array([sizes[column] for column in columns])
    return np.where(wanted > 0.0, wanted, 1.0)


def _moving(model: DynamicModel, names: tuple[str, ...] | None) -> tuple[int, ...]:
    if names is None:
        return tuple(range(model.dof))
    for name in names:
        if name not in model.joint_names:
            joints = f"joints: {', '.join(model.joint_names)}"
            raise UsageError(
                f"no joint is called '{name}'", where=model.name, hint=did_you_mean(name, model.joint_names) or joints
            )
    return tuple(joint for joint, name in enumerate(model.joint_names) if name in names)


def _waves(choices: DesignChoices) -> int:
    return choices.points if choices.kind == "points" else choices.harmonics
