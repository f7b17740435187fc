"""Process data objects of a simulated node, as its master configures them (CiA 301, 7.2.2 and 7.5.2.35–38)."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass

from sim_drivers.canopen.object_dictionary import Abort, ObjectDictionary, SdoAbortError

INVALID = 1 << 31
"""Bit of a PDO's COB-ID: it does not exist."""
LARGEST_SYNCHRONOUS = 240
EVENT_DRIVEN = (254, 255)
LONGEST_PDO = 8
_CODES = {(1, False): "B", (1, True): "b", (2, False): "H", (2, True): "h", (4, False): "I", (4, True): "i"}


@dataclass(frozen=True)
class _Mapping:
    layout: struct.Struct
    places: tuple[tuple[int, int], ...]
    readers: tuple[Callable[[], int], ...]


class _Pdo:
    """Common base of both directions: COB-ID, transmission type, mapping, and a master's access to them.

    `communication` and `mapping` are the first objects of their kind (0x1400 and 0x1600, or 0x1800 and 0x1A00), from
    which `pdo_index` counts.
    """

    def __init__(self, objects: ObjectDictionary, pdo_index: int, communication: int, mapping: int) -> None:
        self._objects = objects
        self._communication, self._mapping = communication + pdo_index, mapping + pdo_index
        objects.on_write(self._communication, 1, self._check_identifier)
        objects.allow(self._communication, 2, (*range(LARGEST_SYNCHRONOUS + 1), *EVENT_DRIVEN))
        objects.on_write(self._mapping, 0, self._check_count)
        for place in range(1, LONGEST_PDO + 1):
            objects.on_write(self._mapping, place, self._check_place)
        self.configured()

    def configured(self) -> None:
        """Apply changed objects."""
        identifier = self._objects.number(self._communication, 1)
        self.identifier = None if identifier & INVALID else identifier & 0x7FF
        self.type = self._objects.number(self._communication, 2)
        count = self._objects.number(self._mapping, 0)
        entries = [self._objects.number(self._mapping, place + 1) for place in range(count)]
        self._mapped = self._compiled(entries)

    @property
    def synchronous(self) -> bool:
        """Return whether SYNC makes it happen."""
        return self.type <= LARGEST_SYNCHRONOUS

    def _compiled(self, entries: list[int]) -> _Mapping:
        code, places = "<", []
        for mapped in entries:
            place = mapped >> 16, mapped >> 8 & 0xFF
            entry = self._objects.entry(*place)
            code += _CODES[entry.size, entry.signed]
            places.append(place)
        return _Mapping(struct.Struct(code), tuple(places), tuple(self._objects.reader(*place) for place in places))

    def _check_identifier(self, value: int) -> None:
        if self.identifier is not None and not value & INVALID and value & 0x7FF != self.identifier:
            raise SdoAbortError(Abort.DEVICE_STATE)  # an existing PDO keeps its COB-ID
        if value & 0x3FFFF800 or not 0x181 <= value & 0x7FF <= 0x57F:
            raise SdoAbortError(Abort.VALUE_RANGE)

    def _check_place(self, value: int) -> None:
        if self.identifier is not None or self._objects.number(self._mapping, 0):
            raise SdoAbortError(Abort.DEVICE_STATE)
        if value:
            self._check_mappable(value)

    def _check_count(self, value: int) -> None:
        if self.identifier is not None:
            raise SdoAbortError(Abort.DEVICE_STATE)
        if value > LONGEST_PDO:
            raise SdoAbortError(Abort.PDO_LENGTH)
        mapped = [self._objects.number(self._mapping, place + 1) for place in range(value)]
        for entry in mapped:
            self._check_mappable(entry)
        if sum(entry & 0xFF for entry in mapped) > 8 * LONGEST_PDO:
            raise SdoAbortError(Abort.PDO_LENGTH)

    def _check_mappable(self, mapped: int) -> None:
        entry = self._objects.entry(mapped >> 16, mapped >> 8 & 0xFF)
        if not entry.mappable or entry.size * 8 != mapped & 0xFF or not self._fits_direction(entry.writable):
            raise SdoAbortError(Abort.NOT_MAPPABLE)

    def restart(self) -> None:
        """The node has become operational."""
        raise NotImplementedError

    def _fits_direction(self, writable: bool) -> bool:
        raise NotImplementedError


class TransmitPdo(_Pdo):
    """A PDO that the drive sends."""

    def __init__(self, objects: ObjectDictionary, pdo_index: int) -> None:
        super().__init__(objects, pdo_index, 0x1800, 0x1A00)
        self.restart()

    def restart(self) -> None:
        """The node has become operational."""
        self._syncs, self._last, self._sent_at = 0, b"", -math.inf

    def content(self) -> bytes:
        """The values of the mapped objects now."""
        return self._mapped.layout.pack(*[read() for read in self._mapped.readers])

    def on_sync(self) -> bytes | None:
        """Return its frame at a SYNC; None where it sends nothing."""
        if self.identifier is None or not self.synchronous:
            return None
        if self.type == 0:
            before, self._last = self._last, self.content()
            return self._last if self._last != before else None
        self._syncs += 1
        return self.content() if self._syncs % self.type == 0 else None

    def on_time(self, time: float) -> bytes | None:
        """Return its event-driven frame: where its content has changed, or its event timer has expired."""
        if self.identifier is None or self.synchronous:
            return None
        content = self.content()
        inhibit = 1e-4 * self._objects.number(self._communication, 3)
        event = 1e-3 * self._objects.number(self._communication, 5)
        waited = time - self._sent_at
        if (content == self._last or waited < inhibit) and not 0.0 < event <= waited:
            return None
        self._last, self._sent_at = content, time
        return content

    def _fits_direction(self, writable: bool) -> bool:
        return True


class ReceivePdo(_Pdo):
    """A PDO that the drive obeys."""

    def __init__(self, objects: ObjectDictionary, pdo_index: int) -> None:
        super().__init__(objects, pdo_index, 0x1400, 0x1600)
        self._waiting: bytes | None = None

    def restart(self) -> None:
        """The node has become operational: earlier data are discarded."""
        self._waiting = None

    def receive(self, content: bytes) -> bool:
        """Receive data; False where they are shorter than the mapping."""
        if len(content) < self._mapped.layout.size:
            return False
        self._waiting = content
        if not self.synchronous:
            self.apply()
        return True

    def apply(self) -> None:
        """Write the last data to the objects; a refused value leaves its object unchanged."""
        content, self._waiting = self._waiting, None
        if content is None:
            return
        for place, value in zip(self._mapped.places, self._mapped.layout.unpack_from(content), strict=True):
            try:
                self._objects.set(*place, value)
            except SdoAbortError:
                continue

    def _fits_direction(self, writable: bool) -> bool:
        return writable
