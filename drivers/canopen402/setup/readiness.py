"""Tells whether drives may be configured, and moved: nothing else has powered them, and none is in fault."""

from __future__ import annotations

from collections.abc import Sequence

from drivers.canopen402.protocol import objects
from drivers.canopen402.protocol.emcy import describe_error, register_words
from drivers.canopen402.protocol.sdo import CanopenNetwork, RemoteDrive
from drivers.canopen402.protocol.state_machine import (
    DISABLE_VOLTAGE,
    FAULT_RESET,
    FAULTY,
    POWERED,
    DriveState,
    drive_state,
)
from drivers.canopen402.settings import HIGHEST_ID
from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.errors import MotionRefusedError

SETTLE_LIMIT = 1.0
"""How long [s] a drive may take to leave a fault."""


def require_unpowered(drives: Sequence[RemoteDrive]) -> None:
    """Read the drives' states, and change nothing.

    Raises:
        MotionRefusedError: somebody else has powered a drive.
        ConnectionFailedError: no answer.
    """
    states = {drive.where: _state(drive) for drive in drives}
    powered = [f"{where} ({state.value})" for where, state in states.items() if state in POWERED]
    if powered:
        raise MotionRefusedError(
            f"already powered, by another master or its own program: {', '.join(powered)}",
            hint="end the program that moves the arm, or switch the drives off; nothing was changed, since that "
            "might stop them",
        )


def faults(drives: Sequence[RemoteDrive]) -> list[str]:
    """The drives that are in fault, and why, in words.

    Raises:
        ConnectionFailedError: no answer.
    """
    return [f"{drive.where} is in fault: {_cause(drive)}" for drive in drives if _state(drive) in FAULTY]


def reset_faults(drives: Sequence[RemoteDrive], clock: Clock = SYSTEM_CLOCK) -> list[str]:
    """Reset the faults of all drives that are in fault, which are without power then; what was done, in words.

    Raises:
        ConnectionFailedError: no answer, or refused.
    """
    said = []
    for drive in drives:
        if _state(drive) is not DriveState.FAULT:
            continue
        cause, end = _cause(drive), clock.now() + SETTLE_LIMIT
        for controlword in (DISABLE_VOLTAGE, FAULT_RESET):  # the edge of its bit resets
            drive.write(objects.CONTROLWORD, controlword)
        while (state := _state(drive)) in FAULTY and clock.now() < end:
            clock.sleep(0.005)
        drive.write(objects.CONTROLWORD, DISABLE_VOLTAGE)
        outcome = "the fault stays" if state in FAULTY else "the fault was reset"
        said.append(f"{drive.where} was in fault: {cause}; {outcome}")
    return said


def _state(drive: RemoteDrive) -> DriveState:
    return drive_state(drive.read(objects.STATUSWORD))


def _cause(drive: RemoteDrive) -> str:
    code, register = drive.read_optional(objects.ERROR_CODE), drive.read_optional(objects.ERROR_REGISTER)
    words = f"{describe_error(code)} (0x603F: 0x{code:04X})" if code else "the drive gives no error code"
    return f"{words}, error register: {register_words(register)}" if register else words


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
