"""A file that HDF5 writes through, and that never refuses: HDF5 crashes where a write of its own is refused."""

from __future__ import annotations

import os
from pathlib import Path


class FailsafeFile:
    """A new file, open for reading and writing; the first error is kept, and what is written after it goes to memory.

    Has what h5py asks of a Python file. The writer looks at `failure` after each step, so little is written after it.

    Raises:
        OSError: it exists already, or cannot be created.
    """

    def __init__(self, path: Path) -> None:
        self.failure: OSError | None = None
        """Why the disk refused a write; None while it refused none."""
        self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_CLOEXEC", 0), 0o666)
        self._place = 0
        self._size = 0
        self._refused: list[tuple[int, bytes]] = []

    def write(self, content: bytes | memoryview) -> int:
        """Write at the place; the number of bytes, which is all of them."""
        rest = memoryview(content).cast("B")
        place, count = self._place, len(rest)
        while rest and self.failure is None:
            try:
                written = os.pwrite(self._descriptor, rest, place)
            except OSError as error:
                self.failure = error
            else:
                place, rest = place + written, rest[written:]
        if rest:
            self._refused.append((place, bytes(rest)))
        self._place += count
        self._size = max(self._size, self._place)
        return count

    def readinto(self, buffer: memoryview) -> int:
        """Fill a buffer from the place on; what was never written reads as 0."""
        view = memoryview(buffer).cast("B")
        start, stop = self._place, self._place + len(view)
        held = os.pread(self._descriptor, len(view), start)
        view[: len(held)] = held
        view[len(held) :] = bytes(len(view) - len(held))
        for place, content in self._refused:
            first, last = max(start, place), min(stop, place + len(content))
            if first < last:
                view[first - start : last - start] = content[first - place : last - place]
        self._place = stop
        return len(view)

    def read(self, count: int) -> bytes:
        """`count` bytes from the place on."""
        content = bytearray(count)
        self.readinto(memoryview(content))
        return bytes(content)

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Move the place; the new one."""
        self._place = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._place, os.SEEK_END: self._size}[whence]
        return self._place

    def tell(self) -> int:
        """The place."""
        return self._place

    def truncate(self, size: int) -> int:
        """Set the size."""
        self._size = size
        if self.failure is None:
            try:
                os.ftruncate(self._descriptor, size)
            except OSError as error:
                self.failure = error
        return size

    def flush(self) -> None:
        """Do nothing: nothing is held back."""

    def close(self) -> None:
        """Have the disk confirm all that was written, and close; `failure` says whether it did. May be called twice."""
        if self._descriptor < 0:
            return
        try:
            os.fsync(self._descriptor)
        except OSError as error:
            self.failure = self.failure or error
        finally:
            os.close(self._descriptor)
            self._descriptor = -1
