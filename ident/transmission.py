"""How the joints of the tree follow the joints with a motor, and the motors the joints (SR400 eq. 1-6)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.kinematics import FloatArray

ZERO_SHARE = 1e-12
"""Entries of G and R⁻ᵀGᵀ below this are rounding."""


@dataclass(frozen=True)
class Transmission:
    """Linear relations of an arm with closed loops or coupled motors: n joints in its tree, a of them with a motor.

    Attributes:
        active: (a,) numbers of the tree's joints that have a motor, in the order of every array.
        follow: (n, a) G = ∂q_tree/∂q_active (SR400 eq. 4).
        offset: (n,) b of q_tree = G·q_active + b [rad or m].
        coupling: (a, a) R of q_motor = R·q_active.
        pair_friction: (a,) whether a coupled joint rubs beside its motor (SR400 eq. 8).
        pair_inertia: (a,) whether an inertia of its own turns with a coupled joint, beside the motor's.
    """

    active: tuple[int, ...]
    follow: FloatArray
    offset: FloatArray
    coupling: FloatArray
    pair_friction: tuple[bool, ...]
    pair_inertia: tuple[bool, ...]

    @property
    def closed(self) -> bool:
        """Whether some joint has no motor."""
        return len(self.offset) > len(self.active)

    @property
    def coupled(self) -> tuple[bool, ...]:
        """Whether each motor is moved by several joints."""
        return tuple(bool(count > 1) for count in np.count_nonzero(self.coupling, axis=1))

    @property
    def joint_to_motor(self) -> FloatArray:
        """R⁻ᵀ (a, a): motor torques = R⁻ᵀ · torques at the active joints, by the power that both give."""
        return _without_rounding(np.asarray(np.linalg.inv(self.coupling).T, dtype=np.float64))

    @property
    def tree_to_motor(self) -> FloatArray:
        """R⁻ᵀ·Gᵀ (a, n): motor torques = R⁻ᵀ·Gᵀ · torques at the tree's joints (SR400 eq. 4 and 6)."""
        return _without_rounding(self.joint_to_motor @ self.follow.T)

    def tree_position(self, position: FloatArray) -> FloatArray:
        """Positions (n, …) of the tree's joints for positions (a, …) of the active ones [rad or m]."""
        offset = self.offset.reshape(-1, *(1,) * (position.ndim - 1))
        return np.asarray(np.tensordot(self.follow, position, axes=1) + offset)

    def tree_rate(self, rate: FloatArray) -> FloatArray:
        """Velocities or accelerations (n, …) of the tree's joints for those (a, …) of the active ones."""
        return np.asarray(np.tensordot(self.follow, rate, axes=1))

    def content(self) -> tuple[object, ...]:
        """All of it, comparable and printable."""
        return (
            self.active,
            self.follow.tolist(),
            self.offset.tolist(),
            self.coupling.tolist(),
            self.pair_friction,
            self.pair_inertia,
        )


def _without_rounding(matrix: FloatArray) -> FloatArray:
    return np.where(np.abs(matrix) < ZERO_SHARE * np.max(np.abs(matrix)), 0.0, matrix)
