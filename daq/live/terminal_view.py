"""The live view of a recording: a process of its own draws on stderr what the acquisition writes into a pipe.

The acquisition never waits for it: what does not fit into the pipe is dropped, and a crashed display is ignored. The
display ends with the pipe: when the recording closes it or exits, never because of Ctrl-C, which the
terminal sends to both.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import select
import signal
import sys
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING

import numpy as np

from daq.recording.recording import JOINTS_STREAM
from daq.session.realtime import ordinary_priority
from daq.session.supervisor import Limits
from daq.session.unrecorded import SampleKeeper
from daq.session.watch import Watch
from drivers.core.arrays import FloatArray
from drivers.core.child_process import leave, started_without_interrupt
from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.terminal import styled, visible
from drivers.core.text import percent_text
from drivers.streams import Batch

if TYPE_CHECKING:
    from rich.console import Group

PERIOD = 0.2
"""Between two pictures [s]."""
RATE_PICTURES = 6
"""Pictures over which a rate is averaged: one second."""
MESSAGE_LIMIT = 4096
"""Bytes that Linux writes into a pipe as a whole or not at all."""
SECONDS_BETWEEN_LINES = 5.0
"""Between two lines [s] where standard error is a file or a pipe."""
LEAVE_LIMIT = 2.0
"""Time [s] in which the display must end before it is killed."""


@dataclass(frozen=True)
class StreamStatus:
    """One stream: its rate over the last second [Hz, host clock], samples so far, samples lost so far."""

    name: str
    rate: float
    samples: int
    lost: int


@dataclass(frozen=True)
class Status:
    """One picture of a recording."""

    state: str  # in words
    # elapsed, total: [s]
    elapsed: float
    total: float
    streams: tuple[StreamStatus, ...]  # of the source
    # torque_share, torque_joint: largest share of its limit that a torque has had; None where unknown
    torque_share: float | None
    torque_joint: str
    # temperature, temperature_joint: highest of the latest sample [°C]; None where unknown
    temperature: float | None
    temperature_joint: str
    backlog: int  # samples that wait for the disk [B]
    overflow: int  # samples that were dropped because the disk did not keep up
    lines: tuple[str, ...] = ()  # of who watches the session


class Publisher:
    """Receives the state of a session; never blocks and never raises.

    The pipe is the file descriptor of its writing end, which is made non-blocking. The recorder's backlog and the lines
    of `watch` are shown, too.
    """

    def __init__(
        self, pipe: int, limits: Limits, recorder: SampleKeeper, clock: Clock = SYSTEM_CLOCK, watch: Watch | None = None
    ) -> None:
        os.set_blocking(pipe, False)
        self._pipe = pipe
        self._limits = limits
        self._recorder = recorder
        self._clock = clock
        self._watch = watch
        self._samples: dict[str, int] = {}
        self._lost: dict[str, int] = {}
        self._torque_shares = np.full(len(limits.joints), np.nan)
        self._temperature: tuple[float, str] | None = None
        self._past: deque[tuple[float, Mapping[str, int]]] = deque(maxlen=RATE_PICTURES)
        self._sent = -np.inf
        self._gone = False

    def add(self, batch: Batch) -> None:
        """Note a batch."""
        with suppress(Exception):  # a display must not stop an arm
            self._samples[batch.stream] = self._samples.get(batch.stream, 0) + len(batch.time)
            self._lost[batch.stream] = self._lost.get(batch.stream, 0) + batch.lost
            if batch.stream == JOINTS_STREAM and len(batch.time):
                self._add_joints(batch.values)

    def show(self, state: str, elapsed: float, total: float) -> None:
        """Send a picture, at most one per period; `elapsed` of `total` [s]."""
        now = self._clock.now()
        if now - self._sent < PERIOD:
            return
        self._sent = now
        with suppress(Exception):  # the pipe is full
            message = json.dumps(asdict(self.status(state, elapsed, total, now))).encode() + b"\n"
            if len(message) <= MESSAGE_LIMIT:
                self._write(message)

    def _write(self, message: bytes) -> None:
        if self._gone:
            return
        try:
            os.write(self._pipe, message)
        except BrokenPipeError:
            self._gone = True
            self._recorder.event(np.nan, "info", "live view", "the display ended; the recording goes on without it")

    def status(self, state: str, elapsed: float, total: float, now: float) -> Status:
        """The picture at `now` [s, host clock]."""
        self._past.append((now, dict(self._samples)))
        before, counts = self._past[0]
        passed = now - before
        streams = tuple(
            StreamStatus(name, (count - counts.get(name, 0)) / passed if passed > 0 else 0.0, count, self._lost[name])
            for name, count in self._samples.items()
        )
        share, torque_joint = _largest(self._torque_shares, self._limits.joints) or (None, "")
        temperature, temperature_joint = self._temperature or (None, "")
        backlog, overflow = self._recorder.backlog, self._recorder.overflow
        return Status(
            state,
            elapsed,
            total,
            streams,
            share,
            torque_joint,
            temperature,
            temperature_joint,
            backlog,
            overflow,
            () if self._watch is None else tuple(self._watch.lines()),
        )

    def _add_joints(self, values: Mapping[str, FloatArray]) -> None:
        limits = self._limits
        torque, joints = values.get("torque"), np.arange(len(limits.joints))
        if torque is None and "current" in values:
            torque, joints = limits.torque_of_current(values["current"], joints)
        if torque is not None:
            limit = limits.torque[joints]
            shares = np.where(np.isinf(limit), np.nan, np.abs(torque).max(axis=0) / limit)
            self._torque_shares[joints] = np.fmax(self._torque_shares[joints], shares)
        if "temperature" in values:
            self._temperature = _largest(values["temperature"][-1], limits.joints)


def _largest(values: FloatArray, joints: tuple[str, ...]) -> tuple[float, str] | None:
    if not np.isfinite(values).any():
        return None
    joint = int(np.argmax(np.where(np.isfinite(values), values, -np.inf)))
    return float(values[joint]), joints[joint]


@contextmanager
def live_view(
    *, shown: bool, limits: Limits, recorder: SampleKeeper, clock: Clock = SYSTEM_CLOCK, watch: Watch | None = None
) -> Iterator[Publisher | None]:
    """A display in its own process and the pipe to it; None where nothing is to be shown."""
    if not shown:
        yield None
        return
    context = multiprocessing.get_context("spawn")
    reader, writer = context.Pipe(duplex=False)
    process = context.Process(target=draw, args=(reader,), name="dynid live view", daemon=True)
    try:
        with ordinary_priority(), started_without_interrupt():
            process.start()
        started = True
    except OSError:  # no room for another process: a recording goes on without a display
        started = False
    reader.close()
    try:
        yield Publisher(writer.fileno(), limits, recorder, clock, watch) if started else None
    finally:
        writer.close()
        if started:
            leave(process, LEAVE_LIMIT)


def draw(reader: Connection) -> None:
    """Draw on stderr every picture that arrives, until the pipe ends; the display's process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    from rich.console import Console
    from rich.live import Live

    pictures = _pictures(reader.fileno())
    console = Console(file=styled(sys.stderr))
    if not console.is_terminal:
        _print_lines(pictures)
        return
    if (first := next(pictures, None)) is None:
        return
    # Only now: before the first picture a person may be asked on the same terminal.
    with Live(picture(first), console=console, auto_refresh=False) as live:
        for status in pictures:
            live.update(picture(status), refresh=True)


def _print_lines(pictures: Iterator[Status]) -> None:
    """Print to a file or a pipe: a line for each state that lasts, and every few seconds."""
    state, said = "", 0.0
    for status in pictures:
        if status.state != state:
            state, said = status.state, status.elapsed
        if status.elapsed - said < SECONDS_BETWEEN_LINES:
            continue
        said = status.elapsed
        of = f" of {status.total:.0f}" if status.total else ""
        streams = ", ".join(f"{visible(s.name)} {s.samples} samples, {s.lost} lost" for s in status.streams)
        with suppress(OSError):  # no reader is left
            print(f"{visible(state)}: {status.elapsed:.0f}{of} s; {streams}", file=sys.stderr, flush=True)


def _pictures(pipe: int) -> Iterator[Status]:
    """The newest picture whenever something has arrived, until the pipe ends."""
    rest = b""
    while True:
        select.select([pipe], [], [])  # the display's own process has nothing else to wait for
        received = os.read(pipe, 16 * MESSAGE_LIMIT)
        if not received:
            return
        *lines, rest = (rest + received).split(b"\n")
        if lines:
            content = json.loads(lines[-1])
            streams = tuple(StreamStatus(**stream) for stream in content.pop("streams"))
            yield Status(streams=streams, lines=tuple(content.pop("lines")), **content)


def picture(status: Status) -> Group:
    """A status as lines of text and a bar."""
    from rich.console import Group
    from rich.progress_bar import ProgressBar
    from rich.table import Table
    from rich.text import Text

    head = Table.grid(padding=(0, 1))
    bar = ProgressBar(total=max(status.total, 1e-9), completed=min(status.elapsed, status.total), width=30)
    of = f" of {status.total:.1f}" if status.total else ""
    head.add_row(Text(visible(status.state)), bar, Text(f"{status.elapsed:.1f}{of} s; Ctrl-C stops"))
    streams = [
        Text(f"{visible(s.name)}: {s.rate:.1f} Hz, {s.samples} samples, {s.lost} lost", style="red" if s.lost else "")
        for s in status.streams
    ]
    arm = []
    if status.torque_share is not None:
        arm.append(f"largest torque so far {percent_text(status.torque_share, 2)} of its limit ({status.torque_joint})")
    if status.temperature is not None:
        arm.append(f"hottest {status.temperature:.1f} °C ({status.temperature_joint})")
    disk = f"waiting for the disk {status.backlog / 2**10:.0f} KiB, dropped {status.overflow} samples"
    lines = [Text(visible("; ".join(arm)))] if arm else []
    lines += [Text(visible(line)) for line in status.lines]
    return Group(head, *streams, *lines, Text(disk, style="red" if status.overflow else ""))
