"""Recordings of a simulated arm that speaks a table of CAN frames, with faults, in simulated time; one for real."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import can
import numpy as np
import pytest
import yaml
from simulated_clock import START, SimulatedClock
from table_arm_bench import (
    CYCLE_TIME,
    JOINTS,
    POSE,
    ROBOT,
    ROBOT_FILE,
    STEP,
    connection_of,
    noted_by,
    opened,
    served,
    session,
)
from unchecked import unchecked_play

from daq.motion.trajectories import slow_move
from daq.output_files import unfinished_files
from daq.recording.reader import read_recording
from daq.recording.recording import Event, Recording
from daq.session.session import READ_TIMEOUT, SessionReport
from daq.session.supervisor import STALE_FLOOR
from drivers.can.bus import close_bus, open_bus
from drivers.can_signals.driver import SILENCE_LIMIT, STOP_LIMIT
from drivers.core.errors import ConnectionFailedError

RATE = 100.0
"""Half of the arm's own: each cycle costs processor time."""
PERIOD = 1 / RATE
FAULT_AT = 1.3
"""When a fault comes [s of the arm's counter]; a motion is under way."""
HALT_TIME = 0.1
"""What the arm takes to halt from that motion [s]."""
FAULTS_APART = 0.2
WAY = 0.3
"""Way of each joint [rad]."""
COMMAND = "import sys; from dynid.command import main; sys.exit(main())"
MINUTE = 60.0


@dataclass(frozen=True)
class Outcome:
    """What came of a recording, and what the plant did meanwhile and afterwards."""

    report: SessionReport  # of the session
    recording: Recording  # the file
    # position, velocity: (N, 6) of the plant in every cycle since the start
    position: np.ndarray
    velocity: np.ndarray
    enabled: bool  # whether the arm would follow commands afterwards

    @property
    def cycles(self) -> np.ndarray:
        """Those recorded, by their numbers."""
        return np.rint(self.recording.streams["joints"].time * RATE).astype(int)

    def events(self, level: str) -> list[Event]:
        return [event for event in self.recording.events if event.level == level]

    def rests_from(self, slower_than: float = 0.01) -> float:
        """When the arm came to rest for good [s of its counter]; it may settle at less than a velocity [rad/s]."""
        moving = np.flatnonzero(np.max(np.abs(self.velocity), axis=1) > slower_than)
        return float(moving[-1] + 1) * PERIOD


Recorded = Callable[..., Outcome]


@pytest.fixture
def recorded(clock: SimulatedClock, tmp_path: Path) -> Recorded:
    """Records the arm in a motion, or for some seconds; faults come from the cycle of `FAULT_AT` on."""

    def record(*faults: str, duration: float | None = None, stall: float = 0.0) -> Outcome:
        play = None if duration is not None else unchecked_play(slow_move(POSE, POSE + WAY, ROBOT.joints), ROBOT)
        rate = {"rate": RATE}
        with served(clock, **rate) as server, opened(connection_of(server) | rate, clock) as driver:
            for number, fault in enumerate(faults):
                # Cycle 0 is a period after the start; a fault is obeyed at the next cycle.
                clock.call_at(START + FAULT_AT + number * FAULTS_APART + PERIOD / 2, partial(server.obey, fault))
            if stall:
                clock.call_at(START + FAULT_AT, lambda: clock.stall(stall))
            report = session(tmp_path / "run.h5", driver, clock, play, duration)
            clock.sleep(0.5)
            cycles = np.arange(server.status().cycles)
            position, velocity = (noted_by(server, quantity, cycles) for quantity in ("position", "velocity"))
            enabled = server.status().enabled
        return Outcome(report, read_recording(tmp_path / "run.h5"), position, velocity, enabled)

    return record


def assert_true(outcome: Outcome) -> None:
    """What was recorded is what the plant did."""
    recorded = outcome.recording.streams["joints"].channels["position"].values
    assert np.max(np.abs(recorded - outcome.position[outcome.cycles])) <= STEP / 2


@pytest.mark.parametrize(
    ("fault", "rests"),
    [("freeze 1", 0.65), ("bus-off 1", 0.65), ("mute 0x182 1", STALE_FLOOR + READ_TIMEOUT + HALT_TIME)],
)
def test_an_arm_that_falls_silent_in_motion_is_stopped_and_comes_to_rest(
    recorded: Recorded, fault: str, rests: float
) -> None:
    """An arm that hears no stop frame either comes to rest by itself; it is off once it hears again."""
    outcome = recorded(fault)
    assert_true(outcome)
    silent = round(FAULT_AT * RATE)
    assert np.max(np.abs(outcome.velocity[silent])) > 0.2
    assert outcome.cycles[-1] == silent - 1
    assert not outcome.recording.complete
    (stopped,) = outcome.events("error")
    assert stopped.message.startswith("stopped: stale data of stream joints: ")
    assert outcome.report.stopped_by == stopped.message.removeprefix("stopped: ")
    silence = stopped.time - outcome.cycles[-1] * PERIOD
    assert STALE_FLOOR < silence < STALE_FLOOR + READ_TIMEOUT + CYCLE_TIME
    assert outcome.recording.events[-1].message == "arm halted"
    assert outcome.rests_from(0.03) < FAULT_AT + rests  # it settles when it hears the stop frames
    assert not outcome.enabled


def test_an_arm_that_does_not_show_that_it_rests_is_told(recorded: Recorded) -> None:
    outcome = recorded("freeze 4")
    stopped, unknown = outcome.events("error")
    assert stopped.message.startswith("stopped: stale data of stream joints: ")
    assert unknown.message == f"the arm did not show within {STOP_LIMIT:g} s of the stop frames that it is at rest"


def test_a_fault_that_the_arm_tells_stops_the_motion_in_its_cycle(recorded: Recorded) -> None:
    outcome = recorded("over-temperature 3")
    assert_true(outcome)
    assert outcome.report.stopped_by == f"fault of {JOINTS[2]}: 2"
    assert outcome.cycles[-1] == round(FAULT_AT * RATE)
    told, stopped = outcome.events("error")
    assert (told.source, told.message) == ("driver", f"fault of {JOINTS[2]}: 2")
    assert stopped.message == f"stopped: fault of {JOINTS[2]}: 2"
    assert FAULT_AT < told.time == stopped.time < FAULT_AT + CYCLE_TIME
    assert outcome.recording.events[-1].message == "arm halted"
    assert outcome.rests_from() < FAULT_AT + HALT_TIME
    assert not outcome.enabled


@pytest.mark.parametrize("quantity", ["position", "current"])
def test_a_channel_that_hangs_ends_the_motion(recorded: Recorded, quantity: str) -> None:
    outcome = recorded(f"stick {quantity} {JOINTS[2]}")
    what = f"stuck {'torque' if quantity == 'current' else quantity} of {JOINTS[2]}: "
    assert (outcome.report.stopped_by or "").startswith(what)
    assert any(event.message.startswith(what) for event in outcome.events("warning"))
    assert FAULT_AT < outcome.cycles[-1] * PERIOD < FAULT_AT + (0.4 if quantity == "position" else 1.0)
    assert outcome.rests_from() < outcome.cycles[-1] * PERIOD + HALT_TIME
    assert not outcome.enabled


@pytest.mark.parametrize("stall", [0.0, 0.012])
def test_what_is_over_in_time_costs_its_rows_and_stops_nothing(recorded: Recorded, stall: float) -> None:
    faults = ("drop 8", "truncate 8", "freeze 0.03") if not stall else ()
    costs = [1, 1, 3] if faults else []
    outcome = recorded(*faults, stall=stall)
    assert outcome.report.stopped_by is None
    assert outcome.recording.complete
    assert_true(outcome)
    steps = np.diff(outcome.cycles) - 1
    assert steps[steps > 0].tolist() == costs
    assert outcome.report.lost["joints"] == sum(costs)
    assert np.allclose(outcome.position[-1], POSE + WAY, atol=2e-3)
    assert not outcome.enabled


def test_random_frames_put_no_value_into_the_recording(recorded: Recorded) -> None:
    outcome = recorded("garbage 50", duration=2.0)
    assert outcome.report.stopped_by is None
    assert_true(outcome)


@pytest.mark.parametrize(
    ("fault", "missing"),
    [
        ("freeze 1", ""),
        ("mute 0x182 1", f": frame 0x182 (position of {JOINTS[2]}, position of {JOINTS[3]}) is missing"),
    ],
)
def test_a_silence_while_only_recorded_is_told_then_ends_the_session(
    recorded: Recorded, fault: str, missing: str
) -> None:
    outcome = recorded(fault, duration=5.0)
    assert_true(outcome)
    assert outcome.cycles[-1] == round(FAULT_AT * RATE) - 1
    assert outcome.report.error is not None
    assert outcome.report.error.message == f"no complete row of the joints for {SILENCE_LIMIT:g} s{missing}"
    stale, *_ = [event for event in outcome.events("warning") if event.source == "session"]
    (stopped,) = outcome.events("error")
    last = outcome.cycles[-1] * PERIOD
    assert stale.message.startswith("stale data of stream joints: ")
    for event, limit in ((stale, STALE_FLOOR), (stopped, SILENCE_LIMIT)):
        assert limit < event.time - last < limit + READ_TIMEOUT + CYCLE_TIME


@contextmanager
def program(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    """`dynid` in a process of its own, for a minute at most."""
    pipes: dict[str, int] = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[2]), "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-c", COMMAND, *arguments, "--no-ui"]
    process = subprocess.Popen(command, text=True, env=environment, **pipes)  # type: ignore[call-overload]
    limit = threading.Timer(MINUTE, process.kill)
    limit.start()
    try:
        yield process
    finally:
        limit.cancel()
        process.kill()
        process.communicate()


def slow_arm(path: Path) -> can.BusABC:
    """Write the file of an arm so slow that no stall of a computer counts as silence; its bus. Needs multicast."""
    content = yaml.safe_load(ROBOT_FILE.text)
    pid = os.getpid()
    group, port = f"239.76.{pid % 250}.{pid // 250 % 250 + 1}", 20000 + pid % 30000
    place = {"channel": group, "options": {"hop_limit": 0, "port": port}, "rate": 2, "timeout": MINUTE}
    content["connections"]["can"] |= place
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    try:
        bus = open_bus("udp_multicast", group, 1_000_000, {"port": port})
        bus.send(can.Message(arbitration_id=0x7FF, is_extended_id=False))
    except (ConnectionFailedError, can.CanOperationError) as error:
        pytest.skip(f"no multicast here: {error}")
    return bus


@pytest.mark.realtime
def test_a_recording_of_an_arm_in_another_process_ends_by_its_fault(tmp_path: Path) -> None:
    arm, out = tmp_path / "arm.yaml", tmp_path / "run.h5"
    bus = slow_arm(arm)
    with program("sim", str(arm), "--wire", "can") as simulator:
        assert simulator.stdin is not None
        assert simulator.stdout is not None
        assert '"ready": true' in simulator.stdout.readline()
        with program("record", str(arm), "--wire", "can", "--duration", "50", "-o", str(out)) as recorder:
            while not unfinished_files(out) and recorder.poll() is None:
                time.sleep(0.01)
            while bus.recv(0.0) is not None:
                pass
            heard = 0
            while heard < 2 and recorder.poll() is None:
                frame = bus.recv(0.1)
                heard += frame is not None and frame.arbitration_id == 0x181
            print("over-temperature 3", file=simulator.stdin, flush=True)
            errors = recorder.communicate()[1]
            assert recorder.returncode == 1
            assert errors == f"dynid: fault of {JOINTS[2]}: 2\n"
    close_bus(bus)
    recording = read_recording(out)
    assert not recording.complete
    assert f"stopped: fault of {JOINTS[2]}: 2" in [event.message for event in recording.events]
    assert np.allclose(np.diff(recording.streams["joints"].time), 0.5)  # by the arm's own counter: none is lost
