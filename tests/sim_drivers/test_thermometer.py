"""The simulated thermometer, read by the real driver."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from types import SimpleNamespace

import numpy as np
import pytest
from kinematic_arm import RATE, KinematicArm
from kinematic_arm import ROBOT_FILE as ARM

from daq.recorder import Recorder
from daq.recording import read_recording
from daq.robot import Connection
from daq.safety import Limits, Supervisor
from daq.session import Play, record
from daq.sources import Sources
from daq.trajectories import PointToPoint
from drivers.base import DriverSettings, Notice
from drivers.errors import UsageError
from drivers.gains import DriveGain
from drivers.serial_thermometer import port as port_module
from drivers.serial_thermometer.driver import SerialThermometerDriver
from drivers.streams import Block
from sim_drivers.plant import Plant
from sim_drivers.thermometer import (
    SimulatedThermometer,
    ThermometerServer,
    serve_thermometer,
    simulated_thermometer,
)
from sim_drivers.thermometer_wire import BesideThermometer, thermometer_alone, thermometer_keys

PATTERN = r"T(?P<channel>\w+)=(?P<value>[-+.\d]+)"
JOINTS = ("shoulder", "elbow")
KEYS: dict[str, object] = {"url": "x", "pattern": PATTERN, "channels": {"b": "shoulder", "a": "elbow"}, "rate": 20}


@pytest.fixture
def opened() -> Iterator[Callable[..., SerialThermometerDriver]]:
    made: list[SerialThermometerDriver] = []

    def make(server: ThermometerServer, joints: tuple[str, ...] = JOINTS, **keys: object) -> SerialThermometerDriver:
        gains = (DriveGain(1.0),) * len(joints)
        made.append(SerialThermometerDriver(DriverSettings(joints, {**KEYS, "url": server.path, **keys}, gains)))
        made[-1].open()
        made[-1].start()
        return made[-1]

    yield make
    for one in made:
        one.close()


def gather(
    driver: SerialThermometerDriver, done: Callable[[list[Block], str], bool], limit: float = 8.0
) -> tuple[np.ndarray, np.ndarray, str]:
    blocks: list[Block] = []
    notices: list[Notice] = []

    def text() -> str:
        return "\n".join(notice.message for notice in notices)

    end = time.monotonic() + limit
    while not done(blocks, text()) and time.monotonic() < end:
        blocks += driver.read(0.02)
        notices += driver.notices()
    values = [block.values["temperature"] for block in blocks]
    return np.concatenate([*values, np.empty((0, 2))]), np.concatenate([b.time for b in blocks] or [[]]), text()


@pytest.mark.parametrize("unit", ["degC", "degF", "K"])
def test_the_driver_reads_what_it_sends(opened: Callable[..., SerialThermometerDriver], unit: str) -> None:
    settings = simulated_thermometer({**KEYS, "unit": unit, "with": ["x"]}, JOINTS)
    assert settings.channels == ("b", "a")  # in the joints' order
    with ThermometerServer(lambda: [30.0, -5.25], settings) as server:
        rows, _, told = gather(opened(server, unit=unit), lambda blocks, _: len(blocks) >= 5)
    assert len(rows) >= 5
    np.testing.assert_allclose(rows, [[30.0, -5.25]] * len(rows), atol=0.006)
    assert told == ""


def test_lines_take_the_time_of_their_characters(opened: Callable[..., SerialThermometerDriver]) -> None:
    """At 1200 bit/s a line of 19 characters takes 158 ms, whatever the pseudo-terminal could do."""
    settings = SimulatedThermometer(("b", "a"), rate=2.0, baudrate=1200)
    sent: list[float] = []

    def temperatures() -> list[float]:
        sent.append(time.monotonic())
        return [20.0, 21.0]

    length = len(settings.line([20.0, 21.0]))
    with ThermometerServer(temperatures, settings) as server:
        driver = opened(server, baudrate=1200, rate=2)
        _, times, _ = gather(driver, lambda blocks, _: len(blocks) >= 4)
        after = [min(when - begun for begun in sent if begun < when) for when in times]
    # The first character of the line end (the last but one of the line) closes it.
    assert min(after) >= (length - 2) * 10 / 1200 - 0.01
    assert np.median(after) < length * 10 / 1200 + 0.1
    assert np.diff(times).mean() == pytest.approx(0.5, abs=0.1)


def test_more_lines_than_the_baud_rate_takes_are_refused() -> None:
    with pytest.raises(UsageError, match="do not fit through 1200 bit/s"):
        ThermometerServer(lambda: [20.0], SimulatedThermometer(("a",), rate=20.0, baudrate=1200))


def test_a_pattern_that_does_not_match_is_refused() -> None:
    with pytest.raises(UsageError, match="which 'pattern' does not match"):
        simulated_thermometer({**KEYS, "pattern": r"#(?P<channel>\d) (?P<value>\d+)"}, JOINTS)


def test_faults_are_seen_and_passed(
    opened: Callable[..., SerialThermometerDriver], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(port_module, "RETRY_PERIOD", 0.1)
    with ThermometerServer(lambda: [30.0, 31.0], simulated_thermometer(KEYS, JOINTS)) as server:
        driver = opened(server)
        server.obey("silent 0.5")
        _, _, told = gather(driver, lambda _, text: "speaks again" in text)
        assert "no temperature for 0." in told
        assert "speaks again after" in told
        server.obey("garbage 1.5")  # some 500 random bytes, line ends among them
        _, _, told = gather(driver, lambda _, text: "ignored" in text)
        assert "line(s) ignored" in told
        server.obey("unplug 0.5")
        rows, _, told = gather(driver, lambda blocks, text: "open again" in text and len(blocks) > 20)
        assert "the port has gone" in told
        assert "the port is open again" in told
        np.testing.assert_array_equal(rows[-1], [30.0, 31.0])
        server.obey("unplug")
        gather(driver, lambda _, text: "has gone" in text)
        server.obey("replug")
        _, _, told = gather(driver, lambda _, text: "open again" in text)
        assert "open again" in told
        with pytest.raises(UsageError, match="not a fault of the thermometer"):
            server.obey("explode")


def test_what_nobody_reads_is_lost_not_kept(opened: Callable[..., SerialThermometerDriver]) -> None:
    value = [20.0]
    settings = SimulatedThermometer(("b",), rate=50.0, baudrate=115200)
    with ThermometerServer(lambda: value, settings) as server:
        time.sleep(0.3)
        assert server.lost > 5
        assert server.lines == 0
        value[0] = 40.0
        driver = opened(server, joints=("shoulder",), channels={"b": "shoulder"}, rate=50)
        blocks: list[Block] = []
        while len(blocks) < 3:
            blocks += driver.read(0.1)
        assert server.lines > 0
    assert {float(value) for block in blocks for value in block.values["temperature"][:, 0]} == {40.0}


def test_it_measures_the_plant(pendulum, opened: Callable[..., SerialThermometerDriver]) -> None:
    plant = Plant(pendulum())
    (joint,) = plant.robot.joint_names
    plant.heat(0, 17.0)
    keys = {**KEYS, "channels": {1: joint}}
    with serve_thermometer(plant, keys) as server:
        driver = opened(server, joints=(joint,), channels={1: joint})
        blocks: list[Block] = []
        while not blocks:
            blocks += driver.read(0.1)
    assert blocks[0].values["temperature"][0, 0] == pytest.approx(plant.thermal.housing[0], abs=0.006)


def test_its_port_is_where_the_robot_file_says(pendulum, tmp_path) -> None:
    plant = Plant(pendulum())
    path = tmp_path / "thermometer"
    path.symlink_to("/dev/pts/no-longer-there")  # of one that was killed
    keys = {**KEYS, "url": str(path), "channels": {1: plant.robot.joint_names[0]}}
    with serve_thermometer(plant, keys) as server:
        assert server.path == str(path)
        assert path.resolve().is_char_device()
    assert not path.is_symlink()
    path.write_text("precious")
    with pytest.raises(UsageError, match="there is something already"):
        serve_thermometer(plant, keys)
    assert serve_thermometer(plant, {**keys, "url": "/dev/ttyUSB0"}).path != "/dev/ttyUSB0"


def test_dynid_sim_serves_it_beside_an_arm_or_alone(pendulum, tmp_path, opened) -> None:
    robot_file = pendulum()
    (joint,) = robot_file.robot.joint_names
    keys = {**KEYS, "url": str(tmp_path / "port"), "channels": {1: joint}}
    connection = Connection(driver="serial_thermometer", **keys)
    robot_file = robot_file.model_copy(
        update={"robot": robot_file.robot.model_copy(update={"connections": {"oven": connection}})}
    )
    with pytest.raises(UsageError, match="has no serial thermometer"):
        thermometer_keys(pendulum().robot)
    with thermometer_alone(robot_file, 1) as alone:
        assert alone.ready() == {"thermometer": str(tmp_path / "port"), "thermometer_baudrate": 9600}
        driver = opened(SimpleNamespace(path=str(tmp_path / "port")), joints=(joint,), channels={1: joint})
        alone.obey(f"heat {joint} 20")
        hottest, end = 0.0, time.monotonic() + 5.0
        while hottest < 40.0 and time.monotonic() < end:
            hottest = max([hottest, *(float(block.values["temperature"].max()) for block in driver.read(0.1))])
        assert 40.0 < hottest < 45.0
        assert "lines" in alone.live_line()
        for wrong in ("heat 7 1", "heat 1 cold", "explode", "thermometer explode"):
            with pytest.raises(UsageError):
                alone.obey(wrong)
        assert alone.failure is None
        driver.close()

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

    arm = Arm()
    with BesideThermometer(arm, serve_thermometer(Plant(robot_file), keys)) as both:
        assert both.ready() == {
            "interface": "virtual",
            "thermometer": str(tmp_path / "port"),
            "thermometer_baudrate": 9600,
        }
        both.obey("block 1")
        both.obey("thermometer unplug")
        assert arm.obeyed == ["block 1"]
        assert not (tmp_path / "port").is_symlink()
        assert both.live_line().startswith("arm; thermometer ")
        assert arm.entered == 1
    assert arm.entered == 0


MOTION = PointToPoint(np.array([[0.1, -0.1], [0.3, 0.1], [0.0, 0.0]]), np.array([1.2, 1.2]))


def record_with(path, server: ThermometerServer, **keys: object):
    """A motion of a scripted arm, recorded with a thermometer on a port."""
    arm = KinematicArm()
    settings = DriverSettings(JOINTS, {**KEYS, "url": server.path, **keys}, (DriveGain(1.0),) * 2)
    sources = Sources("bench", arm, {"oven": SerialThermometerDriver(settings)})
    try:
        sources.open()
        layouts = sources.streams()
        supervisor = Supervisor(Limits.of_robot(ARM.robot, tracking_error=0.05), layouts)
        report = record(sources, Recorder(path, ARM, layouts), supervisor, Play(MOTION, ARM.robot, RATE))
    finally:
        sources.close()
    return arm, report, read_recording(path)


@pytest.mark.parametrize("required", [False, True])
def test_a_thermometer_pulled_out_in_mid_motion(tmp_path, monkeypatch: pytest.MonkeyPatch, required: bool) -> None:
    monkeypatch.setattr(port_module, "RETRY_PERIOD", 0.1)
    with ThermometerServer(lambda: [30.0, 31.0], simulated_thermometer(KEYS, JOINTS)) as server:
        threading.Timer(1.2, server.unplug, (0.6,)).start()
        arm, report, recording = record_with(tmp_path / "run.h5", server, required=required)
    assert arm.stopped_at is not None
    assert arm.commands_after_stop == 0
    messages = [event.message for event in recording.events]
    assert any("oven: the port has gone" in message for message in messages)
    assert len(recording.streams["oven"].time) > 5
    if required:
        assert "oven: the port has gone" in (report.stopped_by or "") or "stale data" in (report.stopped_by or "")
    else:
        assert report.stopped_by is None, report.stopped_by
        assert recording.complete
        assert any("oven: the port is open again" in message for message in messages)
        assert recording.streams["oven"].time[-1] > recording.streams["joints"].host_time[-1] - 0.3


def test_a_hot_joint_stops_the_arm(tmp_path) -> None:
    begun = time.monotonic()
    with ThermometerServer(
        lambda: [30.0, 75.0 if time.monotonic() - begun > 1.5 else 31.0], simulated_thermometer(KEYS, JOINTS)
    ) as server:
        arm, report, _ = record_with(tmp_path / "run.h5", server)
    assert report.stopped_by == "temperature of elbow: 75 °C passes 70 °C"
    assert arm.commands_after_stop == 0
