"""How far each source's clock is from the host's, and how fast it drifts.

A sample that was taken at `time` of the source's clock is received at host_time = time + offset + drift·time + delay,
and delays are one-sided: buses and operating systems make a sample late, never early. So offset and drift are those of
the line below all points (time, host_time − time) that lies closest to them, an edge of their lower convex hull, as in
Moon, Skelly and Towsley, Estimation and removal of clock skew from network delay measurements (INFOCOM 1999). What the
fastest sample needed is included in the offset: one-way measurements cannot separate the two.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.streams import Batch

REPORT_PERIOD = 60.0
"""[s] between two reports on a clock."""
LEAST_SPAN = 1.0
"""[s]; over less the drift is not estimated."""
LEAST_POINTS = 8
GROUP_SPAN = 0.5
"""[s]; the least delay of each such interval is kept."""
GROUPS = 16
"""Groups of intervals whose least delays give the uncertainty of the line."""
OFFSET_FACTOR = 3.0
DRIFT_FACTOR = 2.0
"""Stated errors over the groups' mean least delay (and over the length of the edge). With exponential, uniform, gamma
and bursty delays 95 % of the errors stayed below 2.4 and 1.2 times that."""
HOSTS_OWN = 1e-9
"""Drift [s/s] and delay [s] below which stamps count as the host's own: rounding alone causes as much."""


@dataclass(frozen=True)
class ClockEstimate:
    """A source's clock against the host's: host_time = time + offset + drift·(time − reference), plus each delay."""

    reference: float  # middle of the time seen, of the source's clock [s]
    offset: float  # host's clock less the source's at `reference` [s], the least delay included
    drift: float  # loss of the source's clock [s/s]
    offset_error: float  # how far `offset` may be above the line of no further delay [s]
    drift_error: float  # [s/s], either way
    span: float  # time seen [s]

    def host_time(self, source_time: float) -> float:
        """Host times of source times [s]; the least delay is included."""
        return source_time + self.offset + self.drift * (source_time - self.reference)


class ClockFit:
    """The lower hull of (time, host_time − time), kept up as samples come; a few numbers, however many they are."""

    def __init__(self) -> None:
        self._restart()

    def _restart(self) -> None:
        self._hull: list[tuple[float, float]] = []
        self._intervals: list[tuple[float, float]] = []
        self._interval = math.nan
        self._origin = 0.0
        self._last = -math.inf
        self._points = 0

    def add(self, time: FloatArray, host_time: FloatArray) -> None:
        """Add the stamps (N,) [s] of consecutive samples; the fit restarts when a clock jumps back."""
        ahead = host_time - time
        if not (usable := np.isfinite(ahead)).all():
            time, ahead = time[usable], ahead[usable]
        if not len(time):
            return
        if time[0] < self._last:
            self._restart()
        self._last = float(time[-1])
        # Within a interval no drift shows: its earliest sample says it all.
        interval = np.floor(time / GROUP_SPAN)
        inner = [] if interval[0] == interval[-1] else (np.flatnonzero(np.diff(interval)) + 1).tolist()
        for first, end in itertools.pairwise([0, *inner, len(time)]):
            best = first + int(ahead[first:end].argmin())
            self._add_point(float(time[best]), float(ahead[best]), float(interval[first]))

    def estimate(self) -> ClockEstimate | None:
        """Offset and drift from the samples so far; None where they are too few."""
        if self._points < LEAST_POINTS or self._hull[-1][0] - self._hull[0][0] < LEAST_SPAN:
            return None
        middle = 0.5 * (self._hull[0][0] + self._hull[-1][0])
        right = next((index for index, (x, _) in enumerate(self._hull) if x >= middle), len(self._hull) - 1)
        (x0, y0), (x1, y1) = self._hull[max(right - 1, 0)], self._hull[max(right, 1)]
        drift = (y1 - y0) / (x1 - x0)
        offset = y0 + drift * (middle - x0)
        above = np.array([y - offset - drift * (x - middle) for x, y in self._intervals])
        least = np.array([interval.min() for interval in np.array_split(above, min(GROUPS, len(above)))])
        typical = float(np.mean(least))
        return ClockEstimate(
            reference=self._origin + middle,
            offset=offset,
            drift=drift,
            offset_error=OFFSET_FACTOR * typical,
            drift_error=DRIFT_FACTOR * typical / (x1 - x0),
            span=self._hull[-1][0] - self._hull[0][0],
        )

    def _add_point(self, time: float, ahead: float, interval: float) -> None:
        if not self._points:
            self._origin = time
        x = time - self._origin
        self._points += 1
        if interval != self._interval:
            self._intervals.append((x, ahead))
            self._interval = interval
        elif ahead < self._intervals[-1][1]:
            self._intervals[-1] = (x, ahead)
        hull = self._hull
        if hull and x <= hull[-1][0]:  # stamps may repeat
            if ahead >= hull[-1][1]:
                return
            hull.pop()
        while len(hull) > 1 and _turns_right(hull[-2], hull[-1], (x, ahead)):
            hull.pop()
        hull.append((x, ahead))


class ClockLog:
    """The clocks of a session's streams, and when to report on them."""

    def __init__(self, clock: Clock = SYSTEM_CLOCK) -> None:
        self._clock = clock
        self._fits: dict[str, ClockFit] = {}
        self._due = clock.now() + REPORT_PERIOD

    def add(self, batch: Batch) -> None:
        """Note a batch's stamps."""
        if len(batch.time):
            self._fits.setdefault(batch.stream, ClockFit()).add(batch.time, batch.host_time)

    def due(self) -> list[str]:
        """A message on each stream's clock once per `REPORT_PERIOD`."""
        if self._clock.now() < self._due:
            return []
        self._due = self._clock.now() + REPORT_PERIOD
        return self.messages()

    def messages(self) -> list[str]:
        """State of each stream's clock in words; streams of too short a span are left out."""
        estimates = {stream: fit.estimate() for stream, fit in self._fits.items()}
        return [describe_clock(stream, estimate) for stream, estimate in estimates.items() if estimate is not None]


def describe_clock(stream: str, estimate: ClockEstimate) -> str:
    """One line on a stream's clock."""
    if abs(estimate.drift) < HOSTS_OWN and estimate.offset_error < HOSTS_OWN:  # no delay at all: it was never sent
        shifted = f", shifted by {estimate.offset:.6f} s" if abs(estimate.offset) >= HOSTS_OWN else ""
        return f"clock of {stream}: the host's own{shifted}, stamped on arrival"
    offset = f"offset {estimate.offset:.6f} s ± {estimate.offset_error:.1g} s at {estimate.reference:.3f} s"
    drift = f"drift {1e6 * estimate.drift:+.3g} ppm ± {1e6 * estimate.drift_error:.2g} ppm"
    return f"clock of {stream}: {offset}, {drift} over {estimate.span:.0f} s"


def _turns_right(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> bool:
    return (b[0] - a[0]) * (c[1] - a[1]) <= (b[1] - a[1]) * (c[0] - a[0])
