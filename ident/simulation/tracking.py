"""What a simulator's user feels of a model: how far the simulated arm departs from a recorded motion.

The recorded torque drives the simulated arm, and a soft PD controller holds it near the recorded motion:

    τ = τ_recorded + m·(ω²·(q_recorded − q) + 2ω·(q̇_recorded − q̇))

with m the diagonal of the inertia matrix at the mean posture. Without the controller any arm would fall away from the
motion, also the true one, for small errors grow; with it, an error δτ of the model's torque moves joint i by about
δτᵢ/(mᵢ·ω²). Its damping is integrated implicitly, like viscous friction: joints whose axes nearly align move against
each other with so little inertia that an explicit one would be unstable.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from drivers.core.arrays import FloatArray
from drivers.core.errors import ModelError
from ident.model.dynamics.inverse_dynamics import InverseDynamics
from ident.signals.prepared import Segment
from ident.simulation.forward_arm import ForwardArm
from ident.simulation.time_stepping import SteppedMotion, integrate
from ident.stored import Number, Stored

NATURAL_FREQUENCY = 10.0
"""ω [rad/s] of the controller, critically damped: soft, so that it does not hide the model's errors."""

SIMULATION_STEP = 4e-3
"""[s]"""

LONGEST = 10.0
"""Duration [s] of the motion that is simulated at most: its beginning."""


class TrackingError(Stored):
    """How far the simulated arm departs from a held-out motion, driven by its recorded torque and a soft controller."""

    duration: float = Field(description="of the simulated motion, the beginning of the longest held-out segment [s]")
    natural_frequency: float = Field(description="of the critically damped PD controller [rad/s]")
    position_rmse: list[float] = Field(description="per joint [rad or m]")
    velocity_rmse: list[float] = Field(description="per joint [rad/s or m/s]")
    max_position_error: list[float] = Field(description="per joint [rad or m]")
    ratio: Number = Field(default=None, description="position_rmse over that of constant velocity for 1 s")
    joint_ratio: list[Number] = Field(default=[], description="the same per joint")


@dataclass(frozen=True, eq=False)
class Tracking:
    """A simulated arm near a recorded motion."""

    motion: SteppedMotion  # of the simulated arm
    position: FloatArray  # (N, n) recorded, at its times [rad or m]
    velocity: FloatArray  # (N, n) recorded [rad/s or m/s]
    stiffness: FloatArray  # (n,) of the controller [N·m/rad]
    damping: FloatArray  # (n,) of the controller [N·m·s/rad]


def tracked(inverse: InverseDynamics, segment: Segment, longest: float = np.inf) -> Tracking:
    """Simulate a recorded segment, its first `longest` seconds at most.

    Raises:
        ModelError: the model cannot be simulated, or the motion diverges.
    """
    heat = None if segment.temperature is None else np.mean(segment.temperature, axis=1)
    arm = ForwardArm(inverse, heat)
    duration = min(float(segment.time[-1] - segment.time[0]), longest)
    steps = max(1, round(duration / SIMULATION_STEP))
    time = np.linspace(0.0, duration, steps + 1)
    position, velocity = (at_times(time, segment, signal) for signal in (segment.position, segment.velocity))
    mean_inertia = np.diagonal(inverse.inertia(position.mean(axis=0)[:, None])[0] + inverse.armature)
    stiffness, damping = NATURAL_FREQUENCY**2 * mean_inertia, 2.0 * NATURAL_FREQUENCY * mean_inertia
    arm.viscous = arm.viscous + np.diag(damping)
    torque = at_times(time[:-1] + 0.5 * duration / steps, segment, driving_torque(inverse, segment))

    def drive(now: float, q: FloatArray, rate: FloatArray) -> FloatArray:
        step = round(now / duration * steps)
        wanted = 0.5 * (velocity[step] + velocity[step + 1])  # the damping acts on the mean velocity of the step
        return np.asarray(torque[step] + stiffness * (position[step] - q) + damping * wanted)

    motion = integrate(arm, position[0], velocity[0], drive, duration, steps)
    return Tracking(motion, position, velocity, stiffness, damping)


def driving_torque(inverse: InverseDynamics, segment: Segment) -> FloatArray:
    """Torques (n, N) [N·m] at the joints that drive a simulated arm along a recorded segment.

    A sensor behind the gear does not see what its motor needs for its own inertia; that is added.
    """
    return np.asarray(inverse.coupling.T @ segment.torque + inverse.armature @ segment.acceleration)


def tracking_error(inverse: InverseDynamics, segment: Segment) -> TrackingError:
    """Simulate the beginning of a recorded segment; arguments and errors as of `tracked`."""
    tracking = tracked(inverse, segment, LONGEST)
    departed = tracking.motion.position - tracking.position
    return TrackingError(
        duration=float(tracking.motion.time[-1]),
        natural_frequency=NATURAL_FREQUENCY,
        position_rmse=np.sqrt(np.mean(departed**2, axis=0)).tolist(),
        velocity_rmse=np.sqrt(np.mean((tracking.motion.velocity - tracking.velocity) ** 2, axis=0)).tolist(),
        max_position_error=np.max(np.abs(departed), axis=0).tolist(),
    )


def track_longest(inverse: InverseDynamics, segments: Iterable[Segment]) -> tuple[TrackingError | None, str]:
    """The error along the longest segment; None and the reason where the simulation fails."""
    try:
        return tracking_error(inverse, max(segments, key=lambda segment: len(segment.time))), ""
    except ModelError as error:
        return None, str(error)


def at_times(time: FloatArray, segment: Segment, signal: FloatArray) -> FloatArray:
    """A signal (n, N) of the segment at times (M,) [s] from its start, (M, n)."""
    stamps = segment.time - segment.time[0]
    return np.array([np.interp(time, stamps, row) for row in signal]).T
