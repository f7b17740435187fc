"""Design of an excitation trajectory: the problem, its search, the motion that is played."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from daq.motion.trajectories import Motion
from daq.robot.loader import RobotFile
from drivers.core.arrays import FloatArray
from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.errors import UsageError
from ident.excite.build import build_problem
from ident.excite.choices import DesignChoices
from ident.excite.path import Family
from ident.excite.prior import PriorKnowledge
from ident.excite.search.acceptance import accepted
from ident.excite.search.poses import NoFeasiblePoseError
from ident.excite.search.search import SearchChoices, SearchResult, search


@dataclass(frozen=True)
class Design:
    """A designed excitation.

    Attributes:
        choices: its options.
        motion: as played, from rest to rest.
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
    prior: PriorKnowledge,
    choices: DesignChoices,
    search_choices: SearchChoices,
    earlier: Motion | None = None,
    progress: Callable[[SearchResult], None] = lambda result: None,
    clock: Clock = SYSTEM_CLOCK,
) -> Design:
    """Design an excitation trajectory; Ctrl-C ends the search with the best so far.

    With several processes the caller's main module must be importable without side effects (`if __name__ == …`).

    Args:
        robot_file: the arm.
        prior: prior parameters and noise.
        choices: the user's.
        search_choices: how long and how to search.
        earlier: a motion to start from.
        progress: called after each better motion, and a few times per second.
        clock: the host's.

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
    checked = accepted(problem, variables)
    assert checked is not None, "a candidate has passed this check already"
    return Design(
        choices=choices,
        motion=checked.motion,
        family=checked.family,
        variables=checked.variables,
        cost=float(np.exp(problem.cost(checked.variables))),
        condition=problem.condition(checked.variables),
        use=checked.use,
        limits=problem.limits,
        search=searched,
    )
