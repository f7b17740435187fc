"""Frames of moteus controllers: registers in subframes of CAN FD (see the table)."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Mapping, Sequence
from typing import ClassVar

from drivers.can.bus import EXTENDED
from drivers.can_motors.codec import Answer, CanFrame, MotorCodec
from drivers.core.units import TURN

WRITE, READ, REPLY, NOP = 0x00, 0x10, 0x20, 0x50
"""Kinds of subframes; bits 2 and 3 are the type of their values, bits 0 and 1 their number, where it is not 0."""
TYPES = ("b", "h", "i", "f")
FLOAT, INT8, INT16 = 0x0C, 0x00, 0x04
LENGTHS = (*range(9), 12, 16, 20, 24, 32, 48, 64)
"""Bytes that a frame of CAN FD may have."""
MODE, POSITION, TORQUE, MOTOR_TEMPERATURE, VOLTAGE, BOARD_TEMPERATURE, FAULT = 0, 1, 3, 0x0A, 0x0D, 0x0E, 0x0F
GOAL, SPEED, MOST_TORQUE, STOP, WATCHDOG, INTEGRATOR = 0x20, 0x21, 0x25, 0x26, 0x27, 0x2B
FEED_FORWARD, STIFFNESS_SHARE, DAMPING_SHARE = 0x22, 0x23, 0x24
STOPPED, FAULTY, POSITION_MODE, TIMEOUT_MODE = 0, 1, 10, 11
ANSWER = 0x8000
"""Bit of an identifier that asks for an answer."""
SCALES = {MOTOR_TEMPERATURE: 0.1, VOLTAGE: 0.1, BOARD_TEMPERATURE: 0.1}
"""Size of a count of 16 bits, by register [°C and V]."""


def padded(data: bytes) -> bytes:
    """Data with subframes of no operation up to a length that a frame may have."""
    size: int = next(size for size in LENGTHS if size >= len(data))
    return data + bytes([NOP]) * (size - len(data))


def subframe(kind: int, form: int, first: int, values: Sequence[float] = (), count: int = 0) -> bytes:
    """A subframe of registers from `first` on: so many are read, or values written or answered."""
    count = len(values) or count
    head = bytes([kind | form | count]) if count < 4 else bytes([kind | form, count])
    packed: bytes = struct.pack(f"<{len(values)}{TYPES[form >> 2]}", *values)
    return head + _varuint(first) + packed


def subframes(data: bytes) -> Iterator[tuple[int, int, int, tuple[float, ...] | int]]:
    """Kind, type, first register, and values (of a reading: their number) of every subframe; ends at what is none.

    Raises:
        ValueError, IndexError, struct.error: a frame that is cut short.
    """
    place = 0
    while place < len(data):
        head = data[place]
        place += 1
        if head == NOP:
            continue
        kind, form, count = head & 0xF0, head & 0x0C, head & 3
        if kind not in (WRITE, READ, REPLY):
            return
        if not count:
            count, place = _read_varuint(data, place)
        first, place = _read_varuint(data, place)
        if kind == READ:
            yield kind, form, first, count
            continue
        layout = f"<{count}{TYPES[form >> 2]}"
        yield kind, form, first, struct.unpack_from(layout, data, place)
        place += struct.calcsize(layout)


class MoteusCodec(MotorCodec):
    """moteus controllers; `MotorAddress.host` is this computer's id, 0 as a rule."""

    fd = True
    keeps = ("torque_limit",)
    gains = False
    takes_torque = True
    registers: ClassVar[Mapping[str, int]] = {"torque_limit": MOST_TORQUE, "timeout": WATCHDOG}

    def quantities(self, *, read_only: bool) -> tuple[str, ...]:
        """The same in any case."""
        return (
            *("position", "velocity", "torque"),
            *(("temperature",) if self.motor.thermistor else ()),
            *("drive_temperature", "supply_voltage"),
        )

    def poll(self, *, read_only: bool) -> Sequence[CanFrame]:
        """A frame that only reads."""
        return (self._frame(_QUERY),)

    def goal(self, position: float, *, watched: bool = True) -> Sequence[CanFrame]:
        """Position mode, with largest torque and watchdog; answered as a reading."""
        watchdog = self.motor.watchdog if watched else None
        command = (
            *(position / TURN, 0.0, 0.0, 1.0, 1.0, self._most_torque, math.nan),
            math.nan if watchdog is None else watchdog,
        )
        return (self._frame(_POSITION_MODE + subframe(WRITE, FLOAT, GOAL, command) + _QUERY),)

    def torque(self, torque: float) -> Sequence[CanFrame]:
        """Position mode without its loops, as the controller's documents do it; answered as a reading."""
        watchdog = math.nan if self.motor.watchdog is None else self.motor.watchdog
        command = (math.nan, 0.0, torque, 0.0, 0.0, self._most_torque, math.nan, watchdog)
        loops = subframe(WRITE, FLOAT, GOAL, command) + subframe(WRITE, FLOAT, INTEGRATOR, (0.0,))
        return (self._frame(_POSITION_MODE + loops + _QUERY),)

    def release_frames(self, position: float) -> Sequence[CanFrame]:
        """A goal without a watchdog."""
        return self.goal(position, watched=False)

    def enable(self) -> Sequence[CanFrame]:
        """Nothing: a goal does it."""
        return ()

    def disable(self) -> Sequence[CanFrame]:
        """Stopped, which clears faults, too."""
        return (self._frame(subframe(WRITE, INT8, MODE, (STOPPED,)) + _QUERY),)

    def clear(self) -> Sequence[CanFrame]:
        """Stopped."""
        return self.disable()

    def read(self, register: str) -> CanFrame:
        """A frame that reads one register."""
        return self._frame(subframe(READ, FLOAT, self.registers[register], count=1))

    def parse(self, identifier: int, data: bytes, asked: int | None = None) -> Answer | None:
        """Registers of an answer."""
        if identifier & ~EXTENDED != self.motor.id << 8 | self.motor.host:
            return None
        held: dict[int, float] = {}
        try:
            for kind, form, first, values in subframes(data):
                if kind == REPLY and not isinstance(values, int):
                    scaled = (
                        value * SCALES.get(first + index, 1.0) if form == INT16 else value
                        for index, value in enumerate(values)
                    )
                    held |= {first + index: value for index, value in enumerate(scaled)}
        except (ValueError, IndexError, struct.error):
            return None
        if asked is not None and asked in held:
            return Answer(register=(asked, held[asked]))
        if POSITION not in held or MODE not in held or FAULT not in held:
            return None
        mode = int(held[MODE])
        readings = {
            "position": TURN * held[POSITION],
            "velocity": TURN * held[POSITION + 1],
            "torque": held[TORQUE],
            "temperature": held.get(MOTOR_TEMPERATURE, math.nan),
            "drive_temperature": held.get(BOARD_TEMPERATURE, math.nan),
            "supply_voltage": held.get(VOLTAGE, math.nan),
        }
        fault = {FAULTY: int(held[FAULT]) or FAULTY, TIMEOUT_MODE: TIMEOUT_MODE}.get(mode, 0)
        return Answer(readings, fault, mode == POSITION_MODE)

    @property
    def _most_torque(self) -> float:
        return math.nan if self.motor.torque_limit is None else self.motor.torque_limit

    def _frame(self, data: bytes) -> CanFrame:
        return EXTENDED | ANSWER | self.motor.host << 8 | self.motor.id, padded(data)


def _varuint(number: int) -> bytes:
    text = bytearray()
    while number > 0x7F:
        text.append(number & 0x7F | 0x80)
        number >>= 7
    return bytes([*text, number])


def _read_varuint(data: bytes, place: int) -> tuple[int, int]:
    number = 0
    for count in range(5):
        byte = data[place + count]
        number |= (byte & 0x7F) << 7 * count
        if not byte & 0x80:
            return number, place + count + 1
    raise ValueError("a number of more than 32 bits")


_POSITION_MODE = subframe(WRITE, INT8, MODE, (POSITION_MODE,))
_QUERY = (
    subframe(READ, INT8, MODE, count=1)
    + subframe(READ, FLOAT, POSITION, count=3)
    + subframe(READ, INT16, MOTOR_TEMPERATURE, count=1)
    + subframe(READ, INT16, VOLTAGE, count=3)
)
