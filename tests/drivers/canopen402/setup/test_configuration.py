from __future__ import annotations

import pytest
from canopen_bench import JOINTS, bench
from each import each
from scripted_drives import ScriptedBus, ScriptedDrive

from drivers.can.receiver import POLL
from drivers.canopen402.setup.configuration import PROBE_LIMIT
from drivers.canopen402.setup.error_control import OWN_ID_ANSWER
from drivers.canopen402.setup.readiness import LISTEN
from drivers.core.errors import ConnectionFailedError, MotionRefusedError


def drives(*changed: ScriptedDrive) -> list[ScriptedDrive]:
    """Three drives, some of them replaced."""
    by_node = {node: ScriptedDrive(node) for node in (1, 2, 3)} | {drive.node: drive for drive in changed}
    return list(by_node.values())


def refused(*changed: ScriptedDrive, **keys: object) -> ConnectionFailedError:
    with bench(drives(*changed), begin="closed", **keys) as one:  # type: ignore[arg-type]
        with pytest.raises(ConnectionFailedError) as caught:
            one.driver.open()
        assert "\n" not in str(caught.value)
        assert caught.value.hint
        assert not any("enabled" in drive.states for drive in one.drives)
    return caught.value


def test_the_drives_are_configured_as_agreed() -> None:
    with bench(begin="open", heartbeat=0.2) as one:
        for drive in one.drives:
            node = drive.node
            assert drive.number(0x1800, 1) == 0x180 + node
            assert drive.number(0x1801, 1) == 0x280 + node
            assert drive.number(0x1400, 1) == 0x200 + node
            assert [drive.number(index, 2) for index in (0x1800, 0x1801, 0x1400)] == [1, 1, 1]
            assert [drive.number(0x1A00, k) for k in range(4)] == [3, 0x60410010, 0x60610008, 0x60640020]
            assert [drive.number(0x1A01, k) for k in range(4)] == [3, 0x606C0020, 0x60770010, 0x60780010]
            assert [drive.number(0x1600, k) for k in range(4)] == [3, 0x60400010, 0x60600008, 0x607A0020]
            assert drive.number(0x1802, 1) & 0x80000000
            assert drive.number(0x1803, 1) & 0x80000000
            assert drive.number(0x1017) == 200
            assert drive.number(0x6060) == 8
            assert drive.nmt == 0x7F
            assert drive.states == ["disabled"]
        identity = one.driver.identify()[1]
        assert (identity.joint, identity.node, identity.serial, identity.product) == ("lift", 2, 1002, 402)
        assert (identity.name, identity.firmware) == ("scripted drive", "test 1.0")
        assert (identity.counts_per_turn, identity.rated_current, identity.rated_torque) == (409600.0, 5.0, 50.0)


def test_pdos_that_the_maker_enabled_are_disabled_or_mapped_anew() -> None:
    busy = ScriptedDrive(1, objects={(0x1800, 1): 0x40000181, (0x1802, 1): 0x381, (0x1400, 1): 0x201})
    with bench(drives(busy), begin="open"):
        assert busy.number(0x1802, 1) == 0x80000381
        assert busy.number(0x1800, 1) == 0x40000181  # "no remote frames" stays


def test_recording_only_leaves_drives_without_a_way_to_be_commanded() -> None:
    left = ScriptedDrive(2, state="fault")
    with bench(drives(left), mode="none") as one:
        one.read_rows(3)
        for drive in one.drives:
            assert drive.number(0x1400, 1) & 0x80000000
            assert drive.controlwords == []
            assert drive.number(0x6060) == 0
        assert left.states == ["fault"]  # not even a reset
        one.driver.stop()
        assert left.controlwords == []


def test_nobody_answers() -> None:
    silent = [ScriptedDrive(node, present=False) for node in (1, 2, 3)]
    with bench(silent, begin="closed") as one:
        begun = one.clock.now()
        with pytest.raises(ConnectionFailedError, match=r"pan \(node 1\), lift \(node 2\), elbow \(node 3\)") as caught:
            one.driver.open()
        assert "bit rate" in caught.value.hint
        # Other masters, is dynid's own id free, then the probe; last the receiving thread ends.
        assert 0.0 <= one.clock.now() - begun - LISTEN - OWN_ID_ANSWER - PROBE_LIMIT < POLL


def test_a_silent_node_is_named_with_its_joint() -> None:
    error = refused(ScriptedDrive(2, present=False))
    assert error.message == "no answer from lift (node 2)"


def test_two_devices_with_one_node_id() -> None:
    with bench(begin="closed") as one:
        second = ScriptedBus([ScriptedDrive(2)], one.clock, one.bus.channel)
        try:
            with pytest.raises(ConnectionFailedError, match="2 devices answer to one node id") as caught:
                one.driver.open()
            assert caught.value.where == "lift (node 2)"
        finally:
            second.close()


def test_a_device_that_is_no_drive() -> None:
    error = refused(ScriptedDrive(3, objects={(0x1000, 0): 0x00030191}))
    assert error.message == "this device has profile 401, not that of a drive (402)"
    assert error.where == "elbow (node 3)"


def test_a_mode_that_the_drive_does_not_support() -> None:
    error = refused(ScriptedDrive(1, objects={(0x6502, 0): 0x01}))
    assert "does not support mode 8 (cyclic synchronous position)" in error.message
    assert error.hint == "set the connection's 'mode' to profile or none"


def test_swapped_node_ids_are_named_where_serial_numbers_are_known() -> None:
    nodes: dict[str, dict[str, object]] = {"pan": {"serial": 1002}, "lift": {"serial": 1001}}
    error = refused(nodes=nodes)
    assert "has serial number 1001, but the robot file expects 1002" in error.message
    assert "drive 1002 answers as lift (node 2): node ids are swapped" in error.hint
    assert "expects 77" in refused(nodes={"elbow": {"serial": 77}}).message


@each(
    ("entry", "code", "words"),
    [
        ((0x1A00, 0), 0x06010002, "cannot write 0 to 0x1A00 (PDO mapping): the object can only be read"),
        ((0x1A01, 2), 0x06040041, "PDO mapping, actual torque): the object cannot be mapped into a PDO"),
        ((0x1800, 2), 0x06090030, "the value is out of range"),
        ((0x6060, 0), 0x08000022, "the drive's state keeps the value from being stored"),
        ((0x1000, 0), 0x06060000, "a hardware error in the drive"),
    ],
)
def test_a_refusal_says_joint_object_and_reason(entry: tuple[int, int], code: int, words: str) -> None:
    error = refused(ScriptedDrive(2, aborts={entry: code}))
    assert error.where == "lift (node 2)"
    assert words in error.message
    assert f"0x{entry[0]:04X}" in error.message
    assert f"0x{code:08X}" in error.message


def test_what_the_drive_does_not_say_must_be_in_the_file() -> None:
    mute = {(0x6075, 0): 0x06020000, (0x6076, 0): 0x06020000, (0x6091, 2): 0x06090011}
    file: dict[str, dict[str, object]] = {"pan": {}}
    for key, value in (("counts_per_turn", 10000), ("rated_current", 4.0), ("rated_torque", 30.0)):
        error = refused(ScriptedDrive(1, aborts=mute), nodes=file)
        assert error.message.startswith(f"the drive does not report its {key}")
        assert key in error.hint
        file["pan"][key] = value
    with bench(drives(ScriptedDrive(1, aborts=mute)), nodes=file, begin="open") as one:
        identity = one.driver.identify()[0]
        assert (identity.rated_current, identity.rated_torque, identity.counts_per_turn) == (4.0, 30.0, 10000.0)
        assert one.said("warning") == []


def test_the_file_counts_where_it_contradicts_the_drive_and_says_so() -> None:
    with bench(nodes={"lift": {"rated_current": 6.0, "counts_per_turn": 409600}}, begin="open") as one:
        assert one.driver.identify()[1].rated_current == 6.0
        (warning,) = one.said("warning")
        assert warning.startswith("lift (node 2): rated_current is 6 A in the robot file, but 5 A in the drive")


def test_a_drive_without_optional_objects_is_configured() -> None:
    optional = [(0x1017, 0), (0x1018, 4), (0x1008, 0), (0x6502, 0), (0x1802, 1), (0x603F, 0)]
    with bench(drives(ScriptedDrive(3, aborts=dict.fromkeys(optional, 0x06020000)))) as one:
        one.read_rows(3)
        assert one.driver.identify()[2].name == ""
        assert any("elbow (node 3) has no heartbeat" in text for text in one.said("warning"))
        assert one.said("error") == []


def in_fault(**more: object) -> ScriptedDrive:
    return ScriptedDrive(2, state="fault", objects={(0x603F, 0): 0x4310, (0x1001, 0): 0x09}, **more)  # type: ignore[arg-type]


FAULT = "lift (node 2) is in fault: drive temperature too high (0x603F: 0x4310), error register: generic, temperature"


def test_a_fault_is_named_and_not_reset_unasked() -> None:
    faulty = in_fault()
    with bench(drives(faulty), begin="closed") as one:
        with pytest.raises(MotionRefusedError) as caught:
            one.driver.open()
        assert caught.value.message == FAULT
        assert "dynid check ROBOT --connect --reset-faults" in caught.value.hint
        assert (faulty.states, faulty.controlwords) == (["fault"], [])
    with bench(drives(in_fault()), mode="none") as one:
        one.read_rows(3)
        assert one.said("warning") == [FAULT, "lift: fault"]
        assert one.drives[1].controlwords == []


@pytest.mark.parametrize(("clears", "outcome"), [(True, "the fault was reset"), (False, "the fault stays")])
def test_a_fault_is_reset_where_that_was_asked_for_and_nothing_enabled(clears: bool, outcome: str) -> None:
    faulty = in_fault(clears_faults=clears)
    with bench(drives(faulty), mode="none", reset_faults=True) as one:
        one.read_rows(3)
        assert faulty.states == (["fault", "disabled"] if clears else ["fault"])
        assert faulty.controlwords == [0x00, 0x80, 0x00]
        assert f"{FAULT.replace('is in', 'was in')}; {outcome}" in one.said("warning")
        assert [drive.controlwords for drive in one.drives if drive is not faulty] == [[], []]


@each("mode", ["position", "none"])
@each("state", ["enabled", "quick stop"])
def test_a_drive_that_somebody_else_powered_is_refused_and_nothing_sent_that_changes_it(mode: str, state: str) -> None:
    run_by_another = ScriptedDrive(1, state=state, nmt=5, quick_stop_stays=True)
    with bench(drives(run_by_another), begin="closed", mode=mode) as one:
        with pytest.raises(MotionRefusedError, match=r"already powered, .*: pan \(node 1\) \((operation|quick)"):
            one.driver.open()
        one.driver.close()
        assert {identifier for identifier, _ in one.bus.seen} <= {0x601, 0x602, 0x603, 0x67F}
        assert all(data[0] == 0x40 for _, data in one.bus.seen)  # SDO uploads
        assert (run_by_another.states, run_by_another.nmt) == ([state], 5)


def test_a_motion_that_somebody_else_begins_while_recording_is_not_stopped() -> None:
    with bench(mode="none") as one:
        one.read_rows(3)
        one.drives[1].enter("enabled")
        one.read_rows(3)
        one.driver.close()
        assert [drive.nmt for drive in one.drives] == [0x7F, 5, 0x7F]
        assert one.drives[1].state == "enabled"


@each(
    ("identifier", "data", "words"),
    [
        (0x77F, b"\x05", "a heartbeat as node 127 (0x77F)"),
        (0x77E, b"\x7f", "a heartbeat as node 126 (0x77E)"),
        (0x080, b"", "SYNC (0x080)"),
        (0x000, b"\x01\x00", "NMT commands (0x000)"),
        (0x302, bytes(8), "targets (RPDO)"),
        (0x601, bytes(8), "SDO requests"),
        (0x701, b"\x85", "requests of node guarding"),
    ],
)
@each("mode", ["position", "none"])
def test_another_master_is_heard_before_anything_is_sent(identifier: int, data: bytes, words: str, mode: str) -> None:
    with bench(begin="closed", own_id=126, mode=mode) as one:
        one.clock.call_at(one.clock.now() + LISTEN - 0.01, lambda: one.bus.send(identifier, data))
        with pytest.raises(MotionRefusedError) as caught:
            one.driver.open()
        assert caught.value.message == f"another master is on the bus: it sends {words}"
        assert one.bus.seen == []


def test_other_devices_on_the_bus_are_no_masters() -> None:
    with bench(begin="closed") as one:
        for identifier, data in ((0x701, b"\x05"), (0x750, b"\x05"), (0x1D0, bytes(8)), (0x6D0, bytes(8))):
            one.clock.call_at(one.clock.now() + 0.1, lambda frame=(identifier, data): one.bus.send(*frame))
        one.driver.open()


def test_profile_mode_writes_velocity_and_acceleration() -> None:
    nodes: dict[str, dict[str, object]] = {
        joint: {"counts_per_turn": 62831.853, "velocity": 2.0, "acceleration": 5.0} for joint in JOINTS
    }
    with bench(mode="profile", nodes=nodes, begin="open") as one:
        for drive in one.drives:
            assert drive.number(0x6060) == 1
            assert [drive.number(index) for index in (0x6081, 0x6083, 0x6084)] == [20000, 50000, 50000]


def test_the_interpolation_period_of_drives_that_have_one() -> None:
    own = {(0x60C2, 1): 0, (0x60C2, 2): 0, (0x1006, 0): 0}
    drive = ScriptedDrive(1, objects=dict(own))
    with bench(drives(drive), begin="open", sync_rate=400):
        assert (drive.number(0x60C2, 1), drive.number(0x60C2, 2)) == (25, 0xFC)  # 25 · 10⁻⁴ s
        assert drive.number(0x1006) == 2500


def test_the_time_limit_holds() -> None:
    with bench(begin="closed", timeout=0.1) as one:
        for drive in one.drives:
            drive.present = False
        begun = one.clock.now()
        with pytest.raises(ConnectionFailedError, match="no answer from"):
            one.driver.open()
        assert 0.1 <= one.clock.now() - begun - LISTEN < 0.1 + 1e-3 + POLL


@pytest.mark.parametrize(("sdo_timeout", "fails"), [(0.3, True), (1.0, False)])
def test_a_slow_drive_needs_a_longer_time_limit(sdo_timeout: float, fails: bool) -> None:
    with bench(drives(ScriptedDrive(2, slowness=0.4)), begin="closed", timeout=60, sdo_timeout=sdo_timeout) as one:
        if not fails:
            one.driver.open()
            return
        with pytest.raises(ConnectionFailedError) as caught:
            one.driver.open()
        assert "no answer within 0.3 s" in caught.value.message
        assert "sdo_timeout" in caught.value.hint


def test_a_configuration_that_takes_longer_than_its_time_limit_is_given_up() -> None:
    with bench(begin="closed", timeout=0.12) as one:
        one.drives[0].slowness = 0.02
        begun = one.clock.now()
        with pytest.raises(ConnectionFailedError, match="the configuration of the drives takes too long"):
            one.driver.open()
        # What was asked before the limit is waited for.
        assert 0.12 < one.clock.now() - begun - LISTEN < 0.12 + 0.021 + POLL
        assert not one.drives[0].number(0x1017)
