"""Rows of samples in memory that two processes share: a ring that its writer never waits for."""

from __future__ import annotations

from dataclasses import dataclass
from multiprocessing.shared_memory import SharedMemory
from typing import Self

import numpy as np
import numpy.typing as npt

from drivers.core.arrays import FloatArray

HEADER = 64
"""Bytes before the rows: the count of rows written so far, and room, so that it has a cache line of its own."""


@dataclass(frozen=True)
class RowsHandle:
    """What another process needs to read the rows."""

    name: str  # of the shared memory
    channels: tuple[str, ...]  # names of the columns
    capacity: int  # rows of the ring


class SharedRows:
    """A ring of rows: one process appends, others read what is new; `create` makes one, `attach` opens it elsewhere.

    Row k lies at place k modulo the capacity, and is counted when it is whole. A reader takes the rows that it has
    not had, looks at the count again, and drops those that may have been overwritten meanwhile: nobody waits.
    """

    def __init__(self, memory: SharedMemory, handle: RowsHandle, *, owner: bool) -> None:
        self.handle = handle
        self._memory, self._owner = memory, owner
        shape = (handle.capacity, 1 + len(handle.channels))
        self._count: npt.NDArray[np.uint64] = np.ndarray(1, np.uint64, memory.buf)
        self._rows: FloatArray = np.ndarray(shape, np.float64, memory.buf, HEADER)

    @classmethod
    def create(cls, channels: tuple[str, ...], capacity: int) -> Self:
        """An empty ring of this many rows; whoever made it closes it last."""
        memory = SharedMemory(create=True, size=HEADER + 8 * capacity * (1 + len(channels)))
        return cls(memory, RowsHandle(memory.name, channels, capacity), owner=True)

    @classmethod
    def attach(cls, handle: RowsHandle) -> Self:
        """The ring of another process, to be read."""
        return cls(SharedMemory(handle.name), handle, owner=False)

    def append(self, time: float, row: npt.NDArray[np.float64]) -> None:
        """Add a row (C,) at a time [s]; the oldest one gives way."""
        count = int(self._count[0])
        place = self._rows[count % self.handle.capacity]
        place[0] = time
        place[1:] = row
        self._count[0] = count + 1

    def read(self, after: int) -> tuple[FloatArray, int]:
        """Rows (N, 1 + C), time first, behind the first `after`, and the count with which to read on."""
        capacity = self.handle.capacity
        count = int(self._count[0])
        first = max(after, count - capacity + 1)
        rows = self._rows[np.arange(first, count) % capacity]
        overwritten = int(self._count[0]) - capacity + 1 - first
        return rows[max(overwritten, 0) :], count

    def close(self) -> None:
        """Let go of the memory; its maker removes it."""
        del self._count, self._rows
        self._memory.close()
        if self._owner:
            self._memory.unlink()
