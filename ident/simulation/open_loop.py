"""What a simulation is worth without a controller: recorded torque drives the arm over short windows of held-out data.

Each window starts at the measured position and velocity. Small errors grow without a controller, also those of the true
model; so the windows are short, and the reference is what needs no model: the arm goes on at constant velocity, q + q̇t.
A model whose simulated motion is farther off than that is of no use for simulation.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from pydantic import Field

from drivers.core.arrays import FloatArray
from drivers.core.errors import ModelError
from ident.model.dynamics.inverse_dynamics import InverseDynamics
from ident.signals.prepared import Segment
from ident.simulation.forward_arm import ForwardArm
from ident.simulation.time_stepping import integrate
from ident.simulation.tracking import SIMULATION_STEP, at_times, driving_torque
from ident.stored import Number, Stored

WINDOW = 1.0
"""Length of a window [s]; shorter where no segment is that long."""

SHORTEST_WINDOW = 0.2
"""[s] Shorter motions say nothing."""

WINDOWS = 6
"""Windows at most, spread over the held-out motion: they bound the CPU time."""


class OpenLoop(Stored):
    """Motion of the arm simulated on recorded torque alone, without a controller, over windows of held-out data.

    Each window starts at the measured position and velocity. The reference is the same window at constant velocity.
    """

    window: float = Field(description="length of a window [s]")
    windows: int = Field(description="number of windows, spread over the held-out motion")
    position_rmse: list[Number] = Field(description="per joint [rad or m]; null where the simulation diverged")
    reference_rmse: list[float] = Field(description="the same of constant velocity")
    ratio: Number = Field(
        default=None, description="of both over all joints; below 1 the simulation is better than constant velocity"
    )
    joint_ratio: list[Number] = Field(
        default=[], description="the same per joint, the reference at least a share of the largest"
    )
    diverged: str = Field(default="", description="where and when a window diverged; empty where none did")


def open_loop(inverse: InverseDynamics, segments: Sequence[Segment]) -> OpenLoop | None:
    """Simulate windows of recorded segments, driven by their torque alone.

    Returns:
        The errors; None where no window of motion is long enough.
    """
    longest = max((_duration(segment) for segment in segments), default=0.0)
    window = min(WINDOW, longest)
    if window < SHORTEST_WINDOW:
        return None
    starts = [(segment, start) for segment in segments for start in _starts(segment, window)]
    if not starts:
        return None
    chosen = [starts[place] for place in np.unique(np.linspace(0, len(starts) - 1, WINDOWS).round().astype(int))]
    simulated, reference = np.zeros(inverse.model.dof), np.zeros(inverse.model.dof)
    diverged = ""
    steps = max(1, round(window / SIMULATION_STEP))
    for segment, start in chosen:
        time = start + np.linspace(0.0, window, steps + 1)
        position = at_times(time, segment, segment.position)
        velocity = at_times(time[:1], segment, segment.velocity)[0]
        constant = position[0] + velocity * (time - start)[:, None]
        reference += np.mean(np.square(constant - position), axis=0)
        if diverged:
            continue
        try:
            motion = _simulated(inverse, segment, time, position[0], velocity)
        except ModelError as error:
            diverged = f"from {segment.time[0] + start:.4g} s of the recording, {error.message}"
            simulated[:] = np.nan
            continue
        simulated += np.mean(np.square(motion - position), axis=0)
    return OpenLoop(
        window=window,
        windows=len(chosen),
        position_rmse=np.sqrt(simulated / len(chosen)).tolist(),
        reference_rmse=np.sqrt(reference / len(chosen)).tolist(),
        diverged=diverged,
    )


def _simulated(
    inverse: InverseDynamics, segment: Segment, time: FloatArray, position: FloatArray, velocity: FloatArray
) -> FloatArray:
    """Positions (N, n) of the simulated arm at times (N,) from the segment's start, from a state (n,)."""
    heat = None if segment.temperature is None else np.mean(segment.temperature, axis=1)
    steps, duration = len(time) - 1, float(time[-1] - time[0])
    torque = _step_means(time, segment, driving_torque(inverse, segment))

    def drive(now: float, q: FloatArray, rate: FloatArray) -> FloatArray:
        return np.asarray(torque[min(round(now / duration * steps), steps - 1)])

    return integrate(ForwardArm(inverse, heat), position, velocity, drive, duration, steps).position


def _step_means(time: FloatArray, segment: Segment, torque: FloatArray) -> FloatArray:
    """Means (N - 1, n) of a torque (n, M) between times (N,): of each sample's noise, the least that can be had."""
    impulse = np.zeros_like(torque)
    impulse[:, 1:] = np.cumsum(0.5 * (torque[:, 1:] + torque[:, :-1]), axis=1) / segment.rate
    return np.asarray(np.diff(at_times(time, segment, impulse), axis=0) / np.diff(time)[:, None])


def _starts(segment: Segment, window: float) -> Iterator[float]:
    """Starts of consecutive windows of a segment in which the arm moves [s from its first sample]."""
    stamps = segment.time - segment.time[0]
    for index in range(int(_duration(segment) / window + 1e-9)):
        inside = (stamps >= index * window) & (stamps < (index + 1) * window)
        if np.mean(segment.used[inside]) > 0.5:
            yield index * window


def _duration(segment: Segment) -> float:
    return float(segment.time[-1] - segment.time[0])
