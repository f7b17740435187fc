"""After a contact that ended a motion the arm goes a short way back, slowly, once, and holds."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from canopen_recording import arm_on_bus
from motor_bench import START, MotorBench, motors, robot_file
from recorded_session import record_session
from rtde_in_process import NOWHERE, opened, serving
from simulated_clock import SimulatedClock
from unchecked import unchecked_play

from daq.motion.player import MotionSequence
from daq.motion.trajectories import slow_move
from daq.recording.reader import read_recording
from daq.recording.recording import Recording
from daq.robot.loader import RobotFile, load_robot
from daq.session.retract import SPEED, WAY, way_back
from daq.session.session import SessionReport
from drivers.base import Driver
from drivers.core.errors import MotionRefusedError, SafetyStopError
from drivers.streams import Batch, StreamLayout
from sim_drivers.plant.plant import Plant
from sim_drivers.rtde.server import RtdeServer

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
    file, robot, clock = robot_file(), robot_file().robot, bench.clock
    play = unchecked_play(slow_move(START, GOAL, robot.joints, 0.3), robot)
    with bench.opened() as driver:
        report = record_session(path, file, driver, play, trajectory="played", clock=clock, watch=watch, retracts=True)
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


def test_drives_on_canopen_are_switched_on_once_more_for_the_way_back(tmp_path: Path) -> None:
    with arm_on_bus(drives=2) as bench:
        said = way_back_of(bench.driver, bench.robot_file, bench.plant.position, bench.clock, tmp_path / "run.h5", 90)
        assert said == ["contact: elbow", "goes back", "went back, and holds"]
        assert bench.rests()


def test_a_ur_arm_is_controlled_once_more_for_the_way_back(clock: SimulatedClock, tmp_path: Path) -> None:
    file = load_robot("ur5e")
    plant = Plant(file, seed=1)
    server = RtdeServer(plant, ports=NOWHERE, joints=file.robot.joints, clock=clock)
    with serving(server) as network:
        with opened(file.robot, network.connect, clock) as driver:
            said = way_back_of(driver, file, plant.position, clock, tmp_path / "run.h5", 450)
        assert said == ["contact: elbow", "goes back", "went back, and holds"]
        assert server.controller.script is None  # and no program is left


def way_back_of(
    driver: Driver, file: RobotFile, start: np.ndarray, clock: SimulatedClock, path: Path, sample: int
) -> list[str]:
    """What the monitor's events say of a motion that touches something at a sample."""
    goal = start + 0.3 * np.cos(np.arange(file.robot.dof))
    play, watch = unchecked_play(slow_move(start, goal, file.robot.joints, 0.3), file.robot), Touching(sample)
    record_session(path, file, driver, play, trajectory="played", clock=clock, watch=watch, retracts=True)
    said = [event.message for event in read_recording(path).events if event.source == "monitor"]
    return [message.split(" for ")[0] for message in said]


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
    with pytest.raises(MotionRefusedError, match="away from its path"):
        way_back(here + 0.5, path, elapsed, joints)
    # Touched before it had gone far, it goes back to where it began.
    early = path.positions(np.array([0.2]))[0]
    assert way_back(early, path, 0.2, joints).evaluate(np.array([99.0]))[0][:, 0] == pytest.approx(START, abs=1e-3)
