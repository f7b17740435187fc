"""Short times in which the torque leaves the model by far: contacts, collisions, a cable, a hand on the arm.

A model that lacks something leaves residuals that grow and fall with the motion. A contact leaves a burst of some
tenths of a second, in several joints at once. So windows are compared with what this recording's other windows are
like: each joint's mean squared residual over its median, as a logarithm, summed over the joints, in robust standard
deviations of that sum. Windows overlap and the residuals are dependent; the median and the median deviation of the sum
do not mind. Samples near a velocity reversal do not count, where static friction is in no model. What is left is
confirmed by a fit without the bursts.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers.core.arrays import BoolArray, FloatArray
from drivers.core.errors import IdentificationError
from drivers.core.text import first_few
from ident.estimators.torque_estimator import reduce_torques
from ident.identify.data_split import PreparedRun
from ident.identify.identification import Identification
from ident.model.regressor import RegressorKernel
from ident.regression.comparison import TorqueSeries, compare_torques
from ident.regression.least_squares import weighted_least_squares
from ident.signals.prepared import Prepared, Segment
from ident.signals.segments import HOLES, about_holes
from ident.verdict.catalogue import raised
from ident.verdict.check import Check

WINDOW = 0.3
"""[s] over which the squared residuals are averaged."""

FEWEST_WINDOWS = 10
"""Recordings of fewer, end to end, do not show what is usual."""

SLOW = 0.1
"""Share of its root mean square below which a joint's velocity is near a reversal."""

REVERSAL = 0.1
"""[s] before and after a reversal that do not count, since the filter spreads what happens there."""

MOST_REPEATED = 0.1
"""Share of rows that repeat others beyond which the holes that they leave make bursts of their own."""

COUNTED = 0.5
"""Share of a window's samples that must count for a joint."""

MOST_TIME = 0.25
"""Share of the time beyond which bursts are the rule, and the model is wrong."""

APART = 0.5
"""[s]; bursts that are closer are one."""

LEAST_LEVEL = 1e-6
"""Share of a joint's median squared residual below which a value is rounding."""

_MEDIAN_OF_NORMAL = 0.6745

MOST_SHOWN = 6
"""Bursts that the sentence lists."""

SUSPECT = 3.0
"""Robust σ from which on a window is left out for a trial; noise alone reaches 3.5."""

CONFIRMED = 5.0
"""The same for a burst, over the residuals of the fit without the suspect windows. Recordings without a contact reach
3.8 (3 real arms, 7 built-in and 12 random ones), contacts of half a second that put half of a joint's usual torque on
all joints 5.8 (UR10) and more."""

LARGER = 3.0
"""Residual of a burst over the usual one, of the same fit, as the joints' geometric mean."""

LEAST_ERROR = 0.005
"""Relative error of fit and validation below which bursts do not matter: without noise, rounding comes in bursts."""

MOST_ERROR = 0.15
"""Relative error beyond the suspect windows, without them in the fit, up to which bursts are what is wrong."""

LEAST_SHARE = 0.2
"""Least share of a joint's squared residual in the suspect windows. With less in all joints, leaving them out lowers no
joint's error by more than a tenth of itself, and nothing is gained."""

ROBUST = ("irls", "iirls")
"""Methods that weigh bursts down by themselves."""


def burst_checks(identification: Identification) -> list[Check]:
    """Times in which something touched the arm; none for a method that fits no torques."""
    torques = identification.experiment.torques
    errors = [fit.relative_error for fit in (identification.fit, identification.validation) if fit is not None]
    small = max(errors) < LEAST_ERROR
    stale = [run.signals.stale for run in identification.runs if run.signals.stale is not None]
    holes = any(np.mean(one.repeated | one.held) > MOST_REPEATED for one in stale)
    if identification.choices.estimator.equations == "energy" or not torques or small or holes:
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
    squares, kept_squares, power = (np.zeros(len(identification.model.joint_names)) for _ in range(3))
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
            squares += np.sum(np.where(torque.counted, torque.residual**2, 0.0), axis=1)
            kept_squares += np.sum(np.where(kept, torque.residual**2, 0.0), axis=1)
            power += np.sum(np.where(kept, torque.measured**2, 0.0), axis=1)
        per_segment = windows(_away_from_gaps(runs, series), torques, suspect or None)
        place = iter(bursts_beyond(per_segment, CONFIRMED, LARGER) or [[] for _ in series])
        for run in runs:
            first = float(run.signals.time[0])
            shown += _texts(run.prepared, first, place, run.signals.label if several else "")
        larger = max(
            [larger, *(float(entry.larger[entry.deviation > CONFIRMED].max(initial=0.0)) for entry in per_segment)]
        )
    lower = kept_squares < (1.0 - LEAST_SHARE) * squares
    if not shown or not lower.any() or np.sum(kept_squares) > MOST_ERROR**2 * np.sum(power):
        return []
    robust = "" if identification.choices.estimator.name in ROBUST else ", or compare --method irls"
    text = (
        f"the residual has short bursts, {larger:.0f} times the usual residual: {first_few(shown, MOST_SHOWN)}; "
        f"if something touched the arm, leave these times out{robust}"
    )
    return [raised("residual-bursts", text)]


def _away_from_gaps(runs: Sequence[PreparedRun], series: Sequence[TorqueSeries]) -> list[TorqueSeries]:
    """The series of all segments without what lies about rows that were left out one after the other."""
    of_segments = [run for run in runs for _ in run.prepared.segments]
    kept = []
    for run, torque in zip(of_segments, series, strict=True):
        used = torque.used.copy()
        if run.signals.stale is not None:
            stamps = run.signals.time
            used &= ~about_holes(torque.time, stamps, HOLES[1] * float(np.median(np.diff(stamps))))
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


@dataclass(frozen=True)
class Burst:
    """A time of large residuals, by its first and last stamp [s] in its recording's clock."""

    start: float
    stop: float

    def within(self, time: FloatArray) -> BoolArray:
        """(M,) which of some stamps [s] it holds."""
        return np.asarray((time >= self.start) & (time <= self.stop))


@dataclass(frozen=True, eq=False)
class Windows:
    """All windows of a segment.

    Attributes:
        start, stop: (K,) first and last stamp [s].
        deviation: (K,) of the joints' summed log squared residual from its median, in robust σ; nan where none counts.
        larger: (K,) geometric mean over the joints of the residual over the usual one.
    """

    start: FloatArray
    stop: FloatArray
    deviation: FloatArray
    larger: FloatArray


def windows(
    series: Sequence[TorqueSeries], torques: Sequence[int], bursts: Sequence[Sequence[Burst]] | None = None
) -> list[Windows]:
    """The windows of each segment, compared with all that hold no burst; none where there are too few.

    Args:
        series: measured and predicted torques, one per segment.
        torques: indices of the motors whose torques are used.
        bursts: of each segment.
    """
    chosen = list(torques)
    squares = [np.sum(np.where(part.counted, part.velocity**2, 0.0), axis=1) for part in series]
    counts = [np.sum(part.counted, axis=1) for part in series]
    speed = np.sqrt(sum(squares) / np.maximum(1, sum(counts)))
    means = [_means(part, SLOW * speed)[chosen] for part in series]
    spans = [_spans(part) for part in series]
    kept = np.concatenate(
        [~_touched(span, [] if bursts is None else bursts[number]) for number, span in enumerate(spans)]
    )
    together = np.concatenate(means, axis=1)
    total = sum(float(span[1][-1] - span[0][0]) for span in spans if len(span[0]))
    if total < FEWEST_WINDOWS * WINDOW or not np.isfinite(together[:, kept]).any():
        return []
    usual = np.array([_median(row[kept]) for row in together])[:, None]
    shown = usual[:, 0] > 0.0
    logs = np.log(np.maximum(together[shown] / usual[shown], LEAST_LEVEL))
    known = np.isfinite(logs)
    joints = known.sum(axis=0)
    level = np.where(joints > 0, np.where(known, logs, 0.0).sum(axis=0) / np.sqrt(np.maximum(1, joints)), np.nan)
    middle = _median(level[kept])
    spread = _median(np.abs(level[kept] - middle)) / _MEDIAN_OF_NORMAL
    if not spread > 0.0:
        return []
    deviation = (level - middle) / spread
    larger = np.exp(0.5 * level / np.sqrt(np.maximum(1, joints)))
    edges = np.cumsum([len(span[0]) for span in spans])[:-1]
    return [
        Windows(*span, of_deviation, of_larger)
        for span, of_deviation, of_larger in zip(
            spans, np.split(deviation, edges), np.split(larger, edges), strict=True
        )
    ]


def bursts_beyond(found: Sequence[Windows], deviation: float, larger: float = 0.0) -> list[list[Burst]]:
    """Windows beyond a deviation [σ] and a ratio, by segment; none where they hold more than `MOST_TIME`."""
    bursts, inside, total = [], 0.0, 0.0
    for of_segment in found:
        high = np.flatnonzero((of_segment.deviation > deviation) & (of_segment.larger > larger))
        spans: list[Burst] = []
        for start, stop in zip(of_segment.start[high], of_segment.stop[high], strict=True):
            if spans and start - spans[-1].stop < APART:
                spans[-1] = Burst(spans[-1].start, float(stop))
            else:
                spans.append(Burst(float(start), float(stop)))
        bursts.append(spans)
        inside += sum(span.stop - span.start for span in spans)
        total += float(of_segment.stop[-1] - of_segment.start[0]) if len(of_segment.start) else 0.0
    return bursts if inside <= MOST_TIME * total else [[] for _ in bursts]


def _width(part: TorqueSeries) -> int:
    """Samples of a window."""
    period = float(part.time[1] - part.time[0]) if len(part.time) > 1 else WINDOW
    return max(1, round(WINDOW / period))


def _spans(part: TorqueSeries) -> tuple[FloatArray, FloatArray]:
    """First and last stamps of a segment's windows."""
    width = _width(part)
    count = max(0, len(part.time) - width + 1)
    return part.time[:count], part.time[len(part.time) - count :]


def _means(part: TorqueSeries, slow: FloatArray) -> FloatArray:
    """(n, K) mean squared residual of each joint over each window, nan where too little of it counts."""
    width = _width(part)
    if len(part.time) < width:
        return np.empty((len(part.measured), 0))
    near = np.abs(part.velocity) < slow[:, None]
    near[:, 1:] |= np.sign(part.velocity[:, 1:]) != np.sign(part.velocity[:, :-1])
    around = np.ones(2 * max(1, round(REVERSAL * width / WINDOW)) + 1)
    near = np.array([np.convolve(row, around, "same")[: len(row)] > 0.5 for row in near.astype(np.float64)])
    counted = part.counted & ~near
    sums, counts = (
        np.array([np.convolve(row, np.ones(width), "valid") for row in rows])
        for rows in (np.where(counted, part.residual**2, 0.0), counted.astype(np.float64))
    )
    return np.where(counts >= COUNTED * width, sums / np.maximum(counts, 1.0), np.nan)


def _touched(span: tuple[FloatArray, FloatArray], bursts: Sequence[Burst]) -> BoolArray:
    """(K,) windows that hold a part of a burst."""
    touched = np.zeros(len(span[0]), dtype=np.bool_)
    for burst in bursts:
        touched |= (span[0] <= burst.stop) & (span[1] >= burst.start)
    return touched


def _median(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else 0.0
