"""What the drives' PDOs carry and when: mapping and communication parameters (CiA 301, 7.5.2.35 to 7.5.2.38)."""

from __future__ import annotations

from collections.abc import Sequence

from drivers.canopen402.protocol import objects
from drivers.canopen402.protocol.objects import DriveObject
from drivers.canopen402.protocol.sdo import RemoteDrive
from drivers.core.errors import ConnectionFailedError

_INVALID = 1 << 31
_OLD_ID = (1 << 30) - 1
_SYNCHRONOUS = 1
_UNUSED_TPDOS = (0x1802, 0x1803)


def configure_pdos(drive: RemoteDrive, *, commanded: bool) -> None:
    """Two TPDOs answered to every SYNC, and one RPDO applied at SYNC where the drive is to be moved.

    Args:
        drive: in pre-operational.
        commanded: whether the RPDO is used; else it is disabled, so that nothing can move the drive through it.

    Raises:
        ConnectionFailedError: no answer, refused, or not kept.
    """
    tpdos = zip(objects.TPDO_BASES, objects.TPDO_OBJECTS, strict=True)
    for number, (base, carried) in enumerate(tpdos):
        _map_pdo(drive, 0x1800 + number, 0x1A00 + number, base + drive.node, carried)
    for index in _UNUSED_TPDOS:  # they would take room on the bus
        identifier = drive.read_optional(_communication(index, 1, 4))
        if identifier is not None and not identifier & _INVALID:
            drive.write_optional(_communication(index, 1, 4), identifier | _INVALID)
    if not commanded:
        identifier = drive.read(_communication(0x1400, 1, 4))
        drive.write(_communication(0x1400, 1, 4), identifier | _INVALID)
    else:
        _map_pdo(drive, 0x1400, 0x1600, objects.RPDO1 + drive.node, objects.RPDO_OBJECTS)


def _map_pdo(
    drive: RemoteDrive, communication: int, mapping: int, identifier: int, carried: Sequence[DriveObject]
) -> None:
    """Disable, map, enable (CiA 301, 7.5.2.36): a mapping can be changed only while its PDO is disabled."""
    entry = _communication(communication, 1, 4)
    flags = drive.read(entry) & ~(_INVALID | _OLD_ID)  # bit 30 (no remote frames) is the drive's own
    drive.write(entry, flags | _INVALID | identifier)
    drive.write(_communication(communication, 2, 1), _SYNCHRONOUS)
    count = DriveObject(mapping, 0, 1, False, "PDO mapping")
    drive.write(count, 0)
    for position, mapped in enumerate(carried, start=1):
        drive.write(DriveObject(mapping, position, 4, False, f"PDO mapping, {mapped.name}"), mapped.mapping)
    drive.write(count, len(carried))
    drive.write(entry, flags | identifier)
    written = drive.read(entry), drive.read(_communication(communication, 2, 1)), drive.read(count)
    if written[0] & (_INVALID | _OLD_ID) != identifier or written[1:] != (_SYNCHRONOUS, len(carried)):
        raise ConnectionFailedError(
            f"the drive did not keep its PDO settings (0x{communication:04X}, 0x{mapping:04X})",
            where=drive.where,
            hint="does the drive's manufacturer fix its PDOs?",
        )


def _communication(index: int, subindex: int, size: int) -> DriveObject:
    return DriveObject(index, subindex, size, False, "PDO communication")
