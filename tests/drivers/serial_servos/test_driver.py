"""The driver against simulated servos, in simulated time: samples, motions, limits in the servos, faults, stops."""

from __future__ import annotations

import json
from functools import partial

import numpy as np
import pytest
from servo_bench import START, STEP, WIRES, robot_file, servos
from simulated_clock import SimulatedClock

from daq.recording.commanded_motion import commanded_motion
from daq.recording.reader import read_recording
from drivers.base import DriverSettings
from drivers.core.errors import ConnectionFailedError, DriverStateError, UsageError
from drivers.serial_servos.budget import dynamixel_budget, feetech_budget

GOAL = START + [1.0, -0.8]
JOINTS = ("swing", "bend")


@pytest.mark.parametrize("wire", WIRES)
def test_a_motion_is_recorded_with_its_commands(clock: SimulatedClock, tmp_path, wire):
    with servos(clock, wire) as bench:
        report = bench.session(tmp_path / "run.h5", GOAL)
        assert report.stopped_by is None, report.stopped_by
        torque = [servo.get("torque_enable") for servo in bench.server.servos]
        held = bench.server.plant.arm.position.copy()
    assert torque == [1, 1]  # on_stop: hold
    run = read_recording(tmp_path / "run.h5")
    joints = run.streams["joints"]
    expected = {"position", "velocity", "load", "supply_voltage", "temperature", "current"}
    assert set(joints.channels) == expected
    assert joints.channels["current"].columns == (JOINTS if wire == "feetech" else ("bend",))
    assert joints.channels["current"].magnitude == (wire == "feetech")
    assert report.lost["joints"] == 0
    # Positions and velocities belong together, on a grid of the encoder's steps.
    position, velocity = joints.channels["position"].values, joints.channels["velocity"].values
    assert np.allclose(position / STEP, np.rint(position / STEP), atol=1e-6)
    travelled = np.sum(0.5 * (velocity[1:] + velocity[:-1]) * np.diff(joints.time)[:, None], axis=0)
    assert travelled == pytest.approx(position[-1] - position[0], abs=0.02)
    assert position[-1] == pytest.approx(held, abs=2 * STEP)
    assert held == pytest.approx(GOAL, abs=0.03)
    motion = commanded_motion(run, robot_file().robot)
    assert motion.time[0] >= motion.command_time[0]
    assert motion.commands["target_position"][-1] == pytest.approx(GOAL, abs=STEP)
    events = [event.message for event in run.events]
    assert "the arm holds, its torque stays on" in events


def test_limits_are_set_in_the_servos_and_read_back(clock: SimulatedClock):
    for wire in WIRES:
        with servos(clock, wire) as bench, bench.opened(torque_limit=0.5, speed=2.0) as driver:
            driver.start()
            driver.read(0.1)
            driver.take_control()
            swing = bench.server.servos[0]
            for name, value in {"torque_limit": 0.5, "speed_limit": 2.0, "acceleration": 30.0}.items():
                entry = swing.table.registers[name]
                assert swing.get(name) * entry.scale == pytest.approx(value, abs=entry.scale)
            # Its encoder may count on by a step until it is looked at here.
            assert swing.get("goal_position") == pytest.approx(swing.get("present_position"), abs=1)


def test_nothing_is_written_where_the_arm_is_only_recorded(clock: SimulatedClock, tmp_path):
    for wire in WIRES:
        with servos(clock, wire) as bench:
            before = [bytes(servo._memory[:100]) for servo in bench.server.servos]
            written: list[int] = []
            bench.server._written = partial(_count, written)  # type: ignore[method-assign]
            report = bench.session(tmp_path / f"{wire}.h5", duration=0.5)
            assert report.stopped_by is None
            assert written == []
            assert [bytes(servo._memory[:40]) for servo in bench.server.servos] == [one[:40] for one in before]
            assert read_recording(tmp_path / f"{wire}.h5").streams.keys() == {"joints"}


def _count(written: list[int], *_: object) -> int:
    written.append(1)
    return 0


def test_an_adapter_that_returns_what_is_sent(clock: SimulatedClock):
    for wire in WIRES:
        with servos(clock, wire) as bench:
            bench.server.obey("echo")
            clock.sleep(0.05)
            with bench.opened() as driver:
                driver.start()
                driver.take_control()
                driver.read(0.1)
                driver.command(START)
                clock.sleep(0.3)
                rows = sum(len(batch.time) for batch in driver.read(0.1) if batch.stream == "joints")
                assert rows >= 29
                assert "did not answer" not in driver.losses("joints")


def test_where_one_servo_does_not_obey_the_others_are_stopped_as_well(clock: SimulatedClock, monkeypatch):
    with servos(clock, "feetech") as bench, bench.opened(on_stop="limp") as driver:
        driver.start()
        written = driver._bus.write

        def refusing(motor, name, value, **keywords):
            if name == "torque_enable" and value and motor.joint == "bend":
                raise ConnectionFailedError("bend does not answer")
            written(motor, name, value, **keywords)

        monkeypatch.setattr(driver._bus, "write", refusing)
        with pytest.raises(ConnectionFailedError):
            driver.take_control()
        assert bench.server.servos[0].get("torque_enable") == 1
        driver.stop()
        assert [servo.get("torque_enable") for servo in bench.server.servos] == [0, 0]


def test_a_dead_computer(clock: SimulatedClock):
    """What the arm does where nobody commands or asks it any more: it holds; Dynamixel servos say that it happened."""
    for wire in WIRES:
        with servos(clock, wire) as bench, bench.opened() as driver:
            driver.start()
            driver.read(0.1)
            driver.take_control()
            for share in np.linspace(0.0, 1.0, 60):
                driver.command(START + share * np.array([0.3, 0.0]))
                clock.sleep(0.01)
            assert driver._cycle is not None
            driver._cycle.stop()
            clock.sleep(1.0)
            arm = bench.server.plant.arm
            assert np.max(np.abs(arm.velocity)) < 0.01
            assert arm.position[0] == pytest.approx(START[0] + 0.3, abs=0.1)
            if wire == "dynamixel":
                entry = bench.server.servos[0].table.registers["bus_watchdog"]
                assert bench.server.servos[0].read(entry.address, 1) == b"\xff"
                driver.take_control()  # clears it
                driver.command(arm.position.copy())


def test_positions_and_first_steps_that_cannot_be(clock: SimulatedClock):
    with servos(clock) as bench, bench.opened() as driver:
        with pytest.raises(DriverStateError, match="cannot move while open"):
            driver.take_control()
        driver.start()
        driver.read(0.1)
        with pytest.raises(DriverStateError, match=r"away from the measured one"):
            driver.command(START + 0.3)
        with pytest.raises(ValueError, match="finite numbers"):
            driver.command(np.array([np.nan, 0.0]))
        driver.stop()
        with pytest.raises(DriverStateError):
            driver.command(START)


def test_servos_that_are_refused(clock: SimulatedClock, tmp_path):
    with servos(clock) as bench:
        bench.server.servos[1].put("model_number", 42)
        with pytest.raises(ConnectionFailedError, match=r"bend \(id 7\) is a servo of model number 42"):
            bench.driver().open()
        bench.server.servos[1].put("model_number", 777)
        bench.server.servos[1].dead = True
        with pytest.raises(ConnectionFailedError, match=r"bend \(id 7\) does not answer"):
            bench.driver().open()
        bench.server.servos[1].dead = False
        bench.server.obey("same-id 2")
        clock.sleep(0.05)
        with pytest.raises(ConnectionFailedError, match=r"bend \(id 7\) answers garbled \(two servos with this id"):
            bench.driver().open()
    with servos(clock) as bench, bench.opened() as driver:
        driver.start()
        bench.server.servos[0].put("operating_mode", 1)
        with pytest.raises(DriverStateError, match="operating mode 1"):
            driver.take_control()
        bench.server.servos[0].put("operating_mode", 0)
        bench.server.obey("over-temperature bend")
        clock.sleep(0.1)
        with pytest.raises(DriverStateError, match="in fault: over-temperature"):
            driver.take_control()


def test_another_arms_calibration_is_refused_and_written_only_with_configure(
    clock: SimulatedClock, tmp_path, monkeypatch
):
    entry = {"drive_mode": 0, "homing_offset": 12, "range_min": 500, "range_max": 3500}
    content = {"swing": {"id": 1, **entry}, "bend": {"id": 7, **entry}}
    (tmp_path / "arm.json").write_text(json.dumps(content))
    with servos(clock) as bench:
        keys = {"calibration": str(tmp_path / "arm.json")}
        with pytest.raises(UsageError, match=r"swing \(id 1\) has homing offset 0, and 12"):
            bench.driver(**keys).open()
        (tmp_path / "wild.json").write_text(json.dumps({**content, "bend": content["bend"] | {"homing_offset": 5000}}))
        with pytest.raises(UsageError, match=r"bend \(id 7\) cannot hold 5000 as homing_offset"):
            bench.driver(calibration=str(tmp_path / "wild.json"), configure=True).open()
        assert bench.server.servos[0].get("homing_offset") == 0
        with monkeypatch.context() as patched:
            bend, write = bench.server.servos[1], bench.server.servos[1].write
            offset = bend.table.registers["homing_offset"].address
            patched.setattr(bend, "write", lambda place, data: 1 if place == offset else write(place, data))
            with pytest.raises(ConnectionFailedError, match=r"bend \(id 7\) holds 0 as homing_offset after 12"):
                bench.driver(**keys, configure=True).open()
            assert bend.get("lock") == 1
        bench.server.servos[0].put("homing_offset", 0)
        with bench.opened(**keys, configure=True) as driver:
            assert any("homing_offset was 0, is 12" in notice.message for notice in driver.notices())
            told = driver.identify()
        assert [one.homing_offset for one in told] == [12, 12]
        assert bench.server.servos[0].get("lock") == 1
        with bench.opened(**keys) as driver:
            assert driver.device_limits().highest == pytest.approx(np.full(2, 1500 * STEP))


def test_a_servo_that_answers_twice_takes_no_other_ones_turn(clock: SimulatedClock, monkeypatch):
    with servos(clock) as bench:
        answer = bench.server._answer
        monkeypatch.setattr(
            bench.server, "_answer", lambda servo, *rest: answer(servo, *rest) * (1 + (servo.motor.id == 1))
        )
        with bench.opened() as driver:
            driver.start()
            clock.sleep(0.3)
            assert sum(len(batch.time) for batch in driver.read(0.0)) > 25
            assert "bend" not in driver.losses("joints")


def test_eeprom_is_not_written_by_the_way(clock: SimulatedClock):
    with servos(clock) as bench, bench.opened() as driver:
        with pytest.raises(DriverStateError, match="EEPROM"):
            driver._bus.write(driver._settings.motors[0], "homing_offset", 1)
        with pytest.raises(DriverStateError, match="EEPROM"):
            driver._bus.write_all("homing_offset", {1: 1})


def test_a_slow_adapter_is_named_with_what_to_do(clock: SimulatedClock):
    with servos(clock) as bench:
        bench.server.obey("latency 0.016")
        clock.sleep(0.05)
        with bench.opened() as driver:
            said = [notice.message for notice in driver.notices()]
    assert any("100 Hz cannot be reached" in line for line in said)


def test_the_wire_carries_what_the_budget_says(clock: SimulatedClock, tmp_path):
    """At 90 % of the highest rate without pauses nothing is lost; the reading takes the time of its bytes."""
    for wire in WIRES:
        with servos(clock, wire) as bench:
            for servo in bench.server.servos:
                servo.put("return_delay", 0)
            with bench.opened() as driver:
                begun = clock.now()
                driver._bus.feedback()
                took = clock.now() - begun
            budget = (feetech_budget if wire == "feetech" else dynamixel_budget)(DriverSettings(JOINTS, bench.keys, ()))
            reading = sum(group.bits for group in budget.cycle if group.meaning in ("request to all", "answers"))
            assert took <= reading / 1e6 + 0.0025


def test_servos_without_torque_show_what_is_recorded_side_by_side(clock: SimulatedClock, tmp_path):
    rows = {}
    with servos(clock, "dynamixel") as bench:
        for torque in (0, 1):  # what they show then they show from then on
            for servo in bench.server.servos:
                servo.put("goal_position", servo.get("present_position"))
                servo.put("torque_enable", torque)
            bench.server.plant.changed()
            with bench.opened() as driver:
                assert driver._bus.gathered
        clock.sleep(1.0)
        for gathered in (False, True):
            with bench.opened(read_only=not gathered) as driver:
                assert driver._bus.gathered == gathered
                assert driver._bus.block[1] == (16 if gathered else 23)
                driver.start()
                clock.sleep(0.1)
                rows[gathered] = next(batch for batch in driver.read(0.1) if batch.stream == "joints").values
        for quantity, values in rows[False].items():
            assert rows[True][quantity][-1] == pytest.approx(values[-1], abs=0.05), quantity
        # A servo whose power is interrupted shows other bytes from then on, and says that its torque is off.
        clock.call_at(clock.now() + 1.1, lambda: bench.server.obey("power-cycle bend"))
        report = bench.session(tmp_path / "run.h5", GOAL)
        assert "bend (id 7)" in str(report.stopped_by)
        position = read_recording(tmp_path / "run.h5").streams["joints"].channels["position"].values
        assert np.abs(np.diff(position, axis=0)).max() < 0.2
