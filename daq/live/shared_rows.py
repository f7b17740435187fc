"""Rows of samples in memory that two processes share: a ring that its writer never waits for."""

from __future__ import annotations

from dataclasses import dataclass
from multiprocessing.shared_memory import SharedMemory
from typing import Self

import numpy as np
import numpy.typing as npt

from drivers.core.arrays import FloatArray

HEADER = 64
"""Bytes before the rows: two counts, and room, so that they have a cache line of their own."""


@dataclass(frozen=True)
class RowsHandle:
    """What another process needs to read the rows."""

    name: str  # of the shared memory
    channels: tuple[str, ...]  # names of the columns
    capacity: int  # rows of the ring


class SharedRows:
    """A ring of rows: one process appends, others read what is new; `create` makes one, `attach` opens it elsewhere.

    Row k lies at place k modulo the capacity. One count is of the rows that are whole, the other of those that are
    written or being written. A reader takes the whole rows that it has not had, looks at the second count, and drops
    those that may have been overwritten meanwhile: neither side waits.
    """

    def __init__(self, memory: SharedMemory, handle: RowsHandle, *, owner: bool) -> None:
        self.handle = handle
        self._memory, self._owner = memory, owner
        shape = (handle.capacity, 1 + len(handle.channels))
        self._counts: npt.NDArray[np.uint64] = np.ndarray(2, np.uint64, memory.buf)
        self._rows: FloatArray = np.ndarray(shape, np.float64, memory.buf, HEADER)

    @classmethod
    def create(cls, channels: tuple[str, ...], capacity: int) -> Self:
        """An empty ring of this many rows; the process that created it closes it last."""
        memory = SharedMemory(create=True, size=HEADER + 8 * capacity * (1 + len(channels)))
        return cls(memory, RowsHandle(memory.name, channels, capacity), owner=True)

    @classmethod
    def attach(cls, handle: RowsHandle) -> Self:
        """The ring of another process, to be read."""
        return cls(SharedMemory(handle.name), handle, owner=False)

    def append(self, time: FloatArray, rows: FloatArray) -> None:
        """Add rows (N, C) at times (N,) [s]; the oldest ones give way."""
        count = int(self._counts[0]) + len(time)
        self._counts[1] = count
        kept = min(len(time), self.handle.capacity)
        places = np.arange(count - kept, count) % self.handle.capacity
        self._rows[places, 0] = time[len(time) - kept :]
        self._rows[places, 1:] = rows[len(time) - kept :]
        self._counts[0] = count

    def read(self, after: int) -> tuple[FloatArray, int]:
        """Rows (N, 1 + C), time first, behind the first `after`, and the count with which to read on."""
        capacity = self.handle.capacity
        count = int(self._counts[0])
        first = max(after, count - capacity)
        rows = self._rows[np.arange(first, count) % capacity]
        overwritten = int(self._counts[1]) - capacity - first
        return rows[max(overwritten, 0) :], count

    def close(self) -> None:
        """Let go of the memory; its maker removes it."""
        del self._counts, self._rows
        self._memory.close()
        if self._owner:
            self._memory.unlink()
