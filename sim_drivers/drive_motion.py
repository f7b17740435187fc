"""References of one drive, one step of its control loop at a time: cyclic set-points, profiles, ramps to standstill.

Units rad (or m) and s, joint side.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Protocol

SMOOTHING = 400.0
"""Bandwidth [rad/s] of the filter behind cyclic set-points; a ramp follows 2/400 s late."""
LONGEST_CYCLE = 0.05
"""Set-points further apart than this [s] are steps, not a motion."""
LOCK_RANGE = 4.0
"""A SYNC further away than so many cycles from where it was expected starts the drives' clock anew."""
PHASE_GAIN = 0.05
"""Share of a SYNC's lateness that the drives' clock takes over."""
KEPT_SETPOINTS = 8
EXTRAPOLATED_CYCLES = 3.0
"""Cycles that a motion goes on by itself where set-points are late."""
ARRIVED = 1e-6
"""[rad]: as good as there."""


@dataclass(frozen=True)
class AxisReference:
    """Where a drive wants its joint: position, velocity, acceleration."""

    position: float
    velocity: float = 0.0
    acceleration: float = 0.0


class AxisMotion(Protocol):
    """A reference that moves by itself."""

    def step(self, duration: float) -> AxisReference:
        """The reference `duration` [s] later."""

    @property
    def finished(self) -> bool:
        """Whether it will move no more by itself."""


class Standstill:
    """From the present velocity to rest at a deceleration, then hold.

    Args:
        start: where it begins.
        deceleration: [rad/s²].
    """

    def __init__(self, start: AxisReference, deceleration: float) -> None:
        self._position, self._velocity = start.position, start.velocity
        self._deceleration = deceleration

    @property
    def finished(self) -> bool:
        """Whether the joint stands."""
        return self._velocity == 0.0

    def step(self, duration: float) -> AxisReference:
        """The reference `duration` [s] later."""
        if self._velocity == 0.0:
            return AxisReference(self._position)
        slope = -math.copysign(self._deceleration, self._velocity)
        time = min(duration, abs(self._velocity) / self._deceleration)
        self._position += self._velocity * time + 0.5 * slope * time**2
        self._velocity = 0.0 if time < duration else self._velocity + slope * time
        return AxisReference(self._position, self._velocity, slope if self._velocity else 0.0)


class SyncClock:
    """The drives' own clock, locked to SYNC: its jitter must not become a jitter of the motion.

    A second-order phase-locked loop; SYNC that pauses or jumps starts it anew.
    """

    def __init__(self) -> None:
        self._time = -math.inf
        self.cycle = 0.0

    def age(self, time: float) -> float:
        """How long ago the last SYNC was [s]."""
        return time - self._time

    def tick(self, time: float) -> float:
        """The smoothed time [s] of a SYNC that came at `time`; `cycle` is then the smoothed distance of two."""
        late = time - self._time - self.cycle
        if self.cycle > 0.0 and abs(late) <= LOCK_RANGE * self.cycle:
            self._time += self.cycle + PHASE_GAIN * late
            self.cycle += 0.25 * PHASE_GAIN**2 * late
        else:
            distance = time - self._time
            self.cycle = distance if 0.0 < distance <= LONGEST_CYCLE else 0.0
            self._time = time
        return self._time


class CyclicPosition:
    """Cyclic synchronous position: straight lines between set-points, one cycle late, then a critically damped filter.

    The last line is prolonged by some cycles where set-points are late; then the reference stands at the last one.

    Args:
        start: where it begins.
        time: when, in the clock of `aim` [s].
    """

    def __init__(self, start: AxisReference, time: float) -> None:
        self._reference, self._time = start, time
        self._setpoints: deque[tuple[float, float]] = deque([(time, start.position)], maxlen=KEPT_SETPOINTS)
        self._cycle = 0.0

    @property
    def finished(self) -> bool:
        """Whether it follows no set-point any more."""
        time, position = self._setpoints[-1]
        late = self._time - time > (2.0 + EXTRAPOLATED_CYCLES) * self._cycle
        return late and abs(self._reference.velocity) < ARRIVED and abs(self._reference.position - position) < ARRIVED

    def aim(self, target: float, time: float, cycle: float) -> None:
        """A new set-point of a SYNC at a time [s]; `cycle` [s] apart from its neighbours, 0 where that is unknown."""
        last, position = self._setpoints[-1]
        if cycle <= 0.0 or not 0.5 * cycle < time - last < (1.5 + LOCK_RANGE) * cycle:
            # After a pause the motion goes on from where it stands.
            self._setpoints.clear()
            self._setpoints.append((time - cycle, position))
        self._setpoints.append((time, target))
        self._cycle = cycle

    def step(self, duration: float) -> AxisReference:
        """The reference `duration` [s] later."""
        self._time += duration
        line, slope = self._line(self._time - self._cycle)
        before = self._reference
        # Both poles at −SMOOTHING, integrated exactly for an input that moves straight on: no lag behind a ramp.
        lag = before.position - (line - slope * duration)
        speed = before.velocity - slope
        mixed = speed + SMOOTHING * lag
        decay = math.exp(-SMOOTHING * duration)
        position = line + (lag + mixed * duration) * decay
        velocity = slope + (speed - SMOOTHING * mixed * duration) * decay
        self._reference = AxisReference(position, velocity)
        return self._reference

    def _line(self, time: float) -> tuple[float, float]:
        """Position and velocity on the line through the set-points."""
        end, last = self._setpoints[-1]
        if self._cycle <= 0.0 or time > end + EXTRAPOLATED_CYCLES * self._cycle:
            return last, 0.0
        place = len(self._setpoints) - 1
        while place > 1 and time < self._setpoints[place - 1][0]:
            place -= 1
        (begin, start), (end, last) = self._setpoints[place - 1], self._setpoints[place]
        slope = (last - start) / (end - begin)
        return last + slope * max(time - end, begin - end), slope if time >= begin else 0.0


class Profile:
    """Profile position: to a target with limited speed, acceleration and deceleration.

    Args:
        start: where it begins, in motion or not.
        target: [rad].
        speed: [rad/s].
        acceleration, deceleration: [rad/s²].
    """

    def __init__(
        self, start: AxisReference, target: float, speed: float, acceleration: float, deceleration: float
    ) -> None:
        self._position, self._velocity, self._target = start.position, start.velocity, target
        self._speed, self._acceleration, self._deceleration = speed, acceleration, deceleration

    @property
    def finished(self) -> bool:
        """Whether the target is reached."""
        return self._velocity == 0.0 and self._position == self._target

    def step(self, duration: float) -> AxisReference:
        """The reference `duration` [s] later."""
        if self.finished:
            return AxisReference(self._position)
        way = self._target - self._position
        # The largest speed after this step from which the rest of the way still suffices to stop, in whole steps.
        braking = self._deceleration * duration
        rest = max(abs(way) - 0.5 * math.copysign(self._velocity, self._velocity * way) * duration, 0.0)
        allowed = math.sqrt(0.25 * braking**2 + 2.0 * self._deceleration * rest) - 0.5 * braking
        wanted = math.copysign(min(self._speed, allowed), way)
        change = wanted - self._velocity
        slower = self._velocity * wanted < 0.0 or abs(wanted) < abs(self._velocity)
        limit = (self._deceleration if slower else self._acceleration) * duration
        change = min(max(change, -limit), limit)
        before, self._velocity = self._velocity, self._velocity + change
        self._position += 0.5 * (before + self._velocity) * duration
        if abs(self._target - self._position) <= ARRIVED and abs(self._velocity) <= 2.0 * braking:
            self._position, self._velocity = self._target, 0.0
        return AxisReference(self._position, self._velocity, change / duration)
