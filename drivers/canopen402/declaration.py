"""What dynid knows of the driver `canopen402`."""

from __future__ import annotations

from collections.abc import Sequence

from drivers.base import DriverSettings
from drivers.bus_budget import FRAME_BYTES, WORST, Budget, FrameGroup, can_frames
from drivers.canopen402.protocol import objects
from drivers.canopen402.samples.temperature import RATE
from drivers.canopen402.settings import parse_settings
from drivers.declaration import DriverDeclaration, SimulatedBackEnd


def synchronous_cycle(nodes: int, tpdos: Sequence[int], rpdos: Sequence[int] = ()) -> tuple[FrameGroup, ...]:
    """The frames of one SYNC: SYNC itself, and each node's TPDOs and RPDOs of so many data bytes."""
    transmitted = [can_frames(f"TPDO{number}", nodes, size) for number, size in enumerate(tpdos, start=1)]
    commanded = [can_frames(f"RPDO{number}", nodes, size) for number, size in enumerate(rpdos, start=1)]
    return (can_frames("SYNC", 1, 0), *transmitted, *commanded)


def canopen_budget(settings: DriverSettings) -> Budget:
    """The budget of a connection."""
    bus = parse_settings(settings.connection, settings.joints)
    nodes = len(bus.nodes)
    tpdos = [sum(entry.size for entry in carried) for carried in objects.TPDO_OBJECTS]
    rpdos = [] if bus.mode == "none" else [sum(entry.size for entry in objects.RPDO_OBJECTS)]
    if bus.guarding is not None:
        rate = 1.0 / bus.guarding.period
        beside = [(can_frames("guarding requests", nodes, 0), rate), (can_frames("guarding answers", nodes, 1), rate)]
    else:
        own = 0 if bus.mode == "none" else 1  # where nothing moves, dynid sends none
        beside = [(can_frames("heartbeats", nodes + own, 1), 1.0 / bus.heartbeat)]
    if warm := sum(node.temperature is not None for node in bus.nodes):
        beside.append((can_frames("temperatures by SDO", 2 * warm, FRAME_BYTES), RATE))  # request and answer
    return Budget(bus.bitrate, bus.sync_rate, synchronous_cycle(nodes, tpdos, rpdos), tuple(beside), WORST)


DECLARATION = DriverDeclaration(
    driver="drivers.canopen402.driver:Canopen402Driver",
    budget="drivers.canopen402.declaration:canopen_budget",
    read_only={"mode": "none"},
    reset_faults={"reset_faults": True},
    simulated=(
        SimulatedBackEnd("canopen", "sim_drivers.canopen.server:serve", stands_in=True),
        SimulatedBackEnd("slcan", "sim_drivers.canopen.server:serve_behind_adapter"),
    ),
)
