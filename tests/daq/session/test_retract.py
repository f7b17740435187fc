"""After a contact that ended a motion the arm goes a short way back, slowly, once, and holds."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from motor_bench import START, MotorBench, motors, robot_file
from simulated_clock import SimulatedClock
from unchecked import unchecked_play

from daq.motion.player import MotionSequence
from daq.motion.trajectories import slow_move
from daq.recording.reader import read_recording
from daq.recording.recorder import Recorder
from daq.recording.recording import Recording
from daq.session.retract import SPEED, WAY, way_back
from daq.session.session import SessionReport, record
from daq.session.supervisor import Limits, Supervisor
from drivers.core.errors import MotionRefusedError, SafetyStopError
from drivers.streams import Batch, StreamLayout

GOAL = START + [0.8, -0.6]


class Touching:
    """A watch that notices a contact at a sample, which lasts; perhaps another one later."""

    def __init__(self, sample: int, again: int = 10**9) -> None:
        self.due, self.samples, self.told = [sample, again], 0, 0

    def begin(self, layouts: Sequence[StreamLayout]) -> None:
        pass

    def add(self, batch: Batch) -> None:
        self.samples += len(batch.time) * (batch.stream == "joints")

    def events(self) -> list[tuple[float, str]]:
        if self.told == 2 or self.samples < self.due[self.told]:
            return []
        self.told += 1
        return [(0.0, "contact: elbow")]

    def stop_reason(self) -> str:
        return "contact: elbow" if self.told else ""

    def lines(self) -> list[str]:
        return []


def touched(bench: MotorBench, path: Path, watch: Touching) -> tuple[SessionReport, Recording]:
    robot = robot_file().robot
    play = unchecked_play(slow_move(START, GOAL, robot.joints, 0.3), robot)
    with bench.opened() as driver:
        layouts = driver.streams()
        recorder = Recorder(path, robot_file(), layouts, trajectory="played", clock=bench.clock)
        supervisor = Supervisor(Limits.of_robot(robot), layouts)
        report = record(driver, recorder, supervisor, play, clock=bench.clock, watch=watch, retracts=True)
    assert report.file is not None
    return report, read_recording(report.file)


def test_it_goes_back_and_holds(clock: SimulatedClock, tmp_path: Path) -> None:
    with motors(clock) as bench:
        report, run = touched(bench, tmp_path / "run.h5", Touching(100))
        assert isinstance(report.error, SafetyStopError)  # the session failed all the same
        assert all(motor.enabled for motor in bench.server.motors)
        said = [event.message for event in run.events if event.source == "monitor"]
        assert said[0] == "contact: elbow"
        assert said[-1] == "went back, and holds"
        stream = run.streams["joints"]
        position = stream.channels["position"].values
        begun = next(event.time for event in run.events if "goes back" in event.message)
        back = position[stream.time >= begun]
        assert np.max(np.abs(back[-1] - back[0])) == pytest.approx(WAY, abs=0.05)
        assert np.max(np.abs(np.diff(back, axis=0))) * 100.0 < 2.0 * SPEED
        here = bench.server.plant.arm.position.copy()
        clock.sleep(2.0)  # and nothing goes on by itself
        assert bench.server.plant.arm.position == pytest.approx(here, abs=1e-3)


def test_another_contact_ends_the_way_back(clock: SimulatedClock, tmp_path: Path) -> None:
    with motors(clock) as bench:
        _, run = touched(bench, tmp_path / "run.h5", Touching(90, again=200))
        said = [event.message for event in run.events if event.source == "monitor"]
        assert said[-1].startswith("did not go back as planned: contact: elbow"), said
        assert np.max(np.abs(bench.server.plant.arm.velocity)) < 0.05


def test_an_arm_that_fell_is_not_moved(clock: SimulatedClock, tmp_path: Path) -> None:
    with motors(clock, on_stop="limp") as bench:
        _, run = touched(bench, tmp_path / "run.h5", Touching(100))
        said = [event.message for event in run.events if event.source == "monitor"]
        assert "did not go back as planned" in said[-1]
        assert not any(motor.enabled for motor in bench.server.motors)


def test_the_way_back_is_the_way_it_came() -> None:
    joints = robot_file().robot.joints
    path = MotionSequence([slow_move(START, GOAL, joints, 0.3)], 100.0)
    elapsed = 0.7 * path.duration
    here = path.positions(np.array([elapsed]))[0] + [0.01, -0.02]
    move = way_back(here, path, elapsed, joints)
    positions, velocities, _ = move.evaluate(np.linspace(0.0, move.duration, 200))
    passed = path.positions(np.linspace(0.0, elapsed, 500))
    off = np.abs(positions.T[:, None] - passed[None]).max(axis=2).min(axis=1)
    assert off.max() < 0.03
    assert np.max(np.abs(velocities)) <= SPEED * (1.0 + 1e-9)
    assert np.max(np.abs(positions[:, -1] - passed[-1])) == pytest.approx(WAY, abs=0.02)
    with pytest.raises(MotionRefusedError, match="from the motion that it came by"):
        way_back(here + 0.5, path, elapsed, joints)
    # Touched before it had gone far, it goes back to where it began.
    early = path.positions(np.array([0.2]))[0]
    assert way_back(early, path, 0.2, joints).evaluate(np.array([99.0]))[0][:, 0] == pytest.approx(START, abs=1e-3)
