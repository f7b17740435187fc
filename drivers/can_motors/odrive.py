"""Frames of ODrive's CAN Simple, firmware 0.6 (see the table)."""

from __future__ import annotations

import struct
from collections.abc import Sequence

from drivers.can.bus import REMOTE
from drivers.can_motors.codec import Answer, CanFrame, MotorCodec
from drivers.core.units import TURN

HEARTBEAT, ADDRESS, SET_STATE, ESTIMATES, SET_MODE, SET_GOAL, SET_LIMITS = 0x01, 0x06, 0x07, 0x09, 0x0B, 0x0C, 0x0F
TEMPERATURES, SUPPLY, CLEAR_ERRORS, SET_POSITION_GAIN, SET_VELOCITY_GAINS, TORQUES = 0x15, 0x17, 0x18, 0x1A, 0x1B, 0x1C
EVERYONE = 0x3F
"""Node to which all axes listen."""
IDLE, CLOSED_LOOP = 1, 8
POSITION_CONTROL, PASSTHROUGH = 3, 1
MOST_SPEED, MOST_CURRENT = 1e4, 1e3
"""[turn/s] and [A] of a limit that is none."""


class OdriveCodec(MotorCodec):
    """ODrive axes: its cascade of a position and a velocity loop is a spring and a damper without its integrator."""

    reported = ("position", "velocity", "torque", "temperature", "drive_temperature")  # temperatures as reported last
    keeps = ("speed_limit", "current_limit")
    times_out = False
    unasked = True
    answers_goals = False
    roll_call_time = 0.2

    def poll(self, *, read_only: bool) -> Sequence[CanFrame]:
        """Remote frames for estimates and torques."""
        return self._asked(ESTIMATES), self._asked(TORQUES)

    def slow_poll(self) -> Sequence[CanFrame]:
        """Remote frames for its state and temperatures."""
        return self._asked(HEARTBEAT), self._asked(TEMPERATURES)

    def goal(self, position: float) -> Sequence[CanFrame]:
        """A position, which is not answered."""
        return (self._frame(SET_GOAL, struct.pack("<fhh", position / TURN, 0, 0)),)

    def released(self) -> Sequence[CanFrame]:
        """Idle."""
        return self.disable()

    def enable(self) -> Sequence[CanFrame]:
        """Gains, limits, and closed-loop position control."""
        motor = self.motor
        speed, current = motor.speed_limit, motor.current_limit
        limits = (MOST_SPEED if speed is None else speed / TURN, MOST_CURRENT if current is None else current)
        damping = max(motor.kd, 1e-6)
        return (
            self._frame(SET_MODE, struct.pack("<II", POSITION_CONTROL, PASSTHROUGH)),
            self._frame(SET_POSITION_GAIN, struct.pack("<f4x", motor.kp / damping)),
            self._frame(SET_VELOCITY_GAINS, struct.pack("<ff", damping * TURN, 0.0)),
            *((self._frame(SET_LIMITS, struct.pack("<ff", *limits)),) if (speed, current) != (None, None) else ()),
            self._frame(SET_STATE, struct.pack("<I4x", CLOSED_LOOP)),
        )

    def disable(self) -> Sequence[CanFrame]:
        """Idle."""
        return (self._frame(SET_STATE, struct.pack("<I4x", IDLE)),)

    def roll_call(self, *, read_only: bool) -> Sequence[CanFrame]:
        """A remote frame for every axis' address, which old firmware does not answer."""
        return ((REMOTE | EVERYONE << 5 | ADDRESS, b""),)

    def present(self, frames: Sequence[CanFrame]) -> int:
        """Serial numbers with its node."""
        answers = (self.parse(*frame) for frame in frames)
        return len({answer.serial for answer in answers if answer is not None and answer.serial is not None})

    def clear(self) -> Sequence[CanFrame]:
        """Clear errors."""
        return (self._frame(CLEAR_ERRORS, bytes(8)),)

    def parse(self, identifier: int, data: bytes, asked: int | None = None) -> Answer | None:
        """Heartbeat, address, estimates, torques or temperatures."""
        del asked
        if identifier >> 5 != self.motor.id or len(data) != 8:
            return None
        command = identifier & 0x1F
        if command == HEARTBEAT:
            fault, state = struct.unpack_from("<IB", data)
            return Answer({}, fault, state == CLOSED_LOOP)
        if command == ADDRESS:
            return Answer(serial=data[1:7])
        first, second = struct.unpack("<ff", data)
        if command == ESTIMATES:
            return Answer({"position": TURN * first, "velocity": TURN * second})
        if command == TORQUES:
            return Answer({"torque": second})
        if command == TEMPERATURES:
            return Answer({"drive_temperature": first, "temperature": second})
        return None

    def _frame(self, command: int, data: bytes) -> CanFrame:
        return self.motor.id << 5 | command, data

    def _asked(self, command: int) -> CanFrame:
        return REMOTE | self.motor.id << 5 | command, bytes(8)
