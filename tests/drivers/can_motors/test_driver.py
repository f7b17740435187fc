"""The driver against simulated CAN motors, in simulated time: samples, motions, time-outs, faults, stops."""

from __future__ import annotations

import numpy as np
import pytest
from motor_bench import JOINTS, START, WIRES, keys_of, motors, robot_file
from simulated_clock import SimulatedClock

from daq.motion.trajectories import FourierSeries, RestToRest
from daq.recording.commanded_motion import commanded_motion
from daq.recording.quality.stale_samples import stale_rows
from daq.recording.reader import read_recording
from drivers.can_motors.bus import MotorBus
from drivers.can_motors.settings import parse_settings
from drivers.core.errors import ConnectionFailedError, DriverStateError, UsageError
from ident.identify.identification import IdentifyChoices
from ident.identify.identify import identify

GOAL = START + [0.8, -0.6]


@pytest.mark.parametrize("wire", WIRES)
def test_a_motion_is_recorded_with_its_commands(clock: SimulatedClock, tmp_path, wire):
    with motors(clock, wire) as bench:
        report = bench.session(tmp_path / "run.h5", GOAL)
        assert report.stopped_by is None, report.stopped_by
        assert all(motor.enabled for motor in bench.server.motors)
        clock.sleep(1.0)  # on_stop: hold, also when nobody commands any more
        held = bench.server.plant.arm.position.copy()
        assert np.max(np.abs(bench.server.plant.arm.velocity)) < 1e-3
    run = read_recording(tmp_path / "run.h5")
    joints = run.streams["joints"]
    assert {"position", "velocity", "torque"} <= joints.channels.keys()
    assert report.lost["joints"] == 0
    position, velocity = joints.channels["position"].values, joints.channels["velocity"].values
    travelled = np.sum(0.5 * (velocity[1:] + velocity[:-1]) * np.diff(joints.time)[:, None], axis=0)
    assert travelled == pytest.approx(position[-1] - position[0], abs=0.03)
    assert held == pytest.approx(GOAL, abs=0.08)  # a spring of 60 N·m/rad yields to the weight
    rate = 1.0 / np.median(np.diff(joints.time))
    assert rate == pytest.approx(100.0, rel=0.01)
    # Torque is the motor's own: spring to the commands, damper, within what its frames resolve.
    motion = commanded_motion(run, robot_file().robot)
    assert motion.commands["target_position"][-1] == pytest.approx(GOAL, abs=1e-9)
    assert "the arm holds, its torque stays on" in [event.message for event in run.events]


def test_limits_are_set_in_the_motors_and_read_back(clock: SimulatedClock):
    with motors(clock, "damiao", when_lost="limp", watchdog=0.05) as bench, bench.opened() as driver:
        driver.start()
        driver.take_control()
        assert [motor.timeout for motor in bench.server.motors] == pytest.approx([0.05, 0.05])
    limited = {"swing": {"id": 1, "torque_limit": 2.0}, "bend": {"id": 7, "torque_limit": 1.5}}
    for wire in ("robstride", "moteus"):
        with motors(clock, wire, motors=limited) as bench, bench.opened() as driver:
            driver.start()
            driver.take_control()
            assert bench.server.plant._most == pytest.approx([2.0, 1.5])
            assert driver.device_limits().torque == pytest.approx([2.0, 1.5])
    # What a motor does not keep is a failure by name.
    with motors(clock) as bench, bench.opened() as driver:
        driver.start()
        for motor in bench.server.motors:
            motor._registers = _Stubborn()
        with pytest.raises(ConnectionFailedError, match=r"swing \(id 1\) holds 7 as (control_mode|timeout) after"):
            driver.take_control()


class _Stubborn(dict[int, float]):
    """Registers that keep what they hold."""

    def get(self, number: int, _default: float | None = None) -> float:
        return 7

    def __setitem__(self, number: int, value: float) -> None:
        pass


def test_nothing_drives_where_the_arm_is_only_recorded(clock: SimulatedClock, tmp_path):
    for wire in WIRES:
        if wire == "cubemars":
            continue  # tells nothing unless it is commanded
        with motors(clock, wire) as bench:
            report = bench.session(tmp_path / f"{wire}.h5", duration=0.3)
            assert report.stopped_by is None
            assert not any(motor.enabled or motor._registers for motor in bench.server.motors)
            assert read_recording(tmp_path / f"{wire}.h5").streams.keys() == {"joints"}


@pytest.mark.slow
@pytest.mark.usefixtures("estimate_alone")
def test_from_the_bus_to_a_model(clock: SimulatedClock, tmp_path):
    """A recorded motion gives the simulated arm's moments, so its weights, and its friction."""
    draw = 0.3 * np.random.default_rng(1).uniform(-1.0, 1.0, (2, 2, 3)) / [1.0, 1.5, 2.0]
    series = FourierSeries.from_position_amplitudes(3.0, np.array([-1.3, 0.2]), *draw)
    with motors(clock, "moteus") as bench:
        report = bench.play(tmp_path / "run.h5", RestToRest(series, 1, 0.5))
    assert (report.stopped_by, report.lost["joints"]) == (None, 0)
    found = identify([read_recording(tmp_path / "run.h5")], [], IdentifyChoices())
    assert found.fit.relative_error < 0.06
    named = dict(zip(found.base.names, found.solution.parameters, strict=True))
    assert named["MX2"] == pytest.approx(0.5 * 0.1, rel=0.1)
    assert named["MXR1"] == pytest.approx(0.8 * 0.12 + 0.5 * 0.25, rel=0.05)
    # Read between two goals: by the answers to goals, viscous friction would come out 0.3 N·m·s/rad too small.
    assert [named["Fs1"], named["Fs2"], named["Fv1"], named["Fv2"]] == pytest.approx([0.15, 0.15, 0.1, 0.1], abs=0.05)


def test_a_motion_that_was_refused_leaves_a_file_without_commands(clock: SimulatedClock, tmp_path):
    with motors(clock) as bench:
        report = bench.session(tmp_path / "run.h5", np.array([-2.5, 0.0]))
    assert "passes its limit" in str(report.stopped_by)
    run = read_recording(tmp_path / "run.h5")
    stale = stale_rows(run)
    assert stale is not None
    assert not stale.repeated.any()


def test_answers_that_come_in_the_next_period_are_rows(clock: SimulatedClock, tmp_path, monkeypatch):
    answering = "sim_drivers.can_motors.server.ANSWERING"  # 100 Hz
    with motors(clock, "moteus") as bench:
        for begun in (1.0, 1.2):
            clock.call_at(clock.now() + begun, lambda: monkeypatch.setattr(answering, 0.013))
            clock.call_at(clock.now() + begun + 0.1, lambda: monkeypatch.setattr(answering, 50e-6))
        report = bench.session(tmp_path / "run.h5", GOAL)
    assert (report.stopped_by, report.lost["joints"]) == (None, 0)
    stream = (run := read_recording(tmp_path / "run.h5")).streams["joints"]
    stale, enabled = stale_rows(run), stream.channels["enabled"].values
    assert stale is not None
    assert np.array_equal(stale.off, np.any(enabled == 0.0, axis=1))
    assert 0 < np.count_nonzero(stale.off) < 0.5 * len(stream.time)  # before it is enabled
    steps = np.diff(stream.time)
    assert np.sum(steps > 0.0115) > 8  # late, and there


def test_who_was_late_is_said(clock: SimulatedClock, monkeypatch):
    answering, reading = "sim_drivers.can_motors.server.ANSWERING", MotorBus.cycle
    late = {"": 0.0}

    def slow(bus: MotorBus, *arguments: object, **keywords: object) -> object:
        clock.sleep(late[""])
        return reading(bus, *arguments, **keywords)

    monkeypatch.setattr(MotorBus, "cycle", slow)
    said = []
    for answer, look in ((0.0145, 0.0), (0.025, 0.0), (50e-6, 0.015)):
        with motors(clock) as bench, bench.opened() as driver:
            driver.start()
            clock.sleep(0.05)
            monkeypatch.setattr(answering, answer)
            late[""] = look
            clock.sleep(0.2)
            said.append(driver.losses("joints"))
            driver.stop()
            monkeypatch.setattr(answering, 50e-6)
            late[""] = 0.0
    assert "while answers took longer than a period to come" in said[0]
    assert "did not answer" in said[1]
    assert "while this computer was late to ask, or to look" in said[2]
    assert "answer" not in said[2]


def test_rows_that_a_stalled_computer_does_not_ask_for_in_a_motion_are_its_own(clock: SimulatedClock):
    with motors(clock) as bench, bench.opened() as driver:
        driver.start()
        driver.read(0.1)
        driver.take_control()
        for stall in (0.0, 0.0, 0.045, 0.0):
            driver.command(driver._cycle.latest)
            clock.sleep(0.01)
            clock.stall(stall)
        clock.sleep(0.02)
        assert driver.losses("joints").startswith("4 while this computer was late to ask, or to look")


@pytest.mark.parametrize("wire", ["damiao", "moteus"])
def test_motors_that_go_limp_with_the_end_are_not_in_fault_at_the_next_begin(clock: SimulatedClock, tmp_path, wire):
    with motors(clock, wire, when_lost="limp") as bench:
        for name, goal in (("one.h5", START), ("two.h5", START)):
            report = bench.session(tmp_path / name, goal + [0.1, -0.1])
            assert report.stopped_by is None
            assert not any(motor.enabled or motor.fault for motor in bench.server.motors)
            clock.sleep(4.0)  # longer than any time-out, and until it hangs
            assert not any(motor.fault for motor in bench.server.motors)


@pytest.mark.parametrize("wire", WIRES)
def test_a_dead_computer_leaves_a_holding_or_a_limp_arm(clock: SimulatedClock, wire):
    for when_lost in ("hold", "limp"):
        if when_lost == "limp" and wire in ("cubemars", "odrive"):
            continue  # no time-out that a program sets
        with motors(clock, wire, when_lost=when_lost) as bench, bench.opened() as driver:
            driver.start()
            driver.read(0.1)
            driver.take_control()
            here = driver._cycle.latest.copy()
            for share in np.linspace(0.0, 1.0, 40):
                driver.command(here + share * np.array([0.3, 0.0]))
                clock.sleep(0.01)
            driver._cycle.stop()  # of a killed program nothing more comes
            clock.sleep(2.0 if when_lost == "hold" else 6.0)
            arm = bench.server.plant.arm
            assert np.max(np.abs(arm.velocity)) < 0.05, (wire, when_lost)
            resting = here + [0.3, 0.0] if when_lost == "hold" else START
            assert arm.position[0] == pytest.approx(resting[0], abs=0.2), (wire, when_lost)
            assert all(motor.enabled == (when_lost == "hold") for motor in bench.server.motors), (wire, when_lost)
            driver._cycle.failure = None


def test_an_arm_that_springs_hold_does_not_sag_when_control_is_taken(clock: SimulatedClock):
    for wire in ("damiao", "odrive"):
        with motors(clock, wire) as bench:
            moved = START
            for step in (0.4, 0.0):
                with bench.opened() as driver:
                    driver.start()
                    driver.read(0.1)
                    driver.take_control()
                    clock.sleep(0.5)
                    here = bench.server.plant.arm.position.copy()
                    assert here == pytest.approx(moved, abs=0.003), wire
                    for share in np.linspace(0.0, 1.0, 40) if step else ():
                        driver.command(here + share * np.array([step, 0.0]))
                        clock.sleep(0.01)
                    driver.stop()
                moved = bench.server.plant.arm.position.copy()


def test_faults_are_reset_only_on_request(clock: SimulatedClock):
    for wire in ("damiao", "robstride", "moteus", "odrive"):
        with motors(clock, wire) as bench:
            motor = bench.server.motors[1]
            motor.protect(motor.over_temperature)
            with bench.opened() as driver:
                assert driver.identify()[1].fault.startswith("over-temperature")
                driver.start()
                with pytest.raises(DriverStateError, match=r"bend \(id 7\) is in fault: over-temperature"):
                    driver.take_control()
            with bench.opened(reset_faults=True) as driver:
                assert driver.identify()[1].fault == "", wire
                assert any("reset" in notice.message for notice in driver.notices())
            assert not motor.enabled


def test_a_motor_s_own_full_scale_goes_before_the_table(clock: SimulatedClock):
    with motors(clock, "damiao", model="dm4310_48v") as bench:
        for motor in bench.server.motors:
            motor._registers[22] = 50.0
        with bench.opened(model="dm4310") as driver:
            said = [notice.message for notice in driver.notices()]
            assert driver.identify()[0].velocity_range == 50.0
        assert "swing (id 1): the table of dm4310 says velocity 30, the motor 50: the motor's value is used" in said


def test_motors_whose_answers_are_alike_are_refused():
    alike = {"swing": {"id": 1, "answers_on": 0}, "bend": {"id": 0x21, "answers_on": 0}}
    with pytest.raises(UsageError, match="answers of swing and bend are alike"):
        parse_settings(keys_of("damiao", motors=alike), JOINTS, "damiao")


def test_motors_that_are_refused(clock: SimulatedClock):
    with motors(clock) as bench:
        bench.server.motors[1].die()
        with pytest.raises(ConnectionFailedError, match=r"bend \(id 7\) does not answer"):
            bench.driver().open()
    with motors(clock) as bench, bench.opened() as driver:
        with pytest.raises(DriverStateError, match="cannot move while open"):
            driver.take_control()
        driver.start()
        driver.read(0.1)
        driver.take_control()
        with pytest.raises(DriverStateError, match=r"away from the measured one"):
            driver.command(START + 0.5)
        driver.command(driver._cycle.latest)
        with pytest.raises(DriverStateError, match=r"its frames end at 12.5"):
            driver._control.command(np.array([13.0, 0.0]))


@pytest.mark.parametrize("wire", WIRES)
def test_an_id_of_two_motors_is_named_before_a_motion(clock: SimulatedClock, wire):
    with motors(clock, wire) as bench:
        bench.server.obey("same-id bend")
        with pytest.raises(ConnectionFailedError, match=r"bend \(id 7\): two motors answer to this id") as failure:
            bench.driver().open()
        assert "swing" not in str(failure.value)
        if wire == "cubemars":  # silent unless another program commands them
            return
        with bench.opened(read_only=True) as driver:  # which may listen beside another program
            driver.start()
            clock.sleep(0.3)
            assert any("bend (id 7)" in notice.message for notice in driver.notices())
