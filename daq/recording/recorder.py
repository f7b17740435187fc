"""The recorder: a thread that writes batches to the file while they arrive.

The file is followed while it grows (HDF5 SWMR) and survives the death of the process: whole chunks of half a second
are written and flushed at once; `dynid recover` rescues them.
"""

from __future__ import annotations

import shutil
from collections import deque
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from daq.recording.recording import Level
from daq.recording.writer import CHUNK_SECONDS, RecordingWriter, chunk_rows
from daq.robot.loader import RobotFile
from drivers.clock import SYSTEM_CLOCK, Clock
from drivers.errors import DiskError, RecordingError
from drivers.streams import Batch, StreamLayout

MEMORY_LIMIT = 64 * 2**20
"""Bytes of samples that may wait for the disk before batches are dropped, and counted."""
RESERVE = 16 * 2**20
"""Bytes of free disk space [B] at which a recording is ended: on a full disk HDF5 cannot close a file."""
_WAIT = 0.1


def require_room(path: Path) -> None:
    """Check that there is room for more samples in a recording's folder.

    Raises:
        DiskError: less than `RESERVE` is free.
    """
    free = shutil.disk_usage(path.parent).free
    if free < RESERVE:
        raise DiskError(
            f"the disk is full: {free / 2**20:.0f} MiB are free", where=str(path), hint="make room on the disk"
        )


class Recorder:
    """Writes the acquisition's batches to disk without ever making it wait.

    Args:
        path: of the new recording.
        robot: its robot file.
        layouts: of all streams.
        trajectory: text of the trajectory that is played.
        speed_scale: at which share of its speed.
        comment: the user's words.
        overwrite: an existing file.
        memory_limit: of waiting samples [B].
        clock: the host's.

    Raises:
        UsageError: the file exists already, is no regular file, or its folder cannot be written.
        RecordingError: it cannot be created.
    """

    def __init__(
        self,
        path: Path,
        robot: RobotFile,
        layouts: Sequence[StreamLayout],
        *,
        trajectory: str = "",
        speed_scale: float = 1.0,
        comment: str = "",
        overwrite: bool = False,
        memory_limit: int = MEMORY_LIMIT,
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        self.path = path
        self.overflow = 0
        """Samples that were dropped because the disk did not keep up."""
        self._writer = RecordingWriter(
            path,
            robot,
            layouts,
            trajectory=trajectory,
            speed_scale=speed_scale,
            comment=comment,
            overwrite=overwrite,
        )
        self._writer.allow_readers()
        self._rows = {layout.name: chunk_rows(layout.rate) for layout in layouts}
        self._pending: dict[str, list[Batch]] = {layout.name: [] for layout in layouts}
        self._since = dict.fromkeys(self._pending, 0.0)
        self._queue: deque[Batch | tuple[float, Level, str, str]] = deque()
        self._memory_limit = memory_limit
        self._waiting = 0
        self._clock = clock
        self._changed = clock.condition()
        self._closing = False
        self._failure: DiskError | None = None
        self._broken = False
        self._thread = clock.thread(self._run, f"recorder {path.name}")
        self._thread.start()

    @property
    def backlog(self) -> int:
        """Bytes of samples that wait for the disk, up to half a second of them for a whole chunk."""
        return self._waiting

    @property
    def failure(self) -> DiskError | None:
        """Why nothing can be written any more; None while all is well."""
        return self._failure

    def put(self, batch: Batch) -> None:
        """Hand over a batch; dropped and counted when the queue is full."""
        size = _size(batch)
        with self._changed:
            if self._failure is not None:
                return
            if self._waiting + size > self._memory_limit:
                if self.overflow == 0:
                    when = float(batch.time[0]) if len(batch.time) else float("nan")
                    self._queue.append((when, "error", "recorder", "the disk does not keep up: samples are dropped"))
                self.overflow += len(batch.time)
                return
            self._waiting += size
            self._queue.append(batch)
            self._changed.notify()

    def event(self, time: float, level: Level, source: str, message: str) -> None:
        """Hand over an event; `time` [s] in the clock of the stream that it concerns."""
        with self._changed:
            self._queue.append((time, level, source, message))
            self._changed.notify()

    def close(self, *, complete: bool) -> None:
        """Write what is queued and close the file; safe to call twice.

        Raises:
            DiskError: it could not be written completely; flushed data are kept.
        """
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join()
        if self._broken:
            self._writer.abandon()
        try:
            if self.overflow and self._failure is None:
                self._writer.event(
                    float("nan"), "error", "recorder", f"{self.overflow} samples dropped: the disk did not keep up"
                )
            self._writer.close(complete=complete and not self.overflow and self._failure is None)
        except RecordingError as error:
            self._writer.abandon()
            self._failure = self._failure or _disk_error(error, self.path)
        if self._failure is not None:
            raise self._failure

    def _run(self) -> None:
        try:
            while True:
                with self._changed:
                    if not self._queue and not self._closing:
                        self._changed.wait(_WAIT)
                    items = list(self._queue)
                    self._queue.clear()
                    closing = self._closing
                for item in items:
                    self._take(item)
                self._write(everything=closing)
                if closing:
                    return
        except RecordingError as error:
            self._fail(_disk_error(error, self.path), broken=True)
        except DiskError as error:
            self._fail(error, broken=False)

    def _fail(self, error: DiskError, *, broken: bool) -> None:
        with self._changed:
            self._failure = error
            self._broken = broken
            self._queue.clear()
        if broken:  # left alone until `close`, when the arm stands: what HDF5 does next is not for this moment
            return
        try:  # there is still some room: say why it ends here
            self._writer.event(float("nan"), "error", "recorder", error.message)
            self._writer.flush()
        except RecordingError:
            self._broken = True

    def _take(self, item: Batch | tuple[float, Level, str, str]) -> None:
        if isinstance(item, Batch):
            if not self._pending[item.stream]:
                self._since[item.stream] = self._clock.now()
            self._pending[item.stream].append(item)
        else:
            self._writer.event(*item)
            self._writer.flush()

    def _write(self, *, everything: bool) -> None:
        """Whole chunks; the remainder only at the end, or where a source is much slower than its nominal rate."""
        wrote = False
        for stream, batches in self._pending.items():
            waiting = sum(len(batch.time) for batch in batches)
            whole = waiting - waiting % self._rows[stream]
            late = bool(batches) and self._clock.now() - self._since[stream] > 2.0 * CHUNK_SECONDS
            count = waiting if everything or late else whole
            if count == 0:
                continue
            require_room(self.path)
            joined = _join(batches)
            self._writer.append(
                stream,
                joined.time[:count],
                joined.host_time[:count],
                {name: values[:count] for name, values in joined.values.items()},
            )
            rest = Batch(
                stream,
                joined.time[count:],
                joined.host_time[count:],
                {name: values[count:] for name, values in joined.values.items()},
            )
            self._pending[stream] = [rest] if len(rest.time) else []
            self._since[stream] = self._clock.now()
            with self._changed:
                self._waiting -= _size(joined) - _size(rest)
            wrote = True
        if wrote:
            self._writer.flush()


def _join(batches: Sequence[Batch]) -> Batch:
    if len(batches) == 1:
        return batches[0]
    return Batch(
        batches[0].stream,
        np.concatenate([batch.time for batch in batches]),
        np.concatenate([batch.host_time for batch in batches]),
        {name: np.concatenate([batch.values[name] for batch in batches]) for name in batches[0].values},
    )


def _size(batch: Batch) -> int:
    return batch.time.nbytes + batch.host_time.nbytes + sum(values.nbytes for values in batch.values.values())


def _disk_error(error: RecordingError, path: Path) -> DiskError:
    return DiskError(error.message, where=str(path), hint=f"rescue what was written: dynid recover {path}")
