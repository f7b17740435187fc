"""Transmission between motors, joints with a motor, and all joints of the tree (SR400 eq. 1-6)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import ClassVar

import numpy as np

from drivers.core.arrays import FloatArray

ZERO_SHARE = 1e-12
"""Entries of G and R⁻ᵀGᵀ below this are rounding."""


@dataclass(frozen=True)
class TreeMotion:
    """Motion of the n joints of a tree at N samples, a of them with a motor."""

    # position, velocity, acceleration: (n, N) [rad, rad/s, rad/s² or m…]
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    follow: FloatArray  # G = ∂q_tree/∂q_active, (n, a) where it is constant, else (n, a, N)


@dataclass(frozen=True)
class Transmission(ABC):
    """How n joints of a tree, a of them with a motor, and the motors move each other."""

    direct: ClassVar[bool] = False  # whether every joint of the tree has a motor that it moves alone
    # whether the joints without a motor follow by equations that some positions may not fulfil
    solved_numerically: ClassVar[bool] = False
    active: tuple[int, ...]  # (a,) indices of the tree's joints that have a motor, in the order of every array
    coupling: FloatArray  # (a, a) R of q_motor = R·q_active
    pair_friction: tuple[bool, ...]  # (a,) whether a coupled joint rubs beside its motor (SR400 eq. 8)
    pair_inertia: tuple[bool, ...]  # (a,) whether an inertia of its own turns with a coupled joint, beside the motor's

    @property
    @abstractmethod
    def joint_count(self) -> int:
        """Joints of the tree, n."""

    @property
    def closed(self) -> bool:
        """Return whether some joint has no motor."""
        return self.joint_count > len(self.active)

    @property
    def coupled(self) -> tuple[bool, ...]:
        """Return whether each motor is moved by several joints."""
        return tuple(bool(count > 1) for count in np.count_nonzero(self.coupling, axis=1))

    @property
    def joint_to_motor(self) -> FloatArray:
        """R⁻ᵀ (a, a): motor torques = R⁻ᵀ · torques at the active joints, by the power that both give."""
        return without_rounding(np.asarray(np.linalg.inv(self.coupling).T, dtype=np.float64))

    def motor_rate(self, rate: FloatArray) -> FloatArray:
        """Velocities or accelerations (a, N) of the motors, referred to the joint side, for those of the joints."""
        return np.asarray(self.coupling @ rate)

    def at_joints(self, torque: FloatArray) -> FloatArray:
        """Rᵀ times torques (…, a, N) of the motors: those at the active joints."""
        return np.asarray(self.coupling.T @ torque)

    def from_tree(self, motion: TreeMotion, torque: FloatArray) -> FloatArray:
        """Gᵀ times torques (n, N) of the tree's joints in a motion: those (a, N) at the active joints."""
        follow = motion.follow
        return np.asarray(follow.T @ torque if follow.ndim == 2 else np.einsum("mnN,mN->nN", follow, torque))

    def to_motors(self, follow: FloatArray) -> FloatArray:
        """R⁻ᵀ·Gᵀ (a, n) or (a, n, N) from G (n, a) or (n, a, N): motor torques from those of the tree's joints."""
        return np.asarray(np.einsum("ma,na...->mn...", self.joint_to_motor, follow))

    @abstractmethod
    def tree_position(self, position: FloatArray) -> FloatArray:
        """Positions (n, …) of the tree's joints for positions (a, …) of the active ones [rad or m]."""

    @abstractmethod
    def tree_velocity(self, position: FloatArray, velocity: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Positions and velocities (n, N) of the tree's joints for those (a, N) of the active ones."""

    @abstractmethod
    def tree_motion(self, position: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> TreeMotion:
        """The tree's motion for positions, velocities and accelerations (a, N) of the active joints."""

    @abstractmethod
    def active_gradient(self, position: FloatArray, gradient: FloatArray) -> FloatArray:
        """Derivatives (…, a, N) by the active positions from those (…, n, N) by the tree's, at positions (a, N)."""

    @abstractmethod
    def pull_back(
        self,
        velocity: FloatArray,
        acceleration: FloatArray,
        motion: TreeMotion,
        gradient: FloatArray,
        share: FloatArray,
    ) -> FloatArray:
        """Derivatives (3, a, N) by the active joints' position, velocity and acceleration.

        Args:
            velocity: (a, N) of the active joints.
            acceleration: (a, N).
            motion: result of `tree_motion` for them.
            gradient: (3, n, N) derivatives by the tree's position, velocity and acceleration.
            share: (a, n, N) derivatives by R⁻ᵀ·Gᵀ where it varies.
        """

    @abstractmethod
    def share_pattern(self) -> tuple[FloatArray, np.ndarray]:
        """R⁻ᵀ·Gᵀ (a, n) with its constant entries, zeros elsewhere, and where (a, n) it varies with the position."""

    @abstractmethod
    def content(self) -> tuple[object, ...]:
        """All of it, comparable and printable."""

    def _motor_content(self) -> tuple[object, ...]:
        return (self.coupling.tolist(), self.pair_friction, self.pair_inertia)


@dataclass(frozen=True)
class LinearTransmission(Transmission):
    """Joints that follow linearly: parallelograms, equations, coupled motors."""

    follow: FloatArray  # (n, a) G = ∂q_tree/∂q_active (SR400 eq. 4)
    offset: FloatArray  # (n,) b of q_tree = G·q_active + b [rad or m]

    @property
    def joint_count(self) -> int:
        """Implement `Transmission`."""
        return len(self.offset)

    @cached_property
    def tree_to_motor(self) -> FloatArray:
        """R⁻ᵀ·Gᵀ (a, n): motor torques = R⁻ᵀ·Gᵀ · torques at the tree's joints (SR400 eq. 4 and 6)."""
        return without_rounding(self.joint_to_motor @ self.follow.T)

    def tree_position(self, position: FloatArray) -> FloatArray:
        """Implement `Transmission`."""
        offset = self.offset.reshape(-1, *(1,) * (position.ndim - 1))
        return np.asarray(np.tensordot(self.follow, position, axes=1) + offset)

    def tree_rate(self, rate: FloatArray) -> FloatArray:
        """Velocities or accelerations (n, …) of the tree's joints for those (a, …) of the active ones."""
        return np.asarray(np.tensordot(self.follow, rate, axes=1))

    def tree_velocity(self, position: FloatArray, velocity: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Implement `Transmission`."""
        return self.tree_position(position), self.tree_rate(velocity)

    def tree_motion(self, position: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> TreeMotion:
        """Implement `Transmission`."""
        return TreeMotion(
            self.tree_position(position), self.tree_rate(velocity), self.tree_rate(acceleration), self.follow
        )

    def active_gradient(self, position: FloatArray, gradient: FloatArray) -> FloatArray:
        """Implement `Transmission`."""
        return np.asarray(np.einsum("na,...nt->...at", self.follow, gradient))

    def pull_back(
        self,
        velocity: FloatArray,
        acceleration: FloatArray,
        motion: TreeMotion,
        gradient: FloatArray,
        share: FloatArray,
    ) -> FloatArray:
        """Implement `Transmission`."""
        return self.active_gradient(motion.position, gradient)

    def share_pattern(self) -> tuple[FloatArray, np.ndarray]:
        """Implement `Transmission`."""
        constant = self.tree_to_motor
        return constant, np.zeros(constant.shape, dtype=bool)

    def content(self) -> tuple[object, ...]:
        """Implement `Transmission`."""
        return (self.active, self.follow.tolist(), self.offset.tolist(), *self._motor_content())


class DirectTransmission(LinearTransmission):
    """The identity: every joint of the tree has a motor that it moves alone."""

    direct = True

    def motor_rate(self, rate: FloatArray) -> FloatArray:
        """Implement `Transmission`."""
        return rate

    def at_joints(self, torque: FloatArray) -> FloatArray:
        """Implement `Transmission`."""
        return torque

    def from_tree(self, motion: TreeMotion, torque: FloatArray) -> FloatArray:
        """Implement `Transmission`."""
        return torque

    def tree_position(self, position: FloatArray) -> FloatArray:
        """Implement `Transmission`."""
        return position

    def tree_rate(self, rate: FloatArray) -> FloatArray:
        """Implement `LinearTransmission`."""
        return rate

    def active_gradient(self, position: FloatArray, gradient: FloatArray) -> FloatArray:
        """Implement `Transmission`."""
        return gradient


@lru_cache
def direct_transmission(joints: int) -> DirectTransmission:
    """The transmission of a tree whose joints all have motors of their own."""
    none, identity = (False,) * joints, np.eye(joints)
    return DirectTransmission(tuple(range(joints)), identity, none, none, identity, np.zeros(joints))


def without_rounding(matrix: FloatArray) -> FloatArray:
    """The matrix, entries that are rounding set to zero."""
    return np.where(np.abs(matrix) < ZERO_SHARE * np.max(np.abs(matrix)), 0.0, matrix)
