"""Joint controllers of simulated arms: from a target to a torque.

Both place the poles of every joint by its inertia J: stiffness J·ω², damping 2·ζ·J·ω, integral action ι·J·ω³. All
arrays are (n,), units N·m, rad, s.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import FloatArray
from ident.model.dynamics.rigid_arm import RigidArm
from sim_drivers.plant.friction import FrictionParameters

DAMPING_RATIO = 1.0
INTEGRAL_SHARE = 0.1
"""ι; by Routh a loop without delay is stable below 2·ζ, or 2·ζ·J/M for a joint with an inertia M above J."""

FRICTION_WIDTH = 0.02
"""Width [rad/s] of the smoothed sign in the friction that computed torque compensates."""

COUPLING_LIMIT = 3.0
"""Largest increase of ω² of coupled joints under independent controllers over the design value."""


def independent_inertia(inertias: FloatArray, inverse_inertias: FloatArray) -> FloatArray:
    """Inertias J (n,) that independent joint controllers may be tuned for.

    The mean diagonal of the joint-space inertia M, given as (K, n) at K postures, lowered where another posture or the
    other joints leave a joint lighter, until no eigenvalue of M⁻¹·diag(J), hence no ω², is more than `COUPLING_LIMIT`
    times the design value; M⁻¹ is (K, n, n) there.
    """
    lightest = 1.0 / np.max(np.diagonal(inverse_inertias, axis1=1, axis2=2), axis=0)
    inertia = np.minimum(np.mean(inertias, axis=0), COUPLING_LIMIT * lightest)
    root = np.sqrt(inertia)
    largest = float(np.max(np.linalg.eigvalsh(root[:, None] * inverse_inertias * root)))
    return np.asarray(inertia * min(1.0, COUPLING_LIMIT / largest))


@dataclass(frozen=True)
class Reference:
    """Reference of a controller: position, velocity and acceleration (n,)."""

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray

    @staticmethod
    def at_rest(position: FloatArray) -> Reference:
        """A goal at rest at a position."""
        zeros = np.zeros(len(position))
        return Reference(np.array(position, dtype=np.float64), zeros, zeros)


class ErrorIntegral:
    """Integral of the position error over periods [s], stopped for the joints whose drive saturates.

    Attributes:
        limit: (n,) of the torque, which may change [N·m].
    """

    def __init__(self, period: float, torque_limit: FloatArray) -> None:
        self._period, self.limit = period, torque_limit
        self.value = np.zeros(len(torque_limit))
        self._last = np.zeros(len(torque_limit))

    def add(self, error: FloatArray) -> FloatArray:
        """The integral with this error included."""
        self.value = self.value + self._period * np.where(np.abs(self._last) < self.limit, error, 0.0)
        return self.value

    def limited(self, torque: FloatArray) -> FloatArray:
        """The torque within the limits; remembered for the next call of `add`."""
        self._last = torque
        return np.minimum(np.maximum(torque, -self.limit), self.limit)


class JointController(ABC):
    """Drive torques from measured position and velocity, within limits."""

    def __init__(self, period: float, torque_limit: FloatArray) -> None:
        self._integral = ErrorIntegral(period, torque_limit)

    @abstractmethod
    def torque(self, target: Reference, position: FloatArray, velocity: FloatArray) -> FloatArray:
        """Torque (n,) [N·m] that the drives shall give until the next call."""

    def limit_torque(self, limit: FloatArray) -> None:
        """Keep the torque within (n,) [N·m] from now on."""
        self._integral.limit = limit


class Pid(JointController):
    """Independent joints: PID on the encoder, with the rigid-body torque of the target fed forward (gravity at rest).

    Args:
        arm: the nominal arm with its motors' inertias.
        inertia: (n,) J of `independent_inertia` [kg·m²].
        largest_inertia: (n,) largest that the joint may have [kg·m²]; a heavy joint tolerates less integral action.
        bandwidth: ω [rad/s].
        period: between two calls [s].
        torque_limit: (n,) [N·m].
    """

    def __init__(
        self,
        arm: RigidArm,
        inertia: FloatArray,
        largest_inertia: FloatArray,
        bandwidth: float,
        period: float,
        torque_limit: FloatArray,
    ) -> None:
        super().__init__(period, torque_limit)
        self._arm = arm
        self._stiffness = inertia * bandwidth**2
        self._damping = 2.0 * DAMPING_RATIO * inertia * bandwidth
        self._integral_gain = INTEGRAL_SHARE * inertia**2 / largest_inertia * bandwidth**3

    def torque(self, target: Reference, position: FloatArray, velocity: FloatArray) -> FloatArray:  # noqa: D102
        error = target.position - position
        return self._integral.limited(
            self._stiffness * error
            + self._damping * (target.velocity - velocity)
            + self._integral_gain * self._integral.add(error)
            + self._arm.inverse(target.position, target.velocity, target.acceleration)
        )


class ComputedTorque(JointController):
    """Inverse dynamics of the target's acceleration corrected by PID, plus the friction of the target's motion.

    Args:
        arm: the nominal arm with its motors' inertias.
        friction: nominal Coulomb, viscous and offset friction; the other terms are left to the feedback.
        bandwidth: ω [rad/s].
        period: between two calls [s].
        torque_limit: (n,) [N·m].
    """

    def __init__(
        self, arm: RigidArm, friction: FrictionParameters, bandwidth: float, period: float, torque_limit: FloatArray
    ) -> None:
        super().__init__(period, torque_limit)
        self._arm = arm
        self._friction = friction
        self._stiffness = bandwidth**2
        self._damping = 2.0 * DAMPING_RATIO * bandwidth
        self._integral_gain = INTEGRAL_SHARE * bandwidth**3

    def torque(self, target: Reference, position: FloatArray, velocity: FloatArray) -> FloatArray:  # noqa: D102
        error = target.position - position
        acceleration = (
            target.acceleration
            + self._stiffness * error
            + self._damping * (target.velocity - velocity)
            + self._integral_gain * self._integral.add(error)
        )
        friction = (
            self._friction.coulomb * np.tanh(target.velocity / FRICTION_WIDTH)
            + self._friction.viscous * target.velocity
            + self._friction.offset
        )
        return self._integral.limited(self._arm.inverse(position, velocity, acceleration) + friction)


class Braking:
    """The target of a joint-wise stop: every velocity falls at its deceleration to zero, then the position is held.

    It begins at the target `start`, with decelerations (n,) [rad/s²].
    """

    def __init__(self, start: Reference, deceleration: FloatArray) -> None:
        self._start, self._deceleration = start, deceleration
        self._stop_time = np.abs(start.velocity) / deceleration

    def target(self, elapsed: float) -> Reference:
        """The target `elapsed` [s] after the start."""
        time = np.minimum(elapsed, self._stop_time)
        moving = elapsed < self._stop_time
        slope = -np.sign(self._start.velocity) * self._deceleration
        return Reference(
            self._start.position + self._start.velocity * time + 0.5 * slope * time**2,
            np.where(moving, self._start.velocity + slope * time, 0.0),
            np.where(moving, slope, 0.0),
        )
