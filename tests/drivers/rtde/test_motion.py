"""The motion beside the recording: its rules in simulated time, and that a real process keeps them."""

from __future__ import annotations

import multiprocessing
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from fake_ur_control import (
    CutOffControl,
    DyingControl,
    FakeControl,
    RefusingControl,
    UnwatchedControl,
    WatchedControl,
    hang,
)
from rtde_bench import loopback
from rtde_in_process import MotionThread, PipeEnd
from simulated_clock import START, SimulatedClock

from drivers.core.clock import STALL_LIMIT
from drivers.core.errors import ConnectionFailedError, ConnectionLostError
from drivers.rtde.delayed_path import DELAY
from drivers.rtde.motion import (
    BACKLOG_LIMIT,
    PATIENCE,
    SILENCE_LIMIT,
    STOP_LIMIT,
    WATCHDOG_RATE,
    MotionProcess,
    start_process,
)

REPOSITORY = Path(__file__).resolve().parents[3]
HALT = ["servoStop", "stopJ", "stopScript", "disconnect"]
PERIOD = 0.002


class Bench:
    """Motions in threads of a simulated clock, and what their controls were asked, with the time since the start."""

    def __init__(self, clock: SimulatedClock) -> None:
        self.clock = clock
        self.said: list[tuple[float, str]] = []
        self.thread: MotionThread | None = None
        self.killed = clock.event()

    def move(self, control: type[FakeControl] = FakeControl, timeout: float = 10.0) -> MotionProcess:
        bench = self

        class Timed(control):  # type: ignore[valid-type,misc]
            def write(self, line: str) -> None:
                bench.said.append((bench.clock.now() - START, line))

        return MotionProcess("arm", 1.0 / PERIOD, timeout, Timed, self.start)

    def start(
        self, factory: Callable[[str, float], FakeControl], host: str, rate: float, timeout: float
    ) -> tuple[PipeEnd, MotionThread]:
        self.thread = MotionThread(self.clock, factory, host, rate, killed=self.killed.set)
        return self.thread.pipe, self.thread

    def hang(self) -> None:
        """Do nothing until this is killed, and then nothing more."""
        self.killed.wait()
        raise SystemExit(1)

    def lines(self) -> list[str]:
        return [line for _, line in self.said]


@pytest.fixture
def bench(clock: SimulatedClock) -> Bench:
    return Bench(clock)


def test_positions_reach_the_arm_a_fixed_time_later_and_stop_halts_it(bench: Bench) -> None:
    motion = bench.move()
    for index in range(200):
        motion.command(np.full(6, index / 100), bench.clock.now())
        bench.clock.sleep(PERIOD)
    assert motion.stop()
    assert bench.lines()[0].endswith(" 500")
    assert bench.lines()[-4:] == HALT
    served = bench.said[1:-4]
    when, targets = np.array([[time, float(line.split()[1])] for time, line in served]).T
    np.testing.assert_allclose(when, PERIOD * np.arange(1, len(when) + 1), atol=1e-9)
    np.testing.assert_allclose(targets, np.maximum(when - DELAY, 0.0) / PERIOD / 100, atol=1e-3)
    assert len(when) in (199, 200)
    assert bench.said[-1][0] == pytest.approx(200 * PERIOD)
    assert motion.stop()  # safe twice


@pytest.mark.parametrize("stall", [0.0, 0.004, 0.02, STALL_LIMIT])
def test_a_sender_that_stalls_and_makes_up_for_it_is_not_felt(bench: Bench, stall: float) -> None:
    """It sends more at once than the process may leave unanswered, and waits until it is no longer behind."""
    motion = bench.move()
    begun = bench.clock.now()
    for index in range(400):
        due = begun + index * PERIOD
        bench.clock.sleep_until(due + stall if index == 200 else due)
        motion.command(np.full(6, index * PERIOD), due)
    assert motion.stop()
    when, line = zip(*bench.said[1:-4], strict=True)
    targets = np.array([float(text.split()[1]) for text in line])
    np.testing.assert_allclose(targets, np.maximum(np.array(when) - DELAY, 0.0), atol=2e-3)
    np.testing.assert_allclose(
        np.diff(targets), np.diff(when) * (np.array(when[1:]) > DELAY + 1e-9), atol=0.03 * PERIOD
    )


def test_only_six_finite_numbers_are_positions(bench: Bench) -> None:
    motion = bench.move()
    for position in (np.zeros(5), np.zeros((1, 6)), np.full(6, np.nan), np.full(6, np.inf)):
        with pytest.raises(ValueError):
            motion.command(position, bench.clock.now())
    assert motion.stop()


def test_without_commands_the_arm_is_halted_when_the_limit_has_passed(bench: Bench) -> None:
    motion = bench.move()
    motion.command(np.zeros(6), bench.clock.now())
    bench.clock.sleep(SILENCE_LIMIT - PERIOD)
    motion.command(np.zeros(6), bench.clock.now())
    assert bench.lines()[-1] == "servoJ 0 0.002"
    bench.clock.sleep(2.0)
    halted = 2 * SILENCE_LIMIT - PERIOD
    assert [line for _, line in bench.said[-4:]] == HALT
    assert [when for when, _ in bench.said[-4:]] == pytest.approx([halted] * 4)
    with pytest.raises(ConnectionLostError, match=r"no command for 0\.5 s"):
        motion.command(np.zeros(6), bench.clock.now())
    assert motion.stop()


def test_a_recording_process_that_is_gone_halts_the_arm_at_once(bench: Bench) -> None:
    motion = bench.move()
    motion.command(np.zeros(6), bench.clock.now())
    bench.clock.sleep(0.1)
    assert bench.thread is not None
    bench.thread.pipe.close()
    bench.thread.join()
    assert bench.said[-4:] == [(pytest.approx(0.1), line) for line in HALT]


def test_a_refused_position_halts_the_arm_and_shows(bench: Bench) -> None:
    motion = bench.move(RefusingControl)
    motion.command(np.zeros(6), bench.clock.now())
    bench.clock.sleep(PERIOD)
    motion.command(np.full(6, 2.0), bench.clock.now())
    bench.clock.sleep(DELAY + 3.0 * PERIOD)
    with pytest.raises(ConnectionLostError, match="controller refused a position"):
        motion.command(np.full(6, 2.0), bench.clock.now())
    assert motion.stop()
    assert bench.said[-3:] == [(pytest.approx(DELAY, abs=4.0 * PERIOD), line) for line in HALT[1:]]


def test_a_process_that_hangs_shows_and_is_killed(bench: Bench) -> None:
    class Hanging(FakeControl):
        def servoJ(self, *_: object) -> bool:
            bench.hang()
            return True

    motion = bench.move(Hanging)
    motion.command(np.zeros(6), bench.clock.now())
    bench.clock.sleep(PERIOD)  # it answers what it took
    for _ in range(BACKLOG_LIMIT):
        motion.command(np.zeros(6), bench.clock.now())
    assert not bench.killed.is_set()
    begun = bench.clock.now()
    with pytest.raises(ConnectionLostError, match=r"commands unanswered for 0\.2 s"):
        motion.command(np.zeros(6), bench.clock.now())
    assert bench.clock.now() - begun == pytest.approx(PATIENCE)
    assert bench.killed.is_set()
    assert not motion.stop()


def test_an_arm_that_cannot_be_stopped_in_time_is_given_up(bench: Bench) -> None:
    class Hanging(FakeControl):
        def servoStop(self, a: float) -> bool:
            bench.hang()
            return True

    motion = bench.move(Hanging)
    motion.command(np.zeros(6), bench.clock.now())
    assert not motion.stop()
    assert bench.clock.now() == pytest.approx(START + STOP_LIMIT)
    assert bench.killed.is_set()


def test_a_silent_controller_costs_the_time_limit(bench: Bench) -> None:
    class Silent(FakeControl):
        def __init__(self, host: str, rate: float) -> None:
            bench.hang()

    with pytest.raises(ConnectionFailedError, match=r"no control of the arm within 1\.5 s"):
        bench.move(Silent, timeout=1.5)
    assert bench.clock.now() == pytest.approx(START + 1.5)
    assert bench.killed.is_set()


def test_why_control_was_refused_is_told(bench: Bench) -> None:
    class Refused(FakeControl):
        def __init__(self, host: str, rate: float) -> None:
            raise RuntimeError("robot is not in remote control")

    with pytest.raises(ConnectionFailedError, match="not in remote control"):
        bench.move(Refused)
    assert bench.clock.now() == START


def test_a_stop_that_the_controller_did_not_confirm_is_none(bench: Bench) -> None:
    motion = bench.move(CutOffControl)
    motion.command(np.zeros(6), bench.clock.now())
    assert not motion.stop()
    assert bench.lines()[-3:] == HALT[1:]


def test_the_controller_itself_is_told_to_watch(bench: Bench) -> None:
    motion = bench.move(WatchedControl)
    motion.stop()
    assert bench.lines()[1:] == [f"setWatchdog {WATCHDOG_RATE:g}", *HALT]
    assert 1.0 / WATCHDOG_RATE > SILENCE_LIMIT


def test_without_a_watchdog_there_is_no_motion(bench: Bench) -> None:
    with pytest.raises(ConnectionFailedError, match="refused the watchdog"):
        bench.move(UnwatchedControl)
    assert bench.lines()[-4:] == HALT


# From here on with real processes: nothing is asserted on how long anything takes.

LIMIT = 60.0


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return tmp_path / "control.log"


def lines(log: Path) -> list[str]:
    return log.read_text().splitlines() if log.exists() else []


def wait_for(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + LIMIT
    while not condition():
        assert time.monotonic() < deadline, "it did not happen"
        time.sleep(0.02)


def alive(pid: int) -> bool:
    try:
        # A zombie is not alive; its parent has just not asked yet.
        return "State:\tZ" not in Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return False


def script(call: str) -> tuple[list[str], dict[str, str]]:
    """Command line and environment of a process that makes a call of `fake_ur_control`."""
    paths = os.pathsep.join([str(REPOSITORY), str(REPOSITORY / "tests" / "support")])
    code = f"import fake_ur_control as control\nif __name__ == '__main__': control.{call}"
    return [sys.executable, "-c", code], os.environ | {"PYTHONPATH": paths}


@pytest.mark.realtime
def test_a_process_of_its_own_moves_the_arm_and_leaves_sigterm_to_its_parent(log: Path) -> None:
    motion = MotionProcess(str(log), 500.0, LIMIT, FakeControl)
    motion.command(np.full(6, 0.25), time.monotonic())
    wait_for(lambda: "servoJ 0.25 0.002" in lines(log))
    assert lines(log)[0] == f"control {motion.pid} 500"
    os.kill(int(motion.pid or 0), signal.SIGTERM)
    assert motion.stop()
    assert lines(log)[-4:] == HALT


@pytest.mark.realtime
def test_the_time_limit_for_control_begins_when_the_process_runs(log: Path) -> None:
    """Starting it takes longer than this limit on a busy computer."""
    pipe, worker = start_process(FakeControl, str(log), 500.0, LIMIT)
    assert pipe.poll(LIMIT)
    assert pipe.recv_bytes() == b"ready"
    pipe.send_bytes(b"stop")
    worker.join(LIMIT)
    assert worker.exitcode == 0


@pytest.mark.realtime
def test_a_process_that_dies_shows(log: Path) -> None:
    motion = MotionProcess(str(log), 500.0, LIMIT, DyingControl)
    motion.command(np.zeros(6), time.monotonic())
    wait_for(lambda: not alive(int(motion.pid or 0)))
    with pytest.raises(ConnectionLostError, match="motion process ended with exit status 3"):
        motion.command(np.zeros(6), time.monotonic())
    assert not motion.stop()


@pytest.mark.realtime
def test_a_process_that_hangs_is_killed(log: Path) -> None:
    with pytest.raises(ConnectionFailedError, match=r"no control of the arm"):
        MotionProcess(str(log), 500.0, 1.0, hang)
    assert multiprocessing.active_children() == []


@pytest.mark.realtime
def test_ur_rtde_itself_before_a_silent_controller_is_killed() -> None:
    host = loopback()
    with socket.create_server((host, 30004)), pytest.raises(ConnectionFailedError, match=r"no control of the arm"):
        MotionProcess(host, 500.0, 2.0)
    assert multiprocessing.active_children() == []


@pytest.mark.realtime
def test_what_ur_rtde_prints_does_not_reach_standard_output(log: Path) -> None:
    command, environment = script(f"move_and_print({str(log)!r})")
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=LIMIT)
    assert done.stdout == "only this\n"
    assert "Reconnecting..." in done.stderr


@pytest.mark.realtime
@pytest.mark.parametrize("death", [signal.SIGKILL, signal.SIGSTOP])
def test_the_arm_is_halted_when_the_recording_process_dies_or_stands_still(log: Path, death: signal.Signals) -> None:
    command, environment = script(f"move_for_ever({str(log)!r})")
    with subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as parent:
        try:
            assert parent.stdout is not None
            assert parent.stdout.readline() == "moving\n"
            child = int(lines(log)[0].split()[1])
            parent.send_signal(death)
            wait_for(lambda: lines(log)[-4:] == HALT)
            wait_for(lambda: not alive(child))
        finally:
            parent.kill()
