"""What both protocols of serial servos have in common: packets, and how they are cut out of bytes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

BROADCAST = 0xFE
"""Id that every servo obeys and none answers, in both protocols."""

PING, READ, WRITE = 0x01, 0x02, 0x03
SYNC_READ, SYNC_WRITE = 0x82, 0x83
"""Instructions of both protocols."""
FAST_SYNC_READ, BULK_READ, FAST_BULK_READ = 0x8A, 0x92, 0x9A
"""Instructions of the Dynamixel protocol alone."""


@dataclass(frozen=True)
class Packet:
    """A packet whose sum is right."""

    motor: int  # id of the servo that is asked or answers
    code: int  # an instruction; in an answer, the error bits
    data: bytes  # parameters


def scanned(
    buffer: bytearray,
    header: bytes,
    least: int,
    size: Callable[[bytearray], int],
    packet: Callable[[bytes], Packet | None],
) -> tuple[list[Packet], int]:
    """Take whole packets from the front of a buffer, and how many bytes belonged to none.

    Args:
        buffer: what was heard; what may be the beginning of a packet stays in it.
        header: that packets begin with; after one that begins none, the search goes on behind it.
        least: bytes that `size` looks at.
        size: of the packet at the front [bytes]; 0 where no packet is so long.
        packet: of so many bytes; None where their sum is wrong.
    """
    packets: list[Packet] = []
    strange = 0
    while True:
        start = buffer.find(header)
        # The same byte once more than the header has it is none of an id: the header begins one byte later.
        while start >= 0 and buffer[start + 1 : start + 1 + len(header)] == header:
            start += 1
        if start < 0:
            kept = next((count for count in range(len(header) - 1, 0, -1) if buffer.endswith(header[:count])), 0)
            strange += len(buffer) - kept
            del buffer[: len(buffer) - kept]
            return packets, strange
        strange += start
        del buffer[:start]
        if len(buffer) < least:
            return packets, strange
        end = size(buffer)
        if end > len(buffer):
            return packets, strange
        taken = packet(bytes(buffer[:end])) if end else None
        if taken is None:
            strange += len(header)
            del buffer[: len(header)]
        else:
            packets.append(taken)
            del buffer[:end]


class ServoProtocol(ABC):
    """How packets are written and read; without a state."""

    name: ClassVar[str]  # of the protocol
    word: ClassVar[int]  # bytes of an address, and of a size

    @abstractmethod
    def request(self, motor: int, instruction: int, data: bytes = b"") -> bytes:
        """An instruction as bytes."""

    def words(self, *values: int) -> bytes:
        """Addresses and sizes as bytes."""
        return b"".join(value.to_bytes(self.word, "little") for value in values)

    def read(self, motor: int, address: int, size: int) -> bytes:
        """The request for bytes of one servo's memory."""
        return self.request(motor, READ, self.words(address, size))

    def write(self, motor: int, address: int, data: bytes) -> bytes:
        """The request that writes them."""
        return self.request(motor, WRITE, self.words(address) + data)

    def sync_read(self, address: int, size: int, motors: Sequence[int], *, fast: bool = False) -> bytes:
        """The request for the same bytes of several servos, which answer in this order; `fast` in one packet."""
        if fast:
            raise self._lacking()
        return self.request(BROADCAST, SYNC_READ, self.words(address, size) + bytes(motors))

    def bulk_read(self, addresses: Mapping[int, int], size: int, *, fast: bool = False) -> bytes:
        """The request for bytes of several servos, id → where in each; answered as `sync_read`."""
        raise self._lacking()

    def sync_write(self, address: int, rows: Mapping[int, bytes]) -> bytes:
        """The request that writes equally many bytes to several servos; none answers."""
        size = len(next(iter(rows.values())))
        parts = b"".join(bytes([motor]) + data for motor, data in rows.items())
        return self.request(BROADCAST, SYNC_WRITE, self.words(address, size) + parts)

    @abstractmethod
    def answer(self, motor: int, errors: int, data: bytes = b"") -> bytes:
        """Return what a servo answers."""

    @abstractmethod
    def answer_size(self, size: int) -> int:
        """Bytes of an answer with so many data."""

    def fast_answer_size(self, size: int, count: int) -> int:
        """Bytes of the answer of so many servos to a fast sync read."""
        raise self._lacking()

    @abstractmethod
    def answers(self, buffer: bytearray) -> tuple[list[Packet], int]:
        """Take whole answers from the front of a buffer, and how many bytes belonged to none."""

    def requests(self, buffer: bytearray) -> tuple[list[Packet], int]:
        """Take whole requests from the front of a buffer, and how many bytes belonged to none."""
        return self.answers(buffer)

    def fast_answers(self, packet: Packet, size: int) -> list[Packet]:
        """The servos' answers in the packet of a fast sync read."""
        raise self._lacking()

    def _lacking(self) -> ValueError:
        return ValueError(f"{self.name} servos have no fast sync read and no bulk read")
