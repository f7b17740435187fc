"""A recording's HDF5 file while it grows: others read it, and it owns disk space ahead of its end.

HDF5 crashes at its exit where a write of its own is refused. So a refusal comes when space is asked for, ahead of any
write, and what the file owns by then suffices to close it in order.
"""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import Any

import h5py

from drivers.core.errors import DiskError
from drivers.core.files import LONG_RECORDING_FILE, size_text


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


SPARE = 2**20
"""Space [B] that the file always owns beyond its end: for the last chunks, the last events and its closing."""
EXTENT = 8 * 2**20
"""Space [B] that is asked for at once; where that is refused, what is needed."""
_END_OF_FILE = slice(28, 36)  # in a superblock of version 2 or 3: HDF5 File Format Specification 3.0, II.A


class GrowingFile:
    """A file without samples, opened for appending while others read it (HDF5's SWMR mode).

    Raises:
        OSError, RuntimeError: HDF5 refuses it.
        DiskError: there is no space for it to grow.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._reserved = 0
        # Its name is unique: no other process writes it. A reader that looks too early must not stop the recording.
        self.file: Any = h5py.File(path, "r+", libver="latest", locking=False)
        """The HDF5 file; its datasets are to be opened before `allow_readers`."""
        try:
            self.reserve(0)
        except DiskError:
            self.file.close()
            raise

    def allow_readers(self) -> None:
        """Switch SWMR mode on."""
        self.file.swmr_mode = True

    def reserve(self, size: int) -> None:
        """Own the space for so many bytes more, and `SPARE`.

        Raises:
            DiskError: the system refuses it, or the file would be too large for a reader; it can still be closed.
        """
        end = self.file.id.get_filesize() + size + SPARE
        if end > LONG_RECORDING_FILE.largest:
            raise DiskError(
                f"has reached {size_text(LONG_RECORDING_FILE.largest)}, the largest recording that is read",
                hint="record in parts",
            )
        if end <= self._reserved or not hasattr(os, "posix_fallocate"):
            return
        descriptor = self.file.id.get_vfd_handle()
        try:
            with suppress(OSError):
                os.posix_fallocate(descriptor, 0, end + EXTENT)
                self._reserved = end + EXTENT
                return
            os.posix_fallocate(descriptor, 0, end)
            self._reserved = end
        except OSError as error:
            raise DiskError(
                f"cannot be written: {error.strerror}", hint="free some space on the disk, or choose another place"
            ) from error

    def close(self) -> None:
        """Close the file, give back the space that it did not need, and have the disk confirm what was written.

        Raises:
            OSError, RuntimeError: the disk refuses it; `abandon` the file then.
        """
        if not self.file.id.valid:
            return
        self.file.close()
        with self._path.open("r+b") as file:
            file.truncate(int.from_bytes(file.read(_END_OF_FILE.stop)[_END_OF_FILE], "little"))
            os.fsync(file.fileno())

    def abandon(self) -> None:
        """Close a file that cannot be written any more, as on a disk that fails; flushed data remain.

        HDF5 keeps a file open whose close failed, tries again at the interpreter's exit and crashes there (seen with
        HDF5 2.0). So what it still wants to write goes nowhere.
        """
        # The null device takes every byte, but refuses to be given a length, as a close may want. Memory takes a
        # length, but is bound by a file size limit. What one refused is not tried with the next.
        for make_sink in (_null_device, _memory_file, _null_device):
            if not self.file.id.valid:
                return
            nowhere = make_sink()
            try:
                os.dup2(nowhere, self.file.id.get_vfd_handle())
            finally:
                os.close(nowhere)
            with suppress(OSError, RuntimeError):
                self.file.close()


def _null_device() -> int:
    return os.open(os.devnull, os.O_RDWR)


def _memory_file() -> int:
    return os.memfd_create("abandoned") if hasattr(os, "memfd_create") else _null_device()
