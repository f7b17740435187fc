"""Time on a CAN bus: how long a frame is with its stuffed bits, and which frame goes first (ISO 11898-1).

Buses such as `virtual` and `udp_multicast` carry any number of frames per second; a simulated drive sends through a
`BusModel` instead, so that frames beyond a real bus's capacity are lost here, too.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from heapq import heappop, heappush

from drivers.bus_budget import frame_bits as longest_bits

CRC_POLYNOMIAL = 0x4599
"""x¹⁵ + x¹⁴ + x¹⁰ + x⁸ + x⁷ + x⁴ + x³ + 1, without its highest term."""
CRC_BITS = 15
UNSTUFFED_BITS = 13
"""CRC delimiter, acknowledgement and its delimiter, 7 bits end of frame, 3 bits intermission."""
RUN = 5
"""After so many equal bits an opposite one is stuffed in."""
STANDARD_HEADER, EXTENDED_HEADER = 19, 39
"""Start of frame, identifier, its flags and the length code [bit]."""
QUEUE_LIMIT = 64
"""Frames of one identifier that may wait."""
PDO_BUFFERS = 2
"""A drive keeps one value in its CAN controller and the newest one behind it."""


@dataclass(frozen=True)
class Frame:
    """A classic CAN frame."""

    id: int  # identifier, 11 bits, or 29 where extended
    data: bytes = b""  # 0 to 8 bytes
    extended: bool = False  # whether the identifier has 29 bits
    remote: bool = False  # a request; its data give its length only


def _crc_table() -> tuple[int, ...]:
    table = []
    for byte in range(256):
        crc = byte << (CRC_BITS - 8)
        for _ in range(8):
            crc = (crc << 1) ^ (CRC_POLYNOMIAL if crc >> (CRC_BITS - 1) & 1 else 0)
        table.append(crc & 0x7FFF)
    return tuple(table)


def _stuff_bit(state: int, bit: int) -> tuple[int, int]:
    """State after one more bit, and whether a bit was stuffed in; a state is 5·last + run − 1."""
    last, run = divmod(state, RUN)
    run = run + 2 if bit == last else 1
    if run < RUN:
        return RUN * bit + run - 1, 0
    return RUN * (1 - bit), 1


def _stuff_table() -> tuple[tuple[tuple[int, int], ...], ...]:
    table = []
    for start in range(2 * RUN):
        row = []
        for byte in range(256):
            state, stuffed = start, 0
            for shift in range(7, -1, -1):
                state, added = _stuff_bit(state, byte >> shift & 1)
                stuffed += added
            row.append((state, stuffed))
        table.append(tuple(row))
    return tuple(table)


_CRC = _crc_table()
_STUFF = _stuff_table()
_AFTER_START = 0
"""State after the start of frame, one dominant (0) bit."""


def crc15(content: bytes, crc: int = 0) -> int:
    """CRC-15 of whole bytes, continued from `crc`; zero bits in front change nothing."""
    for byte in content:
        crc = (crc << 8) & 0x7FFF ^ _CRC[crc >> (CRC_BITS - 8) ^ byte]
    return crc


@lru_cache(maxsize=4096)
def _header(identifier: int, length: int, extended: bool, remote: bool) -> tuple[int, int]:
    """The bits of a frame in front of its data, as a number, and how many they are."""
    if not extended:
        return (identifier << 7 | remote << 6 | length), STANDARD_HEADER
    base, rest = identifier >> 18, identifier & 0x3FFFF
    return (base << 27 | 0b11 << 25 | rest << 7 | remote << 6 | length), EXTENDED_HEADER


def exact_bits(frame: Frame) -> int:
    """Exact length of a frame on the bus [bit]: stuffed bits for its content, intermission included.

    Raises:
        ValueError: more than 8 bytes, or an identifier that is too large.
    """
    length = len(frame.data)
    if length > 8 or not 0 <= frame.id < (1 << 29 if frame.extended else 1 << 11):
        raise ValueError(f"no classic CAN frame: {frame}")
    header, size = _header(frame.id, length, frame.extended, frame.remote)
    data = b"" if frame.remote else frame.data
    crc = crc15(header.to_bytes(5, "big") + data)
    content = (header << 8 * len(data) | int.from_bytes(data, "big")) << CRC_BITS | crc
    size += 8 * len(data) + CRC_BITS
    # The start of frame is behind us; then the bits that do not fill a byte, then whole bytes.
    odd = (size - 1) % 8
    state, stuffed = _AFTER_START, 0
    for shift in range(size - 2, size - 2 - odd, -1):
        state, added = _stuff_bit(state, content >> shift & 1)
        stuffed += added
    whole = size - 1 - odd
    for byte in (content & (1 << whole) - 1).to_bytes(whole // 8, "big"):
        state, added = _STUFF[state][byte]
        stuffed += added
    return size + stuffed + UNSTUFFED_BITS


def worst_case_bits(frame: Frame) -> int:
    """Longest that a frame of this kind and length can be [bit]."""
    return longest_bits(0 if frame.remote else len(frame.data), extended=frame.extended)


@dataclass(frozen=True)
class _Waiting:
    frame: Frame  # the frame
    own: bool  # whether a simulated node sends it
    ready: float  # when it was handed over [s]
    bits: int  # its length


@dataclass(frozen=True)
class Sent(_Waiting):
    """A frame that has been on the bus."""

    time: float  # when its last bit was over [s]


class BusModel:
    """One frame at a time at a bit rate; of the frames that are ready when the bus is free, the lowest id goes first.

    Time is in any unit of the caller's, as long as it increases. A cyclic frame (`newest_wins`) has two places to
    wait in: when both are occupied, a newer value replaces the second, which is then lost.

    Attributes:
        bits: carried so far.
        lost: frames that never were on the bus.
    """

    def __init__(self, bitrate: float, length: Callable[[Frame], int] = exact_bits) -> None:
        if not bitrate > 0.0:
            raise ValueError(f"a bit rate must be positive, not {bitrate}")
        self._bit_time = 1.0 / bitrate
        self._length = length
        self._queues: dict[int, deque[_Waiting]] = {}
        # Of the first frames of the queues: those that were ready when the bus became free last, and the others.
        self._ready: list[int] = []
        self._later: list[tuple[float, int]] = []
        self._free = float("-inf")
        self._won: tuple[float, int] | None = None
        self.bits = 0
        self.lost = 0

    def submit(self, frame: Frame, ready: float, *, own: bool, newest_wins: bool = False) -> None:
        """Hand a frame over at a time [s]; earlier frames must have been removed with `pop` by then."""
        # Arbitration compares bit by bit; of equal base identifiers the standard frame wins.
        key = (frame.id << 1 | 1) if frame.extended else frame.id << 19
        queue = self._queues.setdefault(key, deque())
        limit = PDO_BUFFERS if newest_wins else QUEUE_LIMIT
        if len(queue) >= limit:
            self.lost += 1
            if not newest_wins:
                return
            queue.pop()
        queue.append(_Waiting(frame, own, ready, self._length(frame)))
        if len(queue) == 1:
            self._place(key, ready)
            self._won = None

    def peek(self) -> float | None:
        """When the next frame will be over, as far as is known [s]; None where nothing waits."""
        if self._won is None:
            if self._ready:
                start, key = self._free, self._ready[0]
            elif self._later:
                start, key = min(self._later)
            else:
                return None
            self._won = start + self._queues[key][0].bits * self._bit_time, key
        return self._won[0]

    def pop(self) -> Sent:
        """The next frame, its time on the bus over.

        Raises:
            IndexError: nothing waits.
        """
        if self.peek() is None or self._won is None:
            raise IndexError("nothing waits")
        (end, key), self._won = self._won, None
        queue = self._queues[key]
        won = queue.popleft()
        if self._ready:
            heappop(self._ready)
        else:
            self._later.remove((won.ready, key))
        self._free = end
        if queue:
            self._place(key, queue[0].ready)
        else:
            del self._queues[key]
        if self._later:
            later, self._later = self._later, []
            for ready, waiting in later:
                self._place(waiting, ready)
        self.bits += won.bits
        return Sent(**vars(won), time=end)

    def _place(self, key: int, ready: float) -> None:
        if ready <= self._free:
            heappush(self._ready, key)
        else:
            self._later.append((ready, key))
