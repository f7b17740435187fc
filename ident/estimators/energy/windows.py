"""The energy model: differences of energy over windows of time (SR400 eq. 10 to 12).

    H(t_b) − H(t_a) + Σ (Fv·∫q̇² dt + Fs·∫|q̇| dt + Fo·∫q̇ dt) = ∫ q̇mᵀτ dt

A window is informative only if energy is exchanged in it: one in which the arm barely moves is a row of noise. So
windows are not cut by the clock but by the exchange ∫ Σ|q̇m·τ| dt, of which each holds the same amount; they are short
where the arm is fast and long near velocity reversals. Each begins a quarter of its exchange after the one before, so
that what happens near its ends is seen in the middle of others.

Both sides, as functions of a window's end, pass the parallel filter before they are differenced (SR400 .4.3 point 4):
H holds q̇ squared at the two ends alone, where nothing else would average the encoders' noise. Longer windows hold more
signal beside this noise; but there must be many more of them than parameters, and much longer than the motion's own
periods they average it away.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from drivers.core.arrays import FloatArray
from drivers.core.errors import DataError
from ident.estimators.energy.equations import EnergyRows
from ident.model.dynamic_model import DynamicModel
from ident.model.dynamics.energy import STATES_AT_ONCE, EnergyKernel, motor_velocity
from ident.signals.filters import StreamedFilter, ZeroPhaseFilter
from ident.signals.prepared import Segment

HALF_POWER = 0.443
"""Frequency times duration at which a moving average passes half the power."""

SHORTEST_CUTOFF, LONGEST_CUTOFF = 1.0, 0.1
"""Windows of mean duration pass, as moving averages, half the power at one of these shares of the parallel filter's
cut-off, or in between: at the cut-off itself, or at a tenth of it, where the motion's band ends."""

WINDOWS_PER_PARAMETER = 4.0
"""Windows are made no longer than leaves this many, side by side, for each base parameter."""

OVERLAP = 4
"""How many windows each instant belongs to."""


@dataclass(frozen=True)
class EnergyWindows:
    """Equations over windows of equal exchange.

    Attributes:
        kernel: for the base columns.
        exchange: ∫ Σ|q̇m·τ| dt of each window, to a sample [J].
    """

    kernel: EnergyKernel
    exchange: float

    @property
    def overlap(self) -> int:
        """How many consecutive rows share data."""
        return OVERLAP

    def rows(self, segment: Segment, parallel_filter: ZeroPhaseFilter) -> Iterator[EnergyRows]:
        """The equations of one segment; energy and work are filtered at the segment's rate."""
        model = self.kernel.model
        borders = [window_borders(model, segment, span, self.exchange) for span in moving_spans(segment)]
        borders = [samples for samples in borders if len(samples) > OVERLAP]
        if not borders:
            return
        balance = self._balance_at(np.concatenate(borders), segment, replace(parallel_filter, factor=1))
        position = 0
        for samples in borders:
            at_borders = balance[:, position : position + len(samples)]
            position += len(samples)
            rows = at_borders[:, OVERLAP:] - at_borders[:, :-OVERLAP]
            middle = (samples[:-OVERLAP] + samples[OVERLAP:]) // 2
            yield EnergyRows(rows[:-1], rows[-1], middle // parallel_filter.factor)

    def _balance_at(self, samples: npt.NDArray[np.int64], segment: Segment, smoothing: ZeroPhaseFilter) -> FloatArray:
        """Energy stored and lost since the start, last the work, filtered, at rising samples (k,) → (b + 1, k)."""
        streamed = StreamedFilter(smoothing, len(self.kernel.columns) + 1)
        balance = np.empty((len(self.kernel.columns) + 1, len(samples)))
        position = 0
        for chunk in self._balance(segment):
            filtered = streamed.finish() if chunk is None else streamed.push(chunk)
            start, stop = np.searchsorted(samples, [position, position + filtered.shape[1]])
            balance[:, start:stop] = filtered[:, samples[start:stop] - position]
            position += filtered.shape[1]
        return balance

    def _balance(self, segment: Segment) -> Iterator[FloatArray | None]:
        """Energy stored and lost since the start (b, m), and last the work, chunk by chunk; None behind the end."""
        from scipy.integrate import cumulative_trapezoid

        count = segment.position.shape[1]
        work = motor_power(self.kernel.model, segment)
        spent = np.zeros((len(self.kernel.friction_rows) + 1, 1))
        for start in range(0, count, STATES_AT_ONCE):
            inside = slice(start, min(start + STATES_AT_ONCE, count))
            # With the last sample of the chunk before, so that the integral goes on from there.
            around = slice(max(0, start - 1), inside.stop)
            power = np.vstack([self.kernel.friction_power(*friction_motion(segment, around)), work[around]])
            integral = spent + cumulative_trapezoid(power, dx=1.0 / segment.rate, axis=1, initial=0)
            spent = integral[:, -1:]
            integral = integral[:, inside.start - around.start :]
            balance = np.vstack(
                [self.kernel.energy(segment.position[:, inside], segment.velocity[:, inside]), integral[-1:]]
            )
            balance[self.kernel.friction_rows] = integral[:-1]
            yield balance
        yield None


def friction_motion(segment: Segment, samples: slice) -> tuple[FloatArray, FloatArray, FloatArray | None]:
    """Velocity, position and, where recorded, temperature of some samples, which the friction's power follows from."""
    heat = None if segment.temperature is None else segment.temperature[:, samples]
    return segment.velocity[:, samples], segment.position[:, samples], heat


def motor_power(model: DynamicModel, segment: Segment) -> FloatArray:
    """q̇mᵀτ (N,) [W]."""
    return np.asarray(np.einsum("nk,nk->k", motor_velocity(model, segment.velocity), segment.torque))


def moving_spans(segment: Segment) -> tuple[slice, ...]:
    """Spans of consecutive samples that count."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], segment.used, [False]]).astype(np.int8)))
    return tuple(slice(int(start), int(stop)) for start, stop in edges.reshape(-1, 2))


def exchange_rate(model: DynamicModel, segment: Segment) -> FloatArray:
    """Σ|q̇m·τ| (N,) [W]."""
    return np.asarray(np.abs(motor_velocity(model, segment.velocity) * segment.torque).sum(axis=0))


def exchange_for(model: DynamicModel, segments: Sequence[Segment], duration: float) -> float:
    """Exchange [J] of windows that last `duration` [s] on average over all segments.

    Raises:
        DataError: no energy is exchanged at all.
    """
    total = sum(float(exchange_rate(model, segment)[segment.used].sum()) for segment in segments)
    samples = sum(int(segment.used.sum()) for segment in segments)
    if not total > 0.0:
        raise DataError("no energy is exchanged: the torque is zero wherever the arm moves", hint="use --method wls")
    return duration * total / samples


def mean_duration(kernel: EnergyKernel, segments: Sequence[Segment], cutoff: float) -> float:
    """Mean duration [s] of windows for a parallel filter of this cut-off [Hz]: as long as the data allow."""
    moving = sum(int(segment.used.sum()) / segment.rate for segment in segments)
    enough = moving / (WINDOWS_PER_PARAMETER * len(kernel.columns))
    return float(np.clip(enough, HALF_POWER / (SHORTEST_CUTOFF * cutoff), HALF_POWER / (LONGEST_CUTOFF * cutoff)))


def window_borders(model: DynamicModel, segment: Segment, span: slice, exchange: float) -> npt.NDArray[np.int64]:
    """Samples of the segment, `exchange` / `OVERLAP` apart; a window ends at the `OVERLAP`-th behind its start."""
    from scipy.integrate import cumulative_trapezoid

    spent = cumulative_trapezoid(exchange_rate(model, segment)[span], dx=1.0 / segment.rate, initial=0)
    levels = np.arange(0.0, spent[-1], exchange / OVERLAP)
    return np.asarray(np.unique(np.searchsorted(spent, levels)) + span.start)


def describe_windows(equations: EnergyWindows, segments: Sequence[Segment]) -> tuple[int, float]:
    """Number of windows and their mean duration [s]."""
    lengths = [
        (borders[OVERLAP:] - borders[:-OVERLAP]) / segment.rate
        for segment in segments
        for span in moving_spans(segment)
        if len(borders := window_borders(equations.kernel.model, segment, span, equations.exchange)) > OVERLAP
    ]
    durations = np.concatenate([*lengths, np.empty(0)])
    return len(durations), float(durations.mean()) if len(durations) else 0.0
