"""Whether drives may be configured, and moved: nobody else has powered them, and none is in fault."""

from __future__ import annotations

from collections.abc import Sequence

from drivers.canopen402.protocol import objects
from drivers.canopen402.protocol.emcy import describe_error, register_words
from drivers.canopen402.protocol.sdo import RemoteDrive
from drivers.canopen402.protocol.state_machine import (
    DISABLE_VOLTAGE,
    FAULT_RESET,
    FAULTY,
    POWERED,
    DriveState,
    drive_state,
)
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
            f"powered already, by another master or a program of its own: {', '.join(powered)}",
            hint="end what moves the arm, or switch the drives off; nothing was changed, for that might stop them",
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
