"""What does a session cost per sample? `python -m studies.monitor.cost [SECONDS]`.

Plays samples of a simulated UR5e at 500 Hz into a session, in the batches of the RTDE driver, in its own time and as
fast as they go: recorder, supervisor, clocks, terminal's status; then the watch for contacts and the rows of its page.
Prints processor time per 1000 samples, all threads together. What the bus costs is not in it, nor the processes that
draw; and memory caches are warm: a session in real time takes more. A busy computer adds to processor time, too.
About 25 s of it.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import cast

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from daq.live.page import CAPACITY
from daq.live.shared_rows import SharedRows
from daq.live.terminal_view import Publisher
from daq.recording.recorder import Recorder
from daq.session.session import record
from daq.session.supervisor import Limits, Supervisor
from drivers.base import Driver, Notice
from drivers.core.clock import Clock
from drivers.rtde.receiver import UNMOVED
from drivers.streams import Batch, ChannelLayout, StreamLayout
from ident.monitor.live import LiveMonitor, page_channels
from ident.monitor.monitor import earned_thresholds
from studies.monitor import contacts
from studies.monitor.contacts import RATE, ROBOT, run

NAMES = ROBOT.robot.joint_names
FULL = ("position", "velocity", "current", "torque", "target_position", "target_velocity")
STREAMS = {"joints": (FULL, RATE), "thermal": (("temperature",), 20.0)}
LAYOUTS = tuple(
    StreamLayout(name, tuple(ChannelLayout(quantity, NAMES) for quantity in quantities), rate)
    for name, (quantities, rate) in STREAMS.items()
)


class FedClock(Clock):
    """The time of the samples that were read last; threads wait in real time."""

    moment = 0.0

    def now(self) -> float:
        """The newest sample's time [s]."""
        return self.moment


class FedDriver:
    """Delivers prepared batches, one set at each read."""

    def __init__(self, cycles: Sequence[Sequence[Batch]], clock: FedClock) -> None:
        self._cycles, self._clock = iter(cycles), clock

    def read(self, timeout: float) -> Sequence[Batch]:
        """The next batches."""
        batches = next(self._cycles)
        self._clock.moment = float(batches[0].host_time[-1])
        return batches

    def start(self) -> None:
        """Nothing to be started."""

    def stop(self) -> None:
        """Nothing to be stopped."""

    def notices(self) -> Sequence[Notice]:
        """None."""
        return ()


def cycles_of(seconds: float) -> list[list[Batch]]:
    """The batches of each read, of an arm in motion."""
    samples = run(100, seconds + 1.0)
    gain = np.array([ROBOT.robot.drive(name).gain for name in NAMES], dtype=np.float64)
    velocity = np.gradient(samples.position, samples.time, axis=0)
    values = {
        "position": samples.position, "velocity": velocity, "current": samples.torque / gain,
        "torque": samples.torque, "target_position": samples.position, "target_velocity": velocity,
    }  # fmt: skip
    celsius = np.full_like(samples.position, 25.0) if samples.celsius is None else samples.celsius
    edges = np.arange(0, round(seconds * RATE), round(UNMOVED * RATE)).tolist()
    cycles = []
    for begin, end in pairwise(edges):
        at = slice(begin, end)
        stamps = samples.time[at]
        batches = [Batch("joints", stamps, stamps, {name: rows[at] for name, rows in values.items()})]
        due = np.flatnonzero(np.arange(begin, end) % round(RATE / STREAMS["thermal"][1]) == 0) + begin
        if len(due):
            batches.append(Batch("thermal", samples.time[due], samples.time[due], {"temperature": celsius[due]}))
        cycles.append(batches)
    return cycles


def spent(cycles: Sequence[Sequence[Batch]], watch: LiveMonitor | None, folder: Path) -> float:
    """Processor time [s] of a session that is fed with them."""
    clock = FedClock()
    clock.moment = float(cycles[0][0].host_time[0])
    limits = Limits.of_robot(ROBOT.robot)
    recorder = Recorder(folder / "run.h5", ROBOT, LAYOUTS, overwrite=True)
    if watch is not None:
        watch.begin(LAYOUTS)
    reader, writer = os.pipe()
    duration = float(cycles[-1][0].host_time[-1]) - clock.moment - 1e-6
    view = Publisher(writer, limits, recorder, clock, watch)
    begun = time.process_time()
    driver = cast(Driver, FedDriver(cycles, clock))  # a session without a motion asks it for no more
    report = record(
        driver, recorder, Supervisor(limits, LAYOUTS), duration=duration, view=view, clock=clock, watch=watch
    )
    used = time.process_time() - begun
    os.close(reader)
    os.close(writer)
    if report.error is not None or (watch is not None and watch.failure):
        raise SystemExit(str(report.error or (watch and watch.failure)))
    return used


def main() -> None:
    """Print the table."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 40.0
    quiet = [(str(seed), run(seed)) for seed in (1, 2)]
    model = contacts.MODEL[0]
    thresholds = earned_thresholds(model, quiet, kind="direct")
    cycles = cycles_of(seconds)
    print("| session | processor time per 1000 samples [ms] | share of a core at 500 Hz [%] |\n|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for name in ("recorded", "watched", "watched, with a page"):
            watch = LiveMonitor(model, thresholds) if name != "recorded" else None
            rows = SharedRows.create(page_channels(model), CAPACITY)
            if watch is not None and "page" in name:
                watch.page = rows
            each = spent(cycles, watch, Path(folder)) / (seconds * RATE)
            rows.close()
            print(f"| {name} | {1e6 * each:.0f} | {100 * each * RATE:.1f} |", flush=True)


if __name__ == "__main__":
    main()
