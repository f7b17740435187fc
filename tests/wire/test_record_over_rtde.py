"""`dynid record` against a served arm over real RTDE: server and recorder each in their own process."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import yaml
from rtde_bench import ENVIRONMENT, ROOT, loopback, served

from daq.recording import read_recording

COMMAND = "import sys; from drivers.command import main; sys.exit(main())"
REACHED = 0.02
"""How close [rad] the arm is to the last position of its motion when that has been sent."""


def dynid(*arguments: str) -> list[str]:
    """The command line of `dynid` in this interpreter."""
    return ["-c", COMMAND, *arguments]


def trajectory(folder: Path, duration: float) -> Path:
    """A small motion around the simulated arm's first pose."""
    path = folder / "trajectory.yaml"
    sines = {"amplitude": [[0.1]] * 6, "frequency": [[2.0]] * 6, "offset": [0.0] * 6}
    path.write_text(yaml.safe_dump({"robot": "ur5e", "kind": "sines", "duration": duration, "ramp": 0.5, **sines}))
    return path


def recorded(out: Path, arguments: Sequence[str], fault: str | None = None) -> tuple[int, str, str]:
    """Serve an arm, record it, type a fault a second after the file appeared; exit status and both outputs."""
    host = loopback()
    with served(*dynid("sim", "ur5e", "--host", host, "--no-ui")) as (ready, arm):
        assert ready["ready"] is True
        process = subprocess.Popen(
            [sys.executable, *dynid("record", "ur5e", "--host", host, "-o", str(out), "--no-ui", "--json", *arguments)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=ROOT,
            env=ENVIRONMENT,
        )
        try:
            if fault is not None:
                limit = time.monotonic() + 20.0
                while not out.exists() and process.poll() is None and time.monotonic() < limit:
                    time.sleep(0.01)
                time.sleep(1.0)
                assert arm.stdin is not None
                print(fault, file=arm.stdin, flush=True)
            output, errors = process.communicate(timeout=30)
        finally:
            if process.poll() is None:
                process.kill()
                process.communicate()
    return process.returncode, output, errors


@pytest.mark.slow
def test_two_seconds_lose_nothing(tmp_path: Path) -> None:
    out = tmp_path / "run.h5"
    status, output, errors = recorded(out, ["--duration", "2"])
    assert (status, errors) == (0, "")
    joints = json.loads(output)["streams"]["joints"]
    assert (joints["lost"], joints["duplicates"]) == (0, 0)
    recording = read_recording(out)
    stream = recording.streams["joints"]
    assert recording.complete
    assert 950 < len(stream.time) < 1200
    assert set(np.rint(np.diff(stream.time) * 500.0)) == {1.0}
    assert np.all(np.diff(stream.host_time) >= 0.0)


@pytest.mark.slow
@pytest.mark.parametrize(("fault", "reason"), [("protective-stop", "protective stop"), ("cut", "connection")])
def test_a_fault_ends_the_motion_and_the_file_says_why(tmp_path: Path, fault: str, reason: str) -> None:
    out = tmp_path / "run.h5"
    status, _, errors = recorded(out, ["--trajectory", str(trajectory(tmp_path, 20.0))], fault)
    assert status == 1
    assert errors.count("dynid: ") == 1
    assert "Traceback" not in errors
    recording = read_recording(out)
    assert not recording.complete
    assert len(recording.streams["joints"].time) > 200
    last = [event for event in recording.events if event.source == "session"][-1]
    assert last.level == "error"
    assert last.message.startswith("stopped: ")
    assert reason in last.message.lower()


@pytest.mark.slow
def test_dropped_packages_are_counted_and_do_not_end_the_recording(tmp_path: Path) -> None:
    out = tmp_path / "run.h5"
    status, output, _ = recorded(out, ["--duration", "3"], "drop 7")
    assert status == 0
    assert json.loads(output)["streams"]["joints"]["lost"] == 7
    assert [event.message for event in read_recording(out).events if event.source == "joints"] == ["7 samples lost"]


@pytest.mark.slow
def test_a_trajectory_is_played_to_its_end(tmp_path: Path) -> None:
    out = tmp_path / "run.h5"
    path = trajectory(tmp_path, 2.0)
    status, output, errors = recorded(out, ["--trajectory", str(path)])
    assert (status, errors) == (0, "")
    assert json.loads(output)["punctuality"] is not None
    recording = read_recording(out)
    assert recording.complete
    assert recording.trajectory == path.read_text()
    assert [e.message for e in recording.events if e.source == "player"][1:] == ["motion begins", "motion ends"]
    channels = recording.streams["joints"].channels
    position, target = channels["position"].values, channels["target_position"].values
    assert np.ptp(position, axis=0).min() > 0.05  # every joint moved
    assert np.abs(position - target).max() < REACHED
