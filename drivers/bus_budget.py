"""What fits on a CAN bus: bits that a connection's frames take at worst, load, and the highest rate of its cycle.

Longest frames, with every stuffed bit that may occur and three bits of intermission: 47 + 8n + ⌊(34 + 8n − 1)/4⌋ bits
for 11-bit identifiers and n data bytes, 67 + 8n + ⌊(54 + 8n − 1)/4⌋ for 29-bit ones, as in Davis, Burns, Bril and
Lukkien, Controller Area Network (CAN) schedulability analysis, Real-Time Systems 35 (2007).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from drivers.base import DriverSettings

TIGHT_SHARE = 0.8
"""Load from which on a bus has no room left for repeated frames and for what comes in bursts."""
FRAME_BYTES = 8


def frame_bits(data_bytes: int, *, extended: bool = False) -> int:
    """Longest length [bit] of a frame with 0 to 8 data bytes, intermission included.

    Raises:
        ValueError: not 0 to 8 bytes.
    """
    if not 0 <= data_bytes <= FRAME_BYTES:
        raise ValueError(f"a classic CAN frame has 0 to {FRAME_BYTES} data bytes, not {data_bytes}")
    fixed, stuffable = (67, 54) if extended else (47, 34)
    return fixed + 8 * data_bytes + (stuffable + 8 * data_bytes - 1) // 4


@dataclass(frozen=True)
class FrameGroup:
    """Equal frames.

    Attributes:
        meaning: in words.
        count: how many.
        data_bytes: of each.
        extended: whether identifiers have 29 bits.
    """

    meaning: str
    count: int
    data_bytes: int
    extended: bool = False

    @property
    def bits(self) -> int:
        """Bits of all frames, at worst."""
        return self.count * frame_bits(self.data_bytes, extended=self.extended)


@dataclass(frozen=True)
class Budget:
    """What a connection asks of its bus.

    Attributes:
        bitrate: [bit/s].
        rate: of the cycle [Hz].
        cycle: frames of every cycle.
        beside: frames that come at a rate of their own: (frames, rate [Hz]).
    """

    bitrate: float
    rate: float
    cycle: tuple[FrameGroup, ...]
    beside: tuple[tuple[FrameGroup, float], ...] = ()

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


def synchronous_cycle(nodes: int, tpdos: Sequence[int], rpdos: Sequence[int] = ()) -> tuple[FrameGroup, ...]:
    """The frames of one SYNC: SYNC itself, and each node's TPDOs and RPDOs of so many data bytes."""
    transmitted = [FrameGroup(f"TPDO{number}", nodes, size) for number, size in enumerate(tpdos, start=1)]
    commanded = [FrameGroup(f"RPDO{number}", nodes, size) for number, size in enumerate(rpdos, start=1)]
    return (FrameGroup("SYNC", 1, 0), *transmitted, *commanded)


def connection_budget(driver: str, settings: DriverSettings) -> Budget | None:
    """The budget of a connection of one of dynid's CAN drivers; None for another driver.

    Raises:
        UsageError: the connection's keys are wrong.
    """
    if driver == "canopen402":
        return _canopen_budget(settings)
    if driver == "can_frames":
        return _can_frames_budget(settings)
    return None


def _canopen_budget(settings: DriverSettings) -> Budget:
    from drivers.canopen402.protocol import objects
    from drivers.canopen402.samples.temperature import RATE
    from drivers.canopen402.settings import parse_settings

    bus = parse_settings(settings.connection, settings.joints)
    nodes = len(bus.nodes)
    tpdos = [sum(entry.size for entry in carried) for carried in objects.TPDO_OBJECTS]
    rpdos = [] if bus.mode == "none" else [sum(entry.size for entry in objects.RPDO_OBJECTS)]
    if bus.guarding is not None:
        rate = 1.0 / bus.guarding.period
        beside = [(FrameGroup("guarding requests", nodes, 0), rate), (FrameGroup("guarding answers", nodes, 1), rate)]
    else:
        own = 0 if bus.mode == "none" else 1  # where nothing moves, dynid sends none
        beside = [(FrameGroup("heartbeats", nodes + own, 1), 1.0 / bus.heartbeat)]
    if warm := sum(node.temperature is not None for node in bus.nodes):
        beside.append((FrameGroup("temperatures by SDO", 2 * warm, FRAME_BYTES), RATE))  # request and answer
    return Budget(bus.bitrate, bus.sync_rate, synchronous_cycle(nodes, tpdos, rpdos), tuple(beside))


def _can_frames_budget(settings: DriverSettings) -> Budget:
    from drivers.can.bus import EXTENDED
    from drivers.can_signals.settings import parse_settings

    bus = parse_settings(settings.connection, settings.joints, settings.folder)

    def group(meaning: str, identifiers: Sequence[tuple[int, int]]) -> list[FrameGroup]:
        return [FrameGroup(meaning, 1, size, bool(identifier & EXTENDED)) for identifier, size in identifiers]

    # The table says which bytes it needs, not how long a frame is: 8 at worst. What is not in the joints' stream is
    # taken to come at most once a cycle.
    samples = [(layout.identifier, FRAME_BYTES) for layout in bus.frame_layouts("joints")]
    others = [(identifier, FRAME_BYTES) for identifier in sorted(bus.identifiers - {one for one, _ in samples})]
    cycle = group("samples", samples) + group("other samples", others)
    if bus.poll is not None:
        cycle += group("requests", [(frame.identifier, len(frame.data)) for frame in bus.poll.frames])
    if bus.command is not None:
        sizes = [
            (layout.identifier, len(bus.command.templates.get(layout.identifier, b"")) or layout.size)
            for layout in bus.command.layouts
        ]
        cycle += group("commands", sizes)
    return Budget(bus.bitrate, bus.rate, tuple(cycle))
