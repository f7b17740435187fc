"""Recordings of drives on CANopen in simulated time: every row is what the plant was at its SYNC; faults stop the arm.

Plant, drives, bus, driver, session, player, supervisor and recorder are those of production.
"""

from __future__ import annotations

import functools
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import can
import numpy as np
import pytest
from canopen_recording import LOOP_PERIOD, NODES, RADIANS, Bench, Run, arm_on_bus, swing

from daq.motion.trajectories import PointToPoint
from daq.session.device_limits import before_a_motion
from daq.session.session import READ_TIMEOUT
from daq.session.stuck_channels import WATCHED
from daq.session.supervisor import STALE_FLOOR
from drivers.can.receiver import POLL, Receiver
from drivers.canopen402.monitor.drives import NOT_SENT
from drivers.canopen402.monitor.presence import HEARTBEATS_MISSED
from drivers.canopen402.motion.target_path import delay_periods
from drivers.canopen402.samples import temperature
from drivers.canopen402.samples.sync import SyncProducer
from drivers.core.errors import ConnectionFailedError, MotionRefusedError
from drivers.core.text import counted
from sim_drivers.canopen.network import TICKS_PER_CHORE
from sim_drivers.canopen.server import GRANULARITY, LONGEST_WAIT

PERIOD = 0.01
FAULT = 1.605
"""When faults come [s], in mid motion and half a period after SYNC 160."""
BEAT = 0.1
"""Period of heartbeats and of guarding, where a test gives it [s]."""
HEARTBEATS, GUARDING = f"{{heartbeat: {BEAT}}}", f"{{guarding: {{period: {BEAT}, factor: 3}}}}"
LIMIT = HEARTBEATS_MISSED * BEAT
LOOK = LONGEST_WAIT + TICKS_PER_CHORE * LOOP_PERIOD + 1e-3
"""How long [s] the drives may take to do what is due."""
CYCLE = READ_TIMEOUT + PERIOD
"""How long [s] the session may take to look again."""


def assert_exact(
    bench: Bench, run: Run, left_out: Sequence[int] = (), late: Mapping[int, float] = MappingProxyType({})
) -> None:
    """Every row is what the drives measured at its SYNC, no SYNC but those has no row, and none but those was late."""
    assert run.slots == [slot for slot in range(1, run.slots[-1] + 1) if slot not in left_out]
    expected, found = bench.expected(run.slots), run.counts(bench)
    for quantity, counts in expected.items():
        np.testing.assert_array_equal(found[quantity], counts, err_msg=quantity)
        assert np.max(np.abs(counts)) > 100  # not all nothing
    assert run.report.samples["joints"] == len(run.slots)
    assert run.report.lost["joints"] == len(left_out)
    lateness = run.recording.streams["joints"].channels["sync_lateness"].values
    np.testing.assert_allclose(lateness[:, 0], [late.get(slot, 0.0) for slot in run.slots], atol=1e-9)


def assert_stopped(bench: Bench, run: Run, reason: str) -> float:
    """The file says why it ended, and the arm rests with its drives off; the time of the reason."""
    assert run.report.stopped_by is not None
    assert run.report.stopped_by.startswith(reason)
    assert run.report.error is not None
    assert not run.recording.complete
    assert bench.rests()
    return run.when(f"stopped: {reason}")


def test_a_motion_is_recorded_as_it_was(tmp_path: Path) -> None:
    with arm_on_bus() as bench:
        run = bench.record(tmp_path, motion=swing())
        assert run.report.stopped_by is None
        assert run.recording.complete
        assert_exact(bench, run)
        assert bench.rests()
        # The motion is there, as late as targets and drives make it.
        joints = run.recording.streams["joints"]
        begun = run.when("motion begins")
        late = 0.5 * PERIOD * np.arange(26)
        passed = joints.time - begun
        within = (passed > 0.2) & (passed < swing().duration - 0.2)
        errors = [
            np.max(np.abs(joints.channels["position"].values[within] - swing().evaluate(passed[within] - one)[0].T))
            for one in late
        ]
        assert min(errors) < 0.01
        behind = delay_periods(PERIOD) - 1
        assert behind * PERIOD < late[int(np.argmin(errors))] < (behind + 6) * PERIOD
        # Torque is current times gain, but for what the drives' per mille cut off.
        gains = [bench.robot_file.robot.drive(name).gain for name in bench.robot_file.robot.joint_names]
        torque, current = joints.channels["torque"].values, joints.channels["current"].values
        np.testing.assert_allclose(torque, current * gains, atol=0.15)
        thermal = run.recording.streams["thermal"]
        np.testing.assert_allclose(thermal.time, 0.2 * np.arange(1, len(thermal.time) + 1), atol=3e-3)
        assert len(thermal.time) == int(run.recording.streams["joints"].time[-1] / 0.2)
        housing = bench.plant.thermal.housing
        np.testing.assert_allclose(thermal.channels["temperature"].values[-1], housing, atol=0.1)


def test_a_coupled_arm_is_moved_and_recorded_in_joints(tmp_path: Path) -> None:
    """The drives count and drive their motors; commands and the recording are the joints'."""
    coupling = np.eye(len(NODES))
    coupling[2, 1] = 1.0  # the elbow's motor turns with the shoulder, too
    with arm_on_bus(coupling="{elbow_joint: {elbow_joint: 1, shoulder_lift_joint: 1}}") as bench:
        run = bench.record(tmp_path, motion=swing())
        assert run.report.stopped_by is None  # no tracking error either
        assert bench.rests()
        joints = run.recording.streams["joints"]
        recorded = {name: channel.values for name, channel in joints.channels.items()}
        heard = dict(zip(bench.sent(), bench.measured, strict=False))
        motors = {
            name: np.array([[getattr(one.feedback, name) for one in heard[slot]] for slot in run.slots])
            for name in ("position", "velocity", "torque")
        }
        rated = np.array([drive.axis.setup.rated_torque for drive in bench.server.network.drives])
        enabled = np.array([[one.enabled for one in heard[slot]] for slot in run.slots])
    np.testing.assert_allclose(recorded["position"] @ coupling.T, motors["position"], atol=4e-5)
    np.testing.assert_allclose(recorded["velocity"] @ coupling.T, motors["velocity"], atol=4e-5)
    assert np.max(np.abs(recorded["torque"] - (motors["torque"] * enabled) @ coupling)) < 1e-3 * np.max(rated)
    assert np.max(np.abs(recorded["torque"] - motors["torque"] * enabled)[:, 1]) > 10.0  # the motor's own is another


def test_a_recording_without_a_motion_lasts_as_long_as_it_was_asked_for(tmp_path: Path) -> None:
    with arm_on_bus("{sync_rate: 400, mode: none}") as bench:
        bench.at(0.5, "heat 1 5")
        run = bench.record(tmp_path, duration=1.2)
        assert run.report.stopped_by is None
        assert run.recording.complete
        assert 1.2 <= run.seconds < 1.2 + 2 * READ_TIMEOUT
        assert run.slots == list(range(1, len(run.slots) + 1))
        assert len(run.slots) >= 1.2 * 400 - 1
        assert run.report.lost["joints"] == 0
        np.testing.assert_array_equal(run.counts(bench)["position"], bench.expected(run.slots)["position"])
        warm = run.recording.streams["thermal"].channels["temperature"].values[:, 0]
        np.testing.assert_allclose(
            np.diff(warm), [0.0, 0.0, 5.0, 0.0], atol=0.11
        )  # asked for every 0.2 s from 33 ms on


def test_the_recording_and_python_cans_own_logger_agree(tmp_path: Path) -> None:
    with arm_on_bus("{mode: none}") as bench:
        run = bench.record(tmp_path, duration=1.0)
        log = tmp_path / "bus.blf"
        with can.Logger(log) as logger:
            for frame in bench.frames():
                logger(frame)
    answers = {base + node for base in (0x180, 0x280) for node in NODES}
    cycles: list[dict[int, bytes]] = []
    for frame in can.LogReader(log):
        if frame.arbitration_id == 0x80:
            cycles.append({})
        elif frame.arbitration_id in answers:
            assert frame.arbitration_id not in cycles[-1]
            cycles[-1][frame.arbitration_id] = bytes(frame.data)
    rows = len(run.slots)
    assert [cycle.keys() for cycle in cycles[:rows]] == [answers] * rows
    assert len(cycles) - rows <= 2
    words = [[struct.unpack("<Hbi", cycle[0x180 + node]) for node in NODES] for cycle in cycles[:rows]]
    efforts = [[struct.unpack("<ihh", cycle[0x280 + node]) for node in NODES] for cycle in cycles[:rows]]
    found = run.counts(bench)
    for name, columns in (("position", words), ("velocity", efforts), ("torque", efforts), ("current", efforts)):
        place = {"position": 2, "velocity": 0, "torque": 1, "current": 2}[name]
        np.testing.assert_array_equal(found[name], [[one[place] for one in row] for row in columns])
    statuswords = run.recording.streams["joints"].channels["statusword"].values
    np.testing.assert_array_equal(statuswords, [[one[0] for one in row] for row in words])


def test_a_fault_of_a_drive_stops_at_its_row(tmp_path: Path) -> None:
    with arm_on_bus() as bench:
        bench.at(FAULT, "over-temperature 3")
        run = bench.record(tmp_path, motion=swing())
        reason = "elbow_joint: drive temperature too high (EMCY 0x4310, register: generic, temperature)"
        when = assert_stopped(bench, run, reason)
        assert FAULT < when < FAULT + LOOK  # of the emergency message, before the first row that shows the fault
        assert_exact(bench, run)
        assert run.slots[-1] in (159, 160)
        # The others get their quick stop with the targets after SYNC 162 at the latest, and stop along their ramp.
        assert run.when("arm halted") < 1.7


@pytest.mark.parametrize(
    ("keys", "reason"),
    [(HEARTBEATS, "no heartbeat for 0.30 s"), (GUARDING, "no answer to 3 requests of node guarding")],
)
def test_a_drive_that_says_no_more_that_it_lives_ends_the_motion(tmp_path: Path, keys: str, reason: str) -> None:
    with arm_on_bus(keys) as bench:
        bench.at(FAULT, "heartbeat-stop 3")
        run = bench.record(tmp_path, motion=swing())
        when = assert_stopped(bench, run, f"elbow_joint (node 3): {reason}; is its power on?")
        assert_exact(bench, run)
        if keys == GUARDING:  # the first request without an answer; the last of three has a period's time, too
            last = min(time for time in bench.times(0x703) if time > FAULT + LOOK)
        else:
            last = max(time for time in bench.times(0x703))
            assert FAULT - BEAT < last < FAULT + LOOK
        assert LIMIT < when - last <= LIMIT + PERIOD
        assert run.slots[-1] == round(when / PERIOD) - 1  # the newest row that was sure then


@pytest.mark.parametrize(
    ("thread", "place", "name"),
    [
        ("can ", Receiver, "_keep"),
        ("SYNC", SyncProducer, "_send_outputs"),
        ("temperatures", temperature, "read_temperature"),
    ],
)
def test_any_thread_that_breaks_ends_the_motion(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, thread: str, place: object, name: str
) -> None:
    with arm_on_bus(HEARTBEATS) as bench:
        works = getattr(place, name)

        def breaks(*arguments: object) -> object:
            if FAULT < bench.clock.now() - bench.begun < FAULT + 1.0:
                raise KeyError("a bug")
            return works(*arguments)

        monkeypatch.setattr(place, name, breaks)
        run = bench.record(tmp_path, motion=swing())
        when = assert_stopped(bench, run, f"the thread '{thread}")
        assert str(run.report.stopped_by).endswith("broke: KeyError: 'a bug'")
        assert FAULT < when < FAULT + 0.25


def test_a_drive_without_power_makes_the_samples_stale(tmp_path: Path) -> None:
    with arm_on_bus() as bench:
        bench.at(FAULT, "power-cycle 3")
        run = bench.record(tmp_path, motion=swing())
        when = assert_stopped(bench, run, "stale data of stream joints: 0.0")
        assert "(no answer to SYNC of elbow_joint (node 3) for 0.0" in str(run.report.stopped_by)
        assert_exact(bench, run)
        assert run.slots[-1] == 160
        # Row 160 was sure with the first answer to SYNC 161.
        assert STALE_FLOOR < when - 1.61 < STALE_FLOOR + CYCLE
        assert "error: elbow_joint: the drive restarted, and has lost its configuration" in run.events()


def test_a_bus_that_is_off_makes_the_samples_stale_and_drives_stop_by_themselves(tmp_path: Path) -> None:
    with arm_on_bus(HEARTBEATS) as bench:
        bench.at(FAULT, "bus-off 1.0")
        powered: list[float] = []

        def look(moment: float) -> None:
            if any(drive.enabled for drive in bench.server.network.drives):
                powered.append(moment)

        for number in range(60):
            bench.at(FAULT + PERIOD * number, functools.partial(look, FAULT + PERIOD * number))
        run = bench.record(tmp_path, motion=swing())
        when = assert_stopped(bench, run, "stale data of stream joints: 0.0")
        assert "no answer to SYNC of any drive" in str(run.report.stopped_by)
        assert_exact(bench, run)
        assert run.slots[-1] == 160
        # That nothing came is known as late as the receiving thread looks.
        assert STALE_FLOOR < when - 1.61 < STALE_FLOOR + CYCLE + 2 * POLL
        # The drives miss dynid after its last heartbeat that they heard; then their quick stop, from 0.9 rad/s at most.
        last = max(time for time in bench.times(0x77F) if time < FAULT)
        assert last + LIMIT < max(powered) < last + LIMIT + LOOK + 0.9 / 20.0 + PERIOD
        assert "warning: 1 error frame" in run.events()


def test_an_encoder_that_hangs_ends_the_motion(tmp_path: Path) -> None:
    with arm_on_bus() as bench:
        bench.at(FAULT, "stick position elbow_joint")
        run = bench.record(tmp_path, motion=swing())
        assert (run.report.stopped_by or "").startswith("stuck position of elbow_joint: ")
        (warned,) = (event for event in run.events() if event.startswith("warning: stuck position of elbow_joint: "))
        assert str(run.report.stopped_by).startswith(warned.removeprefix("warning: "))  # and says what to do about it
        assert bench.rests()


def test_a_jammed_joint_stops_at_the_first_torque_beyond_its_limit(tmp_path: Path) -> None:
    with arm_on_bus() as bench:
        bench.at(FAULT, "block 2")
        run = bench.record(tmp_path, motion=swing())
        when = assert_stopped(bench, run, "torque of shoulder_lift_joint: ")
        assert_exact(bench, run)
        beyond = np.abs(run.recording.streams["joints"].channels["torque"].values[:, 1]) > 150.0
        assert np.flatnonzero(beyond).tolist() == [len(beyond) - 1]
        assert when == run.recording.streams["joints"].time[-1]


@pytest.mark.parametrize(
    ("fault", "left_out", "told"),
    [
        ("truncate 12", [161, 162], "frames of a wrong length: all joints 1"),
        ("freeze 0.04", [161, 162, 163, 164], "no answer to SYNC: all joints "),
        ("drop 1", [161], "no answer to SYNC: shoulder_pan_joint TPDO1 1"),
    ],
)
def test_frames_that_do_not_come_cost_their_rows_only(
    tmp_path: Path, fault: str, left_out: list[int], told: str
) -> None:
    with arm_on_bus() as bench:
        bench.at(FAULT, fault)
        run = bench.record(tmp_path, motion=swing())
        assert run.report.stopped_by is None
        assert run.recording.complete
        assert_exact(bench, run, left_out)
        assert any(told in event for event in run.events())
        # After a gap a row comes with the next complete one; none of the others is touched.
        assert f"warning: {len(left_out)} samples lost" in run.events()


@pytest.mark.parametrize(
    ("stall", "drives_too", "left_out"),
    [
        (0.009, False, []),  # SYNC 161 is 4 ms late: less than half a period
        (0.0145, False, [161, 162]),  # SYNC 162 would apply old targets: no time to replace them
        (0.0285, False, [161, 162, 163]),
        (0.0385, False, []),
        (0.2, False, []),
        (0.2, True, []),
    ],
)
def test_a_stall_leaves_syncs_out_or_ends_the_motion(
    tmp_path: Path, stall: float, drives_too: bool, left_out: list[int]
) -> None:
    """Only dynid's process stalls, or the whole computer with its drives."""
    with arm_on_bus() as bench:
        clock = bench.clock
        bench.at(FAULT, lambda: clock.stall(stall) if drives_too else clock.suspend(stall, but=("canopen-nodes",)))
        run = bench.record(tmp_path, motion=swing())
        assert run.report.punctuality is not None
        if stall > 0.03:  # more than is bridged: the drives, which nobody holds, would have to stop at one stroke
            assert_stopped(bench, run, "this computer stalled for 0.")
            assert "or use --realtime" in str(run.report.error)
            return
        late = {161: FAULT + 0.009 - 1.61} if stall == 0.009 else {}
        assert_exact(bench, run, left_out, late)
        told = [event for event in run.events() if "not sent" in event]
        expected = f"warning: {counted(len(left_out), NOT_SENT)}"
        assert told == ([expected] if left_out else [])
        assert run.report.stopped_by is None
        assert run.recording.complete
        assert bench.sent()[: len(run.slots)] == run.slots
        assert run.report.punctuality.delayed_ms == 0.0
        assert bench.rests()


@pytest.mark.parametrize("keys", [HEARTBEATS, GUARDING])
def test_drives_stop_by_themselves_when_the_program_is_suspended_and_it_says_why(tmp_path: Path, keys: str) -> None:
    with arm_on_bus(keys) as bench:
        enabled: list[int] = []
        drives = bench.server.network.drives
        bench.at(FAULT, lambda: bench.clock.suspend(0.7, but=("canopen-nodes", *probes)))
        probes = [f"at {bench.clock.now() + FAULT + after:g} s" for after in (0.15, 0.6)]
        for after in (0.15, 0.6):
            bench.at(FAULT + after, lambda: enabled.append(sum(drive.enabled for drive in drives)))
        run = bench.record(tmp_path, motion=swing())
        assert enabled == [len(NODES), 0]
        reason = r"heartbeat or life guarding missed (EMCY 0x8130, register: generic, communication)"
        assert run.report.stopped_by is not None
        assert f"{reason}: it stopped receiving from dynid" in run.report.stopped_by
        assert not run.recording.complete
        assert bench.rests()
        assert_exact(bench, run)
        assert run.slots[-1] == 159  # row 160 was sure only with SYNC 161
        # Every drive so long after the last sign of life that it heard.
        for node in NODES:
            (lost,) = bench.times(0x80 + node, data=b"\x30\x81")
            signs = 0x700 + (node if keys == GUARDING else 127)
            last = max(time for time in bench.times(signs) if time < FAULT)
            assert LIMIT - GRANULARITY < lost - last < LIMIT + LOOK
        told = [event.time for event in run.recording.events if "it stopped receiving from dynid" in event.message]
        assert len(told) == len(NODES) + 1
        assert all(moment > FAULT for moment in told)


def test_limits_looser_than_the_drives_own_are_named_before_a_motion() -> None:
    with arm_on_bus(opened=False) as bench:
        robot = bench.robot_file.robot
        bench.driver.open()
        assert before_a_motion(robot, bench.driver) == []  # simulated drives have those of the robot file
        bench.driver.close()
        objects, counts = bench.server.network.drives[2].objects, 1.0 / RADIANS
        for index, subindex, value in ((0x607D, 1, -1), (0x607D, 2, 2), (0x607F, 0, 0.5), (0x6085, 0, 0.25)):
            objects.set(index, subindex, round(value * counts))
        objects.set(0x6072, 0, 1500)
        objects.set(0x605A, 0, 0)
        bench.driver.open()
        names = ["position limits wider", "velocity limits above", "torque limits above"]
        said = before_a_motion(robot, bench.driver)
        assert [line.partition(" than")[0].partition(" the contr")[0] for line in said[:3]] == names
        assert all(": elbow_joint " in line and ";" not in line for line in said[:3])
        assert said[3] == "elbow_joint: quick stop option (0x605A) 0: its voltage is cut, and the arm coasts"
        objects.set(0x605A, 0, 6)
        bench.driver.close()
        bench.driver.open()
        assert before_a_motion(robot, bench.driver)[3].startswith("a stop decelerates less than")


def test_drives_whose_velocity_has_another_unit_stop_and_are_switched_off_at_rest(tmp_path: Path) -> None:
    with arm_on_bus(opened=False) as bench:
        for drive in bench.server.network.drives:  # tenths of a revolution per minute, and not counts per second
            velocity = drive.objects.reader(0x606C, 0)
            drive.objects.live(0x606C, 0, lambda velocity=velocity: round(velocity() * 600.0 / 524288))
            drive.objects.set(0x605A, 0, 6)  # stays in quick stop until it is switched off
        bench.driver.open()
        run = bench.record(tmp_path, motion=swing())
        assert_stopped(bench, run, "velocity channel of shoulder_pan_joint: it says ")
        joints = range(len(bench.server.network.drives))
        last = [max(index for index, row in enumerate(bench.measured) if row[joint].enabled) for joint in joints]
        assert all(abs(bench.measured[index][joint].feedback.velocity) < 0.02 for joint, index in enumerate(last))


def test_a_max_torque_that_does_not_carry_the_arm_stops_the_motion(tmp_path: Path) -> None:
    with arm_on_bus() as bench:
        shoulder, torques = bench.server.network.drives[1], []
        bench.at(FAULT, lambda: shoulder.objects.set(0x6072, 0, 100))
        for later in np.arange(0.01, 0.1, 0.01):
            bench.at(FAULT + later, lambda: torques.append(abs(bench.plant.drive_torque[1])))
        run = bench.record(tmp_path, motion=swing())
        assert run.report.stopped_by is not None
        assert run.report.stopped_by.startswith("tracking error of shoulder_lift_joint: ")
        assert max(torques) == pytest.approx(0.1 * shoulder.axis.setup.rated_torque)


def test_a_drives_thermometer_that_hangs_stops_the_motion(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(temperature, "RATE", 20.0)  # a motion of ten seconds else
    monkeypatch.setitem(WATCHED, "temperature", 0.5)
    motion = PointToPoint(0.1 * np.array([[0.0], [1.0], [0.0]]) * np.ones(len(NODES)), np.array([2.0, 2.0]))
    with arm_on_bus() as bench:
        robot = bench.robot_file.robot
        hot = {"joints": [joint.model_copy(update={"temperature": 70.0}) for joint in robot.joints]}
        bench.robot_file = bench.robot_file.model_copy(update={"robot": robot.model_copy(update=hot)})
        for tick, change in enumerate(np.diff(np.random.default_rng(0).normal(size=40))):  # it is never quite still
            bench.at(0.05 * tick, functools.partial(bench.plant.heat, 2, change))
        bench.at(FAULT, "stick temperature elbow_joint")
        run = bench.record(tmp_path, motion=motion)
        stopped = assert_stopped(bench, run, "stuck temperature of elbow_joint: ")
        assert FAULT + WATCHED["temperature"] < stopped < FAULT + 2.5
        (event,) = [event for event in run.recording.events if event.message.startswith("stuck ")]
        assert event.source == "thermal"


@pytest.mark.parametrize("moving", [False, True])
def test_no_motion_is_played_by_a_clock_that_the_drives_heartbeats_contradict(tmp_path: Path, moving: bool) -> None:
    """Heartbeats come twice as often as they should, or do so from 0.9 s on: as with this clock at half its rate."""
    with arm_on_bus(HEARTBEATS, opened=False) as bench:
        right = bench.clock.now() + 0.9 if moving else 0.0
        for drive in bench.server.network.drives:
            drive.objects.live(0x1017, 0, lambda: round(1e3 * BEAT if bench.clock.now() < right else 500 * BEAT))
        bench.driver.open()
        said = "the drives' clock runs at 2.00 times the rate of this computer's"
        if moving:
            assert_stopped(bench, bench.record(tmp_path, motion=swing()), said)
            return
        bench.driver.start()
        while not bench.driver.read(READ_TIMEOUT):
            pass
        with pytest.raises(MotionRefusedError, match=said):
            bench.driver.take_control()
        assert not any(drive.enabled for drive in bench.server.network.drives)


def test_swapped_node_ids_are_found_before_anything_moves() -> None:
    with arm_on_bus(swapped=(0, 1), serials=True, opened=False) as bench:
        with pytest.raises(ConnectionFailedError, match="has serial number 2, but the robot file expects 1") as caught:
            bench.driver.open()
        assert caught.value.where == "shoulder_pan_joint (node 1)"
        assert "node ids are swapped" in caught.value.hint
        assert bench.measured == []
        assert {drive.axis.machine.state.name for drive in bench.server.network.drives} == {"SWITCH_ON_DISABLED"}
