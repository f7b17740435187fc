"""An arm in a simulated position loop that follows a reference motion.

    τ = τ_ref + J·(ω²·(q_ref − q) + 2ω·(q̇_ref − q̇))

τ_ref is the model's torque of the reference motion without its acceleration (gravity, Coriolis, friction), J the
diagonal of the inertia matrix, its mean over the motion: independent joints with the gravity compensated, a stand-in
for a controller that nobody described. The gains follow the model's parameters, so that the loop keeps its bandwidth
and the simulated motion hardly depends on them (Gautier, Janot and Vandanjon, IEEE Trans. Control Syst. Technol. 21,
2013, section III). What the reference has above ω, noise above all, the loop does not follow.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drivers.core.arrays import FloatArray
from ident.model.dynamics.inverse_dynamics import InverseDynamics
from ident.signals.prepared import Segment
from ident.simulation.forward_arm import ForwardArm
from ident.simulation.time_stepping import integrate

STEPS_PER_RADIAN = 4.0
"""Steps of the simulation per 1/ω."""

POSTURES = 50
"""Spread over the motion, for the mean inertia."""


def simulated_segment(inverse: InverseDynamics, reference: Segment, bandwidth: float) -> Segment:
    """The segment with the motion of the simulated arm in place of the reference; torques as they are.

    Args:
        inverse: the model.
        reference: motion to follow.
        bandwidth: ω of the position loop [rad/s].

    Raises:
        ModelError: the model cannot be simulated, or the motion diverges.
    """
    heat = None if reference.temperature is None else np.mean(reference.temperature, axis=1)
    arm = ForwardArm(inverse, heat)
    stamps = reference.time - reference.time[0]
    duration = float(stamps[-1])
    steps = max(1, round(duration * bandwidth * STEPS_PER_RADIAN))
    time = np.linspace(0.0, duration, steps + 1)
    position, velocity = (_resampled(time, stamps, signal) for signal in (reference.position, reference.velocity))
    temperature = None if heat is None else np.repeat(heat[:, None], steps + 1, axis=1)
    along = inverse.torque(position, velocity, np.zeros_like(position), temperature).T
    postures = position[:, :: max(1, position.shape[1] // POSTURES)]
    inertia = np.mean(np.diagonal(inverse.inertia(postures), axis1=1, axis2=2), axis=0)
    stiffness, damping = bandwidth**2 * inertia, 2.0 * bandwidth * inertia
    arm.viscous = arm.viscous + np.diag(damping)  # integrated implicitly
    position, velocity = position.T, velocity.T
    # The damping acts on the mean velocity of the step, and so does the rest.
    held = 0.5 * (along[:-1] + along[1:]) + 0.5 * damping * (velocity[:-1] + velocity[1:])
    wanted = 0.5 * (position[:-1] + position[1:]) - 0.5 * (duration / steps) * velocity[:-1]

    def drive(now: float, q: FloatArray, rate: FloatArray) -> FloatArray:
        step = round(now / duration * steps)
        return np.asarray(held[step] + stiffness * (wanted[step] - q))

    motion = integrate(arm, position[0], velocity[0], drive, duration, steps)
    acceleration = np.gradient(motion.velocity, duration / steps, axis=0, edge_order=2)
    return replace(
        reference,
        position=_resampled(stamps, time, motion.position.T),
        velocity=_resampled(stamps, time, motion.velocity.T),
        acceleration=_resampled(stamps, time, acceleration.T),
    )


def _resampled(time: FloatArray, stamps: FloatArray, signal: FloatArray) -> FloatArray:
    """A signal (n, N) at `stamps` [s], at other times (M,), (n, M)."""
    return np.array([np.interp(time, stamps, row) for row in signal])
