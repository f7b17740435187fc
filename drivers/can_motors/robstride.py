"""Frames of RobStride's private protocol on 29-bit identifiers (see the table)."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import ClassVar

from drivers.can.bus import EXTENDED
from drivers.can_motors.codec import Answer, CanFrame, MotorCodec, from_counts, to_counts
from drivers.can_motors.mit import TIMEOUT_COUNT, full_scale

GOAL, FEEDBACK, ENABLE, DISABLE, READ, WRITE = 1, 2, 3, 4, 17, 18
"""Types of frames."""
RUNNING = 2
"""State of a motor that drives."""
FAULT_BITS = 0x3F
READABLE = {0x7019: "position", 0x701B: "velocity", 0x701A: "current"}
"""Parameter → quantity that can be asked for without writing anything."""
FORMATS = {0x7005: "<B3x", 0x7028: "<I"}
"""Formats of parameters that are not floating-point numbers."""


class RobstrideCodec(MotorCodec):
    """RobStride RS motors; `MotorAddress.host` is this computer's id."""

    keeps = ("torque_limit",)
    takes_torque = True
    registers: ClassVar[Mapping[str, int]] = {"mode": 0x7005, "torque_limit": 0x700B, "timeout": 0x7028}

    def quantities(self, *, read_only: bool) -> tuple[str, ...]:
        """Torque and temperature come with answers to commands only."""
        return tuple(READABLE.values()) if read_only else ("position", "velocity", "torque", "temperature")

    def poll(self, *, read_only: bool) -> Sequence[CanFrame]:
        """Return its parameters; else its torque limit is written, which it answers with its state."""
        if read_only:
            return tuple(self._frame(READ, struct.pack("<H6x", number)) for number in READABLE)
        return (self.write("torque_limit", self._torque_limit),)

    def goal(self, position: float) -> Sequence[CanFrame]:
        """A command, which the motor answers with its state."""
        return self._command(position, self.motor.kp, self.motor.kd, 0.0)

    def torque(self, torque: float) -> Sequence[CanFrame]:
        """A command without spring and damper."""
        return self._command(0.0, 0.0, 0.0, torque)

    def enable(self) -> Sequence[CanFrame]:
        """Into operation."""
        return (self._frame(ENABLE, bytes(8)),)

    def disable(self) -> Sequence[CanFrame]:
        """Out of it."""
        return (self._frame(DISABLE, bytes(8)),)

    def clear(self) -> Sequence[CanFrame]:
        """Out of operation, and faults reset."""
        return (self._frame(DISABLE, b"\x01" + bytes(7)),)

    def preparation(self) -> Mapping[str, float]:
        """Commands of MIT kind, the torque limit, the command time-out."""
        timeout = round((self.motor.watchdog or 0.0) / TIMEOUT_COUNT)
        return {"mode": 0, "torque_limit": self._torque_limit, "timeout": timeout}

    def release(self) -> Mapping[str, float]:
        """No command time-out."""
        return {"timeout": 0}

    def read(self, register: str) -> CanFrame:
        """A request for a parameter."""
        return self._frame(READ, struct.pack("<H6x", self.registers[register]))

    def write(self, register: str, value: float) -> CanFrame:
        """A parameter until the power is off."""
        number = self.registers[register]
        form = FORMATS.get(number, "<f")
        return self._frame(
            WRITE, struct.pack("<H2x", number) + struct.pack(form, value if form == "<f" else int(value))
        )

    def parse(self, identifier: int, data: bytes, asked: int | None = None) -> Answer | None:
        """Return its state, or a parameter."""
        motor = self.motor
        if not identifier & EXTENDED or len(data) != 8:
            return None
        kind, upper, sender, receiver = (identifier >> shift & mask for shift, mask in _FIELDS)
        if sender != motor.id or receiver != motor.host:
            return None
        if kind == READ and not upper:
            number = struct.unpack_from("<H", data)[0]
            value = float(struct.unpack_from(FORMATS.get(number, "<f"), data, 4)[0])
            return Answer({READABLE[number]: value} if number in READABLE else {}, register=(number, value))
        if kind != FEEDBACK:
            return None
        p, v, t, _, _ = full_scale(motor.model)
        counts = struct.unpack(">4H", data)
        values = {
            name: from_counts(count, -most, most, 16)
            for name, count, most in zip(("position", "velocity", "torque"), counts, (p, v, t), strict=False)
        }
        return Answer(values | {"temperature": 0.1 * counts[3]}, upper & FAULT_BITS, upper >> 6 == RUNNING)

    @property
    def _torque_limit(self) -> float:
        limit, most = self.motor.torque_limit, full_scale(self.motor.model)[2]
        return most if limit is None else min(limit, most)

    def _command(self, position: float, stiffness: float, damping: float, torque: float) -> Sequence[CanFrame]:
        p, v, t, kp, kd = full_scale(self.motor.model)
        bounds = ((position, -p, p), (0.0, -v, v), (stiffness, 0.0, kp), (damping, 0.0, kd))
        data = struct.pack(">4H", *(to_counts(value, low, high, 16) for value, low, high in bounds))
        return (self._frame(GOAL, data, to_counts(torque, -t, t, 16)),)

    def _frame(self, kind: int, data: bytes, middle: int | None = None) -> CanFrame:
        return frame_identifier(kind, self.motor.host if middle is None else middle, self.motor.id), data


_FIELDS = ((24, 0x1F), (16, 0xFF), (8, 0xFF), (0, 0xFF))


def frame_identifier(kind: int, middle: int, receiver: int) -> int:
    """Identifier of a frame's type, its 16 bits of data, and the id that it is for."""
    return EXTENDED | kind << 24 | middle << 8 | receiver
