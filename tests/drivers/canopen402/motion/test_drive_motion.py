"""Every way into and out of operation enabled; nothing enables by itself."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from canopen_bench import RATE, READ, Bench, bench
from scripted_drives import FRAME_TIME, RAMP, ScriptedDrive

from drivers.can.receiver import POLL
from drivers.canopen402.motion.drive_motion import OFF_LIMIT, STANDING
from drivers.canopen402.motion.target_path import PATIENCE, REPEAT
from drivers.core.errors import ConnectionLostError, DriverStateError, MotionRefusedError

ENABLING = ["disabled", "ready", "switched on", "enabled"]


def drives(*changed: ScriptedDrive) -> list[ScriptedDrive]:
    by_node = {node: ScriptedDrive(node) for node in (1, 2, 3)} | {drive.node: drive for drive in changed}
    return list(by_node.values())


def off(one: Bench) -> bool:
    return all(drive.state == "disabled" and drive.controlwords[-1] == 0 for drive in one.drives)


def test_enabling_goes_through_every_state_and_moves_nothing() -> None:
    with bench() as one:
        before = [drive.number(0x6064) for drive in one.drives]
        one.enable()
        for drive, position in zip(one.drives, before, strict=True):
            assert drive.states == ENABLING
            assert drive.controlwords == [0x00, 0x06, 0x07, 0x0F]
            assert set(drive.targets) <= {position}
            assert drive.number(0x6060) == 8


def test_targets_go_out_to_all_drives_after_the_next_sync() -> None:
    with bench(nodes={"lift": {"direction": -1, "zero": 0.25}}) as one:
        one.enable()
        start = one.position
        for step in range(1, 11):
            one.driver.command(start + step * np.array([0.001, -0.002, 0.003]))
            one.read_rows(1)
        goal = start + 10 * np.array([0.001, -0.002, 0.003])
        one.driver.command(goal)  # at rest there
        one.read(lambda: np.allclose(one.position, goal, atol=1e-5))
        assert len(one.drives[0].targets) > 5
        assert one.said("error") == []
        sent = [identifier for identifier, _ in one.bus.seen if identifier == 0x80 or 0x200 < identifier < 0x280]
        cycles = sent[sent.index(0x201) :]
        assert cycles == ([0x201, 0x202, 0x203, 0x80] * len(cycles))[: len(cycles)]
        times = [time for time, (identifier, _) in zip(one.bus.times, one.bus.seen, strict=True) if identifier == 0x80]
        np.testing.assert_allclose(np.diff(times), 1 / RATE, atol=4 * FRAME_TIME)


def test_a_jump_and_a_blind_start_are_refused() -> None:
    with bench() as one:
        with pytest.raises(DriverStateError, match="no position of the arm is known"):
            one.driver.command(np.zeros(3))
        one.read_rows(2)
        with pytest.raises(DriverStateError, match=r"0\.200 rad away") as caught:
            one.driver.command(one.position + np.array([0.0, 0.0, 0.2]))
        assert caught.value.where == "joint elbow"
        for wrong in (np.zeros(2), np.full(3, np.nan), np.full(3, np.inf), np.zeros((3, 1))):
            with pytest.raises(ValueError, match="3 finite numbers"):
                one.driver.command(wrong)
        assert all(drive.controlwords == [] for drive in one.drives)


def test_recording_only_never_enables() -> None:
    with bench(mode="none") as one:
        one.read_rows(2)
        with pytest.raises(DriverStateError, match="only records"):
            one.driver.command(one.position)
        assert all(drive.states == ["disabled"] for drive in one.drives)


@pytest.mark.parametrize("stuck", ["ready", "switched on", "enabled"])
def test_a_drive_that_does_not_come_along_keeps_all_from_moving(stuck: str) -> None:
    with bench(drives(ScriptedDrive(2, stuck={stuck})), timeout=0.5) as one:
        begun = one.clock.now()
        with pytest.raises(DriverStateError, match="does not reach") as caught:
            one.enable()
        assert 0.5 < one.clock.now() - begun < 0.5 + 4 / RATE + READ  # two rows first
        assert caught.value.where == "lift (node 2)"
        assert "safe-torque-off" in caught.value.hint
        one.read(lambda: not any(drive.state == "enabled" for drive in one.drives))
        with pytest.raises(DriverStateError):
            one.driver.command(one.position)
        one.driver.stop()
        assert off(one)


def test_a_drive_that_does_not_take_the_mode_is_not_enabled() -> None:
    with bench(drives(ScriptedDrive(3, mode_accepted=False)), timeout=0.5) as one:
        with pytest.raises(DriverStateError, match=r"displays mode 0 \(none\) instead of 8"):
            one.enable()
        assert "enabled" not in [state for drive in one.drives for state in drive.states]


def test_a_drive_in_fault_is_not_enabled_and_its_fault_not_reset() -> None:
    with bench() as one:
        one.read_rows(2)
        one.bus.fail(2)
        tried = one.drives[1].controlwords.copy()
        with pytest.raises(DriverStateError, match="in fault") as caught:
            one.enable()
        assert caught.value.where == "lift (node 2)"
        assert one.drives[1].controlwords == tried
        assert one.drives[0].states == ["disabled"]


def test_a_fault_stops_the_others_at_once_and_is_an_error_with_its_cause() -> None:
    with bench() as one:
        one.enable()
        one.bus.fail(2, 0x4310)
        failed = len(one.bus.times)
        one.read(lambda: one.drives[0].state == "disabled" and one.drives[2].state == "disabled")  # without a stop
        # The first SYNC after the fault shows it, the targets after the second one are quick stops.
        after = [data[0] for identifier, data in one.bus.seen[failed:] if identifier in (0x201, 0x203)]
        assert after[:2] == [0x0F, 0x0F]
        assert set(after[2:]) == {0x02}
        assert one.drives[0].states == [*ENABLING, "quick stop", "disabled"]
        with pytest.raises(DriverStateError, match="lift left operation enabled: fault: drive temperature too high"):
            one.driver.command(one.position)
        assert any(text.startswith("lift: fault: drive temperature too high") for text in one.said("error"))
        one.driver.stop()
        one.driver.start()
        one.read_rows(3)
        with pytest.raises(DriverStateError, match="in fault"):
            one.driver.command(one.position)
        assert one.drives[1].states[-1] == "fault"
        assert not any(word & 0x80 for word in one.drives[1].controlwords)


def test_after_a_fault_a_drive_is_never_enabled_by_itself() -> None:
    with bench() as one:
        one.enable()
        one.bus.fail(3)
        one.read(lambda: one.drives[0].state == "disabled")
        one.drives[2].enter("disabled")  # somebody resets the fault at the drive
        count = len(one.drives[2].states)
        one.read_rows(30)
        assert one.drives[2].states[count:] == []


def test_a_drive_that_switches_itself_off_is_an_error_while_moving() -> None:
    with bench() as one:
        one.enable()
        one.drives[0].enter("disabled")  # safe torque off
        one.read(lambda: one.drives[1].state == "disabled")
        assert "pan: left operation enabled: switch on disabled" in one.said("error")
        assert one.drives[0].states == [*ENABLING, "disabled"]


@pytest.mark.parametrize("stays", [True, False])
def test_stop_is_a_quick_stop_until_rest_and_then_off(stays: bool) -> None:
    with bench([ScriptedDrive(node, quick_stop_stays=stays) for node in (1, 2, 3)]) as one:
        one.enable()
        begun = one.clock.now()
        one.driver.stop()
        # The next SYNC applies the quick stop, another one tells of the rest, those within `STANDING` and the next one
        # that the position stays, one more of the voltage.
        assert RAMP + STANDING < one.clock.now() - begun <= RAMP + STANDING + 4 / RATE + POLL
        for drive in one.drives:
            assert drive.controlwords == [0x00, 0x06, 0x07, 0x0F, 0x02, 0x00]
            assert drive.states == [*ENABLING, "quick stop", "disabled"]
        assert one.said("error") == []
        one.driver.stop()
        with pytest.raises(DriverStateError):
            one.driver.command(one.position)


def test_all_drives_get_the_quick_stop_in_the_same_period() -> None:
    with bench() as one:
        one.enable()
        one.driver.stop()
        frames = list(one.bus.seen)
        first = next(i for i, (identifier, data) in enumerate(frames) if identifier == 0x201 and data[0] == 0x02)
        following = [identifier for identifier, _ in frames[first : first + 3]]
        assert following == [0x201, 0x202, 0x203]
        assert {data[0] for _, data in frames[first : first + 3]} == {0x02}


def test_a_drive_that_ignores_the_quick_stop_is_switched_off_after_a_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.canopen402.motion.drive_motion.STOP_LIMIT", 0.3)
    with bench(drives(ScriptedDrive(2, ignores_quick_stop=True))) as one:
        one.enable()
        begun = one.clock.now()
        one.driver.stop()
        assert 0.3 < one.clock.now() - begun < 0.3 + OFF_LIMIT
        assert off(one)
        assert one.said("error") == ["lift: the drive did not confirm that it is at rest and off"]


def test_stop_while_enabling() -> None:
    with bench(drives(ScriptedDrive(2, stuck={"switched on"})), timeout=30.0) as one:
        one.read_rows(2)
        refused: list[DriverStateError] = []

        def command() -> None:
            try:
                one.driver.command(one.position)
            except DriverStateError as error:
                refused.append(error)

        thread = one.clock.thread(command, "command")
        thread.start()
        one.read(lambda: one.drives[0].state == "switched on")
        begun = one.clock.now()
        one.driver.stop()
        assert one.clock.now() - begun <= 3 / RATE + POLL
        thread.join()
        assert "being stopped" in refused[0].message
        assert off(one)


def test_stop_with_a_drive_that_is_gone_stops_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.canopen402.motion.drive_motion.STOP_LIMIT", 0.5)
    with bench(timeout=1.0) as one:
        one.enable()
        one.drives[1].present = False
        one.driver.stop()
        assert [one.drives[0].state, one.drives[2].state] == ["disabled", "disabled"]
        assert any("lift" in text for text in one.said("error"))
        assert not any("pan" in text for text in one.said("error"))


@pytest.mark.parametrize("by_itself", [True, False])
def test_drives_that_left_operational_are_stopped_and_asked_by_sdo(by_itself: bool) -> None:
    with bench() as one:
        one.enable()
        gone = one.drives[1]
        gone.nmt = 0x7F  # no RPDO, no TPDO
        if by_itself:
            gone.control(0x02, one.clock.now())
        begun = one.clock.now()
        one.driver.stop()
        # Silent ones are asked by SDO after a while, and again until they say that they are off.
        assert 2 * PATIENCE < one.clock.now() - begun < 2 * PATIENCE + RAMP + 4 * REPEAT
        assert all(drive.states[-2:] == ["quick stop", "disabled"] for drive in one.drives)
        assert (0x602, bytes.fromhex("40 41 60 00 00 00 00 00")) in one.bus.seen
        assert ((0x602, bytes.fromhex("2b 40 60 00 02 00 00 00")) in one.bus.seen) != by_itself
        assert not [text for text in one.said("error") if "did not confirm" in text]


def test_stop_with_the_whole_bus_gone_neither_raises_nor_hangs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.canopen402.motion.drive_motion.STOP_LIMIT", 0.2)
    with bench() as one:
        one.enable()
        assert one.driver._bus is not None
        one.driver._bus.shutdown()
        with pytest.raises(ConnectionLostError):
            one.read(lambda: False)
        with pytest.raises(ConnectionLostError):
            one.driver.command(one.position)
        begun = one.clock.now()
        one.driver.stop()
        one.driver.close()
        assert 0.0 < one.clock.now() - begun - 0.2 - OFF_LIMIT < POLL + 0.02
        assert len(one.said("error")) == 3


def test_close_and_a_lost_reader_stop_the_arm_too() -> None:
    with bench() as one:
        one.enable()
        one.driver.close()
        assert all(drive.states[-2:] == ["quick stop", "disabled"] for drive in one.drives)


def test_start_again_needs_enabling_again() -> None:
    with bench() as one:
        one.enable()
        one.driver.stop()
        one.driver.start()
        one.read_rows(3)
        assert all(drive.state == "disabled" for drive in one.drives)
        one.enable()
        assert all(drive.state == "enabled" for drive in one.drives)


def test_a_drive_that_leaves_the_mode_stops_all_and_says_so() -> None:
    with bench() as one:
        one.enable()
        one.drives[1].mode_accepted = False
        one.drives[1].objects[0x6061, 0] = 6  # its own homing
        one.read(lambda: all(drive.state == "disabled" for drive in one.drives))
        assert one.said("error")[0] == "lift: the drive left the mode of the motion: it displays mode 6 (homing)"
        with pytest.raises(DriverStateError, match=r"lift left mode 8 .*: it displays 6 \(homing\)"):
            one.driver.command(one.position)


def test_an_emergency_in_motion_is_an_error_and_a_warning_at_rest() -> None:
    with bench() as one:
        one.read_rows(2)
        one.bus.send(0x82, bytes.fromhex("20 75 80 00 00 00 00 00"))
        words = "lift: communication module (EMCY 0x7520, register: manufacturer's own)"
        one.read(lambda: one.said("warning"))
        assert (one.said("warning"), one.said("error")) == ([words], [])
        one.enable()
        one.bus.send(0x82, bytes.fromhex("20 75 80 00 00 00 00 00"))
        one.bus.send(0x82, bytes(8))
        one.read(lambda: one.said("error"))
        assert one.said("error") == [words]


def test_a_master_that_appears_in_a_motion_is_an_error() -> None:
    with bench() as one:
        one.enable()
        one.bus.send(0x77F, b"\x05")
        one.bus.send(0x77F, b"\x05")
        one.read(lambda: one.said("error"))
        assert one.said("error") == [
            "another master is on the bus: a heartbeat as node 127 (0x77F) that is not dynid's"
        ]


def test_a_drive_that_somebody_powers_before_the_motion_keeps_its_voltage() -> None:
    with bench() as one:
        one.read_rows(2)
        one.drives[2].enter("enabled")
        one.read_rows(2)
        with pytest.raises(MotionRefusedError, match="already powered"):
            one.driver.take_control()
        one.driver.close()
        assert (one.drives[2].state, one.drives[2].nmt, one.drives[2].controlwords) == ("enabled", 5, [])


@pytest.mark.parametrize("slows", [True, False])
def test_voltage_is_not_cut_while_a_drive_still_slows_down(slows: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.canopen402.motion.drive_motion.STOP_LIMIT", 0.2)
    drive = ScriptedDrive(2, ramp=1.0)
    with bench(drives(drive)) as one:
        one.enable()
        drive.objects[0x606C, 0] = 50_000
        one.read_rows(2)
        begun = one.clock.now()
        for tick in range(100) if slows else ():
            speed = 50_000 * (1.0 - 0.01 * tick)
            one.clock.call_at(
                begun + 0.01 * tick, lambda speed=speed: drive.objects.update({(0x606C, 0): round(speed)})
            )
        one.driver.stop()
        took = one.clock.now() - begun
        said = one.said("error")
        assert took > 0.9 if slows else 0.2 < took < 0.2 + OFF_LIMIT
        went_on = "lift: the drive went on for 0.2 s after its quick stop without slowing down; its voltage was cut"
        assert said == ([] if slows else [went_on])
        assert off(one)


def test_after_a_stall_all_drives_get_a_quick_stop_and_no_further_target() -> None:
    with bench() as one:
        one.enable()
        start = one.position
        for step in range(1, 11):
            one.driver.command(start + 0.001 * step)
            one.read_rows(1)
        targets = [len(drive.targets) for drive in one.drives]
        frames = len(one.bus.seen)
        one.clock.stall(0.07)
        one.read(lambda: all(drive.state == "disabled" for drive in one.drives))
        assert [len(drive.targets) for drive in one.drives] <= [count + 1 for count in targets]  # one was on its way
        after = [data[0] for identifier, data in one.bus.seen[frames:] if 0x200 < identifier < 0x280]
        assert set(after[3:]) == {0x02}
        assert one.said("error")[0].startswith("this computer stalled for 0.0")


def test_profile_mode_hands_over_every_set_point_by_its_handshake() -> None:
    with bench(mode="profile") as one:
        one.enable()
        start = one.position
        for step in (0.01, 0.02, 0.05):
            one.driver.command(start + step)
            one.read(lambda goal=start + step: np.allclose(one.position, goal, atol=1e-5))  # type: ignore[misc]
        for drive in one.drives:
            assert len(drive.targets) >= 3
            words = drive.controlwords[drive.controlwords.index(0x0F) :]
            assert {word & 0x10 for word in words} == {0x00, 0x10}
            offered = [word & 0x10 for word in words]
            assert all(a != b for a, b in itertools.pairwise(offered[1:]))
        one.driver.stop()
        assert off(one)
