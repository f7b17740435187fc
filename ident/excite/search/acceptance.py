"""The check that a motion must pass to be written: every limit, between the points of the design grid too."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from daq.motion.limits import check_limits
from daq.motion.trajectories import Motion
from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError
from ident.excite.families.moving_joints import Family
from ident.excite.path import JointPath, repeated_for
from ident.excite.search.problem import DesignProblem

DENSER = 10
"""The check's grid is this many times denser than the one of the design."""
UTILISATION_TOLERANCE = 1e-6
"""Excess of a limit utilisation over what the margin allows that is accepted."""
LEAST_SHARE = 1e-3
"""Smallest amplitude that a motion is shrunk to, as a share of its own."""
_RAMP_GROWTH = 1.4
_RAMP_TRIES = 8
_HALVINGS = 7


@dataclass(frozen=True)
class Accepted:
    """A motion that keeps every limit."""

    family: Family  # of motions, with a longer ramp where that was needed
    variables: FloatArray  # (size,), begun where the arm's approach is short
    motion: Motion  # as played, from rest to rest
    use: FloatArray  # (m,) utilisation of every limit along it, on the dense grid; at most 1


def dense_use(problem: DesignProblem, variables: FloatArray) -> float:
    """Largest limit utilisation at full speed, on the dense grid."""
    dense = problem.family.grid(DENSER * len(problem.time))
    return float(problem.use_along(problem.family.path(variables, dense)).max(initial=0.0))


def accepted(problem: DesignProblem, variables: FloatArray, *, final: bool = False) -> Accepted | None:
    """The motion of x (size,) as it is played; None where it exceeds a limit, however long its ramp.

    With `final` the check before a motion is played is asked, too, as it always is where it knows more.
    """
    if float(problem.use(variables).max(initial=0.0)) > problem.allowed + UTILISATION_TOLERANCE:
        return None
    if dense_use(problem, variables) > 1.0:
        return None
    family = problem.family
    variables = family.begun_near_middle(variables)
    for _ in range(_RAMP_TRIES):
        motion = family.motion(variables)
        looked = repeated_for(motion, 0.0)
        count = DENSER * len(problem.time) * max(1, round(looked.duration / float(np.ptp(problem.time))))
        time = np.linspace(0.0, looked.duration, count)
        use = problem.use_along(JointPath(time, *looked.evaluate(time)))
        if use.max(initial=0.0) <= 1.0 and _within_joint_limits(family, motion):
            if (final or problem.by_hull) and problem.refusal(motion):
                return None
            return Accepted(family, variables, motion, use)
        family = family.with_longer_ramp(_RAMP_GROWTH)
    return None


def _within_joint_limits(family: Family, motion: Motion) -> bool:
    """Check the joints' limits at the exact extremes, as a trajectory file is checked."""
    try:
        check_limits(motion, family.joints.limits, where="")
    except UsageError:
        return False
    return True


def shrunk_to_fit(
    problem: DesignProblem,
    variables: FloatArray,
    pose: FloatArray,
    tick: Callable[[], None] = lambda: None,
    *,
    final: bool = False,
) -> FloatArray | None:
    """The x of the same motion about another pose, with the largest accepted amplitude, up to its own, by bisection.

    None where not even a thousandth of the amplitude is accepted. What `tick` raises before a check ends the bisection.
    """

    def fits(share: float) -> FloatArray | None:
        tick()
        about = problem.family.about(variables, pose, share)
        return about if accepted(problem, about, final=final) is not None else None

    largest = fits(1.0)
    if largest is not None:
        return largest
    largest = fits(LEAST_SHARE)
    if largest is None:
        return None
    low, high = LEAST_SHARE, 1.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        fitting = fits(middle)
        if fitting is None:
            high = middle
        else:
            low, largest = middle, fitting
    return largest
