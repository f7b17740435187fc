"""The energy model: differences of energy over windows of time (SR400 eq. 10 to 12).

    H(t_b) − H(t_a) + Σ (Fv·∫q̇² dt + Fs·∫|q̇| dt + Fo·∫q̇ dt) = ∫ q̇mᵀτ dt

A window says something only if energy is exchanged in it: one during which the arm hardly moves is a row of noise. So
windows are not cut by the clock but by the exchange ∫ Σ|q̇m·τ| dt, of which each holds the same amount; they are short
where the arm is fast and long where it turns. A window averages over its length, which makes it a low-pass: its mean
duration is that of a moving average whose half-power frequency is the parallel filter's cut-off. Each begins a quarter
of its exchange after the one before, so that what happens near its ends is seen in the middle of others.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from drivers.errors import DataError
from ident.energy import EnergyKernel, motor_velocity
from ident.energy_equations import EnergyRows
from ident.filters import ZeroPhaseFilter
from ident.kinematics import FloatArray
from ident.model import DynamicModel
from ident.preprocess import Segment

HALF_POWER = 0.443
"""Frequency times duration at which a moving average passes half the power."""

OVERLAP = 4
"""How many windows each instant belongs to."""


@dataclass(frozen=True)
class EnergyWindows:
    """Equations over windows of equal exchange.

    Attributes:
        kernel: for the base columns.
        exchange: what each window holds of ∫ Σ|q̇m·τ| dt, to a sample [J].
    """

    kernel: EnergyKernel
    exchange: float

    @property
    def overlap(self) -> int:
        """How many consecutive rows share data."""
        return OVERLAP

    def rows(self, segment: Segment, parallel_filter: ZeroPhaseFilter) -> Iterator[EnergyRows]:
        """The equations of one segment; the torque is integrated as it is, only the numbering is the filter's."""
        for part in moving_stretches(segment):
            borders = window_borders(self.kernel.model, segment, part, self.exchange)
            if len(borders) <= OVERLAP:
                continue
            start, stop = borders[:-OVERLAP], borders[OVERLAP:]
            velocity = segment.velocity[:, part]
            stored = self.kernel.energy(segment.position[:, borders], segment.velocity[:, borders])
            regressor = stored[:, OVERLAP:] - stored[:, :-OVERLAP]
            power = np.vstack([self.kernel.friction_power(velocity), motor_power(self.kernel.model, segment)[part]])
            spent = _integral(power, segment.rate)
            over_window = spent[:, stop - part.start] - spent[:, start - part.start]
            regressor[self.kernel.friction_rows] = over_window[:-1]
            yield EnergyRows(regressor, over_window[-1], (start + stop) // 2 // parallel_filter.factor)


def motor_power(model: DynamicModel, segment: Segment) -> FloatArray:
    """q̇mᵀτ (N,) [W]."""
    return np.asarray(np.einsum("nk,nk->k", motor_velocity(model, segment.velocity), segment.torque))


def moving_stretches(segment: Segment) -> tuple[slice, ...]:
    """The stretches of consecutive samples that count."""
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


def window_borders(model: DynamicModel, segment: Segment, part: slice, exchange: float) -> npt.NDArray[np.int64]:
    """Samples of the segment, `exchange` / `OVERLAP` apart; a window ends at the `OVERLAP`-th behind its start."""
    spent = _integral(exchange_rate(model, segment)[None, part], segment.rate)[0]
    levels = np.arange(0.0, spent[-1], exchange / OVERLAP)
    return np.asarray(np.unique(np.searchsorted(spent, levels)) + part.start)


def describe_windows(equations: EnergyWindows, segments: Sequence[Segment]) -> tuple[int, float]:
    """Number of windows and their mean duration [s]."""
    lengths = [
        (borders[OVERLAP:] - borders[:-OVERLAP]) / segment.rate
        for segment in segments
        for part in moving_stretches(segment)
        if len(borders := window_borders(equations.kernel.model, segment, part, equations.exchange)) > OVERLAP
    ]
    durations = np.concatenate([*lengths, np.empty(0)])
    return len(durations), float(durations.mean()) if len(durations) else 0.0


def _integral(rows: FloatArray, rate: float) -> FloatArray:
    """Integral (k, N) of `rows` (k, N) from the first sample, by the trapezoidal rule."""
    integral = np.zeros_like(rows)
    np.cumsum(0.5 / rate * (rows[:, 1:] + rows[:, :-1]), axis=1, out=integral[:, 1:])
    return integral
