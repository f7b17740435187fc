"""Recording over RTDE: every sample against the plant in simulated time, `dynid record` as a process in real time."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from rtde_bench import ENVIRONMENT, LIMIT, ROOT, connected, loopback, served
from rtde_in_process import HOST, NOWHERE, Motions, PythonControl, RememberedArm, TakesControl, own_program, serving
from simulated_clock import START, SimulatedClock, simulated_time
from unchecked import unchecked_play

from daq.motion.trajectory_file import load_trajectory
from daq.recording.reader import read_recording
from daq.recording.recorder import Recorder
from daq.recording.recording import Recording
from daq.recording.recover import half_written, recover
from daq.robot.loader import RobotFile, load_robot
from daq.session.connections import driver_settings
from daq.session.session import READ_TIMEOUT, SessionReport, record
from daq.session.supervisor import STALE_FLOOR, TRACKING_ERROR, TRACKING_WINDOW, VELOCITY_MARGIN, Limits, Supervisor
from drivers.core.errors import ConnectionLostError, SafetyStopError
from drivers.rtde.driver import RtdeDriver
from drivers.rtde.receiver import SILENCE_LIMIT, TOGETHER, UNMOVED
from sim_drivers.faults import parse_fault
from sim_drivers.plant.plant import Plant, PlantSettings
from sim_drivers.rtde.server import RtdeServer, ServerStatus

RATE = 500.0
PERIOD = 1.0 / RATE
FAULT = 1.7611
"""When something goes wrong [s after the start], in mid-motion."""
LATER = 2.2611
"""The same, for what only shows once the arm has moved for a while."""
NEXT_PERIOD = 1.762
"""The controller's first period after that; its sample is stamped one period later by the controller."""
STOPPED, PLAYING = 1, 2
"""runtime_state."""
REACHED = 0.02
"""How close [rad] the arm is to the last position of its motion when that has been sent."""


FAST = (0.8, 2.0)
"""Amplitude [rad] and frequency [rad/s] of a motion that reaches 1.6 rad/s."""


def trajectory(folder: Path, duration: float, amplitude: float = 0.1, frequency: float = 2.0) -> Path:
    """A motion around the simulated arm's first pose; amplitude [rad], frequency [rad/s]."""
    path = folder / "trajectory.yaml"
    sines = {"amplitude": [[amplitude]] * 6, "frequency": [[frequency]] * 6, "offset": [0.0] * 6}
    path.write_text(yaml.safe_dump({"robot": "ur5e", "kind": "sines", "duration": duration, "ramp": 0.5, **sines}))
    return path


@cache
def ur5e() -> RobotFile:
    return load_robot("ur5e")


def changed_robot(folder: Path, change: dict[str, Any], timeout: float = 5.0, rate: float = RATE) -> RobotFile:
    """The UR5e with every joint changed, a time limit [s] for taking control of it, and a rate of samples [Hz]."""
    content = yaml.safe_load(ur5e().text)
    content["connections"]["rtde"] |= {"timeout": timeout, "rate": rate}
    content["model"]["mounting"] = "free"  # its first pose, stretched out, is nearer to a table than what is kept
    for joint in content["joints"]:
        joint.update(change)
    path = folder / "changed.yaml"
    path.write_text(yaml.safe_dump(content, sort_keys=False))
    return load_robot(str(path))


class Informed(Supervisor):
    """Keeps what was commanded."""

    def __init__(self, commands: list[tuple[float, np.ndarray]], *arguments: Any) -> None:
        super().__init__(*arguments)
        self._kept = commands

    def commanded(self, host_time: float, position: np.ndarray, lag: float = 0.0) -> None:
        self._kept.append((host_time, position))
        super().commanded(host_time, position, lag)


class Bench:
    """A simulated UR5e and its recorder in one process, in simulated time.

    After `record`: `arm` is what the sensors gave, `commands` the positions that were sent and when [s, host clock],
    `recording` what the file has, `status` the server's, `ended` when the session ended, `playing` and `velocity` the
    program's state and the fastest joint half a second later.
    """

    def __init__(self, clock: SimulatedClock, folder: Path, control: TakesControl = PythonControl) -> None:
        self.clock = clock
        self.control = control
        self.folder = folder
        self.out = folder / "run.h5"
        self.plant = Plant(ur5e(), PlantSettings(step=PERIOD, control_steps=1), seed=1)
        self.arm = RememberedArm(self.plant)
        self.server = RtdeServer(self.arm, ports=NOWHERE, joints=ur5e().robot.joints, clock=clock)
        self.commands: list[tuple[float, np.ndarray]] = []
        self.motions: Motions | None = None
        self.recording: Recording
        self.status: ServerStatus
        self.ended = self.velocity = 0.0
        self.playing = False

    def fault(self, line: str, when: float = FAULT) -> None:
        """Type a fault so many seconds after the start."""
        fault = parse_fault(line, "UR controller", ur5e().robot.joint_names)
        self.clock.call_at(START + when, lambda: self.server.cause(fault))

    def record(
        self, moved: Path | None = None, duration: float | None = None, robot: RobotFile | None = None
    ) -> SessionReport:
        robot = robot or ur5e()
        played = load_trajectory(moved, robot.robot) if moved is not None else None
        with serving(self.server) as network:
            self.motions = Motions(self.clock, network.connect, self.control)
            settings = replace(driver_settings(robot.robot, {"host": HOST}), clock=self.clock)
            driver = RtdeDriver(settings, network.connect, self.motions.take_control)
            driver.open()
            layouts = driver.streams()
            text = played.text if played is not None else ""
            recorder = Recorder(self.out, robot, layouts, trajectory=text, clock=self.clock)
            supervisor = Informed(self.commands, Limits.of_robot(robot.robot), layouts)
            play = unchecked_play(played.motion, robot.robot) if played is not None else None
            report = record(driver, recorder, supervisor, play, duration, clock=self.clock)
            self.ended = self.clock.now() - START
            driver.close()
            self.clock.sleep(0.5)
            self.status = self.server.status()
            self.playing = self.server.controller.script is not None
            self.velocity = float(np.abs(self.plant.velocity).max())
        self.recording = read_recording(self.out)
        self.assert_every_sample_is_the_plants()
        return report

    def assert_every_sample_is_the_plants(self) -> None:
        for name, quantities in (
            ("joints", ("position", "velocity", "current", "target_position")),
            ("thermal", ("temperature",)),
        ):
            stream = self.recording.streams[name]
            index = np.rint(stream.time * RATE).astype(int)
            assert np.array_equal(stream.time, np.array(self.arm.times)[index])
            for quantity in quantities:
                assert np.array_equal(stream.channels[quantity].values, self.arm.values(quantity)[index]), quantity

    def times(self) -> np.ndarray:
        return self.recording.streams["joints"].time

    def stop_event(self) -> tuple[float, str]:
        """Time [s] and words of what ended the session."""
        (stopped,) = (event for event in self.recording.events if event.source == "session")
        assert stopped.level == "error"
        return stopped.time, stopped.message

    def assert_stopped(self, report: SessionReport) -> None:
        """It says why, the file ends in order, no program is left and the arm stands."""
        assert report.error is not None
        assert report.stopped_by == str(report.error)
        assert self.stop_event()[1] == f"stopped: {report.stopped_by}"
        assert not self.recording.complete
        assert not self.playing
        assert self.velocity < 2e-3  # it creeps where its friction holds it


@pytest.fixture
def bench(clock: SimulatedClock, tmp_path: Path, request: pytest.FixtureRequest) -> Bench:
    return Bench(clock, tmp_path, getattr(request, "param", PythonControl))


either_control = pytest.mark.parametrize("bench", [PythonControl, own_program], indirect=True)
"""Motion by ur_rtde's program and by dynid's own."""


def assert_no_sample_is_missing(time: np.ndarray, rate: float = RATE) -> None:
    assert set(np.rint(np.diff(time) * rate)) == {1.0}


def test_what_is_recorded_is_what_the_plant_measured(bench: Bench) -> None:
    report = bench.record(duration=1.0)
    assert (report.stopped_by, report.overflow) == (None, 0)
    assert report.lost == {"joints": 0, "thermal": 0, "status": 0}
    assert bench.recording.complete
    assert_no_sample_is_missing(bench.times())
    assert 500 <= len(bench.times()) <= 500 + round(UNMOVED / PERIOD)  # whole reads
    assert len(bench.recording.streams["thermal"].time) in (20, 21)
    assert len(bench.recording.streams["status"].time) in (10, 11)
    host = bench.recording.streams["joints"].host_time
    np.testing.assert_allclose(host - START, bench.times() - PERIOD, rtol=0.0, atol=1e-9)


@either_control
def test_a_trajectory_is_played_to_its_end(bench: Bench, tmp_path: Path) -> None:
    path = trajectory(tmp_path, 1.0)
    report = bench.record(path)
    assert report.stopped_by is None
    assert report.punctuality is not None
    assert (report.punctuality.skipped, report.punctuality.delayed_ms) == (0, 0.0)
    assert report.punctuality.max_ms < 1e-6
    assert bench.recording.complete
    assert bench.recording.trajectory == path.read_text()
    events = [(event.source, event.message) for event in bench.recording.events]
    assert [message for source, message in events if source == "player"][1:] == ["motion begins", "motion ends"]
    assert events[-1] == ("driver", "arm halted")
    assert_no_sample_is_missing(bench.times())
    channels = bench.recording.streams["joints"].channels
    position, target = channels["position"].values, channels["target_position"].values
    assert np.ptp(position, axis=0).min() > 0.05  # every joint moved
    assert np.abs(position - target).max() < REACHED
    assert not bench.playing
    assert bench.velocity < 1e-3


def test_a_protective_stop_ends_the_motion_with_the_samples_that_show_it(bench: Bench, tmp_path: Path) -> None:
    bench.fault("protective-stop")
    report = bench.record(trajectory(tmp_path, 20.0))
    bench.assert_stopped(report)
    assert "protective stop" in str(report.stopped_by)
    assert bench.stop_event()[0] == pytest.approx(NEXT_PERIOD + PERIOD)
    assert 0.0 <= bench.times()[-1] - bench.stop_event()[0] < TOGETHER - 1e-9
    assert bench.status.safety_mode == 3


def test_a_cut_connection_ends_the_motion_at_once(bench: Bench, tmp_path: Path) -> None:
    bench.fault("cut")
    report = bench.record(trajectory(tmp_path, 20.0))
    bench.assert_stopped(report)
    # Either end of the motion may be the first to notice, in the same period.
    assert isinstance(report.error, ConnectionLostError)
    assert bench.times()[-1] == pytest.approx(NEXT_PERIOD)
    assert bench.stop_event()[0] == pytest.approx(NEXT_PERIOD + PERIOD)


@either_control
def test_a_silent_controller_is_stopped_when_its_data_are_stale(bench: Bench, tmp_path: Path) -> None:
    bench.fault("freeze 3")
    report = bench.record(trajectory(tmp_path, 20.0))
    bench.assert_stopped(report)
    assert isinstance(report.error, SafetyStopError)
    assert "stale data of stream joints" in str(report.stopped_by)
    assert bench.times()[-1] == pytest.approx(NEXT_PERIOD)
    silence = bench.stop_event()[0] - bench.times()[-1]
    # The last sample may wait for a whole read, and the limit is looked at after each.
    assert STALE_FLOOR < silence < STALE_FLOOR + 2 * READ_TIMEOUT + 1e-9
    # The controller confirms the stop when it can: its watchdog has ended the program meanwhile.
    assert bench.ended == pytest.approx(NEXT_PERIOD + 3.0)


def test_a_motion_process_that_is_killed_ends_the_motion(bench: Bench, tmp_path: Path) -> None:
    def kill() -> None:
        assert bench.motions is not None
        bench.motions.kill()

    bench.clock.call_at(START + FAULT, kill)
    report = bench.record(trajectory(tmp_path, 20.0))
    bench.assert_stopped(report)
    assert "motion process ended" in str(report.stopped_by)
    # The player's next position finds it gone; the session sees that with the next samples, and looks once more.
    assert bench.stop_event()[0] == pytest.approx(bench.times()[-1])
    assert NEXT_PERIOD < bench.times()[-1] <= NEXT_PERIOD + 2.0 * TOGETHER + 1e-9
    assert any("was ended by its dashboard" in event.message for event in bench.recording.events)


@pytest.mark.parametrize(
    ("fault", "change", "amplitude", "reason"),
    [
        ("block elbow_joint", {}, 0.4, "torque of elbow_joint"),
        ("drift wrist_1_joint 0.2", {}, 0.1, "tracking error of wrist_1_joint"),
        ("drift wrist_1_joint 0.2", {"position": [-0.13, 0.13]}, 0.1, "position of wrist_1_joint"),
        ("drift wrist_1_joint 1.5", {"velocity": 0.5}, 0.1, "velocity of wrist_1_joint"),
    ],
)
def test_an_arm_that_does_not_do_what_it_is_told_is_stopped_with_the_samples_that_show_it(
    bench: Bench, tmp_path: Path, fault: str, change: dict[str, Any], amplitude: float, reason: str
) -> None:
    robot = changed_robot(tmp_path, change)
    bench.fault(fault, LATER)
    report = bench.record(trajectory(tmp_path, 20.0, amplitude, 1.2), robot=robot)
    bench.assert_stopped(report)
    assert isinstance(report.error, SafetyStopError)
    assert str(report.stopped_by).startswith(reason)
    assert bench.recording.events[-1].message == "arm halted"
    stopped = bench.stop_event()[0]
    assert LATER < stopped <= bench.times()[-1] < stopped + TOGETHER - 1e-9
    what, _, name = reason.rpartition(" of ")
    passed = passes(bench, robot, what, robot.robot.joint_names.index(name))
    assert bench.times()[np.argmax(passed)] == stopped


@pytest.mark.parametrize("fault", ["stick position elbow_joint", "block elbow_joint"])
def test_a_position_that_hangs_ends_a_motion_and_a_current_without_a_limit_is_an_event(
    bench: Bench, tmp_path: Path, fault: str
) -> None:
    bench.fault("stick current wrist_1_joint", LATER - 0.5)
    bench.fault(fault, LATER)
    report = bench.record(trajectory(tmp_path, 20.0, 0.4, 1.2), robot=changed_robot(tmp_path, {"torque": None}))
    bench.assert_stopped(report)
    assert isinstance(report.error, SafetyStopError)
    hung = [event.message for event in bench.recording.events if event.message.startswith("stuck ")]
    (stuck,) = (said for said in hung if said.startswith("stuck position of elbow_joint: "))
    assert str(report.stopped_by).startswith(stuck)  # and says what to do about it
    assert any(said.startswith("stuck current of wrist_1_joint: ") for said in hung)
    assert LATER < bench.times()[-1] < LATER + 0.3


def passes(bench: Bench, robot: RobotFile, what: str, joint: int) -> np.ndarray:
    """Whether each sample of a joint passes the limit of a quantity."""
    stream = bench.recording.streams["joints"]
    limits = robot.robot.joints[joint]
    if what == "torque":
        assert limits.torque is not None
        return np.abs(stream.channels["torque"].values[:, joint]) > limits.torque
    if what == "velocity":
        return np.abs(stream.channels["velocity"].values[:, joint]) > VELOCITY_MARGIN * limits.velocity
    position = stream.channels["position"].values[:, joint]
    if what == "position":
        return (position < limits.position[0]) | (position > limits.position[1])
    passed = np.abs(stream.channels["target_position"].values[:, joint] - position) > TRACKING_ERROR
    sent, commanded = np.array([when for when, _ in bench.commands]), np.array([at[joint] for _, at in bench.commands])
    for row, when in enumerate(stream.host_time):
        first = max(int(np.searchsorted(sent, when - TRACKING_WINDOW)) - 1, 0)
        if len(window := commanded[first : int(np.searchsorted(sent, when, side="right"))]):
            away = max(window.min() - position[row], position[row] - window.max())
            passed[row] |= away > TRACKING_ERROR
    return passed


def test_a_short_silence_while_only_recording_is_an_event(bench: Bench) -> None:
    bench.fault("freeze 0.3", 1.0011)
    report = bench.record(duration=1.6)
    assert report.stopped_by is None
    assert report.lost == {"joints": 150, "thermal": 5, "status": 2}  # of the slow ones, groups that lack every sample
    assert bench.status.faulted == 150
    assert bench.recording.complete
    assert sum("stale data of stream joints" in event.message for event in bench.recording.events) == 1
    steps = np.rint(np.diff(bench.times()) * RATE)
    assert sorted(set(steps)) == [1.0, 151.0]
    assert bench.times()[int(np.argmax(steps))] == pytest.approx(1.002)


def test_a_long_silence_while_only_recording_ends_it(bench: Bench) -> None:
    bench.fault("freeze 2", 1.0011)
    report = bench.record(duration=5.0)
    assert isinstance(report.error, ConnectionLostError)
    assert "no data for 0.5 s" in str(report.stopped_by)
    assert bench.times()[-1] == pytest.approx(1.002)
    stopped = [event for event in bench.recording.events if event.level == "error"]
    assert [event.time for event in stopped] == [pytest.approx(1.002 + SILENCE_LIMIT, abs=1e-6)]


def test_dropped_packages_are_counted_and_do_not_end_the_recording(bench: Bench) -> None:
    bench.fault("drop 7", 1.0011)
    report = bench.record(duration=1.3)
    assert report.stopped_by is None
    assert report.lost["joints"] == 7
    assert [event.message for event in bench.recording.events if event.source == "joints"] == ["7 samples lost"]
    missing = set(range(502, 509))
    ticks = set(np.rint(bench.times() * RATE).astype(int))
    assert set(range(min(ticks), max(ticks) + 1)) - ticks == missing


@pytest.mark.parametrize("stall", [0.03, 0.2])
def test_a_busy_computer_is_not_felt_or_ends_a_motion_and_costs_no_sample(
    bench: Bench, tmp_path: Path, stall: float
) -> None:
    # Controller and recorder share it: the one makes up for its periods, the other for its positions, or stops.
    bench.clock.call_at(START + FAULT, lambda: bench.clock.stall(stall))
    report = bench.record(trajectory(tmp_path, 1.5))
    assert bench.status.stalls == 0
    assert_no_sample_is_missing(bench.times())
    assert report.punctuality is not None
    if stall > 0.05:
        bench.assert_stopped(report)
        assert "this computer stalled for 0.198 s in the motion" in str(report.stopped_by)
        return
    assert report.stopped_by is None
    assert bench.recording.complete
    assert report.punctuality.delayed_ms == 0.0
    channels = bench.recording.streams["joints"].channels
    assert np.abs(channels["position"].values - channels["target_position"].values).max() < REACHED


def felt(bench: Bench) -> tuple[float, float]:
    """The largest acceleration of the controller's target [rad/s²], and share of its limit that a torque took."""
    gain = np.array([drive.gain for drive in ur5e().robot.drives])
    limit = np.array([joint.torque for joint in ur5e().robot.joints])
    accelerations = np.diff(bench.arm.values("target_position"), 2, axis=0) * RATE**2
    return float(np.abs(accelerations).max()), float(np.abs(bench.arm.values("current") * gain / limit).max())


@cache
def fast_motion_alone() -> tuple[float, float]:
    """What of the fast motion is felt where nothing stalls."""
    with simulated_time() as clock, tempfile.TemporaryDirectory() as folder:
        bench = Bench(clock, Path(folder))
        assert bench.record(trajectory(Path(folder), 1.0, *FAST)).stopped_by is None
        return felt(bench)


@pytest.mark.parametrize(
    ("control", "stalls", "whole"),
    [
        (PythonControl, (0.005, 0.02, 0.05), False),
        (PythonControl, (0.005, 0.008, 0.01), True),
        (own_program, (0.005, 0.02, 0.05), True),
        (own_program, (0.1,), True),
    ],
)
def test_stalls_in_a_fast_motion_add_no_acceleration_and_no_torque(
    clock: SimulatedClock, tmp_path: Path, control: TakesControl, stalls: tuple[float, ...], whole: bool
) -> None:
    """At random phases, of the recording process, or of every process of this computer; servoj alone took 4 times."""
    bench = Bench(clock, tmp_path, control)
    controllers = {thread.name for thread in bench.server._threads} | (set() if whole else {f"motion {HOST}"})
    random = np.random.default_rng(round(1e3 * sum(stalls)))
    for number, stall in enumerate(stalls):
        when = START + FAULT + 0.3 * (number + random.random())
        clock.call_at(when, lambda stall=stall: clock.suspend(stall, but=controllers))  # type: ignore[misc]
    report = bench.record(trajectory(tmp_path, 1.0, *FAST))
    if max(stalls) > 0.05:
        bench.assert_stopped(report)
        assert "this computer stalled for" in str(report.stopped_by)
        assert felt(bench)[1] < 1.0
    else:
        assert report.stopped_by is None
        assert np.all(np.array(felt(bench)) <= 1.05 * np.array(fast_motion_alone()))


# From here on in real time: the processes of a recording, with ur_rtde, on a computer that may stall.

SLOW = (0.06, 1.5)
"""Amplitude [rad] and frequency [rad/s] of a motion that bears a stall: what was missed is at most 0.12 rad."""
SELDOM = 125.0
"""Rate of samples [Hz] of the slowest controller: each costs time."""
SIMULATOR = ("-c", "import sys; from dynid.command import main; sys.exit(main())", "sim", "ur5e", "--no-ui")


@pytest.fixture(scope="module")
def host() -> Iterator[str]:
    """The address of a controller in a process of its own, at which one test after the other records."""
    address = loopback()
    with served(*SIMULATOR, "--version", "3.15", "--host", address):
        yield address


@contextmanager
def recording(host: str, out: Path, duration: float) -> Iterator[subprocess.Popen[str]]:
    """`dynid record` of a motion, in processes of its own, ended with the block; no limit of torque stops it."""
    changed_robot(out.parent, {"torque": None}, timeout=LIMIT, rate=SELDOM)
    path = trajectory(out.parent, duration, *SLOW)
    robot = str(out.with_name("changed.yaml"))
    command = [sys.executable, "tests/support/patient_dynid.py", "record", robot, "--host", host, "-o", str(out)]
    process = subprocess.Popen(
        [*command, "--yes", "--no-ui", "--json", "--trajectory", str(path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
        env=ENVIRONMENT,
        start_new_session=True,
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


def wait_for_motion(host: str, process: subprocess.Popen[str]) -> None:
    def moves(row: np.ndarray) -> bool:
        assert process.poll() is None, process.communicate()
        return bool(row["runtime_state"] == PLAYING and np.any(np.abs(row["actual_qd"]) > 0.03))

    with connected(host) as client:
        client.stream(["runtime_state", "actual_qd"], SELDOM)
        client.until(moves)


def wait_for_rest(host: str) -> None:
    """Until no program runs and the arm stands."""
    with connected(host) as client:
        client.stream(["runtime_state", "actual_qd"], SELDOM)
        client.until(lambda row: row["runtime_state"] == STOPPED and np.all(np.abs(row["actual_qd"]) < 5e-3))


@pytest.mark.slow
@pytest.mark.realtime
def test_dynid_moves_an_arm_through_ur_rtde_and_records_it_to_its_end(host: str, tmp_path: Path) -> None:
    out = tmp_path / "run.h5"
    with recording(host, out, 1.0) as process:
        output, errors = process.communicate(timeout=LIMIT)
        assert (process.returncode, errors) == (0, "")
        wait_for_rest(host)
    joints = json.loads(output)["streams"]["joints"]  # one object, and nothing of ur_rtde's
    assert (joints["lost"], joints["duplicates"]) == (0, 0)
    found = read_recording(out)
    assert found.complete
    assert found.trajectory == (tmp_path / "trajectory.yaml").read_text()
    assert_no_sample_is_missing(found.streams["joints"].time, SELDOM)
    assert np.ptp(found.streams["joints"].channels["position"].values, axis=0).min() > 0.03


@pytest.mark.slow
@pytest.mark.realtime
def test_ctrl_c_in_mid_motion_halts_the_arm_and_closes_the_file(host: str, tmp_path: Path) -> None:
    out = tmp_path / "run.h5"
    with recording(host, out, 600.0) as process:
        wait_for_motion(host, process)
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does: the motion process gets it, too
        output, _ = process.communicate(timeout=LIMIT)
        assert process.returncode == 130
        wait_for_rest(host)
    assert json.loads(output)["stopped_by"] == "interrupted"
    found = read_recording(out)
    assert not found.complete
    assert found.events[-1].message == "arm halted"
    assert_no_sample_is_missing(found.streams["joints"].time, SELDOM)


@pytest.mark.slow
@pytest.mark.realtime
def test_the_controllers_watchdog_ends_the_program_when_all_of_dynid_is_killed(host: str, tmp_path: Path) -> None:
    out = tmp_path / "run.h5"
    with recording(host, out, 600.0) as process:
        wait_for_motion(host, process)
        os.killpg(process.pid, signal.SIGKILL)  # the motion process, too
        process.wait(LIMIT)
        wait_for_rest(host)
    recover(half_written(out), tmp_path / "rescued.h5")
    rescued = read_recording(tmp_path / "rescued.h5").streams["joints"]
    assert_no_sample_is_missing(rescued.time, SELDOM)
