"""Torques, of one joint or of all, that belong to another time than the positions: by more than a delay of drives.

At one set of instants, so far from the ends that every shift is within the recording, the normal equations stay the
same and only their right side changes with the shift. The best shift is confirmed under the conditions of every arm.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drivers.core.arrays import BoolArray, FloatArray
from ident.assessment.instants import Instants
from ident.assessment.mistakes.competition import EXPLAINED, HALVED, JOINT_EXPLAINED, RIVAL, Competition
from ident.assessment.mistakes.equations import LEAST_ERROR, RIDGE, equations
from ident.verdict.catalogue import raised
from ident.verdict.check import Check

LONGEST, PART = 3.0, 0.2
"""Shift [s] that is sought at most, and part of the recording's duration."""

STEP = 0.02
NEAR = 0.3
"""Steps of the shift, and difference below which two shifts are one [s]."""

LARGEST_GAP = 0.1
"""Time [s] between two instants beyond which torques are not interpolated."""

LEAST_SHIFT = 0.15
"""Shorter ones [s] are delays, which are sought and taken out."""


def shift_check(competition: Competition) -> list[Check]:
    """The check of torques that belong to another time, if one shift explains the data and no other does.

    Args:
        competition: a recording that nothing explains that is wrong with signs, columns or gravity.
    """
    found = _best(competition)
    if found is None:
        return []
    joint, shift = found
    names = competition.model.joint_names
    whose = "all torques" if joint is None else f"the torque of {names[joint]}"
    text = (
        f"{whose} {'belongs' if joint is not None else 'belong'} to the motion {abs(shift):.2f} s "
        f"{'before' if shift > 0 else 'after'} its stamps: this explains the data, unlike what was recorded; check how "
        "torque and position are stamped and merged"
    )
    return [raised("torque-shifted", text, [] if joint is None else [names[joint]])]


def _best(competition: Competition) -> tuple[int | None, float] | None:
    """Joint (None: all) and time [s] by which its torque is late, of the shift that explains the recording."""
    few, joints = competition.instants, list(competition.joints)
    span = min(LONGEST, PART * float(np.ptp(few.time)))
    inside = _inside(few.time, span)
    if len(joints) < 2 or np.count_nonzero(inside) < 2 * len(competition.active):
        return None
    shifts = STEP * np.arange(-int(span / STEP), int(span / STEP) + 1)
    torque = np.array([_later(few, shift, inside) for shift in shifts])
    rows = competition.regressor(few)[:, :, inside]
    levels = _levels(rows[joints], np.where(few.counted[joints][:, inside], 1.0, 0.0), torque[:, joints])
    row, best = np.unravel_index(int(np.argmin(levels)), levels.shape)
    rivals = levels.copy()
    rivals[row, np.abs(shifts - shifts[best]) < NEAR] = np.inf
    if abs(shifts[best]) < LEAST_SHIFT or rivals.min() < levels[row, best] + RIVAL:
        return None
    joint = joints[row] if row < len(joints) else None
    own = np.arange(len(few.torque)) == joint if joint is not None else np.ones(len(few.torque), dtype=np.bool_)
    fits = []
    for moved in (torque[len(shifts) // 2], np.where(own[:, None], torque[best], torque[len(shifts) // 2])):
        part = replace(
            few, torque=moved, counted=few.counted[:, inside], block=few.block[inside], time=few.time[inside]
        )
        system = equations(rows, part, competition.experiment.torques)
        fit = system.fit(competition.recorded.torques, competition.system(competition.recorded)[1])
        if fit is None:
            return None
        power = np.einsum("kjj->j", system.power)
        fits.append((fit, float(np.sqrt(fit.relative @ power / power.sum()))))
    (plain, _), (fit, error) = fits
    explained = error < EXPLAINED and (joint is None or fit.relative[joint] < JOINT_EXPLAINED**2)
    return (joint, float(shifts[best])) if plain.level - fit.level > HALVED and explained else None


def _inside(time: FloatArray, span: float) -> BoolArray:
    """(N,) instants so far from the ends and from gaps that every shift has torques on both sides."""
    gaps = np.flatnonzero(np.diff(time) > LARGEST_GAP)
    edges = np.concatenate([[time[0]], time[gaps], time[gaps + 1], [time[-1]]])
    after, before = edges[np.searchsorted(edges, time, side="right") - 1], edges[np.searchsorted(edges, time)]
    return np.asarray((time - after >= span) & (before - time >= span))


def _later(few: Instants, shift: float, inside: BoolArray) -> FloatArray:
    """Torques (n, M) so much later than some instants [s]."""
    return np.stack([np.interp(few.time[inside] + shift, few.time, row) for row in few.torque])


def _levels(rows: FloatArray, counted: FloatArray, torque: FloatArray) -> FloatArray:
    """Σ log of the joints' relative squared residuals (n + 1, S): of each joint's torque shifted alone, and of all.

    Args:
        rows: (n, a, M) regressor.
        counted: (n, M) 1 where an equation counts.
        torque: (S, n, M) at every shift; the middle one is none.
    """
    none = len(torque) // 2
    gram = np.einsum("nam,nm,nbm->nab", rows, counted, rows, optimize=True)
    score = np.einsum("nam,nm,snm->sna", rows, counted, torque, optimize=True)
    power = np.einsum("nm,snm->sn", counted, torque**2)
    weight = counted.sum(axis=1) / np.maximum(power[none], np.finfo(float).tiny)
    matrix = np.tensordot(weight, gram, 1)
    scale = np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    inverse = np.linalg.inv(matrix / np.outer(scale, scale) + RIDGE * np.eye(len(scale))) / np.outer(scale, scale)
    levels = []
    for joint in range(len(rows) + 1):
        moved = np.arange(len(rows)) == joint if joint < len(rows) else np.ones(len(rows), dtype=np.bool_)
        own, size = np.where(moved[:, None], score, score[none]), np.where(moved, power, power[none])
        values = np.tensordot(own, weight, axes=(1, 0)) @ inverse
        squares = size - 2.0 * np.einsum("sna,sa->sn", own, values)
        squares += np.einsum("sa,nab,sb->sn", values, gram, values, optimize=True)
        relative = np.maximum(squares, 0.0) / np.maximum(size, np.finfo(float).tiny)
        levels.append(np.log(relative + LEAST_ERROR**2).sum(axis=1))
    return np.array(levels)
