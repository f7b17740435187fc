"""Random faults and clocks that jump, in short motions: the arm ends at rest, the file with the reason."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Sequence
from functools import cache, partial
from pathlib import Path

import numpy as np
import rtde_in_process
from canopen_recording import arm_on_bus
from hypothesis import example, given, settings
from hypothesis import strategies as st
from recorded_session import record_session
from rtde_in_process import NOWHERE, serving
from simulated_clock import SimulatedClock, simulated_time
from table_arm_bench import KEYS, POSE, ROBOT, TIME, connection_of, opened, served, session
from unchecked import unchecked_play

from daq.motion.trajectories import PointToPoint
from daq.recording.reader import read_recording
from daq.recording.recording import Recording
from daq.robot.loader import RobotFile, load_robot, parse_robot
from daq.robot.schema import Robot
from daq.session.session import SessionReport
from drivers.base import Driver
from drivers.core.arrays import FloatArray
from sim_drivers.faults import FAULTS, STICKING, ServerKind, parse_fault
from sim_drivers.plant.plant import Plant
from sim_drivers.rtde.server import RtdeServer

WAY, SHARE = 0.05, 0.9
"""Way of two joints [rad]; share of the acceleration limit that the motion uses."""
LONGEST = 0.4
"""Longest duration of a fault [s]."""
MOMENTS = st.floats(-0.9, 0.3).map(lambda seconds: 0.9 + seconds)
"""When faults begin in a session [s]; the arm moves from 0.6 s to 1.2 s, and the simplest is in it."""
LAST = 1.2
JUMPS = st.one_of(st.floats(-1.0, 1.0), st.floats(-1e9, 1e9)).filter(lambda jump: jump != 0.0)
"""Jumps of a clock [s]."""
SETTLED = 0.5
ARGUMENTS: dict[str, st.SearchStrategy[object]] = {
    "N": st.integers(1, 40),
    "SECONDS": st.floats(0.005, LONGEST),
    "CELSIUS": st.floats(0.1, 100.0),
    "JOINT": st.integers(1, 6),
    "QUANTITY": st.sampled_from(STICKING),
    "IDENTIFIER": st.sampled_from(range(0x180, 0x190)),
    "JUMP": JUMPS,
    "RAD/S": st.floats(-2.0, 2.0),
    "VARIABLE": st.sampled_from(("safety_mode", "target_q", "actual_q")),
}
Faults = Sequence[tuple[float, str]]


def faults(server: ServerKind) -> st.SearchStrategy[Faults]:
    """Some of those that a server obeys, as typed, with their times [s]."""
    lines = [
        st.tuples(st.just(entry.word), *(ARGUMENTS[argument.name] for argument in entry.arguments))
        for entry in FAULTS
        if server in entry.servers
    ]
    line = st.one_of(lines).map(lambda words: " ".join(map(str, words)))
    return st.lists(st.tuples(MOMENTS, line), min_size=1, max_size=4)


def there_and_back(robot: Robot, start: FloatArray) -> PointToPoint:
    away = np.zeros(robot.dof)
    away[[0, -1]] = WAY
    limit = min(robot.joints[index].acceleration for index in (0, -1))
    duration = float(np.sqrt(10.0 / np.sqrt(3.0) * WAY / (SHARE * limit)))
    return PointToPoint(np.array([start, start + away, start]), np.array([duration, duration]))


class Commands:
    """Notes what a driver is told, and when."""

    def __init__(self, driver: Driver, clock: SimulatedClock) -> None:
        self.times: list[float] = []
        self.positions: list[FloatArray] = []
        send = driver.command

        def noted(position: FloatArray, *due: float) -> None:
            self.times.append(clock.now())
            self.positions.append(position.copy())
            send(position, *due)

        driver.command = noted  # type: ignore[method-assign]

    def assert_within_limits(self, robot: Robot, period: float) -> None:
        slots = np.floor((np.array(self.times) - (self.times or [0.0])[0]) / period + 1e-6)
        step, dt = np.diff(np.array(self.positions), axis=0), np.diff(slots)[:, None] * period
        if len(step) < 2:
            return
        change = np.diff(step / dt, axis=0) / (0.5 * (dt[1:] + dt[:-1]))
        assert np.all(np.abs(step / dt) <= [joint.velocity for joint in robot.joints])
        assert np.all(np.abs(change) <= [joint.acceleration for joint in robot.joints])


def assert_in_order(report: SessionReport, recording: Recording) -> None:
    """The session ended by something that it foresaw, and the file says it; its stamps rise, or it says why not."""
    said = [event.message for event in recording.events]
    assert "Error: " not in str(report.stopped_by), report.stopped_by  # a bug, in words
    assert recording.complete == (report.stopped_by is None)
    if report.stopped_by is not None:
        assert f"stopped: {report.stopped_by}" in said
    for name, stream in recording.streams.items():
        assert np.all(np.isfinite(stream.time)), name
        assert np.all(np.diff(stream.time) > 0) or any("clock" in message for message in said), name


def on_table_arm(
    disturb: Callable[[SimulatedClock, Callable[[str], object]], None], **keys: object
) -> tuple[SessionReport, Recording]:
    """The outcome of a motion that is disturbed; the arm and its commands are looked at."""
    with tempfile.TemporaryDirectory() as folder, simulated_time() as clock:
        path = Path(folder, "run.h5")
        with served(clock) as server, opened(connection_of(server) | keys, clock) as driver:
            commands, begun = Commands(driver, clock), clock.now()
            disturb(clock, server.obey)
            report = session(path, driver, clock, unchecked_play(there_and_back(ROBOT, POSE), ROBOT))
            clock.sleep_until(begun + LAST + LONGEST)
            clock.sleep(SETTLED)
            assert np.max(np.abs(server._arm.arm.velocity)) < 0.01  # type: ignore[attr-defined]
        commands.assert_within_limits(ROBOT, 0.005)
        return report, read_recording(path)


@settings(max_examples=1)
@given(faults("signal-table arm"))
def test_any_faults_of_an_arm_with_a_signal_table_end_at_rest_and_with_a_reason(drawn: Faults) -> None:
    def disturb(clock: SimulatedClock, obey: Callable[[str], object]) -> None:
        for moment, line in drawn:
            clock.call_at(clock.now() + moment, partial(obey, line))

    assert_in_order(*on_table_arm(disturb))


@settings(max_examples=1)
@given(faults("CANopen drives"))
def test_any_faults_of_cia402_drives_end_at_rest_and_with_a_reason(drawn: Faults) -> None:
    with tempfile.TemporaryDirectory() as folder, arm_on_bus(drives=6) as bench:
        commands, begun = Commands(bench.driver, bench.clock), bench.clock.now()
        for moment, line in drawn:
            bench.at(moment, line)
        robot = bench.robot_file.robot
        run = bench.record(Path(folder), motion=there_and_back(robot, bench.plant.position.copy()))
        bench.clock.sleep_until(begun + LAST + LONGEST)
        bench.clock.sleep(SETTLED)
        assert np.max(np.abs(bench.plant.velocity)) < 0.01
        commands.assert_within_limits(robot, 1.0 / bench.rate)
        assert_in_order(run.report, run.recording)


@settings(max_examples=1)
@given(st.lists(st.tuples(MOMENTS, JUMPS), min_size=1, max_size=3), st.booleans())
@example([(0.9, -0.5)], False)
def test_a_clock_of_day_that_jumps_ends_no_motion(drawn: Sequence[tuple[float, float]], counted: bool) -> None:
    def disturb(clock: SimulatedClock, _: object) -> None:
        day = clock.time_of_day
        begun, shifts = clock.now(), [(moment, jump) for moment, jump in drawn]
        clock.time_of_day = lambda: (
            day()
            + math.fsum(  # type: ignore[method-assign]
                jump for moment, jump in shifts if clock.now() >= begun + moment
            )
        )

    keys = {} if counted else {"signals": [s for s in KEYS["signals"] if s["quantity"] not in ("counter", "time")]}
    report, recording = on_table_arm(disturb, **keys)
    assert_in_order(report, recording)
    assert report.stopped_by is None
    assert np.all(np.diff(recording.streams["joints"].time) > 0)
    assert np.all(np.diff(recording.streams["joints"].host_time) >= 0)


UR_PERIOD = 0.002


@cache
def ur5e() -> RobotFile:
    """The UR5e, free to move: its first pose, stretched out, is near a table."""
    return parse_robot(load_robot("ur5e").text.replace("mounting: table", "mounting: free"), where="ur5e", folder=None)


def on_ur_arm(drawn: Faults, *, moves: bool = True) -> tuple[SessionReport, Recording]:
    """The outcome of a motion of a simulated UR5e, or of a recording as long, with faults; its arm is looked at."""
    robot = ur5e().robot
    with tempfile.TemporaryDirectory() as folder, simulated_time() as clock:
        plant = Plant(ur5e(), seed=1)
        server = RtdeServer(plant, ports=NOWHERE, joints=robot.joints, clock=clock)
        with serving(server) as network:
            with rtde_in_process.opened(robot, network.connect, clock) as driver:
                commands, begun = Commands(driver, clock), clock.now()
                for moment, line in drawn:
                    fault = parse_fault(line, "UR controller", robot.joint_names)
                    clock.call_at(begun + moment, partial(server.cause, fault))
                play = unchecked_play(there_and_back(robot, plant.position.copy()), robot) if moves else None
                path, duration = Path(folder, "run.h5"), None if moves else LAST
                report = record_session(path, ur5e(), driver, play, duration, clock=clock)
            clock.sleep_until(begun + LAST + LONGEST)
            clock.sleep(SETTLED)
            assert np.max(np.abs(plant.velocity)) < 0.01
        commands.assert_within_limits(robot, UR_PERIOD)
        return report, read_recording(Path(folder, "run.h5"))


@settings(max_examples=1)
@given(faults("UR controller"))
def test_any_faults_of_a_ur_controller_end_at_rest_and_with_a_reason(drawn: Faults) -> None:
    assert_in_order(*on_ur_arm(drawn))


CLOCKS = st.sampled_from(["counter", "time"])


@settings(max_examples=1)
@given(st.lists(st.tuples(MOMENTS, JUMPS), min_size=1, max_size=3), CLOCKS)
@example([(0.9, -0.5)], "counter")
def test_a_counter_or_clock_of_an_arm_on_can_that_jumps_ends_no_motion(
    drawn: Sequence[tuple[float, float]], kind: str
) -> None:
    with tempfile.TemporaryDirectory() as folder, simulated_time() as clock:
        table = {"signals": [TIME if s["quantity"] == "counter" and kind == "time" else s for s in KEYS["signals"]]}
        with served(clock, **table) as server, opened(connection_of(server) | table, clock) as driver:
            commands = Commands(driver, clock)
            for moment, jump in drawn:
                clock.call_at(clock.now() + moment, partial(server.obey, f"clock-jump {jump}"))
            report = session(Path(folder, "run.h5"), driver, clock, unchecked_play(there_and_back(ROBOT, POSE), ROBOT))
        commands.assert_within_limits(ROBOT, 0.005)
        recording = read_recording(Path(folder, "run.h5"))
    assert_in_order(report, recording)
    assert report.stopped_by is None
    assert np.all(np.diff(recording.streams["joints"].time) > 0)


@settings(max_examples=1)
@given(st.lists(st.tuples(MOMENTS, JUMPS), min_size=1, max_size=3), st.booleans())
@example([(0.9, -0.5)], True)
def test_the_clock_of_a_ur_controller_that_jumps_back_ends_the_session_and_its_stamps_rise(
    drawn: Sequence[tuple[float, float]], moves: bool
) -> None:
    report, recording = on_ur_arm([(moment, f"clock-jump {jump}") for moment, jump in drawn], moves=moves)
    assert_in_order(report, recording)
    assert np.all(np.diff(recording.streams["joints"].time) > 0)
    if all(jump > UR_PERIOD for _, jump in drawn):
        assert report.stopped_by is None
