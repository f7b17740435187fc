"""Whether time stamps can be right: recorded velocity against change of position, source clocks against the host's.

Stamps that are off by a constant factor make velocities wrong by it and accelerations by its square, and the model
still fits its own data: the parameters absorb the factor.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from daq.recording.quality.clocks import ClockEstimate, ClockFit
from daq.recording.recording import JOINTS_STREAM, Recording
from daq.recording.unit_plausibility import displacement_ratios
from ident.verdict.catalogue import raised
from ident.verdict.check import Check

SAME_FACTOR = 0.02
"""Ratios of position change to ∫velocity dt within this share of each other are one factor; within it of 1, right."""

CLOCK_DRIFT = 1e-3
"""Drift [s/s] from which on a clock is wrong; quartz clocks drift by 1e-4 at most."""

SURE = 3.0
"""A drift is reported where it is beyond so many times its interval, which a computer that is busy makes too small."""

CLOCK_SPAN = 5.0
"""Shorter streams [s] do not determine their clock."""


@dataclass(frozen=True)
class TimeAxis:
    """Consistency of a recording's time stamps.

    Attributes:
        velocity_ratios: joint → change of position over ∫velocity dt; joints without a clear relation are left out.
        clocks: stream → its clock against the host's; streams without their own clock are left out.
    """

    velocity_ratios: Mapping[str, float]
    clocks: Mapping[str, ClockEstimate]

    @property
    def factor(self) -> float | None:
        """Factor for all stamps by the recorded velocities; None where they agree or are inconclusive."""
        ratios = np.array(list(self.velocity_ratios.values()))
        if len(ratios) < 2 or np.min(ratios) <= 0.0:
            return None
        typical = float(np.median(ratios))
        same = bool(np.all(np.abs(ratios / typical - 1.0) < SAME_FACTOR))
        return typical if same and abs(typical - 1.0) > SAME_FACTOR else None


def time_axis(recording: Recording) -> TimeAxis:
    """Compare recorded velocities with positions, and the streams' clocks with the host's."""
    ratios: dict[str, float] = {}
    stream = recording.streams.get(JOINTS_STREAM)
    position, velocity = (None if stream is None else stream.channels.get(name) for name in ("position", "velocity"))
    if stream is not None and position is not None and velocity is not None:
        names = [name for name in position.columns if name in velocity.columns]
        moved = position.values[:, [position.columns.index(name) for name in names]]
        speed = velocity.values[:, [velocity.columns.index(name) for name in names]]
        finite = np.isfinite(stream.time) & np.isfinite(moved).all(axis=1) & np.isfinite(speed).all(axis=1)
        if np.count_nonzero(finite) > 1:
            values = displacement_ratios(stream.time[finite], moved[finite], speed[finite])
            ratios = {name: ratio for name, ratio in zip(names, values, strict=True) if ratio is not None}
    clocks = {}
    for name, recorded in recording.streams.items():
        fit = ClockFit()
        fit.add(recorded.time, recorded.host_time)
        estimate = fit.estimate()
        if estimate is not None and estimate.span >= CLOCK_SPAN:
            clocks[name] = estimate
    return TimeAxis(ratios, clocks)


def time_axis_checks(recording: Recording, of: str = "") -> list[Check]:
    """The checks that the time stamps raise; `of` begins their sentences."""
    axis = time_axis(recording)
    checks = []
    if axis.factor is not None:
        text = (
            f"{of}in all joints, positions change by {axis.factor:.4g} times what the recorded velocities say: unless "
            f"these have another unit, the stamps should be multiplied by {axis.factor:.4g}; check their unit and rate"
        )
        checks.append(raised("wrong-time-axis", text))
    else:
        off = {name: ratio for name, ratio in axis.velocity_ratios.items() if abs(ratio - 1.0) > SAME_FACTOR}
        if off:
            ratios = ", ".join(f"{name} {ratio:.4g}" for name, ratio in off.items())
            text = f"{of}position changes by another factor than the recorded velocity says: {ratios}; check its unit"
            checks.append(raised("velocity-scale", text, off))
    for name, clock in axis.clocks.items():
        if abs(clock.drift) > max(CLOCK_DRIFT, SURE * clock.drift_error):
            text = (
                f"{of}the clock of '{name}' drifts by {clock.drift:.3g} ± {clock.drift_error:.1g} s per second against "
                f"this computer's: its stamps should be multiplied by {1.0 + clock.drift:.6g}; check its unit and rate"
            )
            checks.append(raised("clocks-drift", text))
    return checks
