"""A simulated arm whose controller sends and obeys a table of CAN frames, without clock and bus.

The controller measures once per cycle, sends it in the table's frames, and follows commanded positions; what
a real one does beyond that (brakes, start-up, collision detection) it has not.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from daq.robot.schema import JointLimits
from drivers.can.bus import EXTENDED
from drivers.can_signals.settings import CanFramesSettings
from drivers.can_signals.table.signal_keys import WHOLE_ARM
from drivers.can_signals.table.signals import FixedFrame, FrameLayout, Signal, batches, decode, encode, frame_layouts
from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError
from sim_drivers.can.bus_load import Frame
from sim_drivers.canopen.motion import EXTRAPOLATED_CYCLES, AxisReference, CyclicPosition, SyncClock
from sim_drivers.plant.plant import Plant
from sim_drivers.plant.sensors import Measurement

MEASURED = (
    "position",
    "velocity",
    "current",
    "torque",
    "temperature",
    "target_position",
    "target_velocity",
    "target_acceleration",
    "target_current",
    "target_torque",
)
"""Quantities that a plant has per joint."""
SLOW = ("temperature",)
"""Quantities whose frames, where they hold nothing else, are sent in turn: one per cycle."""
SUBSTEP = 1e-3
"""How often the reference of the joint controllers is renewed [s]."""
SPEED_MARGIN = 1.2
"""A command beyond this share of a joint's velocity limit is a fault."""
LEAST_STEADY = 5.0
"""Speed over a period [rad/s²] from which two commands determine how far the third should be."""
HALT_DECELERATION = 10.0
"""Deceleration of a stop [rad/s²]: an assumption."""
FAULT_COMMAND, FAULT_REQUESTED = 1, 2
"""Values of `fault`: a command outside the joint's limits of position or speed; a fault on request."""


class TableArm:
    """The controller.

    Raises:
        UsageError: the table has a quantity that a simulated arm does not measure.

    Attributes:
        enabled: whether it follows commands.
        clock_ahead: of the counter or time in its frames [s], before its own time.
        messages: for the terminal, oldest first.
    """

    def __init__(self, arm: Plant, joints: Sequence[JointLimits], settings: CanFramesSettings) -> None:
        for signal in settings.signals:
            if signal.quantity not in (*MEASURED, *WHOLE_ARM, "fault"):
                raise UsageError(
                    f"a simulated arm does not measure {signal.label}", hint=f"it has {', '.join(MEASURED)}"
                )
        self.arm = arm
        self.enabled = False
        self.clock_ahead = 0.0
        self.messages: deque[str] = deque(maxlen=100)
        self._settings = settings
        self._names = [joint.name for joint in joints]
        self._lower, self._upper = np.array([joint.position for joint in joints], dtype=np.float64).T
        self._speed = np.array([joint.velocity for joint in joints], dtype=np.float64)
        layouts = frame_layouts(settings.signals)
        self._slow = [layout for layout in layouts if all(signal.quantity in SLOW for signal in layout.signals)]
        self._fast = [layout for layout in layouts if layout not in self._slow]
        self._faults = np.zeros(len(joints))
        self._cycles = 0
        self._commanded: dict[int, FloatArray] = {}
        self._starting = 0
        self._clock = SyncClock(1.0 / settings.keys.rate)
        self._time = self._commanded_at = 0.0
        self._ahead = 0.0
        self._goal: FloatArray = np.zeros(len(joints))
        self._step: FloatArray = np.zeros(len(joints))  # of the commands, per period
        self._axes: tuple[CyclicPosition, ...] = ()
        # How many periods of full speed the next command may go, one per joint.
        self._periods_left: FloatArray = np.zeros(len(joints))
        self._hold()

    def advance(self, duration: float) -> None:
        """Advance time [s]; the plant follows in whole steps of `SUBSTEP`."""
        self._time += duration
        self._ahead += duration
        while self._ahead >= SUBSTEP - 1e-9:
            self._ahead -= SUBSTEP
            if self.enabled:
                references = [axis.step(SUBSTEP) for axis in self._axes]
                position, velocity = np.array([(reference.position, reference.velocity) for reference in references]).T
                self.arm.set_target(position, velocity)
            self.arm.advance(SUBSTEP)

    def cycle(self) -> list[Frame]:
        """The frames of the next cycle, with the sensors' present values."""
        measured = self.arm.measure()
        marker = self._settings.keys.marker
        frames = [] if marker is None else [_frame(marker, b"")]
        layouts = list(self._fast)
        if self._slow:
            layouts.append(self._slow[self._cycles % len(self._slow)])
        frames += [
            _frame(layout.identifier, encode(layout, [self._value(signal, measured) for signal in layout.signals]))
            for layout in layouts
        ]
        self._cycles += 1
        return frames

    def is_poll(self, identifier: int, data: bytes) -> bool:
        """Return whether a frame requests a cycle: the last one of a poll."""
        poll = self._settings.poll
        return poll is not None and poll.frames[-1] == FixedFrame(identifier, data)

    def obey(self, identifier: int, data: bytes, late: float = 0.0) -> None:
        """Process a frame of the master: start, stop, or a command.

        `late` [s]: how long ago it arrived, where the arm's time is ahead.
        """
        settings, given = self._settings, FixedFrame(identifier, data)
        if given in settings.stop:
            if self.enabled:
                self.arm.halt(HALT_DECELERATION)
            self.enabled, self._starting = False, 0
            self._commanded.clear()
            return
        if given in settings.start:
            # In their order, as a procedure that a manufacturer prescribes.
            self._starting = self._starting + 1 if settings.start[self._starting % len(settings.start)] == given else 0
            if self._starting == len(settings.start):
                self._enable()
            return
        table = settings.command
        if table is None:
            return
        grouped = dict(batches([(0.0, identifier, data)]))
        for index, layout in enumerate(table.layouts):
            if layout.identifier != identifier:
                continue
            _, values, _ = decode(layout, grouped[identifier])
            if len(values):
                self._commanded[index] = values[0]
        if len(self._commanded) == len(table.layouts):
            self._follow(table.layouts, late)

    def fail(self, joint: int, reason: int = FAULT_REQUESTED) -> None:
        """Put a joint into fault: the arm halts and is disabled until it is started again."""
        self._faults[joint] = reason
        self.enabled, self._starting = False, 0
        self.arm.halt(HALT_DECELERATION)
        self.messages.append(f"fault {reason} of joint {self._names[joint]}")

    def _enable(self) -> None:
        self._starting = 0
        self._faults[:] = 0.0
        self._hold()
        self.enabled = True

    def _hold(self) -> None:
        self._goal = np.asarray(self.arm.measure().target_position, dtype=np.float64).copy()
        self._step = np.zeros_like(self._goal)
        self._periods_left = np.full(len(self._goal), 1.0 + EXTRAPOLATED_CYCLES)
        self._axes = tuple(CyclicPosition(AxisReference(start), self._time - self._ahead) for start in self._goal)

    def _follow(self, layouts: Sequence[FrameLayout], late: float) -> None:
        goal = np.full(len(self._names), np.nan)
        for index, layout in enumerate(layouts):
            for signal, value in zip(layout.signals, self._commanded[index], strict=True):
                if signal.quantity == "position":
                    goal[self._names.index(signal.joint)] = value
        self._commanded.clear()
        if not self.enabled and not self._settings.start and not np.any(self._faults):
            self._hold()
            self.enabled = True
        if not self.enabled:
            return
        # Commands that were left out or come late in a bunch may go their way at one stroke, no more.
        periods = (self._time - self._commanded_at) * self._settings.keys.rate
        self._periods_left = np.minimum(self._periods_left + periods, 1.0 + EXTRAPOLATED_CYCLES)
        self._periods_left -= np.abs(goal - self._goal) / (SPEED_MARGIN * self._speed / self._settings.keys.rate)
        outside = ~((goal >= self._lower) & (goal <= self._upper) & (self._periods_left >= 0.0))
        if np.any(outside):
            self.fail(int(np.argmax(outside)), FAULT_COMMAND)
            return
        # Commands are late, all of them, or left out: how far the motion has gone tells, and time where it stands.
        way, arrival = goal - self._goal, self._time - late
        passed, steady = self._clock.passed(arrival), float(np.linalg.norm(self._step))
        if passed <= 1 + EXTRAPOLATED_CYCLES and steady * self._settings.keys.rate**2 > LEAST_STEADY:
            most = max(round(self._clock.age(arrival) * self._settings.keys.rate), 1)
            passed = min(max(round(float(way @ self._step) / steady**2), 1), most)
        # A longer pause may have moved the motion itself: it tells no speed.
        self._step = way / passed if passed <= 1 + EXTRAPOLATED_CYCLES else np.zeros_like(way)
        moment = self._clock.tick(arrival, passed)
        for axis, target in zip(self._axes, goal.tolist(), strict=True):
            axis.aim(target, moment, self._clock.cycle)
        self._goal, self._commanded_at = goal, self._time

    def _value(self, signal: Signal, measured: Measurement) -> float:
        low, high = signal.limits
        if signal.quantity in WHOLE_ARM:
            ahead = self.clock_ahead
            counted = float(self._cycles + round(ahead * self._settings.keys.rate))
            now = counted if signal.quantity == "counter" else self.arm.time + ahead
            if signal.field.floating:
                return now
            turn = signal.gain * 2.0**signal.field.length
            # To whole counts first: 0.9999 of the last count would otherwise round to one that the bits do not hold.
            counts = math.floor((now - signal.bias) % turn / signal.gain + 1e-6) % 2**signal.field.length
            return float(low + signal.gain * counts)
        joint = self._names.index(signal.joint)
        value = float(self._faults[joint] if signal.quantity == "fault" else getattr(measured, signal.quantity)[joint])
        if signal.quantity == "position":
            value += self._ahead * float(measured.velocity[joint])  # between two steps of the plant
        return min(max(value, low), high)


def _frame(identifier: int, data: bytes) -> Frame:
    return Frame(identifier & ~EXTENDED, data, bool(identifier & EXTENDED))
