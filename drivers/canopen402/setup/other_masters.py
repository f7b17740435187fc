"""Whether another master uses the bus: what only masters send is listened for before anything is sent."""

from __future__ import annotations

from collections.abc import Sequence

from drivers.canopen402.protocol import objects
from drivers.canopen402.protocol.sdo import CanopenNetwork
from drivers.canopen402.settings import HIGHEST_ID
from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.errors import MotionRefusedError

LISTEN = 0.5
"""How long [s] is listened, or for two periods of the heartbeat where that is longer."""
LONGEST_LISTEN = 2.0


def masters_heartbeats(ids: Sequence[int], own_id: int) -> dict[int, int]:
    """Identifier → node id of the heartbeats under which a master may be heard: dynid's own id, and 127."""
    return {objects.HEARTBEAT + node: node for node in sorted({own_id, HIGHEST_ID} - set(ids))}


def require_alone(
    network: CanopenNetwork, ids: Sequence[int], own_id: int, heartbeat: float, clock: Clock = SYSTEM_CLOCK
) -> None:
    """Listen for other masters, sending nothing.

    Args:
        network: receives what is no sample.
        ids: node ids of the drives.
        own_id: dynid's node id.
        heartbeat: period of dynid's heartbeat, and so of a second dynid's [s].
        clock: the host's.

    Raises:
        MotionRefusedError: there is one; names all that it sends.
    """
    signs = {objects.SYNC: "SYNC (0x080)", objects.NMT: "NMT commands (0x000)"}
    for identifier, node in masters_heartbeats(ids, own_id).items():
        signs[identifier] = f"a heartbeat as node {node} (0x{identifier:03X})"
    for node in ids:
        signs |= {base + node: "targets (RPDO)" for base in objects.RPDO_BASES}
        signs |= {objects.SDO_REQUEST + node: "SDO requests", objects.HEARTBEAT + node: "requests of node guarding"}
    heard: set[str] = set()

    def note(identifier: int, data: bytearray, _arrived: float) -> None:
        if identifier - objects.HEARTBEAT not in ids or (data and data[0] & objects.GUARDING_TOGGLE):
            heard.add(signs[identifier])

    for identifier in signs:
        network.subscribe(identifier, note)
    clock.sleep(min(max(LISTEN, 2.0 * heartbeat), LONGEST_LISTEN))
    for identifier in signs:
        network.unsubscribe(identifier, note)
    if heard:
        raise MotionRefusedError(
            f"another master is on the bus: it sends {', '.join(sorted(heard))}",
            hint="end that program (a second dynid, the manufacturer's tool, a PLC) first; nothing was sent",
        )
