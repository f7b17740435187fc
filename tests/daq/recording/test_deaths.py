"""Whoever writes a recording may die at any step: in its place is the old one or the new one, whole."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from file_faults import deaths
from kinematic_arm import NAMES, ROBOT_FILE

from daq.output_files import unfinished_files
from daq.recording.reader import read_recording
from daq.recording.recording import Channel, Recording, Stream
from daq.recording.writer import RecordingWriter, write_recording
from drivers.streams import ChannelLayout, StreamLayout

SAMPLES = 300
TIME = np.arange(SAMPLES) / 500.0
VALUES = np.stack([TIME, -TIME], axis=1)
STREAM = Stream("joints", TIME, TIME, {"position": Channel("position", VALUES, "rad", NAMES, "")})
RECORDING = Recording(
    robot_text=ROBOT_FILE.text,
    urdf_text="",
    streams={"joints": STREAM},
    events=(),
    created="",
    versions={},
    host="",
    comment="",
)


def copied(path: Path) -> None:
    write_recording(path, RECORDING, overwrite=True)


def recorded(path: Path) -> None:
    layout = StreamLayout("joints", (ChannelLayout("position", NAMES),), 500.0)
    writer = RecordingWriter(path, ROBOT_FILE, [layout], overwrite=True)
    writer.allow_readers()
    for rows in np.split(np.arange(SAMPLES), 3):
        writer.reserve({"joints": len(rows)})
        writer.append("joints", TIME[rows], TIME[rows], {"position": VALUES[rows]})
        writer.flush()
    writer.close(complete=True)


@pytest.mark.parametrize("old", [False, True])
@pytest.mark.parametrize("job", [copied, recorded])
def test_a_recording_is_the_old_one_or_the_new_one(tmp_path: Path, job: Callable[[Path], None], old: bool) -> None:
    path = tmp_path / "run.h5"

    def prepare() -> None:
        for file in tmp_path.iterdir():
            file.unlink()
        if old:
            path.write_bytes(b"old")

    prepare()
    found = set()
    for _ in deaths(lambda: job(path), ("posix_fallocate", "fsync", "link", "replace", "unlink")):
        beside = unfinished_files(path)
        others = [file for file in tmp_path.iterdir() if file not in beside]
        assert others == ([path] if path.exists() else [])
        if not path.exists() or path.read_bytes() == b"old":
            assert path.exists() == old
            found.add("old")
        else:
            assert len(read_recording(path).streams["joints"].time) == SAMPLES
            found.add("new")
        prepare()
    assert "old" in found
    assert len(read_recording(path).streams["joints"].time) == SAMPLES
