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

from daq.recording.growing_file import SPARE
from daq.recording.hdf5_bounds import MOST_ROWS, MOST_TEXT, text_length
from daq.recording.recording import Level
from daq.recording.writer import CHUNK_SECONDS, RecordingWriter, chunk_rows
from daq.robot.loader import RobotFile
from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.errors import DiskError, RecordingError
from drivers.streams import Batch, StreamLayout

MEMORY_LIMIT = 64 * 2**20
"""Bytes of samples that may wait for the disk before batches are dropped, and counted."""
RESERVE = 16 * 2**20
"""Free disk space [B] at which a recording is ended: other programs need the disk, too."""
MOST_EVENTS = MOST_ROWS - 1000
"""Events at which a recording is ended; the rest of what is read of one is for its end."""
_WAIT = 0.1


def require_room(path: Path) -> None:
    """Check that there is room for more samples in a recording's folder.

    Raises:
        DiskError: less than `RESERVE` is free.
    """
    free = shutil.disk_usage(path.parent).free
    if free < RESERVE:
        raise DiskError(
            f"the disk is full: {free / 2**20:.0f} MiB are free", where=str(path), hint="free some space on the disk"
        )


class Recorder:
    """Writes the acquisition's batches to disk without ever making it wait.

    The recording takes its place when it is closed; until then it grows beside it, under the name `file`. What had that
    place before stays until then, and stays altogether where the disk refused to write.

    The text of the trajectory that is played goes into it, with the share of its speed. Samples that wait take
    `memory_limit` [B] at most.

    Raises:
        UsageError: the file exists already, is no regular file, or its folder cannot be written.
        RecordingError: it cannot be created.
        DiskError: the disk is full or fails.
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
            path, robot, layouts, trajectory=trajectory, speed_scale=speed_scale, comment=comment, overwrite=overwrite
        )
        self._writer.allow_readers()
        self.file = self._writer.unfinished
        """Where the recording is by now; it is its path once it was closed in order."""
        self._overwrite = overwrite
        self._events = self._text = 0
        self._chunk_rows = {layout.name: chunk_rows(layout.rate) for layout in layouts}
        self._pending: dict[str, list[Batch]] = {layout.name: [] for layout in layouts}
        self._rows = dict.fromkeys(self._pending, 0)
        self._begun = dict.fromkeys(self._pending, 0)  # rows handed over of each stream's next chunk
        self._since = dict.fromkeys(self._pending, 0.0)
        self._queue: deque[Batch | tuple[float, Level, str, str]] = deque()
        self._memory_limit = memory_limit
        self.backlog = 0
        """Bytes of samples that wait for the disk, up to half a second of them for a whole chunk."""
        self._clock = clock
        self._changed = clock.condition()
        self._closing = False
        self.failure: DiskError | None = None
        """Why nothing can be written any more; None while all is well."""
        self._broken = False
        self._thread = clock.thread(self._run, f"recorder {path.name}")
        self._thread.start()

    def put(self, batch: Batch) -> None:
        """Hand over a batch; dropped and counted when the queue is full."""
        size = _size(batch)
        with self._changed:
            if self.failure is not None:
                return
            if self.backlog + size > self._memory_limit:
                if self.overflow == 0:
                    when = float(batch.time[0]) if len(batch.time) else float("nan")
                    self._queue.append((when, "error", "recorder", "the disk does not keep up: samples are dropped"))
                self.overflow += len(batch.time)
                return
            self.backlog += size
            self._queue.append(batch)
            self._begun[batch.stream] += len(batch.time)
            if self._begun[batch.stream] >= self._chunk_rows[batch.stream]:  # to wake the thread for each costs more
                self._begun[batch.stream] %= self._chunk_rows[batch.stream]
                self._changed.notify()

    def event(self, time: float, level: Level, source: str, message: str) -> None:
        """Hand over an event; `time` [s] in the clock of the stream that it concerns."""
        with self._changed:
            self._queue.append((time, level, source, message))
            self._changed.notify()

    def close(self, *, complete: bool) -> None:
        """Write what is queued, close the file and give it its name; safe to call twice.

        Raises:
            DiskError: it could not be written completely, or not be given its name; `file` has what was written.
        """
        self._end_thread()
        if self._broken:
            self._writer.abandon()
        elif self.file != self.path:
            try:
                if self.overflow and self.failure is None:
                    self._writer.event(
                        float("nan"), "error", "recorder", f"{self.overflow} samples dropped: the disk did not keep up"
                    )
                self._writer.finish(complete=complete and not self.overflow and self.failure is None)
                # An older recording is not given up for one that the disk cut short.
                self._writer.take_place(overwrite=self._overwrite and self.failure is None)
                self.file = self.path
            except RecordingError as error:
                self.failure = self.failure or self._disk_error(error)
            except DiskError as error:
                self.failure = self.failure or error
        if self.failure is not None:
            raise self.failure

    def discard(self) -> None:
        """Close the file and remove it; what had its place stays."""
        self._end_thread()
        self._writer.discard()

    def _end_thread(self) -> None:
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join()

    def _run(self) -> None:
        try:
            while True:
                with self._changed:
                    if not self._queue and not self._closing:
                        self._changed.wait(_WAIT)
                    items = list(self._queue)
                    self._queue.clear()
                    closing = self._closing
                for item in items:  # samples first: they are kept where there is no space for an event
                    if isinstance(item, Batch):
                        self._hold(item)
                for item in items:
                    if not isinstance(item, Batch):
                        self._write_event(*item)
                self._write(everything=closing)
                if closing:
                    return
        except RecordingError as error:
            self._fail(self._disk_error(error), broken=True)
        except DiskError as error:
            self._fail(error, broken=False)

    def _fail(self, error: DiskError, *, broken: bool) -> None:
        with self._changed:
            self.failure = error
            self._broken = broken
            self._queue.clear()
        if broken:  # left alone until `close`, when the arm stands: what HDF5 does next is not for this moment
            return
        try:  # the file owns some space still: for what is there already, and why it ends here
            for stream, batches in self._pending.items():
                if batches and self._writer.bytes_of({stream: self._rows[stream]}) < SPARE // 4:
                    self._append(stream, _join(batches))
            self._writer.event(float("nan"), "error", "recorder", error.message)
            self._writer.flush()
        except RecordingError:
            self._broken = True

    def _hold(self, batch: Batch) -> None:
        if not self._pending[batch.stream]:
            self._since[batch.stream] = self._clock.now()
        self._pending[batch.stream].append(batch)
        self._rows[batch.stream] += len(batch.time)

    def _write_event(self, time: float, level: Level, source: str, message: str) -> None:
        size = text_length(level, source, message)
        self._events, self._text = self._events + 1, self._text + size
        if self._events > MOST_EVENTS or self._text > MOST_TEXT // 2:
            raise DiskError(
                f"has {self._events} events, the most that can be read of one recording", where=str(self.path)
            )
        self._writer.reserve({}, texts=size)
        self._writer.event(time, level, source, message)
        self._writer.flush()

    def _write(self, *, everything: bool) -> None:
        """Whole chunks; the remainder only at the end, or where a source is much slower than its nominal rate."""
        counts = {}
        for stream, batches in self._pending.items():
            waiting = self._rows[stream]
            late = bool(batches) and self._clock.now() - self._since[stream] > 2.0 * CHUNK_SECONDS
            count = waiting if everything or late else waiting - waiting % self._chunk_rows[stream]
            if count:
                counts[stream] = count
        if not counts:
            return
        require_room(self.path)
        self._writer.reserve(counts)
        for stream, count in counts.items():
            joined = _join(self._pending[stream])
            rest = _rows_of(joined, slice(count, None))
            self._append(stream, _rows_of(joined, slice(count)))
            self._pending[stream] = [rest] if len(rest.time) else []
            self._rows[stream] = len(rest.time)
            self._since[stream] = self._clock.now()
            with self._changed:
                self.backlog -= _size(joined) - _size(rest)
        self._writer.flush()

    def _append(self, stream: str, batch: Batch) -> None:
        self._writer.append(stream, batch.time, batch.host_time, batch.values)

    def _disk_error(self, error: RecordingError) -> DiskError:
        rescue = f"save what was written: dynid recover {self.file}"
        return DiskError(error.message, where=str(self.path), hint=rescue)


def _rows_of(batch: Batch, rows: slice) -> Batch:
    values = {name: values[rows] for name, values in batch.values.items()}
    return Batch(batch.stream, batch.time[rows], batch.host_time[rows], values)


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
