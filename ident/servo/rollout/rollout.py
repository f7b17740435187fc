"""Roll-out of servo joints on commands, many pieces of motion side by side, with derivatives by their parameters.

Every joint is one equation, with gravity known along the motion. The joints of a piece move each other by the inertia
between them, which is known along the motion, too: a step solves them together, or, where only single joints are
looked at, takes the torque between them as known. A step is the implicit midpoint rule: half a step implicit in
damping, stiffness and friction (soft threshold, so that sticking is exact), and its velocity over the whole step. It is
stable with any step, and neither ahead of the joint nor damped. A joint that comes to rest within a step sticks or
turns there, and a goal that changes within a step meets the drive's limit before and after: with the friction or the
limit of the whole step's mean, errors would fall with the step only, and the cost would jump with the parameters.
"""

from __future__ import annotations

from ctypes import c_double, c_long
from dataclasses import replace
from typing import Any

import numpy as np

from drivers.core.arrays import FloatArray, IndexArray
from drivers.core.errors import UsageError
from ident.compiled.library import Call, kernels
from ident.servo.rollout.goals import Goals, goals_of
from ident.servo.rollout.lanes import THINNED, Lanes, RollOut
from ident.servo.rollout.numpy_rollout import Together, roll_out_numpy
from ident.servo.terms import INDEX, TERMS


def roll_out(
    lanes: Lanes,
    values: FloatArray,
    terms: IndexArray | None = None,
    owners: IndexArray | None = None,
    surface: FloatArray | None = None,
) -> RollOut:
    """Roll lanes out on their commands.

    Args:
        lanes: K steps, L lanes. Where none moves another, each is a piece of its own.
        values: (terms, L) parameters of each lane.
        terms: (F,) indices of the terms to derive by; none where None.
        owners: (F,) the joint of a piece whose term it is; 0 where None.
        surface: (5, P) height [m] and stiffness [N/m] of what each piece may touch, and the point (3) [m] that touches;
            nothing is touched where None.
    """
    terms = np.zeros(0, dtype=np.intp) if terms is None else terms
    owners = np.zeros_like(terms) if owners is None else owners
    delay, steepest = values[INDEX["delay"]], values[INDEX["acceleration_limit"]]
    goals = goals_of(lanes, delay, steepest, {TERMS[term].name for term in terms})
    together, library = Together(lanes, surface), kernels().long
    if library is None and values[INDEX["backlash"]].any():
        raise UsageError("backlash in a servo model needs a C compiler, and there is none", hint="install gcc or clang")
    if library is None:
        return roll_out_numpy(lanes, values, (terms, owners), goals, together)
    return _compiled(library, lanes, values, (terms, owners), goals, together)


def with_pull(lanes: Lanes, values: FloatArray) -> Lanes:
    """Lanes whose joints' torques on each other are known: those of a roll-out with values (n, terms)."""
    if lanes.between is None:
        return lanes
    return replace(lanes, load=lanes.load + roll_out(lanes, values[lanes.joint].T).pull, between=None)


def _compiled(
    library: Any,
    lanes: Lanes,
    values: FloatArray,
    parameters: tuple[IndexArray, IndexArray],
    goals: Goals,
    together: Together,
) -> RollOut:
    """The same by the library's C code."""
    (count, width), (terms, owners) = lanes.load.shape, parameters
    coupled, touched, joints = lanes.between is not None, together.touched, together.joints
    pieces, samples = width // joints, len(lanes.sample)
    path, pull = np.empty((count, width)), np.empty((count, width if coupled else 0))
    slopes = np.empty((pieces, samples if len(terms) else 0, joints, len(terms)))
    force = np.empty((count, together.pieces if touched else 0))
    call = Call()
    library.servo_roll_out(
        *(c_long(size) for size in (count, pieces, joints)),
        c_double(lanes.step),
        *map(call.given, (values, lanes.inertia, lanes.load, lanes.load_slope, lanes.start, goals.path, goals.late)),
        *(call.given(lanes.between), c_long(THINNED), call.given(pull if coupled else None)),
        *(call.given(array if touched else None) for array in (together.clear, together.lever, together.surface)),
        *(call.given(force if touched else None), c_long(len(terms))),
        *(call.given(owners, np.int_), call.given(terms, np.int_)),
        *(call.given(goals.by_limit), c_long(samples)),
        *(call.given(lanes.sample[:, ::joints]), call.given(path), call.given(slopes)),
    )
    return RollOut(path, slopes, force, pull)
