"""`dynid record` against a served arm over real RTDE: server and recorder each in their own process."""

from __future__ import annotations

import json
import os
import pty
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from rtde_bench import ENVIRONMENT, ROOT, BareClient, loopback, served

from daq.recording import read_recording
from daq.recover import recover
from daq.robot import load_robot

pytestmark = pytest.mark.realtime
COMMAND = "import sys; from drivers.command import main; sys.exit(main())"
STOPPED, PLAYING = 1, 2
"""runtime_state."""
REACHED = 0.02
"""How close [rad] the arm is to the last position of its motion when that has been sent."""


def dynid(*arguments: str) -> list[str]:
    """The command line of `dynid` in this interpreter."""
    return ["-c", COMMAND, *arguments]


def trajectory(folder: Path, duration: float, amplitude: float = 0.1, frequency: float = 2.0) -> Path:
    """A motion around the simulated arm's first pose; amplitude [rad], frequency [rad/s]."""
    path = folder / "trajectory.yaml"
    sines = {"amplitude": [[amplitude]] * 6, "frequency": [[frequency]] * 6, "offset": [0.0] * 6}
    path.write_text(yaml.safe_dump({"robot": "ur5e", "kind": "sines", "duration": duration, "ramp": 0.5, **sines}))
    return path


def changed_robot(folder: Path, change: Callable[[dict[str, Any]], object]) -> str:
    """The UR5e's robot file with every joint changed."""
    content = yaml.safe_load(load_robot("ur5e").text)
    for joint in content["joints"]:
        change(joint)
    path = folder / "changed.yaml"
    path.write_text(yaml.safe_dump(content, sort_keys=False))
    return str(path)


@contextmanager
def recording(
    host: str, out: Path, arguments: Sequence[str], robot: str = "ur5e", **others: Any
) -> Iterator[subprocess.Popen[str]]:
    """`dynid record` in a process of its own, which is ended with the block."""
    command = dynid("record", robot, "--host", host, "-o", str(out), *arguments)
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | others
    process = subprocess.Popen([sys.executable, *command], text=True, cwd=ROOT, env=ENVIRONMENT, **pipes)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


def wait_for_file(out: Path, process: subprocess.Popen[str]) -> None:
    """Until a recording has begun."""
    limit = time.monotonic() + 20.0
    while not out.exists() and process.poll() is None and time.monotonic() < limit:
        time.sleep(0.01)


def wait_for_motion(host: str) -> None:
    """Until the arm has been moving for a second."""
    with BareClient(host, 30004) as client:
        client.stream(["runtime_state", "actual_qd"])
        client.until(lambda row: row["runtime_state"] == PLAYING and np.any(np.abs(row["actual_qd"]) > 0.01), 20.0)
    time.sleep(1.0)


def state_after(host: str, seconds: float) -> tuple[int, float]:
    """The program's state so many seconds later, and how far a joint moves within the next 0.4 s [rad]."""
    time.sleep(seconds)
    with BareClient(host, 30004) as client:
        client.stream(["runtime_state", "actual_q"])
        rows = [client.row() for _ in range(200)]
    return int(rows[-1]["runtime_state"]), float(np.ptp([row["actual_q"] for row in rows], axis=0).max())


def recorded(
    out: Path, arguments: Sequence[str], fault: str | None = None, robot: str = "ur5e"
) -> tuple[int, str, str]:
    """Serve an arm, record it, type a fault a second after it began (to move); exit status and both outputs.

    A motion that was ended leaves the arm at rest and no program on the controller.
    """
    host = loopback()
    moves = "--trajectory" in arguments
    with served(*dynid("sim", "ur5e", "--host", host, "--no-ui")) as (ready, arm):
        assert ready["ready"] is True
        with recording(host, out, ["--no-ui", "--json", *arguments], robot) as process:
            if fault is not None:
                if moves:
                    wait_for_motion(host)
                else:
                    wait_for_file(out, process)
                    time.sleep(1.0)
                assert arm.stdin is not None
                print(fault, file=arm.stdin, flush=True)
            output, errors = process.communicate(timeout=30)
        if moves:
            state, moved = state_after(host, 0.3)
            assert state == STOPPED
            assert moved < 1e-3
    return process.returncode, output, errors


@pytest.mark.slow
def test_two_seconds_lose_nothing(tmp_path: Path) -> None:
    out = tmp_path / "run.h5"
    status, output, errors = recorded(out, ["--duration", "2"])
    assert (status, errors) == (0, "")
    joints = json.loads(output)["streams"]["joints"]
    assert (joints["lost"], joints["duplicates"]) == (0, 0)
    found = read_recording(out)
    stream = found.streams["joints"]
    assert found.complete
    assert 950 < len(stream.time) < 1200
    assert set(np.rint(np.diff(stream.time) * 500.0)) == {1.0}
    assert np.all(np.diff(stream.host_time) >= 0.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "reason"),
    [("protective-stop", "protective stop"), ("cut", "closed the connection"), ("freeze 3", "stale data")],
)
def test_a_fault_ends_the_motion_and_the_file_says_why(tmp_path: Path, fault: str, reason: str) -> None:
    out = tmp_path / "run.h5"
    status, output, errors = recorded(out, ["--trajectory", str(trajectory(tmp_path, 20.0))], fault)
    assert status == 1
    assert reason in json.loads(output)["stopped_by"]  # one object, and nothing of ur_rtde's
    assert errors.count("dynid: ") == 1
    assert "Traceback" not in errors
    assert_stopped(out, reason, within=0.2)


def assert_stopped(out: Path, reason: str, within: float) -> None:
    """A recording says why it ended, not later than so many seconds after its last sample."""
    found = read_recording(out)
    assert not found.complete
    joints = found.streams["joints"]
    assert len(joints.time) > 200
    (stopped,) = (event for event in found.events if event.source == "session")
    assert stopped.level == "error"
    assert stopped.message.startswith("stopped: ")
    assert reason in stopped.message
    assert stopped.time == pytest.approx(joints.time[-1], abs=within)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "change", "amplitude", "reason"),
    [
        ("block elbow_joint", {}, 0.4, "torque of elbow_joint"),
        ("block elbow_joint", {"torque": None}, 0.4, "tracking error of elbow_joint"),
        ("drift wrist_1_joint 0.2", {}, 0.1, "tracking error of wrist_1_joint"),
        ("drift wrist_1_joint 0.2", {"position": [-0.13, 0.13]}, 0.1, "position of wrist_1_joint"),
        ("drift wrist_1_joint 1.5", {"velocity": 0.5}, 0.1, "velocity of wrist_1_joint"),
    ],
)
def test_an_arm_that_does_not_do_what_it_is_told_is_stopped(
    tmp_path: Path, fault: str, change: dict[str, Any], amplitude: float, reason: str
) -> None:
    out = tmp_path / "run.h5"
    robot = changed_robot(tmp_path, lambda joint: joint.update(change))
    path = trajectory(tmp_path, 20.0, amplitude, 1.2)
    status, output, errors = recorded(out, ["--trajectory", str(path)], fault, robot)
    assert (status, errors.count("\n")) == (1, 1)
    assert reason in errors
    assert reason in json.loads(output)["stopped_by"]
    assert_stopped(out, reason, within=0.02)
    events = read_recording(out).events
    assert events[-1].message == "arm halted"


@pytest.mark.slow
def test_the_controllers_watchdog_ends_the_program_when_all_of_dynid_is_killed(tmp_path: Path) -> None:
    host, out = loopback(), tmp_path / "run.h5"
    arguments = ["--no-ui", "--trajectory", str(trajectory(tmp_path, 20.0))]
    with served(*dynid("sim", "ur5e", "--host", host, "--no-ui")):
        with recording(host, out, arguments, start_new_session=True) as process:
            wait_for_motion(host)
            os.killpg(process.pid, signal.SIGKILL)  # the motion process, too
        state, moved = state_after(host, 2.0)
    assert state == STOPPED
    assert moved < 1e-3
    rescued = recover(out, tmp_path / "rescued.h5").recording.streams["joints"]
    assert len(rescued.time) >= 250
    assert set(np.rint(np.diff(rescued.time) * 500.0)) == {1.0}


@pytest.mark.slow
def test_a_short_silence_while_only_recording_is_an_event(tmp_path: Path) -> None:
    out = tmp_path / "run.h5"
    status, output, errors = recorded(out, ["--duration", "3"], "freeze 0.3")
    assert (status, errors) == (0, "")
    assert json.loads(output)["streams"]["joints"]["lost"] == pytest.approx(150, abs=10)
    found = read_recording(out)
    assert found.complete
    assert sum("stale data of stream joints" in event.message for event in found.events) == 1


@pytest.mark.slow
def test_a_display_that_is_killed_costs_nothing(tmp_path: Path) -> None:
    host, out = loopback(), tmp_path / "run.h5"
    keyboard, terminal = pty.openpty()
    with (
        served(*dynid("sim", "ur5e", "--host", host, "--no-ui")),
        recording(host, out, ["--duration", "4"], stderr=terminal) as process,
    ):
        os.close(terminal)
        seen, killed = b"", 0
        while len(received := read_terminal(keyboard)) > 0:
            seen += received
            if not killed and seen.count(b" Hz, ") >= 6:
                killed = display_of(process.pid)
                os.kill(killed, signal.SIGKILL)
        output, _ = process.communicate(timeout=30)
    os.close(keyboard)
    assert killed, seen.decode(errors="replace")
    assert process.returncode == 0, seen.decode(errors="replace")
    assert "0 lost" in output
    assert b"Traceback" not in seen
    found = read_recording(out)
    assert found.complete
    assert set(np.rint(np.diff(found.streams["joints"].time) * 500.0)) == {1.0}


def read_terminal(keyboard: int) -> bytes:
    """What was drawn; nothing once nobody holds the terminal any more, which Linux calls an error."""
    try:
        return os.read(keyboard, 65536)
    except OSError:
        return b""


def display_of(process: int) -> int:
    """The process that draws for a recording: the child that was spawned to run Python, not to track resources."""
    for child in Path(f"/proc/{process}/task/{process}/children").read_text().split():
        if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes():
            return int(child)
    raise AssertionError("no display")


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
    found = read_recording(out)
    assert found.complete
    assert found.trajectory == path.read_text()
    assert [e.message for e in found.events if e.source == "player"][1:] == ["motion begins", "motion ends"]
    channels = found.streams["joints"].channels
    position, target = channels["position"].values, channels["target_position"].values
    assert np.ptp(position, axis=0).min() > 0.05  # every joint moved
    assert np.abs(position - target).max() < REACHED
