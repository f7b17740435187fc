"""The disk fills at any byte of a recording: one line of error, no crash of HDF5, and the old file stays as it was."""

from __future__ import annotations

import json
import subprocess
import sys
import textwrap
from collections.abc import Sequence
from pathlib import Path

import pytest

from daq.recording.growing_file import SPARE

ROOT = Path(__file__).parents[3]
STEP = 6 * 4096
"""Bytes; studies/safety/full_disk.py takes 4096."""
CHILD = """
    import json, os, resource, sys
    from pathlib import Path
    sys.path[:0] = [{root!r}, {support!r}]
    import numpy as np
    from kinematic_arm import NAMES, ROBOT_FILE
    from daq.recording.reader import read_recording
    from daq.recording.recorder import Recorder
    from daq.recording.recording import Channel, Recording, Stream
    from daq.recording.writer import write_recording
    from drivers.core.errors import DynidError
    from drivers.streams import Batch, ChannelLayout, StreamLayout

    path = Path({path!r})
    time = np.arange(1000) / 500
    values = np.stack([time, time], axis=1)
    channel = Channel("position", values, "rad", NAMES, "")
    stream = Stream("joints", time, time, {{"position": channel}})
    recording = Recording(
        robot_text=ROBOT_FILE.text, urdf_text="", streams={{"joints": stream}},
        events=(), created="", versions={{}}, host="", comment="c" * 20_000,
    )

    def write():
        write_recording(path, recording, overwrite=True)

    def record():
        layout = StreamLayout("joints", (ChannelLayout("position", NAMES),), 500)
        recorder = Recorder(path, ROBOT_FILE, (layout,), overwrite=True)
        for rows in np.split(np.arange(1000), 4):
            recorder.put(Batch("joints", time[rows], time[rows], {{"position": values[rows]}}))
        recorder.close(complete=True)

    def outcome(limit):
        process = os.fork()
        if process == 0:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
            status = 0
            try:
                {job}()
            except DynidError as error:
                status = error.exit_status
            except BaseException:
                status = 70
            sys.exit(status)  # at its exit HDF5 tries again what it could not write
        return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])

    outcomes = []
    for limit in {limits}:
        path.write_bytes(b"old")
        status = outcome(limit)
        content = "old" if path.exists() and path.read_bytes() == b"old" else "new"
        others = [other for other in path.parent.iterdir() if other != path]
        left = [len(read_recording(other).streams["joints"].time) for other in others]
        for other in others:
            other.unlink()
        outcomes.append((status, content, left))
    print(json.dumps(outcomes))
"""


def outcomes(path: Path, job: str, limits: Sequence[int]) -> list[tuple[int, str, list[int]]]:
    """By limit: exit status, what is in the file's place, and the samples of each file beside it."""
    path.parent.mkdir()
    support = str(ROOT / "tests" / "support")
    program = textwrap.dedent(CHILD).format(root=str(ROOT), support=support, path=str(path), job=job, limits=limits)
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    return [(status, content, left) for status, content, left in json.loads(ended.stdout)]


def test_a_copy_is_whole_or_the_old_file_stays(tmp_path: Path) -> None:
    found = outcomes(tmp_path / "disk" / "run.h5", "write", range(0, 160_000, STEP))
    assert {(status, content) for status, content, _ in found} == {(1, "old"), (0, "new")}
    assert all(left == [] for _, _, left in found)


@pytest.mark.realtime  # the recorder has a thread; nothing is asserted of its time
def test_a_recorder_ends_in_order_wherever_the_disk_fills(tmp_path: Path) -> None:
    """What was recorded stays beside the old file, and can be read as it is."""
    limits = [0, STEP, 5 * STEP, *range(SPARE, SPARE + 120_000, STEP)]
    found = outcomes(tmp_path / "disk" / "run.h5", "record", limits)
    kept = [left for status, content, left in found if (status, content) == (1, "old")]
    whole = [left for status, content, left in found if (status, content) == (0, "new")]
    assert len(kept) + len(whole) == len(found)
    assert whole
    assert all(left == [] for left in whole)
    assert kept[0] == []  # it could not even be created
    assert [1000] in kept  # the samples that had come when the disk refused are in it
