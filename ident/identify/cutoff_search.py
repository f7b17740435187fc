"""Lower cut-offs where positions jitter: noise that widens the motion's band would pass the filters chosen by it.

Jitter of the positions, or of the moments at which they were read, is no motion, but its spectrum looks like one. It
shows in the acceleration, which grows with the cut-off where the motion's own does not. Then lower cut-offs are tried,
and judged by what matters: the error of the slow part of the torque on parts of the data that were not fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import DynidError
from drivers.core.text import percent_text
from ident.model.regressor import RegressorKernel
from ident.regression.jackknife import rows_by_block
from ident.signals.cutoffs import parallel_filter
from ident.signals.filters import ZeroPhaseFilter
from ident.signals.options import PreprocessChoices
from ident.signals.prepared import Prepared
from ident.verdict.catalogue import raised
from ident.verdict.check import Check

GROWTH = 1.25
"""Acceleration (root mean square) with the cut-offs chosen by the band over that with half of them, from which on lower
ones are tried. It is 0.9 to 1.1 on TX40, UR10 and Panda, and 1.3 or more once their positions jitter by 4 ms."""

LOWEST_HZ = 1.0
"""Lowest cut-off of the torque [Hz]; half of the positions'."""

BETTER = 0.8
"""Lower cut-offs are taken where they reduce the held-out error to this share or less."""

AS_GOOD = 1.1
"""The highest cut-offs are taken whose error is within this factor of the least."""

BLOCKS = 8
"""Parts of the data, every other one held out in turn."""


@dataclass(frozen=True)
class LoweredCutoffs:
    """Cut-offs that were lowered because the positions jitter."""

    choices: PreprocessChoices  # with the new cut-offs
    # before, after: cut-off of the positions [Hz]
    before: float
    after: float
    # error_before, error_after: relative error of the slow part of the torque on data that were not fitted
    error_before: float
    error_after: float


Prepare = Callable[[PreprocessChoices], Prepared]
"""Prepares the data anew with other choices."""


def lowered_cutoffs(
    kernel: RegressorKernel, prepared: Prepared, prepare: Prepare, choices: PreprocessChoices, torques: Sequence[int]
) -> LoweredCutoffs | None:
    """Lower cut-offs for data whose positions jitter; None where those chosen by the band are kept.

    Args:
        kernel: of the base columns.
        prepared: with the cut-offs chosen by the band.
        prepare: prepares the same data with other choices.
        choices: the user's; cut-offs that are given stay.
        torques: indices of the motors whose torques are used.
    """
    given = (choices.position_cutoff, choices.torque_cutoff, choices.decimate)
    plain = choices.differentiation == choices.filter == "butterworth" and choices.position_decimate == 1
    if not plain or any(value is not None for value in given):
        return None
    tried = [(choices, prepared)]
    cutoff = prepared.cutoffs.torque / 2.0
    while cutoff >= LOWEST_HZ:
        lower = replace(choices, torque_cutoff=cutoff, position_cutoff=2.0 * cutoff)
        try:
            tried.append((lower, prepare(lower)))
        except DynidError:  # too short for such a filter
            break
        if len(tried) == 2 and not _jitters(prepared, tried[1][1], torques):
            return None
        cutoff /= 2.0
    if len(tried) == 1:
        return None
    slowest = tried[-1][1]
    slow = parallel_filter(slowest.cutoffs, choices.filter, slowest.segments[0].rate)
    errors = [_held_out_error(kernel, choice, slow, torques) for _, choice in tried]
    best = next(place for place, error in enumerate(errors) if error <= AS_GOOD * min(errors))
    if errors[best] > min(1.0, BETTER * errors[0]):  # parts of the data that do not predict others judge nothing
        return None
    lower, found = tried[best]
    return LoweredCutoffs(lower, prepared.cutoffs.position, found.cutoffs.position, errors[0], errors[best])


def cutoff_checks(lowered: LoweredCutoffs | None) -> list[Check]:
    """Return what was done about positions that jitter."""
    if lowered is None:
        return []
    text = (
        "the positions jitter, which looks like a motion of high frequency: with their cut-off lowered from "
        f"{lowered.before:.3g} to {lowered.after:.3g} Hz the error on held-out parts falls from "
        f"{percent_text(lowered.error_before, 2)} to {percent_text(lowered.error_after, 2)}; record stamps and "
        "positions of the controller, or give --position-cutoff"
    )
    return [raised("positions-jitter", text)]


def _jitters(prepared: Prepared, lower: Prepared, torques: Sequence[int]) -> bool:
    """Return whether the acceleration of most motors grows with the cut-off."""
    first, second = (_acceleration(run)[list(torques)] for run in (prepared, lower))
    moving = second > 0.0
    return bool(moving.any()) and float(np.median(first[moving] / second[moving])) > GROWTH


def _acceleration(prepared: Prepared) -> FloatArray:
    """Root mean square (n,) of the accelerations that count."""
    values = np.concatenate([segment.acceleration[:, segment.used] for segment in prepared.segments], axis=1)
    return np.asarray(np.sqrt(np.mean(values**2, axis=1)))


def _held_out_error(
    kernel: RegressorKernel, prepared: Prepared, slow: ZeroPhaseFilter, torques: Sequence[int]
) -> float:
    """Relative error of the slow torque on every other block, by the parameters of the others, and the other way round.

    Args:
        kernel: of the base columns.
        prepared: data with the cut-offs to judge; the fit is made with its own parallel filter.
        slow: filter through which the error is seen, the same for all cut-offs.
        torques: indices of the motors whose torques are used.
    """
    fitted = _grams(kernel, prepared, prepared.parallel_filter, torques)
    seen = _grams(kernel, prepared, slow, torques)
    count = len(kernel.columns)
    squares = power = 0.0
    for held_out in (0, 1):
        normal, right = np.zeros((count, count)), np.zeros(count)
        for joint, gram in fitted.items():
            columns, held = list(kernel.joint_rows[joint].columns), gram[1 - held_out]
            weight = 1.0 / held[-1, -1] if held[-1, -1] > 0.0 else 0.0
            normal[np.ix_(columns, columns)] += weight * held[:-1, :-1]
            right[columns] += weight * held[:-1, -1]
        scale = np.sqrt(np.diag(normal))
        scale = np.where(scale > 0.0, scale, 1.0)
        parameters = np.linalg.lstsq(normal / np.outer(scale, scale), right / scale, rcond=1e-10)[0] / scale
        for joint, gram in seen.items():
            size = float(gram[:, -1, -1].sum())
            combination = np.append(-parameters[list(kernel.joint_rows[joint].columns)], 1.0)
            squares += max(0.0, float(combination @ gram[held_out] @ combination)) / size if size > 0.0 else 0.0
            power += float(gram[held_out, -1, -1]) / size if size > 0.0 else 0.0
    return float(np.sqrt(squares / power)) if power > 0.0 else 1.0


def _grams(
    kernel: RegressorKernel, prepared: Prepared, parallel: ZeroPhaseFilter, torques: Sequence[int]
) -> dict[int, FloatArray]:
    """Gram matrices (2, w + 1, w + 1) of [W_j τ_j] of the even and the odd blocks, by joint."""
    dof = kernel.model.dof
    sizes = {joint: len(kernel.joint_rows[joint].columns) + 1 for joint in torques}
    grams = {joint: np.zeros((2, size, size)) for joint, size in sizes.items()}
    first, last = prepared.segments[0].time[0], prepared.segments[-1].time[-1]
    for segment in prepared.segments:
        place = (segment.time[:: parallel.factor] - first) / max(last - first, np.finfo(float).tiny)
        half = np.minimum((place * BLOCKS).astype(np.int64), BLOCKS - 1) % 2
        for block in rows_by_block(kernel, segment, parallel, half, segment.torque):
            for joint in torques:
                rows = np.concatenate([block.regressor[kernel.joint_rows[joint].rows], block.torque[joint::dof]])
                grams[joint][block.index] += rows @ rows.T
    return grams
