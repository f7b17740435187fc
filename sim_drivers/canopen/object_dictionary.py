"""The object dictionary of one simulated CANopen node: the objects of its EDS, with values (CiA 301, CiA 306)."""

from __future__ import annotations

import struct
from collections.abc import Callable, Container
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache
from importlib.resources import files
from io import StringIO
from typing import Any

EDS_NAME = "dynid_drive.eds"
"""File in the folder `eds`; a user's master reads the same one."""

Value = int | str


class Abort(IntEnum):
    """SDO abort codes (CiA 301, 7.2.4.3.17)."""

    TOGGLE = 0x05030000
    COMMAND = 0x05040001
    WRITE_ONLY = 0x06010001
    READ_ONLY = 0x06010002
    NO_OBJECT = 0x06020000
    NOT_MAPPABLE = 0x06040041
    PDO_LENGTH = 0x06040042
    INCOMPATIBLE = 0x06040043
    TOO_LONG = 0x06070012
    TOO_SHORT = 0x06070013
    NO_SUBINDEX = 0x06090011
    VALUE_RANGE = 0x06090030
    DEVICE_STATE = 0x08000022


class SdoAbortError(Exception):
    """A refused access, with its abort code."""

    def __init__(self, code: Abort) -> None:
        super().__init__(f"{code.name.lower().replace('_', ' ')} (0x{code:08X})")
        self.code = code


@dataclass(frozen=True)
class ObjectEntry:
    """One variable."""

    name: str  # in the EDS
    size: int  # [byte]; 0 for a text
    signed: bool  # whether a number may be negative
    # readable, writable: by SDO
    readable: bool
    writable: bool
    mappable: bool  # into a PDO
    default: Value | None  # value after a reset; None where the drive provides it

    def encode(self, value: Value) -> bytes:
        """The encoded bytes; a number that is too large is cut to the largest that fits."""
        if isinstance(value, str):
            return value.encode("ascii", "replace")
        low, high = self.limits
        return min(max(value, low), high).to_bytes(self.size, "little", signed=self.signed)

    def decode(self, content: bytes) -> Value:
        """The value of encoded bytes.

        Raises:
            SdoAbortError: another length.
        """
        if not self.size:
            return content.decode("ascii", "replace")
        if len(content) != self.size:
            raise SdoAbortError(Abort.TOO_LONG if len(content) > self.size else Abort.TOO_SHORT)
        return int.from_bytes(content, "little", signed=self.signed)

    @property
    def limits(self) -> tuple[int, int]:
        """Smallest and largest number that fits."""
        bits = 8 * self.size
        return (-(1 << bits - 1), (1 << bits - 1) - 1) if self.signed else (0, (1 << bits) - 1)


@lru_cache(maxsize=128)
def entries(node: int) -> dict[tuple[int, int], ObjectEntry]:
    """The variables of a node by index and subindex, as its EDS lists them."""
    from canopen.objectdictionary import SIGNED_TYPES, ODVariable, datatypes
    from canopen.objectdictionary.eds import import_eds

    by_place: dict[tuple[int, int], ObjectEntry] = {}
    read: Any = import_eds
    text = files("sim_drivers.canopen").joinpath(EDS_NAME).read_text(encoding="utf-8")
    for index, item in read(StringIO(text), node).items():
        for variable in [item] if isinstance(item, ODVariable) else item.values():
            is_text = variable.data_type == datatypes.VISIBLE_STRING
            by_place[index, variable.subindex] = ObjectEntry(
                name=variable.name,
                size=0 if is_text else len(variable) // 8,
                signed=variable.data_type in SIGNED_TYPES,
                readable=variable.readable,
                writable=variable.writable,
                mappable=variable.pdo_mappable,
                default=variable.default,
            )
    return by_place


class ObjectDictionary:
    """The values of one node.

    `fixed` are values, by (index, subindex), that this node has instead of the defaults of its id.

    Attributes:
        entries: by index and subindex.
    """

    def __init__(self, node: int, fixed: dict[tuple[int, int], Value]) -> None:
        self.entries = entries(node)
        self._fixed = fixed
        self._live: dict[tuple[int, int], Callable[[], int]] = {}
        self._checks: dict[tuple[int, int], Callable[[int], None]] = {}
        self._values: dict[tuple[int, int], Value] = {}
        self.reset()

    def reset(self) -> None:
        """Back to the defaults."""
        defaults = {key: entry.default for key, entry in self.entries.items() if entry.default is not None}
        self._values = {**defaults, **self._fixed}

    def reset_communication(self) -> None:
        """Objects 0x1000 to 0x1FFF back to their defaults."""
        before = self._values
        self.reset()
        self._values |= {key: value for key, value in before.items() if not 0x1000 <= key[0] < 0x2000}

    def live(self, index: int, subindex: int, read: Callable[[], int]) -> None:
        """A value that the drive computes on every read."""
        self._live[index, subindex] = read

    def on_write(self, index: int, subindex: int, check: Callable[[int], None]) -> None:
        """Called before a value is stored; may raise SdoAbortError to refuse it."""
        self._checks[index, subindex] = check

    def allow(self, index: int, subindex: int, values: Container[int]) -> None:
        """Refuse all other values that are written there."""

        def check(value: int) -> None:
            if value not in values:
                raise SdoAbortError(Abort.VALUE_RANGE)

        self.on_write(index, subindex, check)

    def entry(self, index: int, subindex: int) -> ObjectEntry:
        """The variable at a place.

        Raises:
            SdoAbortError: there is none.
        """
        entry = self.entries.get((index, subindex))
        if entry is None:
            exists = any(place == index for place, _ in self.entries)
            raise SdoAbortError(Abort.NO_SUBINDEX if exists else Abort.NO_OBJECT)
        return entry

    def number(self, index: int, subindex: int = 0) -> int:
        """The number at a place, as the drive itself sees it."""
        place = index, subindex
        read = self._live.get(place)
        value = self._values[place] if read is None else read()
        if isinstance(value, str):
            raise TypeError(f"0x{index:04X}:{subindex} is a text")
        return value

    def reader(self, index: int, subindex: int) -> Callable[[], int]:
        """A function that gives the number at a place."""
        return self._live.get((index, subindex)) or (lambda: self.number(index, subindex))

    def set(self, index: int, subindex: int, value: int) -> None:
        """Store a number, without asking whether a master might.

        Raises:
            SdoAbortError: the drive refuses the value.
        """
        check = self._checks.get((index, subindex))
        if check is not None:
            check(value)
        self._values[index, subindex] = value

    def read(self, index: int, subindex: int) -> bytes:
        """Data of an SDO upload.

        Raises:
            SdoAbortError: no such object, or one that cannot be read.
        """
        entry = self.entry(index, subindex)
        if not entry.readable:
            raise SdoAbortError(Abort.WRITE_ONLY)
        live = self._live.get((index, subindex))
        return entry.encode(live() if live is not None else self._values[index, subindex])

    def write(self, index: int, subindex: int, content: bytes) -> None:
        """Store the data of an SDO download.

        Raises:
            SdoAbortError: no such object, one that cannot be written, a wrong length, or a value that is refused.
        """
        entry = self.entry(index, subindex)
        if not entry.writable:
            raise SdoAbortError(Abort.READ_ONLY)
        value = entry.decode(content)
        if isinstance(value, str):
            self._values[index, subindex] = value
        else:
            self.set(index, subindex, value)


DOWNLOAD_SEGMENT, DOWNLOAD, UPLOAD, UPLOAD_SEGMENT, ABORTED = range(5)
"""Client command specifiers, bits 5–7 of the first byte."""
LONGEST_DOWNLOAD = 4096
"""[byte]: nothing that this node holds is longer."""


class SdoServer:
    """Answers one request after another; a client that aborts a transfer affects no other."""

    def __init__(self, objects: ObjectDictionary) -> None:
        self._objects = objects
        self.reset()

    def reset(self) -> None:
        """Forget a transfer that has begun."""
        self._index, self._subindex = 0, 0
        self._sending: bytes | None = None
        self._receiving: bytearray | None = None
        self._toggle = 0

    def answer(self, request: bytes) -> bytes | None:
        """The 8 bytes to answer a request with; None where it needs no answer."""
        if len(request) != 8:
            return None
        specifier = request[0] >> 5
        if specifier == ABORTED:
            self.reset()
            return None
        if specifier not in (DOWNLOAD_SEGMENT, UPLOAD_SEGMENT):
            self.reset()
            self._index, self._subindex = struct.unpack_from("<HB", request, 1)
        try:
            if specifier == UPLOAD:
                return self._upload()
            if specifier == DOWNLOAD:
                return self._download(request)
            if specifier == UPLOAD_SEGMENT:
                return self._upload_segment(request[0])
            if specifier == DOWNLOAD_SEGMENT:
                return self._download_segment(request)
            raise SdoAbortError(Abort.COMMAND)
        except SdoAbortError as abort:
            answer = struct.pack("<BHBI", 0x80, self._index, self._subindex, abort.code)
            self.reset()
            return answer

    def _upload(self) -> bytes:
        content = self._objects.read(self._index, self._subindex)
        head = struct.pack("<HB", self._index, self._subindex)
        if 0 < len(content) <= 4:
            return bytes([0x43 | 4 - len(content) << 2]) + head + content.ljust(4, b"\x00")
        self._sending = content
        return b"\x41" + head + struct.pack("<I", len(content))

    def _upload_segment(self, command: int) -> bytes:
        if self._sending is None:
            raise SdoAbortError(Abort.COMMAND)
        self._check_toggle(command)
        segment, self._sending = self._sending[:7], self._sending[7:]
        last = not self._sending
        answer = bytes([command & 0x10 | 7 - len(segment) << 1 | last]) + segment.ljust(7, b"\x00")
        if last:
            self.reset()
        return answer

    def _download(self, request: bytes) -> bytes:
        command = request[0]
        # Refused before a byte is sent, where it would be refused in the end.
        if not self._objects.entry(self._index, self._subindex).writable:
            raise SdoAbortError(Abort.READ_ONLY)
        if command & 0x02:
            size = 4 - (command >> 2 & 3) if command & 0x01 else self._objects.entry(self._index, self._subindex).size
            self._objects.write(self._index, self._subindex, request[4 : 4 + size])
        else:
            self._receiving = bytearray()
        return b"\x60" + request[1:4] + bytes(4)

    def _download_segment(self, request: bytes) -> bytes:
        if self._receiving is None:
            raise SdoAbortError(Abort.COMMAND)
        command = request[0]
        self._check_toggle(command)
        self._receiving += request[1 : 8 - (command >> 1 & 7)]
        if len(self._receiving) > LONGEST_DOWNLOAD:
            raise SdoAbortError(Abort.TOO_LONG)
        answer = bytes([0x20 | command & 0x10]) + bytes(7)
        if command & 0x01:
            self._objects.write(self._index, self._subindex, bytes(self._receiving))
            self.reset()
        return answer

    def _check_toggle(self, command: int) -> None:
        if command & 0x10 != self._toggle:
            raise SdoAbortError(Abort.TOGGLE)
        self._toggle ^= 0x10
