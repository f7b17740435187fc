"""Joint references of a Universal Robots controller, one period at a time: movej, servoj, speedj, stopj.

A motion is begun at a reference and hands out the next one each period. Shapes are (n,), units rad and s.
"""

from __future__ import annotations

import math

import numpy as np

from drivers.core.arrays import FloatArray
from sim_drivers.plant.control import Reference

LOOKAHEAD_RANGE = (0.03, 0.2)
"""URScript's range of servoj's lookahead_time [s]."""

ACCELERATION_RANGE = (0.01, 40.0)
"""ur_rtde's range of a joint acceleration [rad/s²], its lower end lifted so that every stop ends."""

LEAST_MOVEJ_SPEED = 1e-3
"""[rad/s]: a movej of no speed would never end."""


class MoveJ:
    """movej: straight in joint space, a trapezoid of speed; the joint with the longest distance leads.

    A moving arm is stopped first, with the same acceleration. Speed [rad/s] and acceleration [rad/s²] are the leading
    joint's; the whole motion is slowed down to keep the speed limits (n,) [rad/s].
    """

    def __init__(
        self, start: Reference, target: FloatArray, speed: float, acceleration: float, speed_limit: FloatArray
    ) -> None:
        self._target, self._speed_limit, self._wanted_speed = target.copy(), speed_limit, max(speed, LEAST_MOVEJ_SPEED)
        self._acceleration = float(np.clip(acceleration, *ACCELERATION_RANGE))
        self._brake: VelocityRamp | None = None
        self.finished = False
        if np.any(start.velocity):
            self._brake = VelocityRamp(start, np.zeros_like(target), self._acceleration)
        else:
            self._plan(start.position)

    def _plan(self, start: FloatArray) -> None:
        way = self._target - start
        self._start, self._time = start.copy(), 0.0
        self._length = float(np.max(np.abs(way), initial=0.0))
        if self._length == 0.0:
            self._direction, self._speed, self._ramp, self._duration = way, 0.0, 0.0, 0.0
            return
        self._direction = way / self._length
        allowed = float(np.min(self._speed_limit / np.maximum(np.abs(self._direction), 1e-12)))
        # Too short a way for full speed: a triangle.
        self._speed = min(self._wanted_speed, allowed, math.sqrt(self._length * self._acceleration))
        self._ramp = self._speed / self._acceleration
        self._duration = self._length / self._speed + self._ramp

    def step(self, duration: float) -> Reference:
        """The reference `duration` [s] later."""
        if self._brake is not None:
            reference = self._brake.step(duration)
            if self._brake.finished:
                self._brake = None
                self._plan(reference.position)
            return reference
        self._time += duration
        left = self._duration - self._time
        if left <= 0.0:
            self.finished = True
            return Reference.at_rest(self._target)
        if self._time < self._ramp:
            acceleration, speed = self._acceleration, self._acceleration * self._time
            gone = 0.5 * speed * self._time
        elif left < self._ramp:
            acceleration, speed = -self._acceleration, self._acceleration * left
            gone = self._length - 0.5 * speed * left
        else:
            acceleration, speed = 0.0, self._speed
            gone = speed * (self._time - 0.5 * self._ramp)
        direction = self._direction
        return Reference(self._start + direction * gone, direction * speed, direction * acceleration)


class VelocityRamp:
    """speedj and stopj: the velocity vector goes straight to its target; the joint with most to change leads.

    The velocities (n,) are zeros to stop; the acceleration [rad/s²] is the leading joint's.
    """

    def __init__(self, start: Reference, velocity: FloatArray, acceleration: float) -> None:
        self._reference = start
        self.retarget(velocity, acceleration)
        self.finished = not np.any(start.velocity) and not np.any(velocity)

    def retarget(self, velocity: FloatArray, acceleration: float) -> None:
        """Head for another velocity from now on."""
        self._velocity = velocity.copy()
        self._acceleration = float(np.clip(acceleration, *ACCELERATION_RANGE))

    def step(self, duration: float) -> Reference:
        """The reference `duration` [s] later."""
        before = self._reference.velocity
        missing = self._velocity - before
        largest = float(np.max(np.abs(missing), initial=0.0))
        share = 1.0 if largest == 0.0 else min(1.0, self._acceleration * duration / largest)
        after = self._velocity.copy() if share == 1.0 else before + share * missing
        position = self._reference.position + 0.5 * duration * (before + after)
        self._reference = Reference(position, after, (after - before) / duration)
        self.finished = not np.any(after) and not np.any(self._velocity)
        return self._reference


class ServoJ:
    """servoj: follows a target that moves, smoothed by the lookahead time.

    The controller's own law is not published. This one is a critically damped second-order lag with natural frequency
    2/lookahead: it follows a steady motion `lookahead` late and has no steps of velocity. servoj's gain is not used.
    """

    finished = False

    def __init__(self, start: Reference) -> None:
        self._reference = start
        self._target = start.position
        self._frequency = 2.0 / LOOKAHEAD_RANGE[1]

    def retarget(self, position: FloatArray, lookahead: float) -> None:
        """Follow this position from now on."""
        self._target = position.copy()
        self._frequency = 2.0 / float(np.clip(lookahead, *LOOKAHEAD_RANGE))

    def step(self, duration: float) -> Reference:
        """The reference `duration` [s] later: the exact solution for a target held that long."""
        omega = self._frequency
        error = self._reference.position - self._target
        slope = self._reference.velocity + omega * error
        decay = math.exp(-omega * duration)
        error_after = (error + slope * duration) * decay
        velocity = (slope - omega * (error + slope * duration)) * decay
        acceleration = -(omega**2) * error_after - 2.0 * omega * velocity
        self._reference = Reference(self._target + error_after, velocity, acceleration)
        return self._reference


JointMotion = MoveJ | VelocityRamp | ServoJ
"""A motion that has begun."""
