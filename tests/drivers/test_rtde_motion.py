from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from fake_ur_control import (
    CutOffControl,
    DyingControl,
    FakeControl,
    HangingControl,
    RefusingControl,
    UnwatchedControl,
    WatchedControl,
    hang,
    refuse,
)

from drivers.errors import ConnectionFailedError, ConnectionLostError
from drivers.rtde import motion as motion_module
from drivers.rtde.motion import MotionProcess

REPOSITORY = Path(__file__).resolve().parents[2]
HALT = ["servoStop", "stopJ", "stopScript", "disconnect"]


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return tmp_path / "control.log"


@pytest.fixture
def motion(log: Path) -> Iterator[MotionProcess]:
    process = MotionProcess(str(log), 500.0, 10.0, FakeControl)
    yield process
    process.stop()


def lines(log: Path) -> list[str]:
    return log.read_text().splitlines()


def wait_for(condition: object, limit: float = 5.0) -> bool:
    deadline = time.monotonic() + limit
    while time.monotonic() < deadline:
        if condition():  # type: ignore[operator]
            return True
        time.sleep(0.02)
    return False


def hold(motion: MotionProcess, commands: int, period: float, position: float = 0.0) -> None:
    for _ in range(commands):
        motion.command(np.full(6, position))
        time.sleep(period)


def alive(pid: int) -> bool:
    try:
        # A zombie is not alive; its parent has just not asked yet.
        return "State:\tZ" not in Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return False


def test_positions_reach_the_arm_and_stop_halts_it(motion: MotionProcess, log: Path) -> None:
    for index in range(50):
        motion.command(np.full(6, index / 100))
        time.sleep(0.002)
    assert motion.stop()
    written = lines(log)
    assert written[0] == f"control {motion.pid} 500"
    assert written[-4:] == HALT
    served = [float(line.split()[1]) for line in written[1:-4]]
    assert served == sorted(served)
    assert served[-1] == 0.49
    assert {line.split()[2] for line in written[1:-4]} == {"0.002"}
    assert motion.stop()  # safe twice


def test_only_six_finite_numbers_are_positions(motion: MotionProcess) -> None:
    for position in (np.zeros(5), np.zeros((1, 6)), np.full(6, np.nan), np.full(6, np.inf)):
        with pytest.raises(ValueError):
            motion.command(position)


def test_without_commands_the_arm_is_halted(motion: MotionProcess, log: Path) -> None:
    motion.command(np.zeros(6))
    assert wait_for(lambda: lines(log)[-4:] == HALT, motion_module.SILENCE_LIMIT + 2.0)
    with pytest.raises(ConnectionLostError, match=r"no command for 0\.5 s"):
        motion.command(np.zeros(6))


def test_a_refused_position_halts_the_arm_and_shows(log: Path) -> None:
    motion = MotionProcess(str(log), 500.0, 10.0, RefusingControl)
    with pytest.raises(ConnectionLostError, match="controller refused a position"):
        hold(motion, 100, 0.005, 2.0)
    assert motion.stop()
    assert lines(log)[-3:] == HALT[1:]


def test_a_process_that_dies_shows(log: Path) -> None:
    motion = MotionProcess(str(log), 500.0, 10.0, DyingControl)
    with pytest.raises(ConnectionLostError, match="motion process ended"):
        hold(motion, 100, 0.005)
    assert not motion.stop()


def test_a_process_that_hangs_shows_and_is_killed(log: Path) -> None:
    motion = MotionProcess(str(log), 500.0, 10.0, HangingControl)
    with pytest.raises(ConnectionLostError, match=r"commands unanswered for 0\.2 s"):
        hold(motion, 500, 0.0)
    assert not motion.stop()
    assert not alive(int(motion.pid or 0))


def test_a_silent_controller_costs_no_more_than_the_time_limit(log: Path) -> None:
    begun = time.monotonic()
    with pytest.raises(ConnectionFailedError, match=r"no control of the arm within 1\.5 s"):
        MotionProcess(str(log), 500.0, 1.5, hang)
    assert time.monotonic() - begun < 2.5
    assert not alive(int(lines(log)[0].split()[1]))


def test_why_control_was_refused_is_told(log: Path) -> None:
    with pytest.raises(ConnectionFailedError, match="not in remote control"):
        MotionProcess(str(log), 500.0, 10.0, refuse)


def test_a_stop_that_the_controller_did_not_confirm_is_none(log: Path) -> None:
    motion = MotionProcess(str(log), 500.0, 10.0, CutOffControl)
    motion.command(np.zeros(6))
    assert not motion.stop()
    assert lines(log)[-3:] == HALT[1:]


def test_the_controller_itself_is_told_to_watch(log: Path) -> None:
    motion = MotionProcess(str(log), 500.0, 10.0, WatchedControl)
    motion.stop()
    assert lines(log)[1:] == [f"setWatchdog {motion_module.WATCHDOG_RATE:g}", *HALT]
    assert 1.0 / motion_module.WATCHDOG_RATE > motion_module.SILENCE_LIMIT


def test_without_a_watchdog_there_is_no_motion(log: Path) -> None:
    with pytest.raises(ConnectionFailedError, match="refused the watchdog"):
        MotionProcess(str(log), 500.0, 10.0, UnwatchedControl)
    assert wait_for(lambda: lines(log)[-4:] == HALT)


def test_a_sigterm_to_the_process_group_is_the_parents_business(motion: MotionProcess, log: Path) -> None:
    motion.command(np.zeros(6))
    os.kill(int(motion.pid or 0), signal.SIGTERM)
    hold(motion, 20, 0.005)
    assert motion.stop()
    assert lines(log)[-4:] == HALT


def test_what_ur_rtde_prints_does_not_reach_standard_output(log: Path) -> None:
    script = f"from fake_ur_control import move_and_print\nif __name__ == '__main__': move_and_print({str(log)!r})"
    paths = os.pathsep.join([str(REPOSITORY), str(REPOSITORY / "tests" / "support")])
    done = subprocess.run(
        [sys.executable, "-c", script],
        env=os.environ | {"PYTHONPATH": paths},
        capture_output=True,
        text=True,
        timeout=20,
    )
    assert done.stdout == "only this\n"
    assert "Reconnecting..." in done.stderr


def test_the_real_client_against_a_silent_controller() -> None:
    import socket

    try:
        listener = socket.create_server(("127.0.0.77", 30004))
    except OSError as error:
        pytest.skip(f"no silent controller on 127.0.0.77:30004: {error}")
    with listener:
        begun = time.monotonic()
        with pytest.raises(ConnectionFailedError, match=r"no control of the arm within 2 s"):
            MotionProcess("127.0.0.77", 500.0, 2.0)
        assert 1.9 < time.monotonic() - begun < 3.5


@pytest.mark.parametrize("death", [signal.SIGKILL, signal.SIGSTOP])
def test_the_arm_is_halted_when_the_recording_process_dies_or_stands_still(log: Path, death: signal.Signals) -> None:
    script = f"from fake_ur_control import move_for_ever\nif __name__ == '__main__': move_for_ever({str(log)!r}, 20)"
    paths = os.pathsep.join([str(REPOSITORY), str(REPOSITORY / "tests" / "support")])
    parent = subprocess.Popen(
        [sys.executable, "-c", script],
        env=os.environ | {"PYTHONPATH": paths},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    try:
        assert parent.stdout is not None
        assert parent.stdout.readline() == "moving\n"
        child = int(lines(log)[0].split()[1])
        parent.send_signal(death)
        begun = time.monotonic()
        assert wait_for(lambda: lines(log)[-4:] == HALT, 3.0)
        assert time.monotonic() - begun < (1.5 if death == signal.SIGSTOP else 0.5)
        assert wait_for(lambda: not alive(child), 3.0)
    finally:
        parent.kill()
        parent.wait()
        if parent.stdout is not None:
            parent.stdout.close()
