"""The motion that the arm's controller aimed at, in place of the recorded one: it is free of the sensors' noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from drivers.core.arrays import FloatArray
from ident.linear_algebra.triangular import triangular
from ident.signals.prepared import Prepared, Segment

WEAKEST = 10.0
"""First-stage F below which instruments are weak: their bias may reach a tenth of least squares' (Staiger and Stock,
Econometrica 65, 1997)."""

DEPENDENT = 1e-9
"""Share of a column-normalised instrument that is left beside the others, below which they depend on each other."""


def target_motions(runs: Sequence[Prepared]) -> list[tuple[Segment, ...]] | None:
    """Segments of each run with the targets' motion; None where a segment has none without a gap."""
    motions = []
    for run in runs:
        segments = []
        for segment in run.segments:
            target = segment.target
            if target is None:
                return None
            segments.append(
                replace(segment, position=target.position, velocity=target.velocity, acceleration=target.acceleration)
            )
        motions.append(tuple(segments))
    return motions


def independent_rows(runs: Sequence[Prepared], rows: int) -> float:
    """How many of the filtered equations are independent: two per period of the torques' cut-off."""
    share = np.mean([min(1.0, 2.0 * run.cutoffs.torque / run.filtered_rate) for run in runs])
    return float(share * rows)


def first_stage_f(factor: FloatArray, count: int, rows: float) -> float:
    """F of the weakest combination of W's columns, regressed on as many instruments (Cragg and Donald 1993).

    0 where the instruments depend on each other, as those of a motion that stands still.

    Args:
        factor: triangular factor (2k, 2k) of [Z W].
        count: k.
        rows: independent ones of both.
    """
    lengths = np.linalg.norm(factor, axis=0)
    if not np.all(lengths > 0.0) or np.min(np.abs(np.diag(factor)[:count]) / lengths[:count]) < DEPENDENT:
        return 0.0
    measured = factor[:, count:] / lengths[count:]
    root = triangular(measured)[:count]
    explained = np.linalg.svd(np.linalg.solve(root.T, measured[:count].T), compute_uv=False)[-1] ** 2
    if explained >= 1.0:
        return float("inf")
    return float(explained / (1.0 - explained) * max(0.0, rows - count) / count)
