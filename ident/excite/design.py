"""Design of an excitation trajectory: search, then a check of the limits on a dense grid."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from daq.motion.trajectories import Motion
from daq.robot.loader import RobotFile
from drivers.errors import IdentificationError, UsageError
from drivers.streams import FloatArray
from ident.excite.build import build_problem
from ident.excite.choices import DesignChoices
from ident.excite.path import Family, Path
from ident.excite.prior import Prior
from ident.excite.problem import Problem
from ident.excite.search import SearchChoices, SearchResult, search
from ident.excite.solve import Solver, tighten

DENSER = 10
"""The last check's grid is this many times denser than the one of the design."""
_TIGHTENINGS = 5
_RAMP_GROWTH = 1.4
_RAMP_TRIES = 8


@dataclass(frozen=True)
class Design:
    """A designed excitation.

    Attributes:
        choices: its options.
        motion: what is played, from rest to rest.
        family: of motions, which writes it to a trajectory file.
        variables: (size,) its variables.
        cost: exp of the criterion along one repetition at full speed: a condition number where it is one.
        condition: column-normalised condition number of the base regressor there.
        use: (m,) utilisation of every limit along the played motion, on the dense grid; at most 1.
        limits: (m,) their names.
        search: its outcome.
    """

    choices: DesignChoices
    motion: Motion
    family: Family
    variables: FloatArray
    cost: float
    condition: float
    use: FloatArray
    limits: tuple[str, ...]
    search: SearchResult


def design(
    robot_file: RobotFile,
    prior: Prior,
    choices: DesignChoices,
    search_choices: SearchChoices,
    earlier: Motion | None = None,
    progress: Callable[[SearchResult], None] = lambda result: None,
) -> Design:
    """Design an excitation trajectory; Ctrl-C ends the search with the best so far.

    With several processes the caller's main module must be importable without side effects (`if __name__ == …`).

    Args:
        robot_file: the arm.
        prior: what is known of its parameters and noise.
        choices: what is wanted.
        search_choices: how long and how to search.
        earlier: a motion to start from.
        progress: called after each round of a start.

    Raises:
        UsageError: an option is not possible, or no feasible motion was found; names the limit.
        IdentificationError: the best motion exceeds a limit between the grid's points, however it is narrowed.
        KeyboardInterrupt: Ctrl-C before a feasible motion was found.
    """
    problem = build_problem(robot_file, prior, choices)  # here first: errors are reported before processes start
    first = problem.family.encode(earlier) if earlier is not None else None
    alone = search_choices.processes <= 1
    make = (lambda: problem) if alone else partial(build_problem, robot_file, prior, choices)
    searched = search(make, search_choices, first, progress)
    if searched.best is None:
        if searched.least_use is None:
            if searched.interrupted:
                raise KeyboardInterrupt
            raise UsageError("the time was too short for a single round", hint="give it more with --time")
        raise UsageError(
            f"no feasible motion found; the best one {_worst(problem, searched.least_use.variables)}",
            where=robot_file.robot.name,
            hint="check the joint limits and 'workspace' of the robot file, or give a longer --period",
        )
    return _settled(problem, choices, searched, searched.best.variables, search_choices.solver)


def _settled(
    problem: Problem, choices: DesignChoices, searched: SearchResult, variables: FloatArray, solver: Solver
) -> Design:
    """Check the best candidate between the grid's points, and narrow its limits until it keeps them there."""
    family = problem.family
    dense = family.grid(DENSER * len(problem.time))
    narrowed = problem
    for _ in range(_TIGHTENINGS):
        worst = float(problem.use_along(family.path(variables, dense)).max(initial=0.0))
        if worst <= 1.0:
            break
        narrowed = replace(narrowed, allowed=narrowed.allowed / worst - 1e-3)
        variables = tighten(narrowed, variables, solver)
    else:
        raise IdentificationError(
            "the best motion exceeds a limit between the points of the design grid", hint="give a larger --margin"
        )
    variables = family.begun_near_middle(variables)
    for _ in range(_RAMP_TRIES):
        motion = family.motion(variables)
        count = DENSER * len(problem.time) * max(1, round(motion.duration / float(np.ptp(problem.time))))
        time = np.linspace(0.0, motion.duration, count)
        use = problem.use_along(Path(time, *motion.evaluate(time)))
        if use.max(initial=0.0) <= 1.0:
            return Design(
                choices,
                motion,
                family,
                variables,
                float(np.exp(problem.cost(variables))),
                problem.condition(variables),
                use,
                problem.limits,
                searched,
            )
        family = family.with_longer_ramp(_RAMP_GROWTH)
    raise IdentificationError("the ramp from rest to full speed exceeds a limit", hint="give a longer --ramp")


def _worst(problem: Problem, variables: FloatArray) -> str:
    uses = problem.use(variables)
    worst = int(np.argmax(uses))
    share = f"{100.0 * uses[worst]:.4g} % of the {problem.limits[worst]}"
    return f"uses {share}; the margin allows {100.0 * problem.allowed:.3g} %"
