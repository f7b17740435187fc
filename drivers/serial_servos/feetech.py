"""Feetech's protocol of its SCS, STS and SMS servos: FF FF, id, length, instruction or errors, parameters, sum.

The sum is the complement of the low byte of id + length + instruction + parameters. Source: Feetech, communication
protocol manual of the SCS series; instructions as in its library (`feetech-servo-sdk`).
"""

from __future__ import annotations

from drivers.serial_servos.packets import Packet, ServoProtocol, scanned

HEADER = b"\xff\xff"
SHORTEST = 6
"""Bytes of a packet without parameters."""
LONGEST = 0xFD
"""Largest value of the byte that says the length: parameters and two."""


class FeetechProtocol(ServoProtocol):
    """The protocol as `ServoProtocol` has it."""

    name, word = "feetech", 1

    def request(self, motor: int, instruction: int, data: bytes = b"") -> bytes:
        """An instruction as bytes."""
        body = bytes([motor, len(data) + 2, instruction]) + data
        return HEADER + body + bytes([_sum(body)])

    def answer(self, motor: int, errors: int, data: bytes = b"") -> bytes:
        """Return what a servo answers: as a request, with its errors in the instruction's place."""
        return self.request(motor, errors, data)

    def answer_size(self, size: int) -> int:
        """Bytes of an answer with so many data."""
        return SHORTEST + size

    def answers(self, buffer: bytearray) -> tuple[list[Packet], int]:
        """Take whole packets from the front of a buffer, and how many bytes belonged to none."""
        return scanned(buffer, HEADER, 4, _size, _packet)


def _size(buffer: bytearray) -> int:
    end = buffer[3] + 4
    return end if SHORTEST <= end <= LONGEST + 4 else 0


def _packet(data: bytes) -> Packet | None:
    return Packet(data[2], data[4], data[5:-1]) if _sum(data[2:-1]) == data[-1] else None


def _sum(body: bytes | bytearray) -> int:
    return ~sum(body) & 0xFF
