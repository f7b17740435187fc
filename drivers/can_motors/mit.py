"""Frames of MIT mode with 11-bit identifiers: Damiao and CubeMars motors (see their tables)."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import ClassVar

from drivers.can_motors.codec import Answer, CanFrame, MotorAddress, MotorCodec, from_counts, to_counts
from drivers.can_motors.tables import MotorModel

ENABLE, DISABLE, CLEAR = (b"\xff" * 7 + bytes([code]) for code in (0xFC, 0xFD, 0xFB))
DAMIAO_REQUEST = 0x7FF
"""Identifier of requests to any Damiao motor: registers and state."""
READ, WRITE, STATE = 0x33, 0x55, 0xCC
TIMEOUT_COUNT = 50e-6
"""[s] of a count of a Damiao or RobStride motor's command time-out."""
MIT_MODE = 1
WHOLE_NUMBERS = frozenset({*range(7, 11), *range(13, 17), 35, 36})
"""Numbers of a Damiao motor's registers that hold unsigned integers; the others hold floating-point numbers."""


def full_scale(model: MotorModel) -> tuple[float, float, float, float, float]:
    """Position, velocity, torque [±], kp and kd [from 0] of full scale.

    Raises:
        ValueError: the model has none.
    """
    scales = model.position, model.velocity, model.torque, model.kp, model.kd
    if None in scales:
        raise ValueError("a motor in MIT mode has a full scale of each quantity")
    return scales  # type: ignore[return-value]


def pack_goal(model: MotorModel, goal: Sequence[float]) -> bytes:
    """A command of position [rad], velocity [rad/s], kp [N·m/rad], kd [N·m·s/rad], torque [N·m]."""
    p, v, t, kp, kd = full_scale(model)
    bounds = ((-p, p, 16), (-v, v, 12), (0.0, kp, 12), (0.0, kd, 12), (-t, t, 12))
    whole = 0
    for value, (low, high, bits) in zip(goal, bounds, strict=True):
        whole = whole << bits | to_counts(value, low, high, bits)
    return whole.to_bytes(8, "big")


def unpack_goal(model: MotorModel, data: bytes) -> tuple[float, float, float, float, float]:
    """Position, velocity, kp, kd and torque of a command."""
    p, v, t, kp, kd = full_scale(model)
    whole = int.from_bytes(data, "big")
    return (
        from_counts(whole >> 48, -p, p, 16),
        from_counts(whole >> 36 & 0xFFF, -v, v, 12),
        from_counts(whole >> 24 & 0xFFF, 0.0, kp, 12),
        from_counts(whole >> 12 & 0xFFF, 0.0, kd, 12),
        from_counts(whole & 0xFFF, -t, t, 12),
    )


def pack_state(model: MotorModel, position: float, velocity: float, torque: float) -> bytes:
    """The five bytes of a motor's position, velocity and torque."""
    p, v, t, _, _ = full_scale(model)
    whole = to_counts(position, -p, p, 16) << 24 | to_counts(velocity, -v, v, 12) << 12 | to_counts(torque, -t, t, 12)
    return whole.to_bytes(5, "big")


def unpack_state(model: MotorModel, data: bytes) -> dict[str, float]:
    """Position, velocity and torque of five bytes."""
    p, v, t, _, _ = full_scale(model)
    whole = int.from_bytes(data, "big")
    return {
        "position": from_counts(whole >> 24, -p, p, 16),
        "velocity": from_counts(whole >> 12 & 0xFFF, -v, v, 12),
        "torque": from_counts(whole & 0xFFF, -t, t, 12),
    }


class MitCodec(MotorCodec):
    """Goals of MIT mode: a spring kp to the position, a damper kd to rest."""

    takes_torque = True

    def goal(self, position: float) -> Sequence[CanFrame]:
        """A command, which the motor answers with its state."""
        motor = self.motor
        return ((motor.id, pack_goal(motor.model, (position, 0.0, motor.kp, motor.kd, 0.0))),)

    def torque(self, torque: float) -> Sequence[CanFrame]:
        """A command without spring and damper."""
        return ((self.motor.id, pack_goal(self.motor.model, (0.0, 0.0, 0.0, 0.0, torque))),)

    def enable(self) -> Sequence[CanFrame]:
        """Into MIT mode."""
        return ((self.motor.id, ENABLE),)

    def disable(self) -> Sequence[CanFrame]:
        """Out of it."""
        return ((self.motor.id, DISABLE),)


class DamiaoCodec(MitCodec):
    """Damiao DM motors; `MotorAddress.host` is the master id that the motor answers on."""

    reported = ("position", "velocity", "torque", "temperature", "drive_temperature")
    registers: ClassVar[Mapping[str, int]] = {
        "torque_constant": 1,
        "master_id": 7,
        "timeout": 9,
        "control_mode": 10,
        "position_range": 21,
        "velocity_range": 22,
        "torque_range": 23,
    }

    def __init__(self, motor: MotorAddress) -> None:
        super().__init__(motor)
        self._asking = struct.pack("<H", motor.id)

    def poll(self, *, read_only: bool) -> Sequence[CanFrame]:
        """The request for its state, which changes nothing."""
        return ((DAMIAO_REQUEST, self._asking + bytes([STATE]) + bytes(5)),)

    def preparation(self) -> Mapping[str, float]:
        """MIT mode, and the command time-out."""
        return {"control_mode": MIT_MODE, "timeout": round((self.motor.watchdog or 0.0) / TIMEOUT_COUNT)}

    def release(self) -> Mapping[str, float]:
        """No command time-out."""
        return {"timeout": 0}

    def clear(self) -> Sequence[CanFrame]:
        """Clear errors."""
        return ((self.motor.id, CLEAR),)

    def read(self, register: str) -> CanFrame:
        """A request for a register."""
        return DAMIAO_REQUEST, self._asking + bytes([READ, self.registers[register]]) + bytes(4)

    def write(self, register: str, value: float) -> CanFrame:
        """A request to hold a value until the power is off."""
        number = self.registers[register]
        packed = struct.pack("<I", round(value)) if number in WHOLE_NUMBERS else struct.pack("<f", value)
        return DAMIAO_REQUEST, self._asking + bytes([WRITE, number]) + packed

    def parse(self, identifier: int, data: bytes, asked: int | None = None) -> Answer | None:
        """Return its state, or a register that it was asked for."""
        if identifier != self.motor.host or len(data) != 8:
            return None
        if data[:2] == self._asking and data[2] in (READ, WRITE) and data[3] in self.registers.values():
            if data[2] == WRITE or data[3] != asked:
                return Answer()
            return Answer(register=(asked, struct.unpack("<I" if asked in WHOLE_NUMBERS else "<f", data[4:])[0]))
        if data[0] & 0x0F != self.motor.id & 0x0F:
            return None
        state = data[0] >> 4
        values = unpack_state(self.motor.model, data[1:6])
        values |= {"drive_temperature": float(data[6]), "temperature": float(data[7])}
        return Answer(values, 0 if state in (0, 1) else state, state == 1)


class CubemarsCodec(MitCodec):
    """CubeMars AK motors in MIT mode; `MotorAddress.host` is the identifier that they answer on."""

    reported = ("position", "velocity", "torque", "temperature")
    times_out = False

    def poll(self, *, read_only: bool) -> Sequence[CanFrame]:
        """Entering MIT mode again; nothing where nothing may be written: what others command is answered, too."""
        return () if read_only else self.enable()

    def clear(self) -> Sequence[CanFrame]:
        """None: an error goes with its cause, or with the power."""
        return ()

    def parse(self, identifier: int, data: bytes, asked: int | None = None) -> Answer | None:
        """Return its state."""
        del asked
        if identifier != self.motor.host or len(data) != 8 or data[0] != self.motor.id:
            return None
        values = unpack_state(self.motor.model, data[1:6]) | {"temperature": data[6] + self.motor.temperature_offset}
        return Answer(values, data[7])
