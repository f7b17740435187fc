"""The SDO server of a simulated CANopen node: expedited and segmented transfers (CiA 301, 7.2.4)."""

from __future__ import annotations

import struct

from sim_drivers.canopen.object_dictionary import Abort, ObjectDictionary, SdoAbortError

DOWNLOAD_SEGMENT, DOWNLOAD, UPLOAD, UPLOAD_SEGMENT, ABORTED = range(5)
"""Client command specifiers, bits 5–7 of the first byte."""
LONGEST_DOWNLOAD = 4096
"""[byte]: nothing that this node holds is longer."""


class SdoServer:
    """Answers one request after another; a client that aborts a transfer affects no other.

    Args:
        objects: to read and write.
    """

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
