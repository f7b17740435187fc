"""After a sudden death at any moment, all but the last flush period is rescued."""

from __future__ import annotations

import functools
import json
import os
import shutil
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
from kinematic_arm import NAMES, ROBOT_FILE

from daq.commands.recover import recover_command
from daq.output_files import unfinished_files, unfinished_name
from daq.recording import reader as reader_module
from daq.recording import recover as recover_module
from daq.recording.reader import read_recording
from daq.recording.recover import follow_recording, half_written, recover
from daq.recording.writer import CHUNK_SECONDS, RecordingWriter
from drivers.core import reading_process
from drivers.core.errors import RecordingError, UsageError
from drivers.core.files import InputKind
from drivers.core.reading_process import read_apart
from drivers.streams import ChannelLayout, StreamLayout

ROOT = Path(__file__).parents[3]
RATE = 500
CHUNK = round(CHUNK_SECONDS * RATE)
BLOCK = 5
WRITER = """
    import os, signal, sys
    from pathlib import Path
    sys.path[:0] = [{root!r}, {support!r}]
    import h5py
    import numpy as np
    from kinematic_arm import ROBOT_FILE, NAMES
    from simulated_clock import simulated_time
    from daq.recording.recorder import Recorder
    from drivers.streams import Batch, ChannelLayout, StreamLayout

    def die():
        os.kill(os.getpid(), signal.SIGKILL)

    def record(path, seconds):
        layout = StreamLayout("joints", (ChannelLayout("position", NAMES),), {rate})
        with simulated_time() as clock:
            recorder = Recorder(path, ROBOT_FILE, (layout,), clock=clock)
            for start in range(0, round({rate} * seconds), {block}):
                clock.sleep({block} / {rate})
                ticks = (start + np.arange({block})) / {rate}
                recorder.put(Batch("joints", ticks, ticks, {{"position": np.stack([ticks, ticks], axis=1)}}))
                recorder.event(float(ticks[0]), "info", "test", "τ " + str(start))
            clock.sleep(1e-6)
            die()

    def record_until_write(path, number):
        left, write = number, h5py.Dataset.__setitem__
        def write_or_die(dataset, *where):
            nonlocal left
            if dataset.name.startswith("/streams/"):
                if left == 0:
                    dataset.file.flush()  # HDF5 may write at any moment that rows are announced
                    die()
                left -= 1
            write(dataset, *where)
        h5py.Dataset.__setitem__ = write_or_die
        record(path, 10.0)

    for line in sys.stdin:
        path, kind, value = line.split()
        child = os.fork()
        if child == 0:
            (record if kind == "time" else record_until_write)(Path(path), float(value))
        print(os.waitpid(child, 0)[1], flush=True)
"""


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory):
    """Half-written recordings: a function of how one dies, after a time [s] or before a write of samples, by number."""
    folder = tmp_path_factory.mktemp("killed")
    script = textwrap.dedent(WRITER).format(
        root=str(ROOT), support=str(ROOT / "tests" / "support"), rate=RATE, block=BLOCK
    )
    with subprocess.Popen(
        [sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None

        def kill(kind: str, value: float) -> Path:
            path = folder / f"{kind}{value}.h5"
            process.stdin.write(f"{path} {kind} {value}\n")
            process.stdin.flush()
            assert os.WTERMSIG(int(process.stdout.readline())) == signal.SIGKILL
            assert not path.exists()  # it was to take this place when it was closed
            with pytest.raises(
                RecordingError,
                match=r"no such file \(a recording of this name was not closed: "
                "dynid recover",
            ):
                read_recording(path)
            return half_written(path)

        yield kill
        process.stdin.close()


@pytest.mark.parametrize("life", [0.55, 0.81, 1.0, 1.07, 1.4, 1.63])
def test_whole_chunks_of_a_killed_recording_are_in_the_file(killed, life: float) -> None:
    path = killed("time", life)
    with pytest.raises(RecordingError, match=r"half-written.*dynid recover"):
        read_recording(path)
    found = follow_recording(path)
    written = round(life * RATE) // CHUNK * CHUNK
    np.testing.assert_array_equal(found.streams["joints"].time, np.arange(written) / RATE)
    np.testing.assert_array_equal(
        found.streams["joints"].channels["position"].values[:, 0], found.streams["joints"].time
    )
    # Events are flushed as they come.
    assert [event.message for event in found.events] == [f"τ {start}" for start in range(0, round(life * RATE), BLOCK)]
    assert not found.complete


@pytest.mark.parametrize(("number", "announced"), [(4, 0), (5, CHUNK)])
def test_a_recording_that_died_within_a_chunk_is_rescued_up_to_it(
    killed, tmp_path: Path, monkeypatch, number: int, announced: int
) -> None:
    """A chunk is three writes: stamps, the host's stamps, positions; here the second chunk's last two or last one lack.

    In the latter case all channels have the rows already, those of the positions without values.
    """
    path = killed("write", number)
    found = recover(path, tmp_path / "rescued.h5")
    rescued = read_recording(tmp_path / "rescued.h5")
    times = rescued.streams["joints"].time
    np.testing.assert_array_equal(times, np.arange(CHUNK) / RATE)
    np.testing.assert_array_equal(rescued.streams["joints"].channels["position"].values[:, 0], times)
    assert not rescued.complete
    assert "recovered" in rescued.events[-1].message
    assert rescued.events[0].message.startswith("τ")
    assert found == {"joints": announced}
    # As one that is too large for the memory:
    monkeypatch.setattr(recover_module, "RECORDING_FILE", InputKind("a recording", 10))
    monkeypatch.setattr(recover_module, "AT_ONCE", 1.2 * CHUNK_SECONDS)
    assert recover(path, tmp_path / "parts.h5") == found
    parts = read_recording(tmp_path / "parts.h5")
    assert list(map(str, parts.events)) == list(map(str, rescued.events))
    for name, channel in rescued.streams["joints"].channels.items():
        np.testing.assert_array_equal(parts.streams["joints"].channels[name].values, channel.values)
    np.testing.assert_array_equal(parts.streams["joints"].host_time, rescued.streams["joints"].host_time)


def test_a_large_recording_is_copied_in_parts(tmp_path, monkeypatch):
    path, times = tmp_path / "run.h5", np.arange(1700.0) / RATE
    layouts = (
        StreamLayout("joints", (ChannelLayout("position", NAMES),), RATE),
        StreamLayout("thermal", (ChannelLayout("temperature", NAMES),), 1.0),
    )
    with RecordingWriter(path, ROBOT_FILE, layouts) as file:
        file.append("joints", times, times + 3.0, {"position": np.sin(times)[:, np.newaxis] * [1.0, 2.0]})
        file.append("thermal", times[100::500], times[100::500], {"temperature": np.full((4, 2), 20.0)})
        file.event(float("nan"), "info", "x", "once")
    monkeypatch.setattr(recover_module, "RECORDING_FILE", InputKind("a recording", 10))
    monkeypatch.setattr(recover_module, "AT_ONCE", 0.7)
    assert recover(path, tmp_path / "rescued.h5") == {"joints": 0, "thermal": 0}
    rescued, whole = read_recording(tmp_path / "rescued.h5"), read_recording(path)
    assert [event.message for event in rescued.events][:-1] == ["once"]
    for name, stream in whole.streams.items():
        np.testing.assert_array_equal(rescued.streams[name].host_time, stream.host_time)
        for quantity, channel in stream.channels.items():
            np.testing.assert_array_equal(rescued.streams[name].channels[quantity].values, channel.values)


def test_what_is_no_recording_is_refused(tmp_path):
    with pytest.raises(RecordingError, match="no such file"):
        recover(tmp_path / "none.h5", tmp_path / "out.h5")
    (tmp_path / "text.h5").write_text("hello")
    with pytest.raises(RecordingError, match="nothing can be recovered"):
        recover(tmp_path / "text.h5", tmp_path / "out.h5")
    with pytest.raises(UsageError, match="is an input of this command"):
        recover(tmp_path / "text.h5", tmp_path / "text.h5")


@pytest.mark.reads_apart
def test_a_file_over_which_hdf5_loops_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "run.h5"
    times = np.arange(300.0) / RATE
    with RecordingWriter(
        path, ROBOT_FILE, (StreamLayout("joints", (ChannelLayout("position", NAMES),), RATE),)
    ) as file:
        file.append("joints", times, times, {"position": np.ones((300, 2))})
        for number in range(10):
            file.event(1.0, "info", "x", f"message {number}")
    content = bytearray(path.read_bytes())
    heap = content.rindex(b"GCOL")  # the texts of the events
    # The size of a text, 4, becomes 2564: the next one is looked for among zeros, where each has the size 0.
    content[heap + content[heap:].index(b"info") - 7] = 10
    path.write_bytes(content)
    for module in (recover_module, reading_process):  # a busy computer may need minutes for a second of processor time
        monkeypatch.setattr(module, "WAITING_LIMIT", 3600.0)
    monkeypatch.setattr(reading_process, "_TIME_TO_CLEAN_UP", 0)
    monkeypatch.setattr(recover_module, "read_apart", functools.partial(read_apart, time_limit=1.0))
    monkeypatch.setattr(reader_module, "read_apart", functools.partial(read_apart, time_limit=1.0))
    with pytest.raises(RecordingError, match="cannot be read within 1 s of processor time") as refused:
        recover_command(path, None, False, True)
    assert refused.value.exit_status == 2
    with pytest.raises(RecordingError, match="cannot be read within 1 s of processor time"):
        read_recording(path)
    assert not (tmp_path / "run-recovered.h5").exists()


@pytest.mark.reads_apart
def test_hdf5_does_not_wait_for_ever_for_a_damaged_block_to_be_mended(tmp_path, monkeypatch):
    path = tmp_path / "run.h5"
    with RecordingWriter(path, ROBOT_FILE, (StreamLayout("joints", (ChannelLayout("position", NAMES),), RATE),)):
        pass
    content = bytearray(path.read_bytes())
    content[content.index(b"FHDB") + 30] ^= 1  # its checksum is wrong now
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=r"is damaged: .*checksum"):
        read_recording(path)
    monkeypatch.setattr(recover_module, "WAITING_LIMIT", 0.5)
    with pytest.raises(RecordingError, match=r"cannot be read within 0\.5\d* s; it is damaged"):
        recover(path, tmp_path / "rescued.h5")


def test_the_command_says_what_was_rescued(tmp_path, capsys):
    path = tmp_path / "run.h5"
    times = np.arange(100.0) / RATE
    with RecordingWriter(
        path, ROBOT_FILE, (StreamLayout("joints", (ChannelLayout("position", NAMES),), RATE),)
    ) as file:
        file.append("joints", times, times, {"position": np.ones((100, 2))})
    recover_command(path, None, False, True)
    told = json.loads(capsys.readouterr().out)
    assert told["file"] == str(tmp_path / "run-recovered.h5")
    assert told["streams"]["joints"]["samples"] == 100
    assert told["cut"] == {"joints": 0}


def test_the_command_finds_what_was_to_take_a_files_place(killed, tmp_path, capsys):
    unfinished = killed("time", 0.9)
    folder = tmp_path / "run"
    folder.mkdir()
    path = folder / "run.h5"
    shutil.copy(unfinished, unfinished_name(path))
    recover_command(path, None, False, True)
    assert json.loads(capsys.readouterr().out)["file"] == str(folder / "run-recovered.h5")
    shutil.copy(unfinished, unfinished_name(path))
    first, second = unfinished_files(path)
    with pytest.raises(UsageError, match=rf"no such file, but 2 that are unfinished \(name one: {first}, {second}\)"):
        recover_command(path, None, True, True)
    recover_command(second, None, True, True)
    told = capsys.readouterr()
    assert (json.loads(told.out)["file"], told.err) == (str(folder / "run-recovered.h5"), "")
    shutil.copy(unfinished, path)  # a name is meant where it exists
    recover_command(path, None, True, True)
    assert [line.split()[2] for line in capsys.readouterr().err.splitlines()] == [str(first), str(second)]
