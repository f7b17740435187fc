"""After kill -9 at any moment, all but the last flush period is rescued."""

from __future__ import annotations

import json
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest
from kinematic_arm import NAMES, ROBOT_FILE

from daq.commands import recover_command
from daq.recording import RecordingWriter, read_recording
from daq.recording_writer import CHUNK_SECONDS
from daq.recover import recover
from drivers.errors import RecordingError
from drivers.streams import ChannelLayout, StreamLayout

RATE = 500
WRITER = """
    import sys, time
    from pathlib import Path
    sys.path[:0] = [{root!r}, {support!r}]
    import numpy as np
    from kinematic_arm import ROBOT_FILE, NAMES
    from daq.recorder import Recorder
    from drivers.streams import Block, ChannelLayout, StreamLayout
    layout = StreamLayout("joints", (ChannelLayout("position", NAMES),), {rate})
    recorder = Recorder(Path({path!r}), ROBOT_FILE, (layout,))
    start, sent = time.monotonic(), 0
    while True:
        due = int((time.monotonic() - start) * {rate})
        ticks = np.arange(sent, due) / {rate}
        if len(ticks):
            recorder.put(Block("joints", ticks, ticks, {{"position": np.stack([ticks, ticks], axis=1)}}))
            recorder.event(float(ticks[0]), "info", "test", "τ " + str(sent))
            sent = due
            print(sent, flush=True)
        time.sleep(0.01)
"""


@pytest.mark.parametrize("life", [0.55, 0.81, 1.07, 1.4, 1.63])
def test_a_killed_recording_is_rescued(tmp_path, life):
    root = Path(__file__).parents[2]
    path = tmp_path / "run.h5"
    script = textwrap.dedent(WRITER).format(
        root=str(root), support=str(root / "tests" / "support"), path=str(path), rate=RATE
    )
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        first = process.stdout.readline()
        time.sleep(life)
        process.kill()
        counts = [int(line) for line in [first, *process.stdout] if line.endswith("\n")]
    with pytest.raises(RecordingError, match=r"half-written.*dynid recover"):
        read_recording(path)
    found = recover(path, tmp_path / "rescued.h5")
    rescued = read_recording(tmp_path / "rescued.h5")
    times = rescued.streams["joints"].time
    np.testing.assert_array_equal(times, np.arange(len(times)) / RATE)
    np.testing.assert_array_equal(rescued.streams["joints"].channels["position"].values[:, 0], times)
    # one flush period, and what the writer thread had not taken yet on a busy machine
    assert len(times) >= counts[-1] - RATE * (CHUNK_SECONDS + 0.15)
    assert not rescued.complete
    assert "recovered" in rescued.events[-1].message
    assert rescued.events[0].message.startswith("τ")
    assert set(found.cut) == {"joints"}


def test_what_is_no_recording_is_refused(tmp_path):
    with pytest.raises(RecordingError, match="no such file"):
        recover(tmp_path / "none.h5", tmp_path / "out.h5")
    (tmp_path / "text.h5").write_text("hello")
    with pytest.raises(RecordingError, match="nothing can be rescued"):
        recover(tmp_path / "text.h5", tmp_path / "out.h5")
    with pytest.raises(RecordingError, match="its own source"):
        recover(tmp_path / "text.h5", tmp_path / "text.h5")


LIMITED_RECOVER = """
    import sys
    sys.path[:0] = [{root!r}]
    from daq import recover
    from drivers.command import main
    recover.READ_LIMIT = 4.0
    sys.argv = ["dynid", "recover", {path!r}, "--json"]
    main()
"""


def test_a_file_over_which_hdf5_loops_is_refused(tmp_path):
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
    script = textwrap.dedent(LIMITED_RECOVER).format(root=str(Path(__file__).parents[2]), path=str(path))
    ended = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=30, check=False)
    assert ended.returncode == 2, ended.stderr
    assert "HDF5 did not come to an end within 4 s" in json.loads(ended.stdout)["error"]
    assert not (tmp_path / "run-recovered.h5").exists()


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
