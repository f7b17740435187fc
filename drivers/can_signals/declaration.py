"""What dynid knows of the driver `can_frames`."""

from __future__ import annotations

from collections.abc import Sequence

from drivers.base import DriverSettings
from drivers.bus_budget import FRAME_BYTES, WORST, Budget, FrameGroup, can_frames
from drivers.can.bus import EXTENDED
from drivers.can_signals.settings import parse_settings
from drivers.declaration import DriverDeclaration, SimulatedBackEnd


def table_budget(settings: DriverSettings) -> Budget:
    """The budget of a connection."""
    bus = parse_settings(settings.connection, settings.joints, settings.folder)

    def group(meaning: str, identifiers: Sequence[tuple[int, int]]) -> list[FrameGroup]:
        return [can_frames(meaning, 1, size, extended=bool(identifier & EXTENDED)) for identifier, size in identifiers]

    # The table says which bytes it needs, not how long a frame is: 8 at worst. What is not in the joints' stream is
    # taken to come at most once a cycle.
    samples = [(layout.identifier, FRAME_BYTES) for layout in bus.frame_layouts("joints")]
    others = [(identifier, FRAME_BYTES) for identifier in sorted(bus.identifiers - {entry for entry, _ in samples})]
    cycle = group("samples", samples) + group("other samples", others)
    if bus.poll is not None:
        cycle += group("requests", [(frame.identifier, len(frame.data)) for frame in bus.poll.frames])
    if bus.command is not None:
        sizes = [
            (layout.identifier, len(bus.command.templates.get(layout.identifier, b"")) or layout.size)
            for layout in bus.command.layouts
        ]
        cycle += group("commands", sizes)
    return Budget(bus.keys.bitrate, bus.keys.rate, tuple(cycle), worst=WORST)


DECLARATION = DriverDeclaration(
    driver="drivers.can_signals.driver:CanFramesDriver",
    budget="drivers.can_signals.declaration:table_budget",
    simulated=(SimulatedBackEnd("can", "sim_drivers.can_signals.server:serve"),),
)
