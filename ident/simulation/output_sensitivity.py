"""How the motion of a simulated arm, held near a recorded one, depends on its base parameters.

Along the simulated motion the departure δq that a change δθ causes solves

    M·δq̈ + (∂τ/∂q̇ + D)·δq̇ + (∂τ/∂q + K)·δq = −Y·δθ

with τ the inverse dynamics without dry friction, whose direction is held, K and D the controller's gains and Y the
regressor. It is integrated by the trapezoidal rule for all parameters at once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from drivers.core.arrays import FloatArray

DIFFERENCE = 1e-5
"""Steps of positions [rad] and velocities [rad/s] for the derivatives of the torque."""

STEPS_AT_ONCE = 1000

Torque = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
"""Positions, velocities, accelerations (n, m) → torques (n, m) without dry friction."""


def output_sensitivities(
    torque: Torque,
    regressor: Callable[[FloatArray, FloatArray, FloatArray], FloatArray],
    motion: tuple[FloatArray, FloatArray, FloatArray],
    gains: tuple[FloatArray, FloatArray],
    step: float,
) -> Iterator[FloatArray]:
    """Sensitivities (m, n, b) of the positions, chunk by chunk along the motion.

    Args:
        torque: inverse dynamics.
        regressor: (n, b, m) of chosen columns.
        motion: position, velocity, acceleration (n, N) of the simulated arm, `step` [s] apart.
        gains: K and D (n,) of the controller.
        step: [s].
    """
    dof, count = motion[0].shape
    stiffness, damping = (np.diag(gain) for gain in gains)
    state: tuple[FloatArray, FloatArray] | None = None
    for start in range(0, count, STEPS_AT_ONCE):
        chunk = tuple(signal[:, start : start + STEPS_AT_ONCE] for signal in motion)
        inertia, by_velocity, by_position = _derivatives(torque, *chunk)
        forced = -regressor(*chunk).transpose(2, 0, 1)
        by_velocity += damping
        by_position += stiffness
        implicit = np.linalg.inv(inertia + 0.5 * step * by_velocity + 0.25 * step**2 * by_position)
        if state is None:
            state = np.zeros((dof, forced.shape[2])), np.zeros((dof, forced.shape[2]))
        position, velocity = state
        out = np.empty(forced.shape)
        for sample in range(len(forced)):
            out[sample] = position
            rest = by_velocity[sample] @ velocity + by_position[sample] @ (position + 0.5 * step * velocity)
            change = step * (implicit[sample] @ (forced[sample] - rest))
            position = position + step * (velocity + 0.5 * change)
            velocity = velocity + change
        state = position, velocity
        yield out


def _derivatives(
    torque: Torque, position: FloatArray, velocity: FloatArray, acceleration: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """∂τ/∂q̈, ∂τ/∂q̇ and ∂τ/∂q (m, n, n), by central differences; the first is exact."""
    dof, count = position.shape
    result = [np.empty((count, dof, dof)) for _ in range(3)]
    signals = (acceleration, velocity, position)
    for matrices, signal, reach in zip(result, signals, (1.0, DIFFERENCE, DIFFERENCE), strict=True):
        for joint in range(dof):
            kept = signal[joint].copy()
            sides = []
            for sign in (1.0, -1.0):
                signal[joint] = kept + sign * reach
                sides.append(torque(position, velocity, acceleration))
            signal[joint] = kept
            matrices[:, :, joint] = ((sides[0] - sides[1]) / (2.0 * reach)).T
    return result[0], result[1], result[2]
