"""The live view: it shows what happens, and whatever happens to it the recording goes on."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from kinematic_arm import RATE, ROBOT_FILE, KinematicArm
from rich.console import Console
from simulated_clock import SimulatedClock

from daq.live.terminal_view import PERIOD, Publisher, Status, StreamStatus, live_view, picture
from daq.recording.reader import read_recording
from daq.recording.recorder import Recorder
from daq.session.session import record
from daq.session.supervisor import Limits, Supervisor
from drivers.streams import Batch

LIMITS = Limits.of_robot(ROBOT_FILE.robot)
IDLE = SimpleNamespace(backlog=2048, overflow=0)
PATIENCE = 60.0
"""How long [s] another process may take for what it must do, however busy the computer is."""


def joints_block(torque, temperature, count=20, lost=0):
    ones = np.ones((count, 1))
    values = {"torque": ones * np.array(torque), "temperature": ones * np.array(temperature)}
    return Batch("joints", np.arange(count) / RATE, np.arange(count) / RATE, values, lost)


def display_process():
    return next(child for child in multiprocessing.active_children() if child.name == "dynid live view")


def test_a_picture_says_what_was_noted():
    reader, writer = os.pipe()
    publisher = Publisher(writer, LIMITS, IDLE)
    publisher.add(joints_block([5.0, -40.0], [30.0, np.nan], lost=3))
    first = publisher.status("motion", 0.0, 9.0, now=100.0)
    publisher.add(joints_block([10.0, 1.0], [31.0, 44.0]))
    status = publisher.status("motion", 3.0, 9.0, now=100.1)
    assert (first.torque_share, first.torque_joint) == (0.8, "elbow")
    assert (first.temperature, first.temperature_joint) == (30.0, "shoulder")
    assert (status.torque_share, status.torque_joint) == (0.8, "elbow")  # the largest so far
    assert (status.temperature, status.temperature_joint) == (44.0, "elbow")  # the latest
    (stream,) = status.streams
    assert (stream.samples, stream.lost) == (40, 3)
    assert stream.rate == pytest.approx(20 / 0.1)
    assert status.backlog == 2048
    os.close(reader)
    os.close(writer)


def test_every_figure_is_drawn():
    status = Status(
        "motion", 3.0, 9.0, (StreamStatus("joints", 499.9, 1500, 7),), 0.8, "elbow", 44.0, "wrist", 2048, 11
    )
    console = Console(width=120, record=True, file=open(os.devnull, "w"))  # noqa: SIM115
    console.print(picture(status))
    text = console.export_text()
    for figure in ("motion", "3.0 of 9.0 s", "499.9 Hz", "1500 samples", "7 lost", "80 %", "elbow", "44.0 °C", "wrist"):
        assert figure in text
    assert "2 KiB" in text
    assert "dropped 11 samples" in text
    unknown = Status("recording", 0.0, 0.0, (), None, "", None, "", 0, 0)
    console.print(picture(unknown))
    assert "torque" not in console.export_text().partition("recording")[2]


def test_the_end_of_the_display_is_one_event(clock: SimulatedClock) -> None:
    reader, writer = os.pipe()
    told: list[tuple[object, ...]] = []
    recorder = SimpleNamespace(backlog=0, overflow=0, event=lambda *event: told.append(event))
    publisher = Publisher(writer, LIMITS, recorder, clock)
    publisher.show("motion", 1.0, 2.0)
    assert told == []
    os.close(reader)
    for _ in range(3):
        clock.sleep(2 * PERIOD)
        publisher.show("motion", 1.0, 2.0)
    os.close(writer)
    ((_, level, source, message),) = told
    assert (level, source) == ("info", "live view")
    assert "the recording goes on" in str(message)


def test_names_of_a_controller_command_no_terminal() -> None:
    stream = StreamStatus("joints\x1b[2J", 500.0, 10, 0)
    status = Status("motion\x07", 1.0, 2.0, (stream,), 0.5, "j\x9b1m", 40.0, "k\u202e", 0, 0)
    console = Console(width=160, record=True, file=open(os.devnull, "w"))  # noqa: SIM115
    console.print(picture(status))
    text = console.export_text()
    assert not set("\x1b\x07\x9b\u202e") & set(text)
    assert "joints\\u001b[2J" in text


def test_a_picture_is_sent_at_most_once_a_period(clock: SimulatedClock) -> None:
    reader, writer = os.pipe()
    publisher = Publisher(writer, LIMITS, IDLE, clock)
    for number in range(34):
        publisher.add(joints_block([1.0, 1.0], [30.0, 30.0], count=6))
        publisher.show("motion", 0.03 * number, 1.0)
        clock.sleep(0.03)
    os.close(writer)
    with open(reader) as pipe:
        pictures = [json.loads(line) for line in pipe]
    assert [picture["elapsed"] for picture in pictures] == pytest.approx([0.0, 0.21, 0.42, 0.63, 0.84])
    assert [picture["streams"][0]["rate"] for picture in pictures] == pytest.approx([0.0] + 4 * [RATE])


@pytest.mark.parametrize("end", ["full", "closed"])
def test_a_pipe_that_takes_nothing_neither_blocks_nor_raises(end):
    reader, writer = os.pipe()
    publisher = Publisher(writer, LIMITS, IDLE)
    assert not os.get_blocking(writer)
    if end == "full":
        with suppress(BlockingIOError):
            while True:
                os.write(writer, bytes(4096))
    else:
        os.close(reader)
    publisher.add(joints_block([1.0, 1.0], [30.0, 30.0]))
    publisher.show("motion", 1.0, 2.0)
    if end == "full":
        os.close(reader)
    os.close(writer)


@pytest.mark.realtime
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_display_that_dies_or_hangs_does_not_disturb_the_recording(
    tmp_path: Path, clock: SimulatedClock, monkeypatch: pytest.MonkeyPatch, number: signal.Signals
) -> None:
    """The display is real; a picture at every sample fills the pipe of one that hangs."""
    monkeypatch.setattr("daq.live.terminal_view.LEAVE_LIMIT", 0.2)
    monkeypatch.setattr("daq.live.terminal_view.PERIOD", 0.0)
    path, arm = tmp_path / "run.h5", KinematicArm(clock=clock)
    layouts = arm.streams()
    recorder = Recorder(path, ROBOT_FILE, layouts, clock=clock)
    with live_view(shown=True, limits=LIMITS, recorder=recorder, clock=clock) as view:
        display = display_process()
        assert not os.get_blocking(view._pipe)

        def hit() -> None:
            os.kill(display.pid, number)
            os.waitid(os.P_PID, display.pid, os.WEXITED | os.WSTOPPED | os.WNOWAIT)

        clock.call_at(clock.now() + 0.5, hit)
        report = record(arm, recorder, Supervisor(LIMITS, layouts), None, 2.502, view, clock)
        if number == signal.SIGSTOP:
            with pytest.raises(BlockingIOError):
                os.write(view._pipe, bytes(4096))
    assert not display.is_alive()
    assert display.exitcode == -signal.SIGKILL
    assert report.stopped_by is None
    recording = read_recording(path)
    assert recording.complete
    np.testing.assert_array_equal(
        recording.streams["joints"].time, np.concatenate([block.time for block in arm.samples])
    )
    assert arm.count == 501


def wait_for(condition: Callable[[], object]) -> None:
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.mark.realtime
def test_a_display_outlives_ctrl_c_and_leaves_when_told(
    clock: SimulatedClock, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("daq.live.terminal_view.LEAVE_LIMIT", PATIENCE)
    monkeypatch.setenv("FORCE_COLOR", "1")  # drawn at once, as in a terminal
    seen = ""

    def drawn(words: str) -> bool:
        nonlocal seen
        seen += capfd.readouterr().err
        return words in seen

    with live_view(shown=True, limits=LIMITS, recorder=IDLE, clock=clock) as view:
        display = display_process()
        for elapsed in (0.0, 1.0, 2.0):
            os.kill(display.pid, signal.SIGINT)  # also while it begins
            view.show("recording", elapsed, 9.0)
            clock.sleep(PERIOD)
            wait_for(lambda elapsed=elapsed: drawn(f"{elapsed:.1f} of 9.0 s"))
    assert display.exitcode == 0


@pytest.mark.realtime
def test_a_display_leaves_when_the_recording_was_killed() -> None:
    program = (
        "import signal\n"
        "from types import SimpleNamespace\n"
        "from daq.live.terminal_view import live_view\n"
        "if __name__ == '__main__':\n"
        "    limits, recorder = SimpleNamespace(joints=()), SimpleNamespace(backlog=0, overflow=0)\n"
        "    with live_view(shown=True, limits=limits, recorder=recorder) as view:\n"
        "        view.show('recording', 0.0, 1.0)\n"
        "        signal.pause()\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program], stderr=subprocess.PIPE, env={**os.environ, "FORCE_COLOR": "1"}
    ) as recording:
        assert recording.stderr is not None
        seen = b""
        while b"0.0 of 1.0 s" not in seen:
            received = os.read(recording.stderr.fileno(), 65536)
            assert received, seen
            seen += received
        recording.kill()
        # The display holds the other end of standard error: this returns only once it has left, here in order.
        _, rest = recording.communicate(timeout=PATIENCE)
    assert recording.returncode == -signal.SIGKILL
    assert b"Traceback" not in seen + rest


def test_nothing_is_started_where_nothing_is_shown():
    before = multiprocessing.active_children()
    with live_view(shown=False, limits=LIMITS, recorder=IDLE) as view:
        assert view is None
        assert multiprocessing.active_children() == before
