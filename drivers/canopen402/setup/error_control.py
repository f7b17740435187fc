"""Error control of the drives: heartbeat or guarding, and what a drive does once dynid is gone.

Objects of CiA 301, 7.5.2, and the abort connection option 0x6007 of CiA 402-2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from drivers.canopen402.protocol.emcy import VALUE_REFUSED
from drivers.canopen402.protocol.objects import (
    ABORT_OPTION,
    CONSUMER_HEARTBEAT,
    DEVICE_TYPE,
    GUARD_TIME,
    HEARTBEAT_TIME,
    LIFE_TIME_FACTOR,
    AbortOption,
    DriveObject,
)
from drivers.canopen402.protocol.sdo import RemoteDrive, abort_code
from drivers.canopen402.settings import HEARTBEATS_MISSED, CanopenSettings
from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.errors import ConnectionFailedError, ConnectionLostError

OWN_ID_ANSWER = 0.05
"""How long [s] another device may take to say that it has dynid's node id."""
RELEASE_LIMIT = 0.1
"""How long [s] all drives together may take to stop watching dynid when it leaves."""
STOPPING = frozenset({AbortOption.FAULT, AbortOption.DISABLE_VOLTAGE, AbortOption.QUICK_STOP})


@dataclass(frozen=True)
class ErrorControl:
    """How one drive is watched, and watches."""

    present: bool  # whether it shows that it is there: by its heartbeat, or asked by guarding
    # object by which it watches dynid, 0 to end that; None where it cannot, or need not
    watching: DriveObject | None = None
    abort_option: int | None = None  # what it does once dynid is gone; None where it does not say, or nothing will move


def configure_error_control(drive: RemoteDrive, settings: CanopenSettings) -> ErrorControl:
    """Let a drive show that it is there and, where the arm is to be moved, stop once dynid does not any more.

    Where nothing will move, a drive need not watch dynid, and neither 0x1016 nor 0x6007 is written.

    Raises:
        ConnectionFailedError: no answer, or refused.
    """
    moved = settings.mode != "none"
    guarding = settings.guarding
    if guarding is None:
        present = drive.write_optional(HEARTBEAT_TIME, round(1e3 * settings.heartbeat))
        watching = _watch_heartbeat(drive, settings) if moved else None
    else:
        drive.write_optional(HEARTBEAT_TIME, 0)  # with a heartbeat it would not answer
        drive.write_optional(LIFE_TIME_FACTOR, 0)  # from an earlier session
        present = True
        watching = None
        if moved and drive.write_optional(GUARD_TIME, round(1e3 * guarding.period)):
            watching = LIFE_TIME_FACTOR if drive.write_optional(LIFE_TIME_FACTOR, guarding.factor) else None
    return ErrorControl(present, watching, _choose_abort_option(drive) if moved else None)


def warnings_of(controls: Sequence[tuple[str, ErrorControl]], settings: CanopenSettings) -> list[str]:
    """Return what a person must know of drives, each named as given: who cannot be watched, or does not watch dynid."""
    warnings = [
        f"{who} has no heartbeat ({HEARTBEAT_TIME} does not exist): only its silence would show that it is gone; "
        "'guarding' instead of 'heartbeat' polls such drives"
        for who, control in controls
        if not control.present
    ]
    if settings.mode == "none":
        return warnings
    means = "consumer heartbeat time (0x1016)" if settings.guarding is None else "life guarding (0x100C, 0x100D)"
    blind = [who for who, control in controls if control.watching is None]
    if blind:
        warnings.append(
            f"{', '.join(blind)}: no {means}, or none free; such a drive cannot notice that dynid or the bus is gone, "
            "and may hold its last target"
        )
    unsure = [who for who, control in controls if control.watching is not None and control.abort_option is None]
    if unsure:
        warnings.append(
            f"{', '.join(unsure)}: {ABORT_OPTION} does not exist; what such a drive does when dynid is gone is the "
            "manufacturer's choice"
        )
    warnings += [
        f"{who}: {ABORT_OPTION} stays {control.abort_option}, which does not stop the drive when dynid is gone"
        for who, control in controls
        if control.abort_option is not None and control.abort_option not in STOPPING
    ]
    return warnings


def check_own_id(own: RemoteDrive, clock: Clock = SYSTEM_CLOCK) -> None:
    """Make sure that no device on the bus has dynid's node id.

    Raises:
        ConnectionFailedError: one has.
    """
    own.ask_for(DEVICE_TYPE)
    end = clock.now() + OWN_ID_ANSWER
    while clock.now() < end:
        if own.answers:
            raise ConnectionFailedError(
                f"a device on the bus has node id {own.node}, under which dynid would send its heartbeat",
                hint="set the connection's 'own_id' to a free node id",
            )
        clock.sleep(1e-3)


def release(drives: Sequence[RemoteDrive], controls: Sequence[ErrorControl], clock: Clock = SYSTEM_CLOCK) -> None:
    """End the drives' watch of dynid, so that closing is no error; never raises, and does not wait long."""
    asked = []
    for drive, control in zip(drives, controls, strict=True):
        if control.watching is None:
            continue
        try:
            drive.ask_to_write(control.watching, 0)
        except ConnectionLostError:
            return
        asked.append(drive)
    end = clock.now() + RELEASE_LIMIT
    while any(not drive.answers for drive in asked) and clock.now() < end:
        clock.sleep(1e-3)


def _watch_heartbeat(drive: RemoteDrive, settings: CanopenSettings) -> DriveObject | None:
    """Let a drive watch dynid's heartbeat in an entry that is dynid's already, or free; None where there is none."""
    count = drive.read_optional(CONSUMER_HEARTBEAT) or 0
    entries = [
        DriveObject(CONSUMER_HEARTBEAT.index, place, 4, False, CONSUMER_HEARTBEAT.name) for place in range(1, count + 1)
    ]
    values = {entry: drive.read_optional(entry) for entry in entries}
    own = [entry for entry, value in values.items() if value is not None and value >> 16 & 0xFF == settings.own_id]
    free = [entry for entry, value in values.items() if value is not None and not (value >> 16 and value & 0xFFFF)]
    limit = round(1e3 * HEARTBEATS_MISSED * settings.heartbeat)
    for entry in (*own[:1], *free[:1]):
        if drive.write_optional(entry, settings.own_id << 16 | limit):
            return entry
    return None


def _choose_abort_option(drive: RemoteDrive) -> int | None:
    """Quick stop; else what the drive keeps; None where it has no such object."""
    try:
        if drive.write_optional(ABORT_OPTION, AbortOption.QUICK_STOP):
            return AbortOption.QUICK_STOP
    except ConnectionFailedError as error:
        if abort_code(error) not in VALUE_REFUSED:
            raise
    return drive.read_optional(ABORT_OPTION)
