"""The simulated thermometer, read by the real driver."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path

import numpy as np
import pytest
import recorded_session
from kinematic_arm import RATE, KinematicArm
from kinematic_arm import ROBOT_FILE as ARM
from recorded_session import record_session
from serial_lines import SerialLine
from simulated_clock import SimulatedClock
from unchecked import unchecked_play

from daq.motion.trajectories import PointToPoint
from daq.recording.reader import read_recording
from daq.recording.recording import Recording
from daq.robot.schema import Connection, Robot
from daq.session.session import SessionReport
from daq.session.sources import Sources
from daq.session.stuck_channels import WATCHED
from drivers.base import DriverSettings, Notice
from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.errors import ConnectionFailedError, UsageError
from drivers.gains import DriveGain
from drivers.serial_thermometer.driver import SerialThermometerDriver
from drivers.serial_thermometer.port import READ_TIMEOUT
from drivers.streams import Batch
from sim_drivers.plant.plant import Plant
from sim_drivers.pseudo_terminal import PseudoTerminal
from sim_drivers.served import SimOptions
from sim_drivers.thermometer.server import (
    PERIOD,
    SLICE,
    BesideThermometer,
    SimulatedThermometer,
    ThermometerServer,
    serve,
    serve_thermometer,
    simulated_thermometer,
    thermometer_keys,
)

PATTERN = r"T(?P<channel>\w+)=(?P<value>[-+.\d]+)"
JOINTS = ("shoulder", "elbow")
KEYS: dict[str, object] = {"url": "x", "pattern": PATTERN, "channels": {"b": "shoulder", "a": "elbow"}, "rate": 20}
MISSED = 3
"""Lines: of the first one a part may be missing, the next ends the opening, and the next may have begun before it."""
LIMIT = 60.0
"""[s] that a test in real time waits for what must come."""
Make = Callable[..., SerialThermometerDriver]


def driver_of(path: str, clock: Clock, joints: tuple[str, ...] = JOINTS, **keys: object) -> SerialThermometerDriver:
    gains = (DriveGain(1.0),) * len(joints)
    return SerialThermometerDriver(DriverSettings(joints, {**KEYS, "url": path, **keys}, gains, clock=clock))


@pytest.fixture
def line(clock: SimulatedClock) -> SerialLine:
    return SerialLine(clock)


@pytest.fixture
def opened(clock: SimulatedClock, line: SerialLine) -> Iterator[Make]:
    """Makes a driver that runs."""
    made = ExitStack()

    def make(joints: tuple[str, ...] = JOINTS, **keys: object) -> SerialThermometerDriver:
        driver = made.enter_context(closing(driver_of(line.path, clock, joints, **keys)))
        driver.open()
        driver.start()
        return driver

    with made:
        yield make


def listen(
    driver: SerialThermometerDriver, clock: Clock, seconds: float
) -> tuple[np.ndarray, np.ndarray, list[Notice]]:
    """Rows, their stamps [s] and notices of a while [s]."""
    blocks: list[Batch] = []
    notices: list[Notice] = []
    end = clock.now() + seconds
    while (left := end - clock.now()) > 1e-9:
        blocks += driver.read(min(left, READ_TIMEOUT))
        notices += driver.notices()
    values = [block.values["temperature"] for block in blocks]
    return np.concatenate(values or [np.empty((0, 2))]), np.concatenate([b.time for b in blocks] or [[]]), notices


def messages(notices: list[Notice]) -> list[str]:
    """Without the bytes that are quoted."""
    return [notice.message.partition("; the last one:")[0] for notice in notices]


@pytest.mark.parametrize("unit", ["degC", "degF", "K"])
def test_the_driver_reads_what_it_sends(opened: Make, clock: SimulatedClock, line: SerialLine, unit: str) -> None:
    settings = simulated_thermometer({**KEYS, "unit": unit, "with": ["x"]}, JOINTS)
    assert settings.channels == ("b", "a")  # in the joints' order
    with ThermometerServer(lambda: [30.0, -5.25], settings, line_end=line, clock=clock) as server:
        rows, _, notices = listen(opened(unit=unit), clock, 1.0)
        assert server.lines == MISSED + len(rows)
    np.testing.assert_allclose(rows, [[30.0, -5.25]] * 19, rtol=0, atol=0.006)
    assert notices == []


def test_lines_take_the_time_of_their_characters(opened: Make, clock: SimulatedClock, line: SerialLine) -> None:
    """At 1200 bit/s a line of 18 characters takes 150 ms, whatever carries it."""
    settings = SimulatedThermometer(("b", "a"), rate=2.0, baudrate=1200)
    text = settings.line([20.0, 21.0])
    begun = clock.now()
    with ThermometerServer(lambda: [20.0, 21.0], settings, line_end=line, clock=clock):
        driver = opened(baudrate=1200, rate=2)
        rows, times, _ = listen(driver, clock, 10.0 - (clock.now() - begun))
    assert b"".join(data for _, data in line.said) == text * 20
    arrivals = np.array([moment for moment, data in line.said for _ in data])
    number, character = np.divmod(np.arange(len(arrivals)), len(text))
    late = arrivals - (begun + 0.5 * number + (character + 1) * 10 / 1200)
    assert np.all((late > -1e-9) & (late < SLICE + 1e-9))
    # The first character of the line end (the last but one of the line) closes it, and the driver looks every 10 ms.
    np.testing.assert_array_equal(rows, [[20.0, 21.0]] * (20 - MISSED))
    late = times - (begun + 0.5 * np.arange(MISSED, 20) + (len(text) - 1) * 10 / 1200)
    assert np.all((late > -1e-9) & (late < SLICE + READ_TIMEOUT + 1e-9))


def test_more_lines_than_the_baud_rate_takes_are_refused() -> None:
    with pytest.raises(UsageError, match="exceed 1200 bit/s"):
        ThermometerServer(lambda: [20.0], SimulatedThermometer(("a",), rate=20.0, baudrate=1200))


def test_a_pattern_that_does_not_match_is_refused() -> None:
    with pytest.raises(UsageError, match="which 'pattern' does not match"):
        simulated_thermometer({**KEYS, "pattern": r"#(?P<channel>\d) (?P<value>\d+)"}, JOINTS)


def test_it_is_unplugged_until_it_is_plugged_in_and_has_no_other_faults(
    opened: Make, clock: SimulatedClock, line: SerialLine
) -> None:
    settings = simulated_thermometer(KEYS, JOINTS)
    with ThermometerServer(lambda: [30.0, 31.0], settings, line_end=line, clock=clock) as server:
        driver = opened()
        server.obey("unplug")
        rows, _, notices = listen(driver, clock, 10.2)
        assert (len(rows), len(notices)) == (0, 1)
        server.obey("replug")
        server.obey("replug")
        rows, _, notices = listen(driver, clock, 1.3)
        assert messages(notices) == ["the port is open again after 11.0 s, attempt 11"]
        assert len(rows) > 0
        assert all(row.tolist() == [30.0, 31.0] for row in rows)
        with pytest.raises(UsageError, match="not a fault of the thermometer"):
            server.obey("explode")
        assert server.failure is None


def test_it_comes_back_after_the_time_that_was_said_last(clock: SimulatedClock, line: SerialLine) -> None:
    with ThermometerServer(
        lambda: [30.0, 31.0], simulated_thermometer(KEYS, JOINTS), line_end=line, clock=clock
    ) as server:

        def plugged_after(limit: float) -> float | None:
            begun = clock.now()
            return clock.now() - begun if clock.wait(lambda: line.plugged, limit) else None

        clock.sleep(0.021)  # between two lines
        for duration in (0.003, 0.123):
            server.unplug(duration)
            assert plugged_after(1.0) == pytest.approx(duration, abs=1e-9)
        server.unplug(0.123)
        server.unplug()
        assert plugged_after(100.0) is None
        server.unplug(0.123)
        assert plugged_after(1.0) == pytest.approx(0.123, abs=1e-9)


def test_what_nobody_reads_is_lost_not_kept(opened: Make, clock: SimulatedClock, line: SerialLine) -> None:
    value = [20.0]
    settings = SimulatedThermometer(("b",), rate=50.0, baudrate=115200)
    with ThermometerServer(lambda: value, settings, line_end=line, clock=clock) as server:
        clock.sleep(0.295)
        assert (server.lost, server.lines) == (15, 0)
        value[0] = 40.0
        driver = opened(joints=("shoulder",), channels={"b": "shoulder"}, rate=50)
        rows, _, _ = listen(driver, clock, 0.2)
        assert (server.lost, server.lines) == (15, 12)
    np.testing.assert_array_equal(rows, [[40.0]] * (12 - MISSED))


def test_it_measures_the_plant(pendulum, opened: Make, clock: SimulatedClock, line: SerialLine) -> None:
    plant = Plant(pendulum())
    (joint,) = plant.robot.joint_names
    plant.heat(0, 17.0)
    with serve_thermometer(plant, {**KEYS, "channels": {1: joint}}, line_end=line, clock=clock):
        rows, _, _ = listen(opened(joints=(joint,), channels={1: joint}), clock, 0.1)
    np.testing.assert_allclose(rows[:, 0], plant.thermal.housing[0], rtol=0, atol=0.006)
    assert len(rows) == 2


def test_its_port_is_where_the_robot_file_says(pendulum, tmp_path) -> None:
    plant = Plant(pendulum())
    path = tmp_path / "thermometer"
    path.symlink_to("/dev/pts/no-longer-there")  # of one that was killed
    keys = {**KEYS, "url": str(path), "channels": {1: plant.robot.joint_names[0]}}
    server = serve_thermometer(plant, keys)
    assert server.path == str(path)
    server.replug()
    assert path.resolve().is_char_device()
    server.stop()
    assert not path.is_symlink()
    path.write_text("precious")
    with pytest.raises(UsageError, match="the path exists already"):
        serve_thermometer(plant, keys)
    elsewhere = serve_thermometer(plant, {**keys, "url": "/dev/ttyUSB0"})
    assert elsewhere.path != "/dev/ttyUSB0"
    elsewhere.replug()
    assert Path(elsewhere.path).resolve().is_char_device()
    elsewhere.stop()
    assert not Path(elsewhere.path).parent.exists()


def on_bench(pendulum):
    """The robot file of a pendulum that cools within seconds and has a thermometer, its keys, and its joint."""
    robot_file = pendulum(thermal="winding_capacity: 5, housing_capacity: 5")
    (joint,) = robot_file.robot.joint_names
    keys = {**KEYS, "channels": {1: joint}}
    robot = robot_file.robot.model_copy(
        update={"connections": {"oven": Connection(driver="serial_thermometer", **keys)}}
    )
    return robot_file.model_copy(update={"robot": robot}), keys, joint


def test_dynid_sim_serves_it_alone(pendulum, opened: Make, clock: SimulatedClock, line: SerialLine) -> None:
    robot_file, _, joint = on_bench(pendulum)
    with pytest.raises(UsageError, match="has no serial thermometer"):
        thermometer_keys(pendulum().robot)
    begun = clock.now()
    plant = Plant(robot_file, seed=1)
    with serve(robot_file, plant, SimOptions(robot="pendulum"), clock, line) as alone:
        assert alone.ready() == {"thermometer": line.path, "thermometer_baudrate": 9600}
        driver = opened(joints=(joint,), channels={1: joint})
        twin = Plant(robot_file, seed=1)
        clock.sleep_until(begun + 5.5 * PERIOD)
        alone.obey(f"heat {joint} 20")  # at the plant's next period
        twin.advance(5 * PERIOD)
        twin.heat(0, 20.0)
        for end in (0.5, 2.0, 10.0):  # it cools
            rows, _, _ = listen(driver, clock, begun + end + 0.03 - clock.now())
            twin.advance(end - twin.time)
            assert rows[-1, 0] == pytest.approx(twin.thermal.housing[0], abs=0.1)  # half a period's fall
        assert rows[-1, 0] < rows[0, 0] - 5.0
        assert alone.live_line() == f"thermometer {line.path}: 201 lines"
        for wrong in ("heat 7 1", "heat 1 cold", "explode", "thermometer explode"):
            with pytest.raises(UsageError):
                alone.obey(wrong)
        alone.obey("thermometer unplug")
        assert not line.plugged
        assert alone.failure is None


def test_dynid_sim_serves_it_beside_an_arm(pendulum, clock: SimulatedClock, line: SerialLine) -> None:
    class Arm:
        failure = None
        entered = 0

        def __init__(self):
            self.messages: deque[str] = deque()
            self.obeyed: list[str] = []

        def __enter__(self):
            self.entered += 1
            return self

        def __exit__(self, *_):
            self.entered -= 1

        def ready(self):
            return {"interface": "virtual"}

        def live_line(self):
            return "arm"

        def obey(self, line):
            self.obeyed.append(line)

    robot_file, keys, _ = on_bench(pendulum)
    arm = Arm()
    with BesideThermometer(arm, serve_thermometer(Plant(robot_file), keys, line_end=line, clock=clock)) as both:
        assert both.ready() == {"interface": "virtual", "thermometer": line.path, "thermometer_baudrate": 9600}
        both.obey("block 1")
        both.obey("thermometer unplug")
        assert arm.obeyed == ["block 1"]
        assert not line.plugged
        assert both.live_line() == f"arm; thermometer {line.path}: 0 lines"
        assert arm.entered == 1
    assert arm.entered == 0


MOTION = PointToPoint(np.array([[0.1, -0.1], [0.3, 0.1], [0.0, 0.0]]), np.array([1.2, 1.2]))


def recorded(
    path: Path,
    clock: SimulatedClock,
    line: SerialLine,
    duration: float | None = None,
    fault: tuple[float, str] | None = None,
    *,
    motion: PointToPoint = MOTION,
    robot: Robot = ARM.robot,
    noise: float = 0.0,
    **keys: object,
) -> tuple[KinematicArm, SessionReport, Recording]:
    """A motion, or a while [s], of an arm at 31 °C, recorded with a thermometer that has a fault.

    `noise` [°C] is that of the thermometer, `robot` has the limits.

    Times count from the beginning of the recording [s].
    """
    arm, draw = KinematicArm(clock=clock), np.random.default_rng(0)
    server = ThermometerServer(
        lambda: [30.0, 31.0] + noise * draw.standard_normal(2),
        simulated_thermometer({**KEYS, **keys}, JOINTS),
        line_end=line,
        clock=clock,
    )
    sources = Sources("bench", arm, {"oven": driver_of(line.path, clock, **keys)})
    with server, recorded_session.opened(sources):
        play = unchecked_play(motion, robot) if duration is None else None
        if fault is not None:
            clock.call_at(clock.now() + fault[0], lambda: server.obey(fault[1]))
        file = ARM.model_copy(update={"robot": robot})
        report = record_session(path, file, sources, play, duration, tracking_error=0.05, clock=clock)
    return arm, report, read_recording(path)


def told(recording: Recording) -> list[str]:
    """What the thermometer reported, without the bytes that are quoted."""
    events = (event for event in recording.events if event.message.startswith("oven: "))
    return [f"{event.level}: {event.message[6:].partition('; the last one:')[0]}" for event in events]


@pytest.mark.parametrize(
    ("fault", "gap", "words"),
    [
        ("silent 2", 2.2, ["warning: no temperature for 1.00 s", "info: sends again after 2.2 s"]),
        (
            "unplug 1.5",
            2.4,
            [
                "warning: the port is gone: Input/output error; it is opened again when it is back",
                "info: the port is open again after 2.0 s, attempt 2",
            ],
        ),
        (
            "garbage 3",
            3.2,
            [
                "warning: no temperature for 1.00 s",
                "warning: 1 line ignored: 1 do not match the pattern",
                "info: sends again after 3.2 s",
                "warning: 3 lines ignored: 3 do not match the pattern",
            ],
        ),
    ],
)
def test_a_thermometer_in_trouble_ends_nothing(
    tmp_path: Path, clock: SimulatedClock, line: SerialLine, fault: str, gap: float, words: list[str]
) -> None:
    arm, report, recording = recorded(tmp_path / "run.h5", clock, line, duration=5.0, fault=(1.03, fault), rate=5)
    assert (report.stopped_by, report.error) == (None, None)
    assert recording.complete
    assert told(recording) == words
    # Every fifth of a second, but for the gap.
    times = recording.streams["oven"].time - arm.begun
    assert np.diff(times).max() == pytest.approx(gap, abs=SLICE)
    np.testing.assert_allclose(np.sort(np.diff(times))[:-1], 0.2, rtol=0, atol=SLICE)
    assert times[0] == pytest.approx(0.4, abs=0.01)
    assert times[-1] == pytest.approx(4.8, abs=0.01)
    np.testing.assert_array_equal(recording.streams["joints"].channels["position"].values, arm.positions)
    assert arm.count == 5.0 * RATE


@pytest.mark.parametrize("required", [False, True])
def test_a_thermometer_pulled_out_in_mid_motion(
    tmp_path: Path, clock: SimulatedClock, line: SerialLine, required: bool
) -> None:
    arm, report, recording = recorded(tmp_path / "run.h5", clock, line, fault=(1.003, "unplug 0.6"), required=required)
    gone = "the port is gone: Input/output error; it is opened again when it is back"
    events = [event for event in recording.events if event.message.startswith("oven: ")]
    assert events[0].time == pytest.approx(arm.stamp(arm.begun + 1.003), abs=1e-9)
    times = recording.streams["oven"].time - arm.begun
    assert times[times < 1.003] == pytest.approx(np.arange(0.1, 1.01, 0.05), abs=0.01)
    if required:  # noticed with the next sample of the arm; the player ends at its next period
        assert told(recording) == [f"error: {gone}"]
        assert report.stopped_by == f"oven: {gone}"
        assert not recording.complete
        assert arm.command_times[-1] - arm.begun == pytest.approx(1.005, abs=1e-9)
        assert arm.stopped_at - arm.begun == pytest.approx(1.01, abs=1e-9)
    else:
        assert told(recording) == [f"warning: {gone}", "info: the port is open again after 1.0 s, attempt 1"]
        assert report.stopped_by is None
        assert recording.complete
        assert events[1].time == pytest.approx(arm.stamp(arm.begun + 2.003), abs=1e-9)
        assert times[times > 1.003] == pytest.approx(np.arange(2.1, 3.11, 0.05), abs=0.01)
        np.testing.assert_allclose(arm.position, [0.0, 0.0], atol=1e-12)


@pytest.mark.realtime
def test_on_a_pseudo_terminal(tmp_path: Path) -> None:
    path = str(tmp_path / "port")
    settings = simulated_thermometer({**KEYS, "url": path}, JOINTS)
    blocks: list[Batch] = []
    notices: list[Notice] = []

    with ThermometerServer(lambda: [30.0, -5.25], settings, line_end=PseudoTerminal(path)) as server:
        driver = driver_of(server.path, SYSTEM_CLOCK, timeout=LIMIT)
        driver.open()

        def hear(done: Callable[[], bool]) -> None:
            end = time.monotonic() + LIMIT
            while not done():
                assert time.monotonic() < end, messages(notices)
                blocks.extend(driver.read(0.1))
                notices.extend(driver.notices())

        try:
            with pytest.raises(ConnectionFailedError, match="another program has opened it"):
                driver_of(server.path, SYSTEM_CLOCK).open()
            driver.start()
            hear(lambda: len(blocks) >= 5)
            server.unplug()
            hear(lambda: any("the port is gone" in message for message in messages(notices)))
            before = len(blocks)
            server.replug()
            hear(lambda: len(blocks) > before)
            assert any("the port is open again" in message for message in messages(notices))
        finally:
            driver.close()
    for block in blocks:
        np.testing.assert_allclose(block.values["temperature"], [[30.0, -5.25]] * len(block.time), rtol=0, atol=0.006)


@pytest.mark.parametrize("limited", [True, False])
def test_a_thermometer_that_hangs_ends_a_motion_that_is_supervised_by_it_and_is_an_event_in_any(
    tmp_path: Path, clock: SimulatedClock, line: SerialLine, limited: bool
) -> None:
    limit = {"temperature": 70.0 if limited else None}
    robot = ARM.robot.model_copy(update={"joints": [joint.model_copy(update=limit) for joint in ARM.robot.joints]})
    slow = PointToPoint(MOTION.points, np.array([6.0, 6.0]))
    path, fault = tmp_path / "run.h5", (3.0, "stick")
    arm, report, recording = recorded(path, clock, line, fault=fault, motion=slow, robot=robot, noise=0.3, rate=10)
    hung = [event for event in recording.events if event.message.startswith("stuck temperature of ")]
    assert {event.message.partition(":")[0] for event in hung} >= {"stuck temperature of shoulder"}
    assert 3.0 + WATCHED["temperature"] < hung[0].time - arm.stamp(arm.begun) < 10.0
    assert recording.complete is not limited
    if limited:
        assert str(report.stopped_by).startswith("stuck temperature of shoulder: ")
        assert arm.commands_after_stop == 0
    else:
        assert report.stopped_by is None
