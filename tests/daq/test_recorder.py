"""The recorder: all that was put is in the file, which can be followed; memory is bounded; a full disk is an error."""

from __future__ import annotations

import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
from kinematic_arm import NAMES, ROBOT_FILE

from daq.recorder import Recorder
from daq.recording import read_recording
from daq.recover import recover
from drivers.streams import Block, ChannelLayout, StreamLayout

LAYOUTS = (
    StreamLayout("joints", (ChannelLayout("position", NAMES),), 100.0),
    StreamLayout("thermal", (ChannelLayout("temperature", NAMES),), 0.0),
)
FOLLOWER = """
    import sys, time
    sys.path.insert(0, {root!r})
    from pathlib import Path
    from daq.recording import read_recording
    from daq.recover import follow_recording
    from drivers.errors import RecordingError
    path = Path({path!r})
    for line in sys.stdin:
        end = time.monotonic() + 5.0
        while len((now := follow_recording(path)).streams["joints"].time) < int(line) and time.monotonic() < end:
            time.sleep(0.02)
        print(len(now.streams["joints"].time), now.events[0].message, flush=True)
    try:
        read_recording(path)
    except RecordingError as error:
        print(error, flush=True)
"""
FULL_DISK = """
    import os, resource, sys, time
    sys.path[:0] = [{root!r}, {support!r}]
    import numpy as np
    from kinematic_arm import ROBOT_FILE, NAMES
    from daq.recorder import Recorder
    from drivers.errors import DiskError
    from drivers.streams import Block, ChannelLayout, StreamLayout
    layout = StreamLayout("joints", (ChannelLayout("position", NAMES),), 100.0)
    recorder = Recorder({path!r}, ROBOT_FILE, (layout,))
    unlimited = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, unlimited[1]))

    def memory_file(name, create=os.memfd_create):
        # Files in memory are bound by this limit too, though not by a full disk.
        resource.setrlimit(resource.RLIMIT_FSIZE, unlimited)
        return create(name)

    os.memfd_create = memory_file
    for start in range(0, 10_000, 50):
        time_ = (start + np.arange(50.0)) / 100.0
        recorder.put(Block("joints", time_, time_, {{"position": np.ones((50, 2))}}))
        time.sleep(0.001)
        if recorder.failure:
            break
    try:
        recorder.close(complete=True)
    except DiskError as error:
        print(error.message)
"""


def block(start: int, count: int, stream: str = "joints") -> Block:
    time_ = np.arange(start, start + count) / 100.0
    quantity = "position" if stream == "joints" else "temperature"
    return Block(stream, time_, time_ + 5.0, {quantity: np.stack([time_, -time_], axis=1)})


def test_what_is_put_is_in_the_file(tmp_path):
    recorder = Recorder(tmp_path / "run.h5", ROBOT_FILE, LAYOUTS, trajectory="kind: fourier")
    sizes = np.random.default_rng(1).integers(1, 90, 40)
    for start, count in zip(np.cumsum([0, *sizes[:-1]]), sizes, strict=True):
        recorder.put(block(int(start), int(count)))
    recorder.put(block(0, 3, "thermal"))
    recorder.event(1.0, "info", "test", "τ")
    recorder.close(complete=True)
    recorder.close(complete=True)
    recording = read_recording(tmp_path / "run.h5")
    assert recording.complete
    assert recording.trajectory == "kind: fourier"
    assert [event.message for event in recording.events] == ["τ"]
    joints = recording.streams["joints"]
    expected = np.arange(sizes.sum()) / 100.0
    np.testing.assert_array_equal(joints.time, expected)
    np.testing.assert_array_equal(joints.channels["position"].values[:, 1], -expected)
    assert len(recording.streams["thermal"].time) == 3


def test_another_process_follows_the_file_while_it_grows(tmp_path):
    path = tmp_path / "run.h5"
    recorder = Recorder(path, ROBOT_FILE, LAYOUTS)
    recorder.event(0.0, "info", "test", "begin")
    # In the writer's own process HDF5 would hand out the open file: only another one shows what is on disk.
    script = textwrap.dedent(FOLLOWER).format(root=str(Path(__file__).parents[2]), path=str(path))
    with subprocess.Popen(
        [sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as follower:
        assert follower.stdin is not None
        assert follower.stdout is not None
        for turn in range(3):
            recorder.put(block(100 * turn, 100))
            follower.stdin.write(f"{100 * (turn + 1)}\n")
            follower.stdin.flush()
            assert follower.stdout.readline() == f"{100 * (turn + 1)} begin\n"
        follower.stdin.close()
        assert "dynid recover" in follower.stdout.read()
        assert follower.wait(10) == 0
    recorder.close(complete=True)
    assert len(read_recording(path).streams["joints"].time) == 300


def test_what_does_not_fit_into_memory_is_counted(tmp_path):
    recorder = Recorder(tmp_path / "run.h5", ROBOT_FILE, LAYOUTS, memory_limit=2000)
    recorder.put(block(0, 30))
    recorder.put(block(30, 1000))  # 32 bytes a row: this one can never fit
    recorder.close(complete=True)
    assert recorder.overflow == 1000
    recording = read_recording(tmp_path / "run.h5")
    assert not recording.complete
    assert "1000 samples dropped" in recording.events[-1].message
    assert len(recording.streams["joints"].time) == 30


def test_a_disk_that_refuses_is_an_error_and_the_file_is_recovered(tmp_path):
    root = Path(__file__).parents[2]
    path = tmp_path / "run.h5"
    script = textwrap.dedent(FULL_DISK).format(root=str(root), support=str(root / "tests" / "support"), path=str(path))
    script = script.replace(f"Recorder('{path}'", f"Recorder(__import__('pathlib').Path('{path}')")
    ended = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == 0, ended.stderr[-3000:]  # HDF5 crashes at exit where a broken file is left to it
    assert "cannot be written" in ended.stdout
    rescued = recover(path, tmp_path / "rescued.h5").recording
    times = rescued.streams["joints"].time
    assert len(times) >= 50
    np.testing.assert_array_equal(times, np.arange(len(times)) / 100.0)
