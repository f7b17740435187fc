"""The power model: the energy model's differential form (SR400 eq. 10, divided by ever shorter windows).

    d/dt h(q, q̇)·π + friction powers = q̇mᵀτ

h is differentiated as a whole by central differences, so that no acceleration is formed, and both sides pass the
parallel filter.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from drivers.core.arrays import FloatArray
from ident.estimators.energy_model import EnergyEstimator, EnergyRows, friction_motion, motor_power
from ident.estimators.estimator import Estimator, Setup
from ident.estimators.method import Method, NoOptions
from ident.model.dynamics.energy import STATES_AT_ONCE, EnergyKernel
from ident.signals.filters import StreamedFilter, ZeroPhaseFilter
from ident.signals.prepared import Segment
from ident.signals.segments import central_difference


@dataclass(frozen=True)
class PowerSamples:
    """Equations of power, one a filtered sample."""

    kernel: EnergyKernel  # for the base columns
    overlap: ClassVar[int] = 1  # rows share data only through the filter

    def rows(self, segment: Segment, parallel_filter: ZeroPhaseFilter) -> Iterator[EnergyRows]:
        """The equations of one segment."""
        streamed = StreamedFilter(parallel_filter, len(self.kernel.columns) + 1)
        used = segment.used[:: parallel_filter.factor]
        position = 0
        for unfiltered in self._chunks(segment):
            filtered = streamed.finish() if unfiltered is None else streamed.push(unfiltered)
            here = used[position : position + filtered.shape[1]]
            sample = position + np.flatnonzero(here)
            position += filtered.shape[1]
            if len(sample):
                yield EnergyRows(filtered[:-1, here], filtered[-1, here], sample)

    def _chunks(self, segment: Segment) -> Iterator[FloatArray | None]:
        """Powers (b + 1, m) chunk by chunk, the motors' last; None behind the end."""
        count = segment.position.shape[1]
        work = motor_power(self.kernel.model, segment)
        for start in range(0, count, STATES_AT_ONCE):
            stop = min(start + STATES_AT_ONCE, count)
            # Neighbours on both sides, so that differences within the segment are central ones.
            around = slice(max(0, start - 2), min(stop + 1, count))
            inside = slice(start - around.start, stop - around.start)
            stored = self.kernel.energy(segment.position[:, around], segment.velocity[:, around])
            power = central_difference(stored, segment.rate)[:, inside]
            power[self.kernel.friction_rows] = self.kernel.friction_power(*friction_motion(segment, slice(start, stop)))
            yield np.vstack([power, work[start:stop]])
        yield None


def _estimator(options: NoOptions, setup: Setup) -> Estimator:
    return EnergyEstimator(setup, PowerSamples(EnergyKernel(setup.kernel.model, setup.kernel.columns)), "power")


METHOD = Method("the derivative of the whole arm's energy, one equation per sample", "energy", NoOptions, _estimator)
