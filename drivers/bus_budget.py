"""What fits on a bus: bits that a connection's frames take at worst, load, and the highest rate of its cycle."""

from __future__ import annotations

from dataclasses import dataclass

TIGHT_SHARE = 0.8
"""Load from which on a bus has no room left for repeated frames and for what comes in bursts."""


@dataclass(frozen=True)
class FrameGroup:
    """Equal frames.

    Attributes:
        meaning: in words.
        count: how many.
        data_bytes: of each.
        frame_bits: of each at worst, with all that the bus adds to its data.
    """

    meaning: str
    count: int
    data_bytes: int
    frame_bits: int

    @property
    def bits(self) -> int:
        """Bits of all frames, at worst."""
        return self.count * self.frame_bits


@dataclass(frozen=True)
class Budget:
    """What a connection asks of its bus.

    Attributes:
        bitrate: [bit/s].
        rate: of the cycle [Hz].
        cycle: frames of every cycle.
        beside: frames that come at a rate of their own: (frames, rate [Hz]).
        worst: what the lengths of the frames include, in words; empty where they are exact.
    """

    bitrate: float
    rate: float
    cycle: tuple[FrameGroup, ...]
    beside: tuple[tuple[FrameGroup, float], ...] = ()
    worst: str = ""

    @property
    def cycle_bits(self) -> int:
        """Bits of one cycle at worst."""
        return sum(group.bits for group in self.cycle)

    @property
    def beside_rate(self) -> float:
        """What comes beside the cycle, at worst [bit/s]."""
        return sum(group.bits * rate for group, rate in self.beside)

    @property
    def load(self) -> float:
        """Share of the bus that is taken at worst; above 1 it does not fit."""
        return (self.cycle_bits * self.rate + self.beside_rate) / self.bitrate

    def highest_rate(self, share: float = 1.0) -> float:
        """Highest rate of the cycle [Hz] with which the load stays within a share of the bus; 0 where none does."""
        return max(share * self.bitrate - self.beside_rate, 0.0) / self.cycle_bits
