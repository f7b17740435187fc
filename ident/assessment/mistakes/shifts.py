"""Torques, of one joint or of all, that belong to another time than the positions: by more than a delay of drives.

At instants so far from the ends that every shift is within their recording the normal matrix stays the same, and
only its right side changes with the shift.
"""

from __future__ import annotations

import numpy as np

from drivers.core.arrays import FloatArray
from ident.assessment.mistakes.competition import COUPLED, HALVED, RIVAL, WELL_EXPLAINED, Competition
from ident.assessment.mistakes.equations import LEAST_ERROR, RIDGE
from ident.verdict.catalogue import raised
from ident.verdict.check import Check

LONGEST, PART = 3.0, 0.2
"""Shift [s] that is sought at most, and part of the recording's duration."""

STEP, NEAR = 0.02, 0.3
"""Steps of the shift, and difference below which two shifts are one [s]."""

LEAST_SHIFT = 0.15
"""Shorter ones [s] are delays, which are sought and taken out."""


def shift_check(competition: Competition) -> list[Check]:
    """The check of torques that belong to another time, if one shift explains the data and no other does.

    Args:
        competition: a recording that nothing explains that is wrong with signs, columns or gravity.
    """
    few, joints = competition.instants, list(competition.joints)
    runs = [here for number in range(len(few.tracks)) if len(here := np.flatnonzero(few.track == number))]
    span = min(LONGEST, PART * max((float(np.ptp(few.time[here])) for here in runs), default=0.0))
    none = int(span / STEP)
    shifts = STEP * np.arange(-none, none + 1)
    later, inside = np.zeros((len(shifts), len(joints), len(few.time))), np.zeros(len(few.time), dtype=bool)
    for here in runs:
        time = few.time[here]
        inside[here] = (time >= time[0] + span) & (time <= time[-1] - span)
        for number, joint in enumerate(joints):
            later[:, number, here] = np.interp(time + shifts[:, None], time, few.torque[joint, here])
    if len(joints) < 2 or np.count_nonzero(inside) < 2 * len(competition.active):
        return []
    counted = few.counted[joints][:, inside].astype(np.float64)
    relative, errors = _fits(competition.regressor(few)[joints][:, :, inside], counted, later[:, :, inside])
    levels = np.log(relative + LEAST_ERROR**2).sum(axis=2)
    row, best = (int(index) for index in np.unravel_index(int(np.argmin(levels)), levels.shape))
    level, plain, alone = levels[row, best], levels[0, none], row < len(joints)
    levels[row, np.abs(shifts - shifts[best]) < NEAR] = np.inf
    if (
        abs(shifts[best]) < LEAST_SHIFT
        or min(levels.min() - RIVAL, plain - 2.0 * HALVED) < level
        or errors[row, best] > COUPLED
        or (alone and relative[row, best, row] > WELL_EXPLAINED**2)
    ):
        return []
    names = [competition.model.joint_names[joints[row]]] if alone else []
    what, its = (f"the torque of {names[0]} belongs", "its") if alone else ("all torques belong", "their")
    text = (
        f"{what} to the motion {abs(shifts[best]):.2f} s {'before' if shifts[best] > 0 else 'after'} {its} stamps: "
        "this explains the data, unlike what was recorded; check how torque and position are stamped and merged"
    )
    return [raised("torque-shifted", text, names)]


def _fits(rows: FloatArray, counted: FloatArray, torque: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Fits with each joint's torque shifted alone, and with all, at every shift.

    Args:
        rows: (n, a, M) regressor.
        counted: (n, M) 1 where an equation counts.
        torque: (S, n, M) at every shift; the middle one is none.

    Returns:
        The joints' squared residuals over their squared torques (n + 1, S, n), and errors of the arm (n + 1, S).
    """
    none, tiny = len(torque) // 2, np.finfo(float).tiny
    gram = np.einsum("nam,nm,nbm->nab", rows, counted, rows, optimize=True)
    score = np.einsum("nam,nm,snm->sna", rows, counted, torque, optimize=True)
    power = np.maximum(np.einsum("nm,snm->sn", counted, torque**2), tiny)
    weight = counted.sum(axis=1) / power[none]
    matrix = np.tensordot(weight, gram, 1)
    scale = np.sqrt(np.maximum(np.diag(matrix), tiny))
    inverse = np.linalg.inv(matrix / np.outer(scale, scale) + RIDGE * np.eye(len(scale))) / np.outer(scale, scale)
    relative, errors = [], []
    for joint in range(len(rows) + 1):
        moved = (np.arange(len(rows)) == joint) | (joint == len(rows))
        own, size = np.where(moved[:, None], score, score[none]), np.where(moved, power, power[none])
        values = np.tensordot(own, weight, axes=(1, 0)) @ inverse
        squares = size - 2.0 * np.einsum("sna,sa->sn", own, values)
        squares += np.einsum("sa,nab,sb->sn", values, gram, values, optimize=True)
        squares = np.maximum(squares, 0.0)
        relative.append(squares / size)
        errors.append(np.sqrt(squares.sum(axis=1) / size.sum(axis=1)))
    return np.array(relative), np.array(errors)
