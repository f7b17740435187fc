"""The live page of a session in a browser: samples go into shared memory, and a process of its own serves them.

The acquisition never waits for it: a row is a few hundred bytes written into memory, an alarm a line into a pipe that
does not block, and a server that crashed or stands still is not noticed.
"""

from __future__ import annotations

import json
import math
import multiprocessing
import os
import secrets
import socket
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from importlib.util import find_spec

import numpy as np

from daq.live.shared_rows import SharedRows
from daq.recording.recording import JOINTS_STREAM
from daq.robot.arm_lengths import joint_axes
from daq.robot.loader import RobotFile
from daq.session.course import View
from daq.session.realtime import ordinary_priority
from drivers.core.arrays import FloatArray
from drivers.core.child_process import leave, started_without_interrupt
from drivers.core.errors import UsageError
from drivers.core.text import json_text
from drivers.core.units import joint_unit
from drivers.streams import UNITS, Batch, StreamLayout

CAPACITY = 8192
"""Rows of the ring: 16 s at 500 Hz, which the server reads every 0.05 s."""

LONGEST_LINE = 4096
"""Bytes that a pipe takes as a whole or not at all."""

LEAVE_LIMIT = 3.0
"""[s] in which the server must end before it is killed."""

MODULES = ("starlette", "uvicorn", "websockets")


@dataclass(frozen=True)
class Alarm:
    """What a page lists beside its plots."""

    time: float  # of the session's rows [s]
    text: str  # what happened, in a line
    joint: str = ""  # whose plot is marked; empty for all


class BrowserPage:
    """What a session shows in browsers; neither method waits or raises.

    Attributes:
        address: to be opened in a browser on this computer.
    """

    def __init__(self, rows: SharedRows, pipe: int, address: str) -> None:
        os.set_blocking(pipe, False)
        self._rows, self._pipe = rows, pipe
        self.address = address

    def append(self, time: FloatArray, rows: FloatArray) -> None:
        """Show rows (N, C) of the channels at times (N,) [s]; NaN where there is no value."""
        self._rows.append(time, rows)

    def alarm(self, alarm: Alarm) -> None:
        """List an alarm; pages that are opened later list it, too."""
        time = alarm.time if math.isfinite(alarm.time) else None
        line = json.dumps({"kind": "alarm", **asdict(alarm), "time": time}).encode() + b"\n"
        with suppress(OSError):  # the server is gone, or stands still
            if len(line) <= LONGEST_LINE:
                os.write(self._pipe, line)


@contextmanager
def browser_page(
    robot_file: RobotFile, channels: Sequence[str], *, units: Mapping[str, str] | None = None, title: str = ""
) -> Iterator[BrowserPage]:
    """A live page in a process of its own; its address is printed on stderr.

    Each joint has a plot of `measured` and `predicted`, one of `residual` with ± `band`, and one of every other
    quantity; `position` also moves the drawn arm.

    Args:
        robot_file: of the arm.
        channels: of the rows, each `quantity/joint`.
        units: of quantities that `drivers.streams` does not know; those of a monitor are torques.
        title: of the page; the robot's name where empty.

    Raises:
        UsageError: a package that serves it is not installed.
    """
    require_browser()
    names = tuple(channels)
    unit_of = {**dict.fromkeys(("measured", "predicted", "residual", "band"), "N·m"), **UNITS, **(units or {})}
    slides = {joint.name: joint.sliding for joint in robot_file.robot.joints}
    about = {
        "kind": "about",
        "title": title or robot_file.robot.name,
        "joints": list(robot_file.robot.joint_names),
        "channels": [
            {
                "quantity": quantity,
                "joint": joint,
                "unit": joint_unit(unit_of.get(quantity, "").replace("*", "·"), sliding=slides.get(joint, False)),
            }
            for quantity, _, joint in (name.partition("/") for name in names)
        ],
        "arm": skeleton(robot_file),
    }
    rows = SharedRows.create(names, CAPACITY)
    try:
        with socket.create_server(("127.0.0.1", 0)) as listening:
            token = secrets.token_urlsafe(16)
            address = f"http://127.0.0.1:{listening.getsockname()[1]}/?token={token}"
            with _server(rows, json_text(about), token, listening) as pipe:
                print(f"live page: {address}", file=sys.stderr, flush=True)
                yield BrowserPage(rows, pipe, address)
    finally:
        rows.close()


def require_browser() -> None:
    """Check that what serves the page is installed.

    Raises:
        UsageError: a package is missing.
    """
    missing = [name for name in MODULES if find_spec(name) is None]
    if missing:
        raise UsageError(f"the live page needs {', '.join(missing)}", hint="pip install 'dynid[browser]'")


@contextmanager
def _server(rows: SharedRows, about: str, token: str, listening: socket.socket) -> Iterator[int]:
    """The server's process, and the descriptor of the pipe to it."""
    from daq.live.page_server import serve

    context = multiprocessing.get_context("spawn")
    reader, writer = context.Pipe(duplex=False)
    arguments = (reader, rows.handle, about, token, listening)
    process = context.Process(target=serve, args=arguments, name="dynid live page", daemon=True)
    with ordinary_priority(), started_without_interrupt():
        process.start()
    reader.close()
    listening.close()
    try:
        yield writer.fileno()
    finally:
        writer.close()
        leave(process, LEAVE_LIMIT)


def skeleton(robot_file: RobotFile) -> list[dict[str, object]] | None:
    """Axes of the joints with all at 0 (place, direction, parent's number or −1), by which a page draws the arm.

    None of an arm with closed loops, whose other joints a page does not know, and of one whose axes are not stated.
    """
    robot = robot_file.robot
    axes = joint_axes(robot_file)
    if robot.model.loops or not set(robot.joint_names) <= axes.keys():
        return None
    place = {name: number for number, name in enumerate(robot.joint_names)}
    drawn: list[dict[str, object]] = []
    for joint in robot.joints:
        point, direction, parent = axes[joint.name]
        while parent in axes and parent not in place:
            parent = axes[parent][2]
        drawn.append(
            {
                "point": point.tolist(), "axis": direction.tolist(), "parent": place.get(parent, -1),
                "sliding": joint.sliding,
            }
        )  # fmt: skip
    return drawn


class PageView:
    """A session's view that shows the joints' stream on a page; it neither blocks nor raises."""

    def __init__(self, page: BrowserPage, layout: StreamLayout, beside: View | None) -> None:
        self._page, self._layout, self._beside = page, layout, beside

    def add(self, batch: Batch) -> None:
        """Show the samples of the stream."""
        if self._beside is not None:
            self._beside.add(batch)
        if batch.stream != self._layout.name or not len(batch.time):
            return
        with suppress(Exception):  # a display must not stop an arm
            parts = [
                batch.values.get(channel.quantity, np.full((len(batch.time), len(channel.columns)), np.nan))
                for channel in self._layout.channels
            ]
            self._page.append(batch.time, np.concatenate(parts, axis=1))

    def show(self, state: str, elapsed: float, total: float) -> None:
        """The page shows samples alone."""
        if self._beside is not None:
            self._beside.show(state, elapsed, total)


@contextmanager
def page_view(
    robot_file: RobotFile, layouts: Sequence[StreamLayout], *, shown: bool, beside: View | None
) -> Iterator[View | None]:
    """A view of the joints' stream on a page; `beside` alone where no page is to be shown.

    Raises:
        UsageError: a package that serves it is not installed, or there is no stream of joints.
    """
    if not shown:
        yield beside
        return
    layout = next((layout for layout in layouts if layout.name == JOINTS_STREAM), None)
    if layout is None:
        raise UsageError("the connection has no joint stream to show", hint="leave out --browser")
    channels = [f"{channel.quantity}/{column}" for channel in layout.channels for column in channel.columns]
    units = {channel.quantity: channel.unit for channel in layout.channels}
    with browser_page(robot_file, channels, units=units) as page:
        yield PageView(page, layout, beside)
