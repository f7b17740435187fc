"""A minute and more of samples through the recorder, against plain h5py and an MCAP file."""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np

from benchmarks.agreement import check
from daq.recording.recorder import Recorder
from daq.recording.recording import JOINTS_STREAM
from daq.robot.loader import load_robot
from drivers.core.arrays import FloatArray
from drivers.streams import Batch, ChannelLayout, StreamLayout

ROWS, DOUBLES = 60_000, 32
RATE = 500.0
BATCH = 5
"""Samples that a driver hands over at once, 10 ms of them."""
CHUNK = 250

COMPARED = """\
recorder_rows_vs_plain_h5py, recorder_cpu_vs_plain_h5py: 60,000 rows of 32 doubles in batches of 5, as they come from
  the wire, until the file is closed; wall time, and processor time of all threads. Peer: one dataset (N, 32), resized
  and appended to at every batch, no flush. Ours: the recorder with 7 datasets, SWMR and a flush every 250 rows.
recorder_rows_vs_batched_h5py, recorder_cpu_vs_batched_h5py: the same against a peer that gathers 250 rows before it
  appends them, as the recorder does; what is left is the price of seven datasets, the thread, SWMR and the flushes.
recorder_rows_vs_mcap: the same rows, wall time; peer: package mcap, a message a row, not compressed."""


def run(rounds: int = 5) -> dict[str, float]:
    """Peers' time over ours, all sides once a round.

    Raises:
        DisagreementError: a file holds something else than what was written.
    """
    rows = np.random.default_rng(1).standard_normal((ROWS, DOUBLES))
    rows[:, 0] = np.arange(ROWS) / RATE
    sides = {"ours": _ours, "h5py": _plain_h5py, "batched": _batched_h5py, "mcap": _mcap}
    wall: dict[str, list[float]] = {name: [] for name in sides}
    processor: dict[str, list[float]] = {name: [] for name in sides}
    with tempfile.TemporaryDirectory() as folder:
        for turn in range(rounds + 1):
            for name, write in sides.items():
                path = Path(folder) / f"{name}{turn}"
                since, used = time.perf_counter(), time.process_time()
                write(path, rows)
                if turn > 0:
                    wall[name].append(time.perf_counter() - since)
                    processor[name].append(time.process_time() - used)
                elif name != "mcap":
                    check(f"rows written by {name}", _read(path), rows, 0.0)
                else:
                    check("rows written by mcap", _read_mcap(path), rows, 0.0)
                path.unlink()
    typical: Callable[[list[float]], float] = statistics.median
    return {
        "recorder_rows_per_second": ROWS / typical(wall["ours"]),
        "recorder_rows_vs_plain_h5py": typical(wall["h5py"]) / typical(wall["ours"]),
        "recorder_cpu_vs_plain_h5py": typical(processor["h5py"]) / typical(processor["ours"]),
        "recorder_rows_vs_batched_h5py": typical(wall["batched"]) / typical(wall["ours"]),
        "recorder_cpu_vs_batched_h5py": typical(processor["batched"]) / typical(processor["ours"]),
        "recorder_rows_vs_mcap": typical(wall["mcap"]) / typical(wall["ours"]),
    }


def _layout() -> StreamLayout:
    names = tuple(f"joint_{number}" for number in range(1, 7))
    channels = [ChannelLayout(f"quantity_{number}", names, "1", "") for number in range(5)]
    return StreamLayout(JOINTS_STREAM, tuple(channels), RATE)


def _ours(path: Path, rows: FloatArray) -> None:
    layout = _layout()
    recorder = Recorder(path, load_robot("ur5e"), (layout,))
    for first in range(0, ROWS, BATCH):
        batch = rows[first : first + BATCH]
        values = {channel.quantity: batch[:, 2 + 6 * i : 8 + 6 * i] for i, channel in enumerate(layout.channels)}
        recorder.put(Batch(JOINTS_STREAM, batch[:, 0], batch[:, 1], values))
    recorder.close(complete=True)


def _plain_h5py(path: Path, rows: FloatArray) -> None:
    _append(path, rows, BATCH)


def _batched_h5py(path: Path, rows: FloatArray) -> None:
    _append(path, rows, CHUNK)


def _append(path: Path, rows: FloatArray, batch: int) -> None:
    with h5py.File(path, "w", libver="latest") as file:
        dataset = file.create_dataset(
            "rows", (0, DOUBLES), np.float64, maxshape=(None, DOUBLES), chunks=(CHUNK, DOUBLES)
        )
        for first in range(0, ROWS, batch):
            dataset.resize(first + batch, axis=0)
            dataset[first:] = rows[first : first + batch]


def _mcap(path: Path, rows: FloatArray) -> None:
    from mcap.writer import CompressionType, Writer

    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start()
        channel = writer.register_channel("joints", "doubles", writer.register_schema("row", "", b""))
        for number in range(ROWS):
            stamp = round(rows[number, 0] * 1e9)
            writer.add_message(channel, stamp, rows[number].tobytes(), stamp, number)
        writer.finish()


def _read(path: Path) -> FloatArray:
    with h5py.File(path) as file:
        if "rows" in file:
            return np.asarray(file["rows"])
        group = file[f"streams/{JOINTS_STREAM}"]
        columns = [group[name][:] for name in ("time", "host_time", *(c.quantity for c in _layout().channels))]
    return np.column_stack(columns)


def _read_mcap(path: Path) -> FloatArray:
    from mcap.reader import make_reader

    with path.open("rb") as stream:
        return np.array([np.frombuffer(message.data) for _, _, message in make_reader(stream).iter_messages()])
