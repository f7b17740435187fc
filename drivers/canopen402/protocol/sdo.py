"""A drive's object dictionary over SDO (CiA 301, 7.2.4), with errors in words; the transfers are canopen's."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager

from canopen.network import Network
from canopen.objectdictionary import ObjectDictionary
from canopen.sdo.client import SdoClient
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from drivers.can.bus import Sender
from drivers.canopen402.protocol import objects
from drivers.canopen402.protocol.emcy import NOT_THERE, describe_abort
from drivers.canopen402.protocol.objects import DriveObject
from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.errors import ConnectionFailedError

_UPLOAD = 0x40
_DOWNLOAD = 0x23
"""Expedited, with its size: four bytes, less one for every 4 that are added."""
_LENGTH = 8
"""Length of every SDO frame (CiA 301, 7.2.4.3) [bytes]."""


class CanopenNetwork(Network):
    """canopen's network on a bus that others send on and receive from as well."""

    def __init__(self, sender: Sender) -> None:
        super().__init__()
        self._sender = sender

    def take(self, identifier: int, data: bytes, arrived: float) -> None:
        """Take a frame that is no sample: SDO answers, emergencies, heartbeats."""
        self.notify(identifier, bytearray(data), arrived)

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        """Send a frame; raises ConnectionLostError where the adapter does not take it."""
        del remote  # no service that is used here needs remote frames
        self._sender.send(can_id, bytes(data))


class _Client(SdoClient):
    """canopen's client, but waiting for answers on a clock of ours."""

    def __init__(self, node: int, timeout: float, clock: Clock) -> None:
        dictionary = ObjectDictionary()  # type: ignore[no-untyped-call]
        super().__init__(objects.SDO_REQUEST + node, objects.SDO_ANSWER + node, dictionary)  # type: ignore[no-untyped-call]
        self._answered = clock.condition()
        self._timeout = timeout

    def on_response(self, can_id: int, data: bytearray, timestamp: float) -> None:
        if len(data) != _LENGTH:
            raise ValueError(f"an SDO answer of {len(data)} bytes")  # the receiver reports it and leaves it out
        with self._answered:
            super().on_response(can_id, data, timestamp)  # type: ignore[no-untyped-call]
            self._answered.notify_all()

    def read_response(self) -> bytes:
        with self._answered:
            if not self._answered.wait_for(lambda: not self.responses.empty(), self._timeout):
                raise SdoCommunicationError(f"no answer within {self._timeout:g} s")
        return bytes(super().read_response())  # type: ignore[no-untyped-call]


class RemoteDrive:
    """The object dictionary of one drive, read and written by SDO; it may take `timeout` [s] to answer a request.

    Reading and writing raise ConnectionFailedError: no answer, refused, or too late.
    """

    def __init__(self, network: Network, joint: str, node: int, timeout: float, clock: Clock = SYSTEM_CLOCK) -> None:
        self.joint, self.node = joint, node
        self.where = f"{joint} (node {node})"
        self.timeout = timeout
        self.deadline = math.inf
        self._clock = clock
        self._client = _Client(node, timeout, clock)
        self._client.network = network
        network.subscribe(objects.SDO_ANSWER + node, self._client.on_response)

    def ask_for(self, entry: DriveObject) -> None:
        """Request an object without waiting; `answers` counts what came."""
        self._request(_UPLOAD, entry, b"")

    def ask_to_write(self, entry: DriveObject, value: int) -> None:
        """Request that an object of at most 4 bytes be written, without waiting; `answers` counts what came.

        Raises:
            ConnectionLostError: the adapter does not take it.
        """
        self._request(_DOWNLOAD + 4 * (4 - entry.size), entry, entry.encode(value))

    @property
    def answers(self) -> int:
        """Answers that wait."""
        return int(self._client.responses.qsize())

    def read(self, entry: DriveObject) -> int:
        """A number."""
        return entry.decode(self.read_bytes(entry))

    def read_bytes(self, entry: DriveObject) -> bytes:
        """An object as it is."""
        with self._in_words(entry, "read"):
            return bytes(self._client.upload(entry.index, entry.subindex))

    def read_optional(self, entry: DriveObject) -> int | None:
        """A number, or None where the drive does not have the object."""
        data = self._bytes_optional(entry)
        return None if data is None else entry.decode(data)

    def read_text(self, entry: DriveObject) -> str:
        """A text; empty where the drive does not have the object."""
        data = self._bytes_optional(entry) or b""
        return "".join(c for c in data.decode("latin-1") if c.isprintable()).strip()

    def write(self, entry: DriveObject, value: int) -> None:
        """Write a number."""
        with self._in_words(entry, f"write {value} to"):
            self._client.download(entry.index, entry.subindex, entry.encode(value))

    def write_optional(self, entry: DriveObject, value: int) -> bool:
        """Write a number; whether the drive has the object."""
        try:
            self.write(entry, value)
        except ConnectionFailedError as error:
            if _is_missing(error):
                return False
            raise
        return True

    def _bytes_optional(self, entry: DriveObject) -> bytes | None:
        try:
            return self.read_bytes(entry)
        except ConnectionFailedError as error:
            if _is_missing(error):
                return None
            raise

    def _request(self, command: int, entry: DriveObject, data: bytes) -> None:
        while not self._client.responses.empty():
            self._client.responses.get_nowait()
        request = bytes([command, *entry.index.to_bytes(2, "little"), entry.subindex]) + data.ljust(4, b"\0")
        self._client.send_request(request)  # type: ignore[no-untyped-call]

    @contextmanager
    def _in_words(self, entry: DriveObject, action: str) -> Iterator[None]:
        if self._clock.now() > self.deadline:
            raise ConnectionFailedError(
                "the configuration of the drives takes too long",
                where=self.where,
                hint="raise the connection's 'timeout', or reduce the load of the bus",
            )
        try:
            yield
        except SdoAbortedError as error:
            words, hint = describe_abort(error.code)
            raise ConnectionFailedError(f"cannot {action} {entry}: {words}", where=self.where, hint=hint) from error
        except SdoCommunicationError as error:
            raise ConnectionFailedError(
                f"no answer within {self.timeout:g} s when asked to {action} {entry}",
                where=self.where,
                hint="check that the drive is on and the bus terminated; a slow drive needs a longer 'sdo_timeout'",
            ) from error
        except OverflowError as error:
            raise ConnectionFailedError(
                f"cannot {action} {entry}: the value does not fit",
                where=self.where,
                hint="check counts_per_turn, velocity and acceleration of this node",
            ) from error


def abort_code(error: ConnectionFailedError) -> int | None:
    """The SDO abort code with which a drive refused something; None where it did not refuse."""
    return error.__cause__.code if isinstance(error.__cause__, SdoAbortedError) else None


def _is_missing(error: ConnectionFailedError) -> bool:
    return abort_code(error) in NOT_THERE
