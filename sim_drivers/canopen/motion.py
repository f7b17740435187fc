"""References of one drive, one step of its control loop at a time: cyclic set-points, profiles, ramps to standstill.

Units rad (or m) and s, joint side.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

LONGEST_CYCLE = 0.05
"""SYNCs, or commands, at a longer interval than this [s] begin a new series of unknown rate."""
NEXT_SHARE = 0.9
"""A SYNC is still the next one where it is late by up to this share of a cycle; later ones come after others were left
out."""
PHASE_GAIN = 0.05
"""Share of a SYNC's lateness that the drives' clock follows."""
ASTRAY, ASTRAY_MEMORY = 0.2, 10.0
"""SYNCs that are early or late by more than this share of a cycle on average, over so many: the rate has changed."""
LAG_CYCLES = 2.0
"""So many cycles after its SYNC the reference passes a set-point: the curve needs the next two."""
EXTRAPOLATED_CYCLES = 3
"""Cycles for which a motion continues with its velocity where set-points are missing."""
COAST_DECELERATION = 20.0
"""Deceleration where none comes even then [rad/s²]: an assumption."""
LARGEST_ACCELERATION = 30.0
"""Set-points with a larger acceleration [rad/s²] are a jump, not a motion: an assumption."""
RESUME_TIME = 0.03
"""Time constant [s] of the approach to set-points that jump, or that return after an interruption: an assumption."""
LONGEST_COAST = 1000
"""Cycles after which a joint without set-points is certainly at rest."""
ARRIVED = 1e-6
"""[rad]: as good as there."""


@dataclass(frozen=True)
class AxisReference:
    """Reference of a drive for its joint: position, velocity, acceleration."""

    position: float
    velocity: float = 0.0
    acceleration: float = 0.0


class Standstill:
    """Brakes from the present velocity to rest at a deceleration [rad/s²], then holds."""

    def __init__(self, start: AxisReference, deceleration: float) -> None:
        self._position, self._velocity = start.position, start.velocity
        self._deceleration = deceleration

    @property
    def finished(self) -> bool:
        """Return whether the joint is at rest."""
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

    A second-order phase-locked loop. SYNCs left out are counted; a long pause, or another rate, starts it anew. The
    distance of two SYNCs [s] is 0 where it is not known beforehand.

    Attributes:
        cycle: smoothed; 0 where unknown.
    """

    def __init__(self, cycle: float = 0.0) -> None:
        self._time = -math.inf
        self._known = cycle
        self.cycle = cycle
        self._first, self._cycles, self._astray = 0.0, 0.0, 0.0

    def age(self, time: float) -> float:
        """Return how long ago the last SYNC was [s]."""
        return time - self._time

    def passed(self, time: float) -> int:
        """Return how many cycles a SYNC that comes at `time` is after the last one, by time; at least 1."""
        cycles = (time - self._time) / self.cycle + 1.0 - NEXT_SHARE if self.cycle > 0.0 else 1.0
        return int(min(max(cycles, 1.0), LONGEST_COAST))

    def tick(self, time: float, passed: int | None = None) -> float:
        """The smoothed time [s] of a SYNC that came at `time`; `passed` cycles behind the last where that is known."""
        distance = time - self._time
        astray = self._astray > ASTRAY and not self._known
        if astray or abs(distance) > LONGEST_CYCLE:
            self.cycle = 0.0 if astray else self.cycle
            self._time = self._first = time
            self._cycles = self._astray = 0.0
            return time
        if self.cycle <= 0.0:
            self.cycle = max(distance, 0.0)
        passed = self.passed(time) if passed is None else passed
        self._cycles += passed
        late = distance - passed * self.cycle
        self._astray += (abs(late) / self.cycle - self._astray) / ASTRAY_MEMORY if self.cycle else 0.0
        # While it locks, averages; then a loop of fixed bandwidth.
        self._time += passed * self.cycle + max(PHASE_GAIN, 1.0 / (self._cycles + 1.0)) * late
        if self._cycles * PHASE_GAIN < 1.0 and not self._known:
            self.cycle = (time - self._first) / self._cycles
        else:
            self.cycle += 0.25 * PHASE_GAIN**2 * late / passed
        return self._time


class CyclicPosition:
    """Cyclic synchronous position: a uniform cubic B-spline over the set-points, two cycles late.

    Its acceleration is continuous. Straight lines have a step of velocity at every SYNC: the torque, which is measured
    at every SYNC too, would always differ from its mean by the same share of the inertial torque.

    Where set-points are missing, the motion continues with its velocity for some cycles, then comes to rest. When they
    come again, or jump, it goes to them softly.

    Args:
        start: where it begins; from a motion it continues with zero velocity.
        time: when, in the clock of `aim` [s].
    """

    def __init__(self, start: AxisReference, time: float) -> None:
        self._reference, self._time = start, time
        self._points = deque([start.position] * 4, maxlen=8)
        self._newest, self._cycle = time, LONGEST_CYCLE
        self._coasted: list[float] = []
        self._target, self._speed = start.position, 0.0
        # How far, and how fast, from where the set-points would have the joint, after a jump of theirs.
        self._distance = self._approach = 0.0
        self._jumped = False

    @property
    def finished(self) -> bool:
        """Return whether it follows no set-point any more."""
        late = self._time - self._newest > (LAG_CYCLES + EXTRAPOLATED_CYCLES) * self._cycle
        return late and abs(self._reference.velocity) < ARRIVED

    def aim(self, target: float, time: float, cycle: float) -> None:
        """A new set-point of a SYNC at a time [s]; `cycle` [s] apart from its neighbours, 0 where that is unknown."""
        elapsed = time - self._newest
        left_out = min(round(elapsed / self._cycle) - 1, LONGEST_COAST)
        if left_out < 0:  # a second one in the same cycle, or an earlier one
            replaced = self._points.pop()
            if abs(target - self._target) > abs(self._speed) * self._cycle + LARGEST_ACCELERATION * self._cycle**2:
                self._distance, self._jumped = replaced - target, True
            time = max(time, self._newest)
        else:
            self._coast(left_out + 1)
            *played, following = self._coasted[: left_out + 1]
            self._points.extend(played)  # what went in the place of those left out stays
            speed, self._speed = self._speed, (target - self._target) / elapsed
            # What a steady acceleration makes of a line through the last two, by differences.
            largest = 0.5 * LARGEST_ACCELERATION * self._cycle**2 * (left_out + 1) * (left_out + 2)
            if left_out > EXTRAPOLATED_CYCLES or abs(target - self._target - speed * elapsed) > largest:
                self._distance, self._jumped = following - target, True
            elif self._jumped:
                # Only the second set-point shows how fast they go.
                self._approach = (following - self._points[-1]) / self._cycle - self._speed
                self._distance, self._jumped = following - target, False
            else:
                self._come_closer((left_out + 1) * self._cycle)
        self._coasted.clear()
        self._points.append(target + self._distance)
        self._target, self._newest = target, time
        self._cycle = cycle if cycle > 0.0 else LONGEST_CYCLE

    def _come_closer(self, duration: float) -> None:
        """Critically damped, exactly."""
        rate = 1.0 / RESUME_TIME
        mixed = self._approach + rate * self._distance
        decay = math.exp(-rate * duration)
        self._distance = (self._distance + mixed * duration) * decay
        self._approach = (self._approach - rate * mixed * duration) * decay

    def step(self, duration: float) -> AxisReference:
        """The reference `duration` [s] later."""
        self._time += duration
        # Set-points are numbered from the newest, which is 0, into the past, and coasted ones into the future.
        place = (self._time - self._newest) / self._cycle - LAG_CYCLES
        first = max(math.floor(place), 2 - len(self._points))
        share = min(max(place - first, 0.0), 1.0)
        if first <= -2:  # as a rule: what was received, as `_point` gives it
            points = self._points
            before, start, end, after = points[first - 2], points[first - 1], points[first], points[first + 1]
        else:
            before, start, end, after = (self._point(first + offset) for offset in (-1, 0, 1, 2))
        rest = 1.0 - share
        position = (
            rest**3 * before
            + (4.0 - 6.0 * share**2 + 3.0 * share**3) * start
            + (4.0 - 6.0 * rest**2 + 3.0 * rest**3) * end
            + share**3 * after
        ) / 6.0
        slope = (rest**2 * (start - before) + (1.0 + 2.0 * share * rest) * (end - start) + share**2 * (after - end)) / (
            2.0 * self._cycle
        )
        self._reference = AxisReference(position, slope)
        return self._reference

    def _point(self, set_point: int) -> float:
        if set_point <= 0:
            return self._points[set_point - 1]
        set_point = min(set_point, LONGEST_COAST)
        self._coast(set_point)
        return self._coasted[set_point - 1]

    def _coast(self, count: int) -> None:
        """Set-points in the place of those that do not come."""
        while len(self._coasted) < count:
            before, last = [*self._points, *self._coasted][-2:]
            way = last - before
            if len(self._coasted) >= EXTRAPOLATED_CYCLES:
                way = math.copysign(max(abs(way) - COAST_DECELERATION * self._cycle**2, 0.0), way)
            self._coasted += [last + way] * (1 if way else count - len(self._coasted))


class Profile:
    """Profile position: to a target [rad] with limited speed [rad/s], acceleration and deceleration [rad/s²]."""

    def __init__(
        self, start: AxisReference, target: float, speed: float, acceleration: float, deceleration: float
    ) -> None:
        self._position, self._velocity, self._target = start.position, start.velocity, target
        self._speed, self._acceleration, self._deceleration = speed, acceleration, deceleration

    @property
    def finished(self) -> bool:
        """Return whether the target is reached."""
        return self._velocity == 0.0 and self._position == self._target

    def step(self, duration: float) -> AxisReference:
        """The reference `duration` [s] later."""
        if self.finished:
            return AxisReference(self._position)
        way = self._target - self._position
        # The largest speed after this step from which the remaining distance suffices to stop, in whole steps.
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


ReferenceMotion = Standstill | CyclicPosition | Profile
"""A reference that moves on its own."""
