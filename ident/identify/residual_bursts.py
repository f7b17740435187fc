"""The check on short bursts of residuals, confirmed by a fit without them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import IdentificationError
from ident.assessment.residual_bursts import REVERSAL, Burst, bursts_beyond, windows
from ident.estimators.torque_estimator import reduce_torques
from ident.identify.identification import Identification, PreparedRun
from ident.model.regressor import RegressorKernel
from ident.regression.comparison import TorqueSeries, compare_torques
from ident.regression.least_squares import weighted_least_squares
from ident.signals.prepared import Prepared, Segment
from ident.verdict.catalogue import raised
from ident.verdict.check import Check

MOST_SHOWN = 6
"""Stretches that the sentence lists."""

SUSPECT = 3.0
"""Robust σ from which on a window is left out for a trial; noise alone reaches 3.5."""

CONFIRMED = 5.0
"""The same for a burst, over the residuals of the fit without the suspect windows. Recordings without a contact reach
3.8 (3 real arms, 7 built-in and 12 random ones), contacts of half a second that put half of a joint's usual torque on
all joints 5.8 (UR10) and more."""

LARGER = 3.0
"""Residual of a burst over the usual one, of the same fit, as the joints' geometric mean."""

GAP = 2.5
"""Time between rows, over the usual one, from which on the positions between are too uncertain for accelerations."""

LEAST_ERROR = 0.005
"""Relative error of fit and validation below which bursts do not matter: without noise, rounding comes in bursts."""

MOST_ERROR = 0.15
"""Relative error beyond the suspect windows, without them in the fit, up to which bursts are what is wrong."""

ROBUST = ("irls", "iirls")
"""Methods that weigh bursts down by themselves."""


def burst_checks(identification: Identification) -> list[Check]:
    """Stretches of time in which something touched the arm; none for a method that fits no torques."""
    torques = identification.experiment.torques
    errors = [fit.relative_error for fit in (identification.fit, identification.validation) if fit is not None]
    small = max(errors) < LEAST_ERROR
    if identification.choices.estimator.equations == "energy" or not torques or small:
        return []
    halves = tuple(
        (runs, _away_from_gaps(runs, series))
        for runs, series in (
            (identification.runs, identification.fit_series),
            (identification.validation_runs, identification.validation_series),
        )
    )
    suspects = [bursts_beyond(windows(series, torques), SUSPECT) for _, series in halves]
    if not any(any(of_half) for of_half in suspects):
        return []
    kernel = RegressorKernel(identification.model, identification.base.columns)
    parameters = _without_bursts(identification, kernel, suspects[0])
    if parameters is None:
        return []
    squares, power = 0.0, 0.0
    shown, larger, several = [], 0.0, len({run.signals.label for runs, _ in halves for run in runs}) > 1
    for (runs, _), suspect in zip(halves, suspects, strict=True):
        series = [
            compared
            for run in runs
            for compared in compare_torques(
                kernel.model, kernel.columns, parameters, run.prepared.segments, run.prepared.parallel_filter
            )
        ]
        for torque, bursts in zip(series, suspect or [[] for _ in series], strict=True):
            kept = torque.counted & ~np.any(
                [burst.within(torque.time) for burst in bursts] or [np.zeros(1, bool)], axis=0
            )
            squares += float(np.sum(np.where(kept, torque.residual**2, 0.0)))
            power += float(np.sum(np.where(kept, torque.measured**2, 0.0)))
        per_segment = windows(_away_from_gaps(runs, series), torques, suspect or None)
        place = iter(bursts_beyond(per_segment, CONFIRMED, LARGER) or [[] for _ in series])
        for run in runs:
            first = float(run.signals.time[0])
            shown += _texts(run.prepared, first, place, run.signals.label if several else "")
        larger = max(
            [larger, *(float(entry.larger[entry.deviation > CONFIRMED].max(initial=0.0)) for entry in per_segment)]
        )
    if not shown or squares > MOST_ERROR**2 * power:
        return []
    more = f" and {len(shown) - MOST_SHOWN} more" if len(shown) > MOST_SHOWN else ""
    robust = "" if identification.choices.estimator.name in ROBUST else ", or compare --method irls"
    text = (
        f"the residual has short bursts, {larger:.0f} times the usual residual: {', '.join(shown[:MOST_SHOWN])}{more}; "
        f"if something touched the arm, leave these times out{robust}"
    )
    return [raised("residual-bursts", text)]


def _away_from_gaps(runs: Sequence[PreparedRun], series: Sequence[TorqueSeries]) -> list[TorqueSeries]:
    """The series of all segments without what lies about rows that were left out one after the other.

    Positions in between are interpolated, and their second derivatives are wrong for a moment.
    """
    of_segments = [run for run in runs for _ in run.prepared.segments]
    kept = []
    for run, torque in zip(of_segments, series, strict=True):
        used = torque.used.copy()
        if run.signals.stale is not None:
            time = run.signals.time
            steps = np.diff(time)
            for row in np.flatnonzero(steps > GAP * np.median(steps)):
                used &= (torque.time < time[row] - REVERSAL) | (torque.time > time[row + 1] + REVERSAL)
        kept.append(replace(torque, used=used))
    return kept


def _without_bursts(
    identification: Identification, kernel: RegressorKernel, bursts: Sequence[Sequence[Burst]]
) -> FloatArray | None:
    """The parameters of a fit without bursts; None where too little is left."""
    if not any(bursts):
        return identification.solution.parameters
    place, parts = iter(bursts), []
    for run in identification.runs:
        segments = tuple(_without(segment, next(place)) for segment in run.prepared.segments)
        parts.append(replace(run.prepared, segments=segments))
    try:
        reduction = reduce_torques(kernel, parts, identification.experiment.torques)
        return weighted_least_squares(reduction, identification.solution.active).parameters
    except IdentificationError:
        return None


def _without(segment: Segment, bursts: Sequence[Burst]) -> Segment:
    """The segment with the samples of bursts not used."""
    used = segment.used.copy()
    for burst in bursts:
        used &= ~burst.within(segment.time)
    return replace(segment, used=used)


def _texts(prepared: Prepared, first: float, place: Iterator[list[Burst]], label: str) -> list[str]:
    """The bursts of a run as times [s] after its first stamp."""
    before = f"{label}: " if label else ""
    return [
        f"{before}{span.start - first:.1f}-{span.stop - first:.1f} s" for _ in prepared.segments for span in next(place)
    ]
