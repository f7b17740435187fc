from __future__ import annotations

import threading
import time
import tomllib
from collections.abc import Callable, Iterator, Sequence
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
from fake_ur_control import FakeControl
from scripted_rtde import Cut, Never, Sample, ScriptedController, Step, Wait, paced, steady

from drivers.base import DRIVERS_GROUP, Driver, DriverSettings, Identifying
from drivers.errors import ConnectionFailedError, ConnectionLostError, DriverStateError, UsageError
from drivers.gains import DriveGain
from drivers.rtde import driver as driver_module
from drivers.rtde import wire
from drivers.rtde.driver import RtdeDriver
from drivers.rtde.motion import MotionProcess
from drivers.streams import Block

JOINTS = tuple(f"j{number}" for number in range(1, 7))
GAINS = tuple(DriveGain(float(number), 0.1) for number in range(1, 7))
Make = Callable[..., ScriptedController]
MakeDriver = Callable[..., RtdeDriver]


@pytest.fixture
def make_driver() -> Iterator[MakeDriver]:
    made: list[RtdeDriver] = []

    def make(port: int, *, gains: Sequence[DriveGain] = GAINS, **keys: object) -> RtdeDriver:
        connection = {"host": "127.0.0.1", "port": port, "timeout": 2.0} | keys
        made.append(RtdeDriver(DriverSettings(JOINTS, connection, tuple(gains))))
        return made[-1]

    yield make
    for one in made:
        one.close()


def read_all(driver: RtdeDriver, samples: int) -> dict[str, list[Block]]:
    blocks: dict[str, list[Block]] = {"joints": [], "thermal": [], "status": []}
    deadline = time.monotonic() + 5.0
    while sum(len(block.time) for block in blocks["joints"]) < samples and time.monotonic() < deadline:
        for block in driver.read(0.2):
            blocks[block.stream].append(block)
    return blocks


def joined(blocks: list[Block], quantity: str) -> np.ndarray:
    return np.concatenate([block.values[quantity] for block in blocks])


def times(blocks: list[Block]) -> np.ndarray:
    return np.concatenate([block.time for block in blocks])


def test_the_driver_is_registered() -> None:
    # From the source: an installation in place keeps the entry points of the day it was made.
    project = tomllib.loads((Path(__file__).resolve().parents[2] / "pyproject.toml").read_text())
    value = project["project"]["entry-points"][DRIVERS_GROUP]["rtde"]
    assert EntryPoint("rtde", value, DRIVERS_GROUP).load() is RtdeDriver


def test_it_tells_who_answers(controller: Make, make_driver: MakeDriver) -> None:
    script = controller(lambda number: [*steady(10.0, 10), Never()])
    driver = make_driver(script.port)
    assert isinstance(driver, Identifying)
    with pytest.raises(DriverStateError):
        driver.identify()
    driver.open()
    (identity,) = driver.identify()
    assert identity.controller == f"127.0.0.1:{script.port}"
    assert identity.software.startswith("5.")
    assert identity.rate == 500.0
    assert identity.variables > 4


def test_blocks_are_what_the_streams_promise(controller: Make, make_driver: MakeDriver) -> None:
    driver: Driver = make_driver(controller(lambda number: [*steady(10.0, 1000), Never()]).port)
    driver.open()
    layouts = {layout.name: layout for layout in driver.streams()}
    assert {name: layout.rate for name, layout in layouts.items()} == {"joints": 500.0, "thermal": 20.0, "status": 10.0}
    driver.start()
    assert isinstance(driver, RtdeDriver)
    blocks = read_all(driver, 1000)
    for name, layout in layouts.items():
        for block in blocks[name]:
            assert set(block.values) == {channel.quantity for channel in layout.channels}
            for channel in layout.channels:
                assert block.values[channel.quantity].shape == (len(block.time), len(channel.columns))
                assert block.values[channel.quantity].dtype == np.float64
            assert block.host_time.shape == block.time.shape
    clock = times(blocks["joints"])
    assert np.array_equal(clock, 10.0 + np.arange(1000) / 500)
    base = clock[:, np.newaxis] + np.arange(6) / 10
    for quantity, factor in (("position", 1), ("velocity", 2), ("current", 3), ("target_position", 4)):
        assert np.allclose(joined(blocks["joints"], quantity), factor * base)
    for quantity, factor in (("target_acceleration", 6), ("target_current", 7), ("target_torque", 8)):
        assert np.allclose(joined(blocks["joints"], quantity), factor * base)
    assert np.allclose(joined(blocks["joints"], "torque"), 3 * base * np.arange(1, 7))
    thermal = times(blocks["thermal"])
    assert np.allclose(thermal, 10.0 + np.arange(40) / 20)
    assert np.allclose(joined(blocks["thermal"], "temperature")[:, 0], 9 * thermal)
    assert len(times(blocks["status"])) == 20
    assert set(joined(blocks["status"], "robot_mode")[:, 0]) == {7.0}
    assert joined(blocks["status"], "joint_mode").shape == (20, 6)


@pytest.mark.parametrize(
    "gains",
    [
        (),
        (*GAINS[:5], DriveGain(None)),
        (*GAINS[:5], DriveGain(1.0, 0.1, "torque")),
    ],
)
def test_without_all_gains_there_is_current_but_no_torque(
    controller: Make, make_driver: MakeDriver, gains: tuple[DriveGain, ...]
) -> None:
    driver = make_driver(controller(lambda number: [*steady(1.0, 5), Never()]).port, gains=gains)
    driver.open()
    quantities = [channel.quantity for channel in driver.streams()[0].channels]
    assert "current" in quantities
    assert "torque" not in quantities
    driver.start()
    assert "torque" not in read_all(driver, 5)["joints"][0].values


def test_a_gap_is_counted_in_every_stream(controller: Make, make_driver: MakeDriver) -> None:
    steps = [sample for index, sample in enumerate(steady(10.0, 1000)) if not 300 <= index < 451]
    driver = make_driver(controller(lambda number: [*steps, Never()]).port)
    driver.open()
    driver.start()
    blocks = read_all(driver, len(steps))
    lost = {name: sum(block.lost for block in found) for name, found in blocks.items()}
    # 151 samples are missing, and with them six groups of 25 and three groups of 50 but for a sample of the last.
    assert lost["joints"] == 151
    assert (lost["thermal"], lost["status"]) == (6, 3)
    for name, period in (("thermal", 25), ("status", 50)):
        ticks = np.rint(times(blocks[name]) * 500).astype(int)
        assert len(set(ticks // period)) == len(ticks)


def test_refused_variables_leave_their_channels_out(controller: Make, make_driver: MakeDriver) -> None:
    refuse = dict.fromkeys(("target_moment", "joint_temperatures", "joint_mode"), "NOT_FOUND")
    driver = make_driver(controller(lambda number: [*steady(1.0, 100), Never()], refuse=refuse).port)
    driver.open()
    layouts = {layout.name: [channel.quantity for channel in layout.channels] for layout in driver.streams()}
    assert set(layouts) == {"joints", "status"}
    assert "target_torque" not in layouts["joints"]
    assert layouts["status"] == ["robot_mode", "safety_mode", "runtime_state"]
    assert sum("left out" in notice.message for notice in driver.notices()) == 3
    driver.start()
    assert read_all(driver, 100)["thermal"] == []


def test_an_older_controller_has_its_own_rate(controller: Make, make_driver: MakeDriver) -> None:
    driver = make_driver(controller(lambda number: [*steady(1.0, 125, 125.0), Never()], major=3).port)
    driver.open()
    assert [round(layout.rate, 1) for layout in driver.streams()] == [125.0, 20.8, 10.4]
    driver.start()
    blocks = read_all(driver, 125)
    assert sum(block.lost for block in blocks["joints"]) == 0


def modes(**values: int) -> dict[str, list[float]]:
    return {name: [value] for name, value in values.items()}


def test_modes_become_notices_when_they_change(controller: Make, make_driver: MakeDriver) -> None:
    steps: list[Step] = [
        *steady(1.0, 10),
        Sample(1.02, modes(safety_mode=3)),
        Sample(1.022, modes(safety_mode=3, runtime_state=1)),
        Wait(0.1),
        Sample(1.024, modes(safety_mode=6)),
        Sample(1.026, modes(robot_mode=3)),
        Sample(1.028, modes(robot_mode=99)),
        Never(),
    ]
    driver = make_driver(controller(lambda number: steps).port)
    driver.open()
    driver.start()
    read_all(driver, 15)
    found = [(round(notice.time, 3), notice.level, notice.message) for notice in driver.notices()]
    assert sorted(found) == sorted(
        [
            (1.0, "info", "robot mode: running"),
            (1.0, "info", "safety mode: normal"),
            (1.0, "info", "runtime state: playing"),
            (1.02, "error", "safety mode: protective stop"),
            (1.022, "info", "runtime state: stopped"),
            (1.024, "error", "safety mode: system emergency stop"),
            (1.024, "info", "runtime state: playing"),
            (1.026, "info", "safety mode: normal"),
            (1.026, "error", "robot mode: power off"),
            (1.028, "error", "robot mode: unknown (99)"),
        ]
    )
    assert driver.notices() == []


def test_a_lost_connection_shows_and_can_be_had_again(controller: Make, make_driver: MakeDriver) -> None:
    scripts = [[*steady(1.0, 20), Cut()], [*steady(2.0, 20), Never()]]
    driver = make_driver(controller(lambda number: scripts[number]).port)
    driver.open()
    driver.start()
    read_all(driver, 20)
    for _ in range(2):
        with pytest.raises(ConnectionLostError):
            driver.read(1.0)
    driver.reconnect()
    blocks = read_all(driver, 20)
    assert times(blocks["joints"])[0] == 2.0
    assert sum(block.lost for block in blocks["joints"]) == 480
    driver.stop()
    driver.close()


def test_stop_and_start_again(controller: Make, make_driver: MakeDriver) -> None:
    starts = iter([1.0, 7.0])
    server = controller(lambda number: [*steady(next(starts), 10), Never()])
    driver = make_driver(server.port)
    driver.open()
    for begin in (1.0, 7.0):
        driver.start()
        assert times(read_all(driver, 10)["joints"])[0] == begin
        driver.stop()
        driver.stop()
    assert server.connections == 1
    driver.close()
    driver.close()


def test_after_a_loss_start_connects_again(controller: Make, make_driver: MakeDriver) -> None:
    scripts = [[*steady(1.0, 5), Cut()], [*steady(3.0, 5), Never()]]
    driver = make_driver(controller(lambda number: scripts[number]).port)
    driver.open()
    driver.start()
    time.sleep(0.1)
    driver.stop()
    driver.start()
    blocks = read_all(driver, 5)["joints"]
    assert times(blocks)[0] == 3.0
    assert sum(block.lost for block in blocks) == 0


def test_calls_that_the_state_does_not_allow(controller: Make, make_driver: MakeDriver) -> None:
    driver = make_driver(controller(lambda number: [*steady(1.0, 5), Never()]).port)
    calls: dict[str, Callable[[], object]] = {
        "open": driver.open,
        "streams": driver.streams,
        "start": driver.start,
        "read": lambda: driver.read(0.0),
        "command": lambda: driver.command(np.zeros(6)),
        "reconnect": driver.reconnect,
    }

    def refused(*names: str) -> None:
        for name in names:
            with pytest.raises(DriverStateError, match="the driver must be"):
                calls[name]()

    refused("streams", "start", "read", "command", "reconnect")
    driver.stop()
    driver.close()
    driver.open()
    refused("open", "read", "command", "reconnect")
    driver.start()
    refused("open", "start")
    driver.streams()
    driver.close()
    refused("streams", "start", "read", "command", "reconnect")


def test_an_arm_of_another_make_is_refused() -> None:
    with pytest.raises(UsageError, match="moves 6 joints, but the robot file names 4"):
        RtdeDriver(DriverSettings(("a", "b", "c", "d"), {"host": "h"}, ()))


def test_nobody_there_leaves_the_driver_closed(make_driver: MakeDriver, controller: Make) -> None:
    server = controller(lambda number: [], mute_at="V")
    driver = make_driver(server.port, timeout=0.2)
    with pytest.raises(ConnectionFailedError):
        driver.open()
    server.mute_at = ""
    driver.open()


def test_motion_needs_the_port_that_ur_rtde_knows(controller: Make, make_driver: MakeDriver) -> None:
    driver = make_driver(controller(lambda number: [*steady(0.0, 5), Never()]).port)
    driver.open()
    driver.start()
    with pytest.raises(DriverStateError, match="needs RTDE on port 30004"):
        driver.command(np.zeros(6))


def test_motion_begins_where_the_arm_stands_and_ends_with_stop(
    controller: Make, make_driver: MakeDriver, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    server = controller(lambda number: paced(500.0, start=0.0))
    log = tmp_path / "control.log"
    monkeypatch.setattr(wire, "PORT", server.port)
    monkeypatch.setattr(
        driver_module,
        "MotionProcess",
        lambda host, rate, timeout: MotionProcess(str(log), rate, timeout, FakeControl),
    )
    driver = make_driver(server.port, timeout=10.0)
    driver.open()
    driver.start()
    with pytest.raises(DriverStateError, match="where the arm stands"):
        driver.command(np.zeros(6))
    blocks = list(driver.read(1.0))
    position = blocks[0].values["position"][-1]
    with pytest.raises(DriverStateError, match=r"0\.200 rad away") as caught:
        driver.command(position + np.array([0, 0, 0.2, 0, 0, 0]))
    assert caught.value.where == "joint j3"
    assert not log.exists()  # nobody took control
    for _ in range(20):
        driver.command(position)
        blocks += driver.read(0.1)
    driver.stop()
    with pytest.raises(DriverStateError):
        driver.command(position)
    written = log.read_text().splitlines()
    assert written[0].startswith("control ")
    assert sum(line.startswith("servoJ") for line in written) >= 1
    assert written[-1] == "disconnect"
    joints = [block for block in blocks if block.stream == "joints"]
    assert np.all(np.diff(times(joints)) > 0)
    assert sum(block.lost for block in joints) == 0  # taking control costs no sample


class SlowMotion:
    """Takes its time to stop, as an arm does."""

    made = 0

    def __init__(self, host: str, rate: float, timeout: float) -> None:
        SlowMotion.made += 1
        self.stopping = threading.Event()
        self.stopped = threading.Event()
        SlowMotion.last = self

    last: SlowMotion

    def command(self, position: np.ndarray) -> None:
        assert not self.stopping.is_set()

    def stop(self) -> bool:
        self.stopping.set()
        return self.stopped.wait(5.0)


def test_while_the_arm_is_braking_it_is_recorded_but_not_commanded(
    controller: Make, make_driver: MakeDriver, monkeypatch: pytest.MonkeyPatch
) -> None:
    server = controller(lambda number: paced(500.0, start=0.0))
    monkeypatch.setattr(wire, "PORT", server.port)
    monkeypatch.setattr(driver_module, "MotionProcess", SlowMotion)
    driver = make_driver(server.port)
    driver.open()
    driver.start()
    position = driver.read(1.0)[0].values["position"][-1]
    driver.command(position)
    stopper = threading.Thread(target=driver.stop)
    stopper.start()
    assert SlowMotion.last.stopping.wait(2.0)
    with pytest.raises(DriverStateError, match="being stopped"):
        driver.command(position)
    assert len(driver.read(1.0)) >= 1
    SlowMotion.last.stopped.set()
    stopper.join()
    assert SlowMotion.made == 1
    with pytest.raises(DriverStateError, match="must be running"):
        driver.read(0.0)
    assert driver.notices()[-1].level == "info"  # it did confirm
