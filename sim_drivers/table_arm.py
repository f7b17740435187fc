"""A simulated arm whose controller speaks a table of CAN frames, without clock and bus.

The controller measures once a cycle, says it in the table's frames, and follows positions that it is commanded; what
a real one does beyond that (brakes, start-up, collision detection) it has not.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from daq.robot import JointLimits
from drivers.can_bus import EXTENDED
from drivers.can_frames.settings import CanFramesSettings, FixedFrame
from drivers.can_frames.signal_keys import WHOLE_ARM
from drivers.can_frames.table import Part, Signal, batches, decode, encode, parts_of
from drivers.errors import UsageError
from drivers.streams import FloatArray
from sim_drivers.bus_load import Frame
from sim_drivers.controller import MeasurementLike, SimulatedArm
from sim_drivers.joint_motion import Reference, ServoJ

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
"""Quantities that a plant gives one a joint."""
SLOW = ("temperature",)
"""Quantities whose frames, where they hold nothing else, take turns: one a cycle."""
SUBSTEP = 0.002
"""How often the reference of the joint controllers is renewed [s]."""
FOLLOW_PERIODS = 1.5
"""The way to a commanded position takes so many periods, so that it goes on where the next command comes late."""
LOOKAHEAD = 0.03
"""Of the smoothing behind that [s]: steps of velocity between two commands would be steps of torque."""
SPEED_MARGIN = 1.2
"""A command that asks for more than this share of a joint's velocity limit is a fault."""
HALT_DECELERATION = 10.0
"""Of a stop [rad/s²]: an assumption."""
FAULT_COMMAND, FAULT_REQUESTED = 1, 2
"""What `fault` says: a command outside the joint's limits of position or speed; a fault on request."""


class TableArm:
    """The controller.

    Args:
        arm: the plant.
        joints: limits, one a joint.
        settings: of the connection; the same table that the driver reads.

    Raises:
        UsageError: the table has a quantity that a simulated arm does not measure.

    Attributes:
        enabled: whether it follows commands.
        messages: for whoever shows them.
    """

    def __init__(self, arm: SimulatedArm, joints: Sequence[JointLimits], settings: CanFramesSettings) -> None:
        for signal in settings.signals:
            if signal.quantity not in (*MEASURED, *WHOLE_ARM, "fault"):
                raise UsageError(
                    f"a simulated arm does not measure {signal.label}", hint=f"it has {', '.join(MEASURED)}"
                )
        self.arm = arm
        self.enabled = False
        self.messages: deque[str] = deque(maxlen=100)
        self._settings = settings
        self._names = [joint.name for joint in joints]
        self._lower, self._upper = np.array([joint.position for joint in joints], dtype=np.float64).T
        self._speed = np.array([joint.velocity for joint in joints], dtype=np.float64)
        parts = parts_of(settings.signals)
        self._slow = [part for part in parts if all(signal.quantity in SLOW for signal in part.signals)]
        self._fast = [part for part in parts if part not in self._slow]
        self._faults = np.zeros(len(joints))
        self._cycles = 0
        self._commanded: dict[int, FloatArray] = {}
        self._starting = 0
        self._left = 0.0
        self._goal: FloatArray = np.zeros(len(joints))
        self._velocity: FloatArray = np.zeros(len(joints))
        self._servo = ServoJ(Reference.at_rest(self._goal))
        self._hold()

    def advance(self, duration: float) -> None:
        """Let time pass [s]."""
        while duration > 1e-9:
            step = min(SUBSTEP, duration)
            duration -= step
            if self.enabled:
                self._left = max(0.0, self._left - step)
                self._servo.retarget(self._goal - self._left * self._velocity, LOOKAHEAD)
                reference = self._servo.step(step)
                self.arm.set_target(reference.position, reference.velocity, reference.acceleration)
            self.arm.advance(step)

    def cycle(self) -> list[Frame]:
        """The frames of the next cycle, with what the sensors say now."""
        measured = self.arm.measure()
        marker = self._settings.cycle
        frames = [] if marker is None else [_frame(marker, b"")]
        parts = list(self._fast)
        if self._slow:
            parts.append(self._slow[self._cycles % len(self._slow)])
        frames += [
            _frame(part.identifier, encode(part, [self._value(signal, measured) for signal in part.signals]))
            for part in parts
        ]
        self._cycles += 1
        return frames

    def is_poll(self, identifier: int, data: bytes) -> bool:
        """Whether a frame asks for a cycle: the last one of a poll."""
        poll = self._settings.poll
        return poll is not None and poll.frames[-1] == FixedFrame(identifier, data)

    def obey(self, identifier: int, data: bytes) -> None:
        """Take a frame of the master: start, stop, or a command."""
        settings, given = self._settings, FixedFrame(identifier, data)
        if given in settings.stop:
            if self.enabled:
                self.arm.halt(HALT_DECELERATION)
            self.enabled, self._starting = False, 0
            self._commanded.clear()
            return
        if given in settings.start:
            # In their order, as a procedure that a maker prescribes.
            self._starting = self._starting + 1 if settings.start[self._starting % len(settings.start)] == given else 0
            if self._starting == len(settings.start):
                self._enable()
            return
        table = settings.command
        if table is None:
            return
        grouped = dict(batches([(0.0, identifier, data)]))
        for number, part in enumerate(table.parts):
            if part.identifier != identifier:
                continue
            _, values, _ = decode(part, grouped[identifier])
            if len(values):
                self._commanded[number] = values[0]
        if len(self._commanded) == len(table.parts):
            self._follow(table.parts)

    def fail(self, joint: int, reason: int = FAULT_REQUESTED) -> None:
        """Let a joint fall into fault: the arm halts and is enabled no more until it is started anew."""
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
        self._velocity = np.zeros_like(self._goal)
        self._left = 0.0
        self._servo = ServoJ(Reference.at_rest(self._goal))

    def _follow(self, parts: Sequence[Part]) -> None:
        goal = np.full(len(self._names), np.nan)
        for number, part in enumerate(parts):
            for signal, value in zip(part.signals, self._commanded[number], strict=True):
                if signal.quantity == "position":
                    goal[self._names.index(signal.joint)] = value
        self._commanded.clear()
        if not self.enabled and not self._settings.start and not np.any(self._faults):
            self._hold()
            self.enabled = True
        if not self.enabled:
            return
        allowed = SPEED_MARGIN * self._speed / self._settings.rate
        outside = ~((goal >= self._lower) & (goal <= self._upper) & (np.abs(goal - self._goal) <= allowed))
        if np.any(outside):
            self.fail(int(np.argmax(outside)), FAULT_COMMAND)
            return
        period = FOLLOW_PERIODS / self._settings.rate
        reached = self._goal - self._left * self._velocity
        self._goal, self._left, self._velocity = goal, period, (goal - reached) / period

    def _value(self, signal: Signal, measured: MeasurementLike) -> float:
        low, high = signal.limits
        if signal.quantity in WHOLE_ARM:
            now = float(self._cycles) if signal.quantity == "counter" else self.arm.time
            if signal.field.floating:
                return now
            turn = signal.gain * 2.0**signal.field.length
            # To whole counts first: 0.9999 of the last count would otherwise round to one that the bits do not hold.
            counts = math.floor((now - signal.bias) % turn / signal.gain + 1e-6) % 2**signal.field.length
            return float(low + signal.gain * counts)
        joint = self._names.index(signal.joint)
        value = float(self._faults[joint] if signal.quantity == "fault" else getattr(measured, signal.quantity)[joint])
        return min(max(value, low), high)


def _frame(identifier: int, data: bytes) -> Frame:
    return Frame(identifier & ~EXTENDED, data, bool(identifier & EXTENDED))
