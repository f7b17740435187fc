"""Feetech's protocol of its SCS, STS and SMS servos: FF FF, id, length, instruction or errors, parameters, sum.

The sum is the complement of the low byte of id + length + instruction + parameters. Source: Feetech, communication
protocol manual of the SCS series; instructions as in its library (`feetech-servo-sdk`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from drivers.serial_servos.packets import BROADCAST, READ, SYNC_READ, SYNC_WRITE, WRITE, Packet, scanned

HEADER = b"\xff\xff"
SHORTEST = 6
"""Bytes of a packet without parameters."""
LONGEST = 0xFD
"""Largest value of the byte that says the length: parameters and two."""


class FeetechProtocol:
    """Implements `drivers.serial_servos.packets.ServoProtocol`."""

    name = "feetech"

    def request(self, motor: int, instruction: int, data: bytes = b"") -> bytes:
        """An instruction as bytes."""
        body = bytes([motor, len(data) + 2, instruction]) + data
        return HEADER + body + bytes([_sum(body)])

    def read(self, motor: int, address: int, size: int) -> bytes:
        """The request for bytes of one servo's memory."""
        return self.request(motor, READ, bytes([address, size]))

    def write(self, motor: int, address: int, data: bytes) -> bytes:
        """The request that writes them."""
        return self.request(motor, WRITE, bytes([address]) + data)

    def sync_read(self, address: int, size: int, motors: Sequence[int], *, fast: bool = False) -> bytes:
        """The request for the same bytes of several servos, which answer one after the other."""
        if fast:
            raise ValueError("Feetech servos have no fast sync read")
        return self.request(BROADCAST, SYNC_READ, bytes([address, size, *motors]))

    def bulk_read(self, addresses: Mapping[int, int], size: int, *, fast: bool = False) -> bytes:
        """They have none."""
        raise ValueError("Feetech servos have no bulk read")

    def sync_write(self, address: int, rows: Mapping[int, bytes]) -> bytes:
        """The request that writes equally many bytes to several servos; none answers."""
        size = len(next(iter(rows.values())))
        parts = b"".join(bytes([motor]) + data for motor, data in rows.items())
        return self.request(BROADCAST, SYNC_WRITE, bytes([address, size]) + parts)

    def answer(self, motor: int, errors: int, data: bytes = b"") -> bytes:
        """Return what a servo answers: as a request, with its errors in the instruction's place."""
        return self.request(motor, errors, data)

    def answer_size(self, size: int) -> int:
        """Bytes of an answer with so many data."""
        return SHORTEST + size

    def fast_answer_size(self, size: int, count: int) -> int:
        """There is none."""
        raise ValueError("Feetech servos have no fast sync read")

    def answers(self, buffer: bytearray) -> tuple[list[Packet], int]:
        """Take whole packets from the front of a buffer, and how many bytes belonged to none."""
        return scanned(buffer, HEADER, 4, _size, _packet)

    requests = answers

    def fast_answers(self, packet: Packet, size: int) -> list[Packet]:
        """There are none."""
        raise ValueError("Feetech servos have no fast sync read")


def _size(buffer: bytearray) -> int:
    end = buffer[3] + 4
    return end if SHORTEST <= end <= LONGEST + 4 else 0


def _packet(data: bytes) -> Packet | None:
    return Packet(data[2], data[4], data[5:-1]) if _sum(data[2:-1]) == data[-1] else None


def _sum(body: bytes | bytearray) -> int:
    return ~sum(body) & 0xFF
