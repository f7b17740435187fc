"""The disk fills at any byte of a recording: one line of error, no crash of HDF5, and the old file stays as it was."""

from __future__ import annotations

import json
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
STEP = 4096
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
    from drivers.errors import DynidError
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
        recorder.put(Batch("joints", time, time, {{"position": values}}))
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
    for limit in range(0, {size}, {step}):
        path.write_bytes(b"old")
        status = outcome(limit)
        content = "old" if path.exists() and path.read_bytes() == b"old" else "new"
        left = [other.name for other in path.parent.iterdir() if other != path]
        outcomes.append((status, content, left))
    print(json.dumps(outcomes))
"""


def outcomes(path: Path, job: str, size: int) -> list[tuple[int, str, list[str]]]:
    path.parent.mkdir()
    support = str(ROOT / "tests" / "support")
    program = textwrap.dedent(CHILD).format(
        root=str(ROOT), support=support, path=str(path), job=job, size=size, step=STEP
    )
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    return [(status, content, left) for status, content, left in json.loads(ended.stdout)]


def test_a_copy_is_whole_or_the_old_file_stays(tmp_path: Path) -> None:
    found = outcomes(tmp_path / "disk" / "run.h5", "write", 160_000)
    assert {(status, content) for status, content, _ in found} == {(1, "old"), (0, "new")}
    assert all(left == [] for _, _, left in found)


@pytest.mark.realtime  # the recorder has a thread; nothing is asserted of its time
def test_a_recorder_ends_in_order_wherever_the_disk_fills(tmp_path: Path) -> None:
    found = outcomes(tmp_path / "disk" / "run.h5", "record", 160_000)
    assert {status for status, _, _ in found} == {0, 1}
    assert all(left == [] for _, _, left in found)
