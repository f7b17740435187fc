"""The live view: it shows what happens, and whatever happens to it the recording goes on."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from types import SimpleNamespace

import numpy as np
import pytest
from kinematic_arm import RATE, ROBOT_FILE, KinematicArm
from rich.console import Console

from daq.live_view import PERIOD, Publisher, Status, StreamStatus, live_view, picture
from daq.recorder import Recorder
from daq.recording import read_recording
from daq.safety import Limits, Supervisor
from daq.session import record
from drivers.streams import Block

LIMITS = Limits.of_robot(ROBOT_FILE.robot)
IDLE = SimpleNamespace(backlog=2048, overflow=0)


def joints_block(torque, temperature, count=20, lost=0):
    ones = np.ones((count, 1))
    values = {"torque": ones * np.array(torque), "temperature": ones * np.array(temperature)}
    return Block("joints", np.arange(count) / RATE, np.arange(count) / RATE, values, lost)


def display_process():
    return next(child for child in multiprocessing.active_children() if child.name == "dynid live view")


def test_a_picture_says_what_was_noted():
    reader, writer = os.pipe()
    publisher = Publisher(writer, LIMITS, IDLE)
    publisher.take(joints_block([5.0, -40.0], [30.0, np.nan], lost=3))
    first = publisher.status("motion", 0.0, 9.0, now=100.0)
    publisher.take(joints_block([10.0, 1.0], [31.0, 44.0]))
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


@pytest.mark.parametrize("end", ["full", "closed"])
def test_a_pipe_that_takes_nothing_neither_blocks_nor_raises(end):
    reader, writer = os.pipe()
    publisher = Publisher(writer, LIMITS, IDLE)
    if end == "full":
        with suppress(BlockingIOError):
            while True:
                os.write(writer, bytes(4096))
    else:
        os.close(reader)
    publisher.take(joints_block([1.0, 1.0], [30.0, 30.0]))
    begun = time.monotonic()
    publisher.show("motion", 1.0, 2.0)
    assert time.monotonic() - begun < PERIOD
    if end == "full":
        os.close(reader)
    os.close(writer)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_display_that_dies_or_hangs_does_not_disturb_the_recording(tmp_path, monkeypatch, number):
    monkeypatch.setattr("daq.live_view.LEAVE_LIMIT", 0.2)
    path, arm = tmp_path / "run.h5", KinematicArm()
    layouts = arm.streams()
    recorder = Recorder(path, ROBOT_FILE, layouts)
    with live_view(shown=True, limits=LIMITS, recorder=recorder) as view:
        display = display_process()
        timer = threading.Timer(0.5, os.kill, (display.pid, number))
        timer.start()
        report = record(arm, recorder, Supervisor(LIMITS, layouts), None, 1.5, view)
        timer.join()
    assert not display.is_alive()
    assert display.exitcode == -signal.SIGKILL
    assert report.stopped_by is None
    recording = read_recording(path)
    assert recording.complete
    ticks = np.rint((recording.streams["joints"].time - 100.0) * RATE)
    np.testing.assert_array_equal(ticks, np.arange(len(ticks)))
    assert len(ticks) == report.samples["joints"] > 1.3 * RATE


def test_a_display_outlives_ctrl_c_and_leaves_when_told():
    with live_view(shown=True, limits=LIMITS, recorder=IDLE) as view:
        display = display_process()
        for _ in range(10):  # also while it begins
            os.kill(display.pid, signal.SIGINT)
            view.show("recording", 0.0, 1.0)
            time.sleep(0.1)
        assert display.is_alive()
    assert display.exitcode == 0


def test_a_display_leaves_when_the_recording_was_killed():
    program = (
        "import os, signal, time\n"
        "from types import SimpleNamespace\n"
        "from daq.live_view import live_view\n"
        "if __name__ == '__main__':\n"
        "    with live_view(shown=True, limits=None, recorder=SimpleNamespace(backlog=0, overflow=0)) as view:\n"
        "        view.show('recording', 0.0, 1.0)\n"
        "        time.sleep(0.5)\n"
        "        os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    # The display holds the other end of standard error: this returns only once it has left, here in order.
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, timeout=20, check=False)
    assert done.returncode == -signal.SIGKILL
    assert b"0.0 of 1.0 s" in done.stderr


def test_nothing_is_started_where_nothing_is_shown():
    before = multiprocessing.active_children()
    with live_view(shown=False, limits=LIMITS, recorder=IDLE) as view:
        assert view is None
        assert multiprocessing.active_children() == before
