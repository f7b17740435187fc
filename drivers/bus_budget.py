"""What fits on a bus: bits that a connection's frames take at worst, load, and the highest rate of its cycle.

The longest frames of classic CAN, with every stuffed bit that may occur and three bits of intermission, take 47 + 8n +
⌊(34 + 8n − 1)/4⌋ bits for 11-bit identifiers and n data bytes, 67 + 8n + ⌊(54 + 8n − 1)/4⌋ for 29-bit ones, as in
Davis, Burns, Bril and Lukkien, Controller Area Network (CAN) schedulability analysis, Real-Time Systems 35 (2007).
Frames of CAN FD after ISO 11898-1:2015: one bit stuffed after four in front of the check sum, where the stuffed bits'
places are fixed.
"""

from __future__ import annotations

from dataclasses import dataclass

FRAME_BYTES = 8
WORST = "with every stuffed bit"
"""What a budget of such frames includes, in words."""


def frame_bits(data_bytes: int, *, extended: bool = False) -> int:
    """Longest length [bit] of a frame with 0 to 8 data bytes, intermission included.

    Raises:
        ValueError: not 0 to 8 bytes.
    """
    if not 0 <= data_bytes <= FRAME_BYTES:
        raise ValueError(f"a classic CAN frame has 0 to {FRAME_BYTES} data bytes, not {data_bytes}")
    fixed, stuffable = (67, 54) if extended else (47, 34)
    return fixed + 8 * data_bytes + (stuffable + 8 * data_bytes - 1) // 4


def can_frames(meaning: str, count: int, data_bytes: int, *, extended: bool = False) -> FrameGroup:
    """Equal frames of classic CAN, for a budget; `extended`: whether identifiers have 29 bits."""
    return FrameGroup(meaning, count, data_bytes, frame_bits(data_bytes, extended=extended))


def fd_frame_bits(data_bytes: int, speed_up: float) -> float:
    """Longest length of a CAN FD frame with a 29-bit identifier [bit of the slow rate], intermission included.

    It has 0 to 64 bytes of data, which go `speed_up` times as fast.
    """
    slow, fast = 36, 8 * data_bytes + 5  # identifier and control bits; data, error state and length
    checked = 4 + (17 if data_bytes <= 16 else 21)
    stuffed_fast = fast // 4 + checked // 4 + 1
    return slow + slow // 4 + (fast + stuffed_fast + checked) / speed_up + 13


TIGHT_SHARE = 0.8
"""Load from which on a bus has no room left for repeated frames and for what comes in bursts."""


@dataclass(frozen=True)
class FrameGroup:
    """Equal frames."""

    meaning: str  # in words
    count: int  # how many
    data_bytes: int  # of each
    frame_bits: int  # of each at worst, with all that the bus adds to its data

    @property
    def bits(self) -> int:
        """Bits of all frames, at worst."""
        return self.count * self.frame_bits


@dataclass(frozen=True)
class Budget:
    """What a connection asks of its bus."""

    bitrate: float  # [bit/s]
    rate: float  # of the cycle [Hz]
    cycle: tuple[FrameGroup, ...]  # frames of every cycle
    beside: tuple[tuple[FrameGroup, float], ...] = ()  # frames that come at a rate of their own: (frames, rate [Hz])
    worst: str = ""  # what the lengths of the frames include, in words; empty where they are exact

    @property
    def cycle_bits(self) -> int:
        """Bits of one cycle at worst."""
        return sum(group.bits for group in self.cycle)

    @property
    def beside_rate(self) -> float:
        """Return what comes beside the cycle, at worst [bit/s]."""
        return sum(group.bits * rate for group, rate in self.beside)

    @property
    def load(self) -> float:
        """Share of the bus that is taken at worst; above 1 it does not fit."""
        return (self.cycle_bits * self.rate + self.beside_rate) / self.bitrate

    def highest_rate(self, share: float = 1.0) -> float:
        """Highest rate of the cycle [Hz] with which the load stays within a share of the bus; 0 where none does."""
        return max(share * self.bitrate - self.beside_rate, 0.0) / self.cycle_bits
