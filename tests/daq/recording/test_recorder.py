"""The recorder: all that was put is in the file, which can be followed; memory is bounded; a full disk is an error."""

from __future__ import annotations

import errno
import os
import re
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
from kinematic_arm import NAMES, ROBOT_FILE
from simulated_clock import SimulatedClock

from daq.output_files import unfinished_files
from daq.recording.growing_file import SPARE
from daq.recording.reader import read_recording
from daq.recording.recorder import Recorder
from daq.recording.recover import recover
from daq.recording.writer import CHUNK_SECONDS
from drivers.core.errors import DiskError, UsageError
from drivers.core.files import InputKind
from drivers.streams import Batch, ChannelLayout, StreamLayout

ROOT = Path(__file__).parents[3]
RATE = 100.0
CHUNK = round(CHUNK_SECONDS * RATE)
LAYOUTS = (
    StreamLayout("joints", (ChannelLayout("position", NAMES),), RATE),
    StreamLayout("thermal", (ChannelLayout("temperature", NAMES),), 0.0),
)
ROW = 8 * 4
"""Bytes."""
FOLLOWER = """
    import sys
    sys.path.insert(0, {root!r})
    from pathlib import Path
    from daq.recording.reader import read_recording
    from daq.recording.recover import follow_recording
    from drivers.core.errors import RecordingError
    path = Path({path!r})
    for _ in sys.stdin:
        now = follow_recording(path)
        print(len(now.streams["joints"].time), now.events[0].message, flush=True)
    try:
        read_recording(path)
    except RecordingError as error:
        print(error, flush=True)
"""
FULL_DISK = """
    import os, resource, sys
    sys.path[:0] = [{root!r}, {support!r}]
    from pathlib import Path
    import numpy as np
    from kinematic_arm import ROBOT_FILE, NAMES
    from simulated_clock import simulated_time
    from daq.recording.recorder import Recorder
    from drivers.core.errors import DiskError
    from drivers.streams import Batch, ChannelLayout, StreamLayout
    layout = StreamLayout("joints", (ChannelLayout("position", NAMES),), 100.0)
    unlimited = resource.getrlimit(resource.RLIMIT_FSIZE)

    def memory_file(name, create=os.memfd_create):
        # Files in memory are bound by this limit too, though not by a full disk.
        resource.setrlimit(resource.RLIMIT_FSIZE, unlimited)
        return create(name)

    os.memfd_create = memory_file
    with simulated_time() as clock:
        recorder = Recorder(Path({path!r}), ROBOT_FILE, (layout,), overwrite=True, clock=clock)
        resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, unlimited[1]))
        for start in range(0, 10_000, 50):
            time_ = (start + np.arange(50.0)) / 100.0
            recorder.put(Batch("joints", time_, time_, {{"position": np.ones((50, 2))}}))
            clock.sleep(0.5)
            if recorder.failure:
                break
        try:
            recorder.close(complete=True)
        except DiskError as error:
            print(start)
            print(error)
            print(recorder.file)
"""


def block(start: int, count: int, stream: str = "joints") -> Batch:
    time = np.arange(start, start + count) / RATE
    quantity = "position" if stream == "joints" else "temperature"
    return Batch(stream, time, time + 5.0, {quantity: np.stack([time, -time], axis=1)})


def test_what_is_put_is_in_the_file(tmp_path: Path, clock: SimulatedClock) -> None:
    recorder = Recorder(tmp_path / "run.h5", ROBOT_FILE, LAYOUTS, trajectory="kind: fourier", clock=clock)
    sizes = np.random.default_rng(1).integers(1, 50, 70)
    for start, count in zip(np.cumsum([0, *sizes[:-1]]), sizes, strict=True):
        clock.sleep(count / RATE)
        recorder.put(block(int(start), int(count)))
        clock.sleep(1e-6)
        assert recorder.backlog == ROW * (int(start + count) % CHUNK)  # whole chunks are written at once
    recorder.put(block(0, 3, "thermal"))
    recorder.event(1.0, "info", "test", "τ")
    recorder.close(complete=True)
    recorder.close(complete=True)
    assert recorder.backlog == 0
    recording = read_recording(tmp_path / "run.h5")
    assert recording.complete
    assert recording.trajectory == "kind: fourier"
    assert [event.message for event in recording.events] == ["τ"]
    joints = recording.streams["joints"]
    expected = np.arange(sizes.sum()) / RATE
    np.testing.assert_array_equal(joints.time, expected)
    np.testing.assert_array_equal(joints.host_time, expected + 5.0)
    np.testing.assert_array_equal(joints.channels["position"].values, np.stack([expected, -expected], axis=1))
    assert len(recording.streams["thermal"].time) == 3


def test_a_source_that_is_slower_than_it_said_is_written_after_two_chunks_times(
    tmp_path: Path, clock: SimulatedClock
) -> None:
    recorder = Recorder(tmp_path / "run.h5", ROBOT_FILE, LAYOUTS, clock=clock)
    clock.sleep(0.33)
    recorder.put(block(0, 1))
    begun = clock.now()
    assert clock.wait(lambda: recorder.backlog == 0, 10.0)
    assert clock.now() - begun == pytest.approx(2.0 * CHUNK_SECONDS, abs=0.1)
    assert clock.now() - begun > 2.0 * CHUNK_SECONDS
    recorder.close(complete=True)
    assert len(read_recording(tmp_path / "run.h5").streams["joints"].time) == 1


def test_another_process_follows_the_file_while_it_grows(tmp_path: Path, clock: SimulatedClock) -> None:
    path = tmp_path / "run.h5"
    recorder = Recorder(path, ROBOT_FILE, LAYOUTS, clock=clock)
    recorder.event(0.0, "info", "test", "begin")
    # In the writer's own process HDF5 would hand out the open file: only another one shows what is on disk.
    script = textwrap.dedent(FOLLOWER).format(root=str(ROOT), path=str(recorder.file))
    with subprocess.Popen(
        [sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as follower:
        assert follower.stdin is not None
        assert follower.stdout is not None
        for turn in range(3):
            recorder.put(block(110 * turn, 110))
            clock.sleep(0.001)
            follower.stdin.write("look\n")
            follower.stdin.flush()
            assert follower.stdout.readline() == f"{110 * (turn + 1) // CHUNK * CHUNK} begin\n"
        follower.stdin.close()
        assert "dynid recover" in follower.stdout.read()
        assert follower.wait(60.0) == 0
    recorder.close(complete=True)
    assert len(read_recording(path).streams["joints"].time) == 330


def test_what_does_not_fit_into_memory_is_counted(tmp_path: Path, clock: SimulatedClock) -> None:
    """The disk is kept from writing by a stall: what fits is written after it, what does not is told and counted."""
    recorder = Recorder(tmp_path / "run.h5", ROBOT_FILE, LAYOUTS, memory_limit=60 * ROW, clock=clock)
    for start in range(0, 300, 30):
        recorder.put(block(start, 30))
        clock.stall(0.3)
    assert recorder.overflow == 300 - 60
    clock.sleep(0.01)
    recorder.put(block(300, 50))  # there is room again
    recorder.put(block(350, 1000))  # this one can never fit
    recorder.close(complete=True)
    assert recorder.overflow == 1240
    recording = read_recording(tmp_path / "run.h5")
    assert not recording.complete
    assert [event.message for event in recording.events] == [
        "the disk does not keep up: samples are dropped",
        "1240 samples dropped: the disk did not keep up",
    ]
    assert recording.events[0].time == 0.6
    expected = np.concatenate([np.arange(60), np.arange(300, 350)]) / RATE
    np.testing.assert_array_equal(recording.streams["joints"].time, expected)


def test_a_disk_that_refuses_what_it_granted_is_an_error_and_the_file_is_recovered(tmp_path: Path) -> None:
    """A failing disk does this: the recorder owned the space that it was not allowed to write into."""
    path = tmp_path / "run.h5"
    path.write_text("old")
    script = textwrap.dedent(FULL_DISK).format(root=str(ROOT), support=str(ROOT / "tests" / "support"), path=str(path))
    ended = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr[-3000:]  # HDF5 crashes at exit where a broken file is left to it
    refused, message, file = ended.stdout.splitlines()
    assert message.startswith(f"{path}: cannot be written")
    assert message.endswith(f"(save what was written: dynid recover {file})")
    assert path.read_text() == "old"
    assert unfinished_files(path) == [Path(file)]
    recover(Path(file), tmp_path / "rescued.h5")
    rescued = read_recording(tmp_path / "rescued.h5")
    np.testing.assert_array_equal(rescued.streams["joints"].time, np.arange(int(refused)) / RATE)
    assert int(refused) >= 50


def space_for(granted: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """A disk that grants a file so many bytes, and not one more."""

    def allocate(descriptor: int, offset: int, length: int) -> None:
        if offset + length > granted:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "posix_fallocate", allocate)


@pytest.mark.parametrize("old", [False, True])
def test_a_disk_that_fills_ends_the_recording_in_order(tmp_path, clock, monkeypatch, old: bool) -> None:
    """All that had come is in a file that opens without a rescue: in its place, or beside an older recording."""
    path = tmp_path / "run.h5"
    if old:
        path.write_text("old")
    space_for(SPARE + 100_000, monkeypatch)
    recorder = Recorder(path, ROBOT_FILE, LAYOUTS, overwrite=True, clock=clock)
    put = 0
    while recorder.failure is None:
        recorder.put(block(put, 30))
        put += 30
        clock.sleep(0.3)
    recorder.put(block(put, 30))  # too late
    said = "run.h5: cannot be written: No space left on device (free some space on the disk, or choose another place)"
    with pytest.raises(DiskError, match=re.escape(said)):
        recorder.close(complete=True)
    assert recorder.file == (unfinished_files(path)[0] if old else path)
    if old:
        assert path.read_text() == "old"
    recording = read_recording(recorder.file)
    assert not recording.complete
    assert recording.events[-1].message == "cannot be written: No space left on device"
    np.testing.assert_array_equal(recording.streams["joints"].time, np.arange(put) / RATE)
    assert put > 1000
    assert recorder.file.stat().st_size < 200_000  # what it owned beyond its end was given back


def test_an_older_recording_stays_until_the_new_one_is_whole(tmp_path: Path, clock: SimulatedClock) -> None:
    path = tmp_path / "run.h5"
    path.write_text("old")
    with pytest.raises(UsageError, match="exists already"):
        Recorder(path, ROBOT_FILE, LAYOUTS, clock=clock)
    recorder = Recorder(path, ROBOT_FILE, LAYOUTS, overwrite=True, clock=clock)
    recorder.put(block(0, 100))
    clock.sleep(1.0)
    assert path.read_text() == "old"
    assert unfinished_files(path) == [recorder.file]
    recorder.close(complete=True)
    assert len(read_recording(path).streams["joints"].time) == 100
    assert list(tmp_path.iterdir()) == [path]
    discarded = Recorder(path, ROBOT_FILE, LAYOUTS, overwrite=True, clock=clock)
    discarded.discard()
    assert len(read_recording(path).streams["joints"].time) == 100
    assert list(tmp_path.iterdir()) == [path]


def test_of_two_recordings_of_one_name_the_second_keeps_its_unfinished_one(tmp_path, clock) -> None:
    path = tmp_path / "run.h5"
    first, second = (Recorder(path, ROBOT_FILE, LAYOUTS, clock=clock) for _ in range(2))
    first.put(block(0, 10))
    second.put(block(0, 20))
    first.close(complete=True)
    with pytest.raises(DiskError, match=rf"exists by now and was not replaced \(the recording is {second.file}\)"):
        second.close(complete=True)
    assert len(read_recording(path).streams["joints"].time) == 10
    assert len(read_recording(second.file).streams["joints"].time) == 20


def test_what_a_reader_would_refuse_is_not_recorded(tmp_path, clock, monkeypatch) -> None:
    """A recording ends in order before it has more bytes, or events, than are read of one."""
    monkeypatch.setattr("daq.recording.growing_file.LONG_RECORDING_FILE", InputKind("a recording", SPARE + 60_000))
    recorder = Recorder(tmp_path / "long.h5", ROBOT_FILE, LAYOUTS, clock=clock)
    recorder.put(block(0, 100))
    clock.sleep(1.0)
    recorder.put(block(100, 1500))
    clock.sleep(1.0)
    with pytest.raises(DiskError, match=r"has reached .*, the largest recording that is read"):
        recorder.close(complete=True)
    assert len(read_recording(tmp_path / "long.h5").streams["joints"].time) == 1600
    monkeypatch.setattr("daq.recording.recorder.MOST_EVENTS", 3)
    recorder = Recorder(tmp_path / "talkative.h5", ROBOT_FILE, LAYOUTS, clock=clock)
    recorder.put(block(0, 10))
    for number in range(5):
        recorder.event(0.0, "info", "test", str(number))
    clock.sleep(1.0)
    with pytest.raises(DiskError, match="has 4 events, the most that can be read"):
        recorder.close(complete=True)
    recording = read_recording(tmp_path / "talkative.h5")
    assert len(recording.streams["joints"].time) == 10
    assert [event.message for event in recording.events[:3]] == ["0", "1", "2"]
