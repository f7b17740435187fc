"""Dry friction over one time step: which directions stick, which slide, and with what torque.

With u = D·q̇ after the step and W = h·D·A⁻¹·Dᵀ (symmetric, positive semidefinite), find λ so that

    u = u_free − W·λ        λᵢ = fᵢ·sign(uᵢ), or |λᵢ| ≤ fᵢ where uᵢ = 0

the minimum of ½·λᵀWλ − u_freeᵀλ over the box |λ| ≤ f (Moreau 1988; Acary and Brogliato 2008, ch. 10).
"""

from __future__ import annotations

import numpy as np

from drivers.streams import FloatArray

CHANGES = 20
"""Changes of the sticking set before the sweeps take over, which always converge."""

SWEEPS = 500
PRECISION = 1e-10
"""Relative change of λ below which the sweeps end."""


def dry_friction(matrix: FloatArray, free: FloatArray, limit: FloatArray, guess: FloatArray) -> FloatArray:
    """λ (m,) [N·m].

    Primal-dual active set: a direction sticks where λ, corrected by its velocity, lies within the box. Where that
    cycles, projected Gauss-Seidel.

    Args:
        matrix: W (m, m).
        free: u_free (m,) velocity without dry friction [rad/s].
        limit: f (m,) [N·m].
        guess: λ of the step before.
    """
    scale = np.diagonal(matrix)
    torque, before = guess, b""
    for _ in range(CHANGES):
        wanted = torque + (free - matrix @ torque) / scale
        sticks = np.abs(wanted) < limit
        pattern = sticks.tobytes() + (wanted > 0.0).tobytes()
        if pattern == before:
            return torque
        before = pattern
        torque = _with_sticking(matrix, free, np.where(sticks, 0.0, np.copysign(limit, wanted)), sticks)
    return _swept(matrix, free, limit, np.clip(guess, -limit, limit))


def _with_sticking(matrix: FloatArray, free: FloatArray, sliding: FloatArray, sticks: np.ndarray) -> FloatArray:
    """λ with the values that hold the sticking directions; those of coupled joints may depend on each other."""
    if not sticks.any():
        return sliding
    torque = sliding.copy()
    remaining = (free - matrix @ sliding)[sticks]
    torque[sticks] = np.linalg.lstsq(matrix[np.ix_(sticks, sticks)], remaining, rcond=None)[0]
    return torque


def _swept(matrix: FloatArray, free: FloatArray, limit: FloatArray, torque: FloatArray) -> FloatArray:
    """Projected Gauss-Seidel."""
    for _ in range(SWEEPS):
        largest = 0.0
        for row in range(len(torque)):
            value = torque[row] + (free[row] - matrix[row] @ torque) / matrix[row, row]
            value = min(max(value, -limit[row]), limit[row])
            largest = max(largest, abs(value - torque[row]))
            torque[row] = value
        if largest <= PRECISION * float(np.max(limit)):
            break
    return torque
