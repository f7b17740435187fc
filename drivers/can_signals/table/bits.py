"""Numbers in the bits of a classic CAN frame, in DBC's numbering: bit 8·b + k is bit k (0 lowest) of byte b.

A little-endian (Intel) number starts at its lowest bit and goes up; a big-endian (Motorola) number starts at its
highest bit and goes down through the byte, then on from the highest bit of the next one.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from drivers.bus_budget import FRAME_BYTES
from drivers.core.arrays import FloatArray

FRAME_BITS = 8 * FRAME_BYTES
Payloads = npt.NDArray[np.uint8]
"""(N, 8), shorter frames filled up with zeros."""

ByteOrder = Literal["little", "big"]
_FLOATS = {16: ("<e", "<f2"), 32: ("<f", "<f4"), 64: ("<d", "<f8")}


@dataclass(frozen=True)
class BitField:
    """Place and kind of a number in a frame.

    Raises:
        ValueError: it does not fit into 8 bytes, or no such float exists.
    """

    start: int  # of the lowest bit (little-endian) or the highest (big-endian)
    length: int  # [bit]
    byte_order: ByteOrder = "little"  # "little" or "big"
    signed: bool = False  # two's complement
    floating: bool = False  # IEEE 754 of 16, 32 or 64 bits

    def __post_init__(self) -> None:
        if not 0 <= self.start < FRAME_BITS:
            raise ValueError(f"start {self.start} is not a bit of a frame; allowed: 0 to {FRAME_BITS - 1}")
        if not 1 <= self.length <= FRAME_BITS:
            raise ValueError(f"length {self.length} is impossible; allowed: 1 to {FRAME_BITS}")
        if self._lowest < 0 or self._lowest + self.length > FRAME_BITS:
            raise ValueError(
                f"{self.length} bits from bit {self.start} on ({self.byte_order} endian) leave the frame of "
                f"{FRAME_BYTES} bytes"
            )
        if self.floating and self.length not in _FLOATS:
            raise ValueError(f"a float has 16, 32 or 64 bits, not {self.length}")

    @property
    def bits(self) -> frozenset[int]:
        """Numbers of the bits that it takes."""
        places = range(self._lowest, self._lowest + self.length)
        if self.byte_order == "little":
            return frozenset(places)
        return frozenset(8 * (FRAME_BYTES - 1 - place // 8) + place % 8 for place in places)

    @property
    def size(self) -> int:
        """Bytes that a frame must have to hold it."""
        return max(self.bits) // 8 + 1

    @property
    def range(self) -> tuple[float, float]:
        """Lowest and highest number that it holds."""
        if self.floating:
            kind = np.finfo(np.dtype(_FLOATS[self.length][1]))
            return float(kind.min), float(kind.max)
        if self.signed:
            return -(2.0 ** (self.length - 1)), 2.0 ** (self.length - 1) - 1.0
        return 0.0, 2.0**self.length - 1.0

    def decode(self, payloads: Payloads) -> FloatArray:
        """Numbers (N,) in frames (N, 8)."""
        raw = self.raw(payloads)
        if self.floating:
            unsigned = raw.astype(f"<u{self.length // 8}")
            return unsigned.view(_FLOATS[self.length][1]).astype(np.float64)
        if self.signed:
            spare = np.uint64(FRAME_BITS - self.length)
            return ((raw << spare).view(np.int64) >> spare.astype(np.int64)).astype(np.float64)
        return raw.astype(np.float64)

    def raw(self, payloads: Payloads) -> npt.NDArray[np.uint64]:
        """The bits themselves (N,), as unsigned numbers."""
        word = np.ascontiguousarray(payloads).view("<u8" if self.byte_order == "little" else ">u8")[:, 0]
        mask = np.uint64((1 << self.length) - 1)
        return (word.astype(np.uint64) >> np.uint64(self._lowest)) & mask

    def encode(self, number: float) -> int:
        """A frame, as the number that its 8 bytes are in little-endian order, that holds this number and zeros.

        Integers are rounded to the nearest.

        Raises:
            ValueError: the number does not fit.
        """
        if self.floating:
            try:
                packed = struct.pack(_FLOATS[self.length][0], number)
            except OverflowError as error:
                raise ValueError(f"{number:g} does not fit into a float of {self.length} bits") from error
            raw = int.from_bytes(packed, "little")
        else:
            low, high = self.range
            if not low - 0.5 <= number <= high + 0.5:
                raise ValueError(f"{number:g} does not fit into {self.length} bits")
            raw = min(max(round(number), round(low)), (1 << self.length) - 1)
            if self.signed:
                raw = min(raw, (1 << self.length - 1) - 1)
        placed = (raw & (1 << self.length) - 1) << self._lowest
        if self.byte_order == "little":
            return placed
        return int.from_bytes(placed.to_bytes(FRAME_BYTES, "big"), "little")

    @property
    def _lowest(self) -> int:
        """Place of the lowest bit in the frame's 64-bit word of this byte order."""
        if self.byte_order == "little":
            return self.start
        highest = 8 * (FRAME_BYTES - 1 - self.start // 8) + self.start % 8
        return highest - self.length + 1


def stack(payloads: list[bytes]) -> Payloads:
    """Frames (N, 8) of data bytes, shorter ones filled up with zeros, longer ones cut."""
    joined = b"".join([data.ljust(FRAME_BYTES, b"\0")[:FRAME_BYTES] for data in payloads])
    return np.frombuffer(joined, dtype=np.uint8).reshape(-1, FRAME_BYTES)
