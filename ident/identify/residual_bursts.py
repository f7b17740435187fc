"""The check on short stretches of time in which the torque leaves the model, confirmed by a fit without them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from drivers.errors import IdentificationError
from ident.assessment.residual_bursts import Burst, bursts_beyond, windows
from ident.estimators.torque_estimator import reduce_torques
from ident.identify.identification import Identification
from ident.model.regressor import RegressorKernel
from ident.regression.comparison import compare_torques
from ident.regression.least_squares import weighted_least_squares
from ident.signals.prepared import Prepared, Segment
from ident.verdict.catalogue import raised
from ident.verdict.check import Check

MOST_SHOWN = 6
"""Stretches that the sentence lists."""

SUSPECT = 3.0
"""Robust σ from which on a stretch is left out for a trial; noise alone reaches 3.5."""

CONFIRMED = 5.0
"""The same for a burst, over the residuals of the fit without the suspect stretches. Recordings without a contact reach
3.8 (3 real arms, 7 built-in and 12 random ones), contacts of half a second that put half of a joint's usual torque on
all joints 5.8 (UR10) and more."""

LARGER = 3.0
"""Residual of a burst over the usual one, of the same fit, as the joints' geometric mean."""

LEAST_ERROR = 0.005
"""Relative error of the fit below which bursts do not matter: a simulation without noise leaves rounding in bursts."""

ROBUST = ("irls", "iirls")
"""Methods that weigh such stretches down by themselves."""


def burst_checks(identification: Identification) -> list[Check]:
    """Stretches of time that bend the fit; none for a method that fits no torques."""
    runs, torques = identification.runs, identification.experiment.torques
    small = identification.fit.relative_error < LEAST_ERROR
    if identification.choices.estimator.equations == "energy" or not torques or small:
        return []
    suspect = bursts_beyond(windows(identification.fit_series, torques), SUSPECT)
    if not any(suspect):
        return []
    kernel = RegressorKernel(identification.model, identification.base.columns)
    place, parts = iter(suspect), []
    for run in runs:
        segments = tuple(_without(segment, next(place)) for segment in run.prepared.segments)
        parts.append(replace(run.prepared, segments=segments))
    try:
        reduction = reduce_torques(kernel, parts, torques)
        solution = weighted_least_squares(reduction, identification.solution.active)
    except IdentificationError:  # too little is left
        return []
    series = [
        part
        for run in runs
        for part in compare_torques(
            kernel.model, kernel.columns, solution.parameters, run.prepared.segments, run.prepared.parallel_filter
        )
    ]
    found = windows(series, torques, suspect)
    bursts = bursts_beyond(found, CONFIRMED, LARGER)
    if not any(bursts):
        return []
    larger = max(float(of_segment.larger[of_segment.deviation > CONFIRMED].max(initial=0.0)) for of_segment in found)
    place = iter(bursts)
    shown = [
        text
        for run in runs
        for text in _texts(run.prepared, float(run.signals.time[0]), place, run.signals.label if len(runs) > 1 else "")
    ]
    more = f" and {len(shown) - MOST_SHOWN} more" if len(shown) > MOST_SHOWN else ""
    robust = "" if identification.choices.estimator.name in ROBUST else ", or compare --method irls"
    text = (
        f"the torque leaves the model in short stretches, by {larger:.0f} times the usual residual, which bends the "
        f"fit: {', '.join(shown[:MOST_SHOWN])}{more}; did something touch the arm? Leave these times out{robust}"
    )
    return [raised("residual-bursts", text)]


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
        f"{before}{one.start - first:.1f}-{one.stop - first:.1f} s" for _ in prepared.segments for one in next(place)
    ]
