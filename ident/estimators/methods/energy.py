"""The energy model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from drivers.core.errors import UsageError
from drivers.core.ranges import Range
from ident.estimators.energy_model import EnergyEstimator, EnergyWindows, exchange_for, mean_duration, moving_spans
from ident.estimators.estimator import Estimator, Setup
from ident.estimators.method import Method, within
from ident.model.dynamics.energy import EnergyKernel


@dataclass(frozen=True)
class EnergyOptions:
    """Options of the energy model."""

    window: Annotated[
        float | None,
        within(Range(1e-3, 3600.0, "s")),
        Field(description="mean duration of the windows [s]; from the parallel filter and the data if absent"),
    ] = None


def _estimator(options: EnergyOptions, setup: Setup) -> Estimator:
    energy = EnergyKernel(setup.kernel.model, setup.kernel.columns)
    segments = [segment for run in setup.runs for segment in run.segments]
    duration = options.window
    if duration is None:
        duration = mean_duration(energy, segments, setup.runs[0].cutoffs.torque)
    else:
        longest = max((span.stop - span.start) / s.rate for s in segments for span in moving_spans(s))
        if duration > longest:
            raise UsageError(
                f"windows of {duration:g} s do not fit into the data, whose longest motion lasts {longest:.3g} s",
                where="--method energy:window",
            )
    windows = EnergyWindows(energy, exchange_for(setup.kernel.model, segments, duration))
    return EnergyEstimator(setup, windows, "energy")


METHOD = Method(
    "differences of the whole arm's energy over windows of time; needs no accelerations",
    "energy",
    EnergyOptions,
    _estimator,
)
