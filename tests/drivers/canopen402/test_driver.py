from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from canopen_bench import JOINTS, RATE, READ, bench
from scripted_drives import FRAME_TIME, ScriptedDrive

from drivers.base import Driver, DriverSettings
from drivers.can.receiver import POLL
from drivers.canopen402.driver import FIRST_ROW_LIMIT, SILENCE_LIMIT, Canopen402Driver
from drivers.canopen402.monitor.drives import ALIGNMENT_PERIOD
from drivers.core.errors import ConnectionFailedError, ConnectionLostError, UsageError

TEMPERATURE: dict[str, object] = {"index": 0x2031, "subindex": 1, "scale": 0.1, "offset": -1.0}


def test_blocks_are_what_the_streams_promise() -> None:
    with bench(nodes={"pan": {"temperature": TEMPERATURE}, "elbow": {"temperature": TEMPERATURE}}) as one:
        driver: Driver = one.driver
        begun = one.clock.now()
        for drive in one.drives:
            drive.objects |= {(0x606C, 0): 100, (0x6077, 0): -200, (0x6078, 0): 300}
        layouts = {layout.name: layout for layout in driver.streams()}
        assert {name: layout.rate for name, layout in layouts.items()} == {"joints": RATE, "thermal": 5.0}
        assert layouts["thermal"].channels[0].columns == ("pan", "elbow")
        one.read_rows(60)
        assert one.clock.now() - begun == pytest.approx(61 / RATE + FRAME_TIME)  # row 60 is sure with SYNC 61
        for block in itertools.chain.from_iterable(one.blocks.values()):
            assert {values.dtype for values in (block.time, *block.values.values())} == {np.dtype(np.float64)}
            assert block.host_time.shape == block.time.shape
        assert np.allclose(one.position, 2 * np.pi * np.array([1000, 2000, 3000]) / 409600)
        assert np.allclose(one.joined("velocity")[-1], 2 * np.pi * 100 / 409600)
        assert np.allclose(one.joined("torque")[-1], -0.2 * 50.0)
        assert np.allclose(one.joined("current")[-1], 0.3 * 5.0)
        assert set(one.joined("statusword")[-1]) == {0x240}
        np.testing.assert_allclose(one.joined("sync_lateness"), 0.0, atol=1e-12)
        assert np.allclose(one.blocks["thermal"][-1].values["temperature"], 30.2)
        # The clock of the samples is SYNC's schedule: a row a SYNC, that came with the last of its six frames.
        assert one.slots == list(range(1, 61))
        assert one.lost == 0
        for block in one.blocks["joints"]:
            np.testing.assert_allclose(block.host_time - begun, block.time + 6 * FRAME_TIME, atol=2 * FRAME_TIME)
        thermal = np.concatenate([block.time for block in one.blocks["thermal"]])
        np.testing.assert_allclose(thermal, [0.2, 0.4, 0.6], atol=2 * FRAME_TIME)
        np.testing.assert_allclose(thermal, [block.host_time[0] - begun for block in one.blocks["thermal"]])


def test_a_dropped_frame_loses_its_row_and_names_the_drive() -> None:
    drive = ScriptedDrive(2)
    with bench([ScriptedDrive(1), drive, ScriptedDrive(3)]) as one:
        drive.drop = {number: {1} for number in (10, 11, 12)}
        drive.repeat = {17: {0}}
        one.read_rows(30)
        # SYNC number k is the (k + 1)th that the drive sees.
        assert one.slots == [slot for slot in range(1, 34) if slot not in (11, 12, 13)]
        assert one.lost == 3
        one.read_rows(100)
        told = [notice for notice in one.notices if notice.level == "warning"]
        assert [one.message for one in told] == [
            "no answer to SYNC: lift TPDO2 1",
            "no answer to SYNC: lift TPDO2 2; more than one answer to SYNC: lift TPDO1 1",
        ]
        assert told[1].time - told[0].time == pytest.approx(ALIGNMENT_PERIOD, abs=1.01 / RATE)


def test_losses_tell_this_computer_from_a_drive() -> None:
    drive = ScriptedDrive(2)
    with bench([ScriptedDrive(1), drive, ScriptedDrive(3)]) as one:
        one.read_rows(3)
        assert one.driver.losses("joints") == ""
        one.clock.stall(0.035)  # too early to know that the arm is at rest
        one.read_rows(30)
        assert one.lost == 3
        assert one.driver.losses("joints") == "3 SYNCs not sent: this computer was late"
        drive.drop = {number: {0, 1} for number in (50, 51)}
        one.read_rows(60)
        assert one.lost == 5
        assert one.driver.losses("joints").endswith("late; no answer to SYNC in time: lift 2")
        assert one.driver.losses("thermal") == ""


@pytest.mark.parametrize("stall", [0.007, 0.05, 0.15])
def test_at_rest_a_busy_computer_loses_nothing(stall: float) -> None:
    with bench() as one:
        one.read_rows(15)
        for _ in range(5):
            one.clock.stall(stall)
            one.read_rows(80)
        assert one.lost == 0
        assert one.slots == list(range(1, one.slots[-1] + 1))
        assert one.driver.losses("joints") == ""


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
        last = one.blocks["joints"][-1].host_time[-1]
        with pytest.raises(ConnectionLostError, match=r"no answer of elbow \(node 3\)"):
            one.read(lambda: False)
        # The row of the SYNC before was complete, but not sure yet.
        assert 0.0 < one.clock.now() - last - 1 / RATE - SILENCE_LIMIT < READ + 1 / RATE
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
        begun = one.clock.now()
        with pytest.raises(ConnectionLostError, match="no answer of any drive"):
            one.read(lambda: False)
        assert FIRST_ROW_LIMIT < one.clock.now() - begun < FIRST_ROW_LIMIT + READ + POLL


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
        assert notice.time == one.blocks["joints"][-1].time[-1]  # of the first row that shows it, which has just come
        assert (one.joined("statusword")[-2:, 2].astype(int) & 0x4F).tolist() == [0x40, 0x08]


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
        one.driver.stop()
        one.driver.stop()
        one.clock.sleep(0.2)
        assert all(drive.nmt == 0x7F for drive in one.drives)
        before = one.bus.syncs
        one.driver.start()
        one.read_rows(5)
        assert one.bus.syncs == before + 6
        first = math.floor((one.clock.now() - one.begun) * RATE) - 5
        assert one.slots == [1, 2, 3, 4, 5, *range(first, first + 5)]
        assert first > 25
        assert one.lost == 0  # the pause is no loss
        one.driver.close()
        one.driver.close()


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
