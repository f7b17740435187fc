from __future__ import annotations

import re
import time
import tomllib
from collections.abc import Callable
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
from canopen_bench import JOINTS, RATE, bench
from scripted_drives import ScriptedDrive

from drivers.base import DRIVERS_GROUP, Driver, DriverSettings
from drivers.canopen402.driver import Canopen402Driver
from drivers.errors import ConnectionFailedError, ConnectionLostError, DriverStateError, UsageError

pytestmark = pytest.mark.usefixtures("punctual")

TEMPERATURE: dict[str, object] = {"index": 0x2031, "subindex": 1, "scale": 0.1, "offset": -1.0}


def test_the_driver_is_registered() -> None:
    # From the source: an installation in place keeps the entry points of the day it was made.
    project = tomllib.loads((Path(__file__).resolve().parents[2] / "pyproject.toml").read_text())
    value = project["project"]["entry-points"][DRIVERS_GROUP]["canopen402"]
    assert EntryPoint("canopen402", value, DRIVERS_GROUP).load() is Canopen402Driver


def test_blocks_are_what_the_streams_promise() -> None:
    with bench(nodes={"pan": {"temperature": TEMPERATURE}, "elbow": {"temperature": TEMPERATURE}}) as one:
        driver: Driver = one.driver
        for drive in one.drives:
            drive.objects |= {(0x606C, 0): 100, (0x6077, 0): -200, (0x6078, 0): 300}
        layouts = {layout.name: layout for layout in driver.streams()}
        assert {name: layout.rate for name, layout in layouts.items()} == {"joints": RATE, "thermal": 5.0}
        assert layouts["thermal"].channels[0].columns == ("pan", "elbow")
        one.read(lambda: len(one.slots) > 60 and len(one.blocks["thermal"]) > 1)
        for name, layout in layouts.items():
            for block in one.blocks[name]:
                assert set(block.values) == {channel.quantity for channel in layout.channels}
                for channel in layout.channels:
                    assert block.values[channel.quantity].shape == (len(block.time), len(channel.columns))
                    assert block.values[channel.quantity].dtype == np.float64
                assert block.host_time.shape == block.time.shape
                assert block.time.dtype == np.float64
        assert np.allclose(one.position, 2 * np.pi * np.array([1000, 2000, 3000]) / 409600)
        assert np.allclose(one.joined("velocity")[-1], 2 * np.pi * 100 / 409600)
        assert np.allclose(one.joined("torque")[-1], -0.2 * 50.0)
        assert np.allclose(one.joined("current")[-1], 0.3 * 5.0)
        assert set(one.joined("statusword")[-1]) == {0x240}
        assert np.all(one.joined("sync_lateness") >= 0)
        assert np.median(one.joined("sync_lateness")) < 0.5 / RATE  # a single one may be late by any stall
        assert np.allclose(one.blocks["thermal"][-1].values["temperature"], 30.2)
        # The clock of the samples is SYNC's schedule; nothing comes twice; what is missing is counted.
        assert len(set(one.slots)) == len(one.slots)
        assert one.slots[-1] - one.slots[0] + 1 == len(one.slots) + one.lost
        host = np.concatenate([block.host_time for block in one.blocks["joints"]])
        clock = np.concatenate([block.time for block in one.blocks["joints"]])
        assert abs(np.median(host - clock) - (time.monotonic() - clock[-1])) < 0.5
        assert abs(one.blocks["thermal"][-1].time[-1] - clock[-1]) < 0.5


def test_a_dropped_frame_loses_its_row_and_names_the_drive() -> None:
    drive = ScriptedDrive(2)
    with bench([ScriptedDrive(1), drive, ScriptedDrive(3)]) as one:
        one.read_rows(5)
        begin = one.bus.syncs
        drive.drop = {number: {1} for number in range(begin + 5, begin + 8)}
        drive.repeat = {begin + 12: {0}}
        one.read_rows(30)
        assert one.lost >= 3
        assert one.slots[-1] - one.slots[0] + 1 == len(one.slots) + one.lost
        one.read(lambda: any("more than one" in text for text in one.said("warning")))
        told = " ".join(one.said("warning"))
        assert sum(int(count) for count in re.findall(r"no answer to SYNC: lift TPDO2 (\d+)", told)) == 3
        assert "more than one answer to SYNC: lift TPDO1 1" in told
        assert "pan" not in told


def test_a_drive_with_a_foreign_mapping_is_told() -> None:
    with bench(joints=JOINTS[:2]) as one:
        one.read_rows(3)
        one.drives[0].short_tpdo = True
        with pytest.raises(ConnectionLostError, match="no complete sample"):
            one.read(lambda: False)
        assert any("frames of a wrong length: pan TPDO1" in text for text in one.said("warning"))


def test_a_silent_drive_ends_the_reading_with_its_name() -> None:
    with bench() as one:
        one.read_rows(3)
        one.drives[2].present = False
        with pytest.raises(ConnectionLostError, match=r"no answer of elbow \(node 3\)"):
            one.read(lambda: False)
        (told,) = one.said("error")
        assert told.startswith("elbow (node 3): no heartbeat for 0.3")
        with pytest.raises(ConnectionLostError):
            one.driver.read(0.0)
        one.driver.stop()


def test_no_answer_to_the_first_sync() -> None:
    with bench(begin="open") as one:
        for drive in one.drives:
            drive.present = False
        one.driver.start()
        with pytest.raises(ConnectionLostError, match="no answer of any drive"):
            one.read(lambda: False)


def test_a_heartbeat_that_stops_and_comes_back() -> None:
    with bench(heartbeat=0.05) as one:
        one.read_rows(3)
        one.drives[0].beats = False
        one.read(lambda: one.said("error"))
        one.drives[0].beats = True
        one.read(lambda: "pan: its heartbeat is back" in one.said("info"))
        assert len(one.said("error")) == 1


def test_a_drive_that_restarts_or_leaves_operational_is_an_error() -> None:
    with bench(heartbeat=0.05) as one:
        one.read_rows(3)
        one.bus.restart(2)
        one.drives[0].nmt = 0x04
        with pytest.raises(ConnectionLostError):
            one.read(lambda: False)
        told = one.said("error")
        assert "lift: the drive restarted, and has lost its configuration" in told
        assert "pan: the drive is no longer operational, but stopped" in told


def test_emergencies_are_told_and_faults_are_errors() -> None:
    with bench() as one:
        one.read_rows(3)
        one.bus.send(0x81, bytes.fromhex("10 42 08 00 00 00 00 00"))
        one.bus.send(0x81, bytes(8))
        one.bus.send(0x82, b"\x10")
        one.read(lambda: len(one.said("warning")) >= 2)
        assert "pan: device temperature too high (EMCY 0x4210, register: temperature)" in one.said("warning")
        assert "pan: error cleared (EMCY 0x0000)" in one.said("info")
        assert one.said("error") == []
        one.bus.fail(3, 0x8611)
        one.read(lambda: one.said("error"))
        assert one.said("error")[0].startswith("elbow: fault: following error (EMCY 0x8611")
        notice = next(notice for notice in one.notices if notice.level == "error")
        assert abs(notice.time * RATE - one.slots[-1]) < 20


def test_warnings_of_the_statusword_are_told_once() -> None:
    with bench() as one:
        one.read_rows(3)
        one.drives[1].bits = 0x0080 | 0x2000
        one.read_rows(10)
        assert one.said("warning") == ["lift: warning", "lift: following error"]


def test_a_temperature_that_does_not_come_is_no_number_and_told() -> None:
    with bench(nodes={"lift": {"temperature": TEMPERATURE}}) as one:
        one.read(lambda: one.blocks["thermal"])
        one.drives[1].aborts[0x2031, 1] = 0x06060000
        one.read(lambda: np.isnan(one.blocks["thermal"][-1].values["temperature"]).all())
        assert any("no temperature: lift (node 2)" in text for text in one.said("warning"))


def test_a_wrong_temperature_object_shows_when_opening() -> None:
    with (
        bench(nodes={"lift": {"temperature": {"index": 0x2999}}}, begin="closed") as one,
        pytest.raises(ConnectionFailedError, match=r"0x2999 \(temperature\): the object does not exist"),
    ):
        one.driver.open()


def test_stop_and_start_again_on_one_clock() -> None:
    with bench() as one:
        one.read_rows(5)
        first = one.slots[-1]
        one.driver.stop()
        one.driver.stop()
        time.sleep(0.2)
        assert all(drive.nmt == 0x7F for drive in one.drives)
        one.driver.start()
        one.read_rows(5)
        assert one.slots[-1] > first + 0.2 * RATE
        assert one.lost < 5  # the pause is no loss
        one.driver.close()
        one.driver.close()


def test_calls_that_the_state_does_not_allow() -> None:
    with bench(begin="closed") as one:
        driver = one.driver
        calls: dict[str, Callable[[], object]] = {
            "open": driver.open,
            "streams": driver.streams,
            "identify": driver.identify,
            "start": driver.start,
            "read": lambda: driver.read(0.0),
            "command": lambda: driver.command(np.zeros(3)),
        }

        def refused(*names: str) -> None:
            for name in names:
                with pytest.raises(DriverStateError, match="the driver must be"):
                    calls[name]()

        refused("streams", "identify", "start", "read", "command")
        assert driver.notices() == []
        driver.stop()
        driver.close()
        driver.open()
        refused("open", "read", "command")
        driver.start()
        refused("open", "start")
        driver.streams()
        driver.close()
        refused("streams", "identify", "start", "read", "command")
        driver.open()  # and anew


def test_wrong_keys_are_refused_before_anything_is_opened() -> None:
    with pytest.raises(UsageError, match="no drive for b"):
        Canopen402Driver(
            DriverSettings(("a", "b"), {"interface": "virtual", "channel": "x", "nodes": {"a": {"id": 1}}}, ())
        )


def test_an_unknown_bus_leaves_the_driver_closed() -> None:
    with bench(begin="closed", interface="virtuel") as one:
        with pytest.raises(ConnectionFailedError, match="no interface 'virtuel'") as caught:
            one.driver.open()
        assert caught.value.hint == "did you mean 'virtual'?"
        one.driver.close()
