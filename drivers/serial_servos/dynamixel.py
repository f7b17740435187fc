"""Dynamixel protocol 2.0: FF FF FD 00, id, length, instruction, parameters, CRC-16.

The CRC has the polynomial 0x8005, starts at 0 and runs from the header on. FF FF FD within instruction and parameters
is followed by another FD. An answer has the instruction 0x55, its errors come first. In the answer to a fast
sync read, each servo adds errors, id, data and the CRC of all bytes so far, and nothing is stuffed. Source: ROBOTIS
e-manual, DYNAMIXEL protocol 2.0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from drivers.serial_servos.packets import (
    BROADCAST,
    BULK_READ,
    FAST_BULK_READ,
    FAST_SYNC_READ,
    SYNC_READ,
    Packet,
    ServoProtocol,
    scanned,
)

HEADER = b"\xff\xff\xfd\x00"
MARK = HEADER[:3]
STATUS = 0x55
FRAME = 10
"""Bytes of a packet without parameters."""
LONGEST = 2048
"""Most bytes behind the length; what says more is no packet."""


class DynamixelProtocol(ServoProtocol):
    """Protocol 2.0, with bulk and fast reads."""

    name, word = "dynamixel", 2

    def request(self, motor: int, instruction: int, data: bytes = b"") -> bytes:
        """An instruction as bytes."""
        body = (bytes([instruction]) + data).replace(MARK, MARK + b"\xfd")
        packet = HEADER + bytes([motor]) + (len(body) + 2).to_bytes(2, "little") + body
        return packet + crc16(packet).to_bytes(2, "little")

    def sync_read(self, address: int, size: int, motors: Sequence[int], *, fast: bool = False) -> bytes:
        """The request for the same bytes of several servos; `fast` in one packet."""
        return self.request(BROADCAST, FAST_SYNC_READ if fast else SYNC_READ, self.words(address, size) + bytes(motors))

    def bulk_read(self, addresses: Mapping[int, int], size: int, *, fast: bool = False) -> bytes:
        """The request for bytes of several servos, id → where in each; `fast` in one packet."""
        rows = b"".join(bytes([motor]) + self.words(address, size) for motor, address in addresses.items())
        return self.request(BROADCAST, FAST_BULK_READ if fast else BULK_READ, rows)

    def answer(self, motor: int, errors: int, data: bytes = b"") -> bytes:
        """Return what a servo answers."""
        return self.request(motor, STATUS, bytes([errors]) + data)

    def fast_answer(self, rows: Sequence[tuple[int, int, bytes]]) -> bytes:
        """Return what servos answer together to a fast sync read: (id, errors, data) of each, in their order."""
        length = 1 + sum(len(data) + 4 for _, _, data in rows)
        packet = HEADER + bytes([BROADCAST]) + length.to_bytes(2, "little") + bytes([STATUS])
        for motor, errors, data in rows:
            packet += bytes([errors, motor]) + data
            packet += crc16(packet).to_bytes(2, "little")
        return packet

    def answer_size(self, size: int) -> int:
        """Bytes of an answer with so many data, none of them stuffed."""
        return FRAME + 1 + size

    def fast_answer_size(self, size: int, count: int) -> int:
        """Bytes of the answer of so many servos to a fast sync read."""
        return FRAME - 2 + count * (size + 4)

    def answers(self, buffer: bytearray) -> tuple[list[Packet], int]:
        """Take whole answers from the front of a buffer, and how many bytes belonged to none."""
        packets, strange = _packets(buffer)
        answers = []
        for packet in packets:
            if packet.code != STATUS:  # a request: somebody else's, or an echo
                continue
            if packet.motor == BROADCAST:
                answers.append(packet)
            elif packet.data:
                data = packet.data.replace(MARK + b"\xfd", MARK)
                answers.append(Packet(packet.motor, data[0], data[1:]))
        return answers, strange

    def requests(self, buffer: bytearray) -> tuple[list[Packet], int]:
        """Take whole requests from the front of a buffer, and how many bytes belonged to none."""
        packets, strange = _packets(buffer)
        stuffed = MARK + b"\xfd"
        requests = [Packet(p.motor, p.code, p.data.replace(stuffed, MARK)) for p in packets if p.code != STATUS]
        return requests, strange

    def fast_answers(self, packet: Packet, size: int) -> list[Packet]:
        """The servos' answers in the packet of a fast sync read."""
        # The CRC of the last is that of the packet, and cut off already.
        data, step = packet.data + b"\0\0", size + 4
        parts = [data[start : start + step] for start in range(0, len(data) - step + 1, step)]
        return [Packet(answer[1], answer[0], answer[2 : 2 + size]) for answer in parts]


def _packets(buffer: bytearray) -> tuple[list[Packet], int]:
    """Whole packets, with their parameters as they came, and how many bytes belonged to none."""
    return scanned(buffer, HEADER, 7, _size, _packet)


def _size(buffer: bytearray) -> int:
    length = int.from_bytes(buffer[5:7], "little")
    return 7 + length if 3 <= length <= LONGEST else 0


def _packet(data: bytes) -> Packet | None:
    return Packet(data[4], data[7], data[8:-2]) if crc16(data[:-2]) == int.from_bytes(data[-2:], "little") else None


def crc16(data: bytes | bytearray) -> int:
    """CRC-16 with the polynomial 0x8005, most significant bit first, from 0."""
    value = 0
    for byte in data:
        value = (value << 8 & 0xFFFF) ^ _CRC[value >> 8 ^ byte]
    return value


def _crc_entry(index: int) -> int:
    value = index << 8
    for _ in range(8):
        value = value << 1 ^ (0x8005 if value & 0x8000 else 0)
    return value & 0xFFFF


_CRC = [_crc_entry(index) for index in range(256)]
