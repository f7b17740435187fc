"""What every arm of servos or motors does that are asked again and again, in simulated time: faults, losses, stops."""

from __future__ import annotations

from contextlib import AbstractContextManager

import motor_bench
import numpy as np
import pytest
import servo_bench
from motor_bench import JOINTS, MotorBench, motors
from servo_bench import ServoBench, servos
from simulated_clock import SimulatedClock

from daq.recording.reader import read_recording
from drivers.core.errors import ConnectionLostError, SafetyStopError
from sim_drivers.faults import parse_fault

WIRES = (*motor_bench.WIRES, *servo_bench.WIRES)


def served(clock: SimulatedClock, wire: str, **more: object) -> AbstractContextManager[MotorBench | ServoBench]:
    return (servos if wire in servo_bench.WIRES else motors)(clock, wire, **more)


def goal(bench: MotorBench | ServoBench) -> np.ndarray:
    return servo_bench.START + [1.0, -0.8] if isinstance(bench, ServoBench) else motor_bench.START + [0.8, -0.6]


def stiff(bench: MotorBench | ServoBench) -> list[bool]:
    """Which motors drive."""
    if isinstance(bench, ServoBench):
        return [servo.get("torque_enable") == 1 for servo in bench.server.servos]
    return [motor.enabled for motor in bench.server.motors]


def cause_after(bench: MotorBench | ServoBench, seconds: float, line: str) -> None:
    fault = parse_fault(line, "serial servos" if isinstance(bench, ServoBench) else "CAN motors", JOINTS)
    bench.clock.call_at(bench.clock.now() + seconds, lambda: bench.server.cause(fault))


OF_MOTORS = {
    "die bend": ("stale data of stream joints", "no answer of bend (id 7)"),
    "same-id bend": ("bend (id 7) answers twice: two motors have this id", ""),
    "freeze 2": ("stale data of stream joints", "no motor answers"),
    "bus-off 2": ("stale data of stream joints", "no motor answers"),
    "over-temperature bend": ("bend (id 7) reports over-temperature", "let it cool down"),
    "power-cycle bend": ("bend", ""),
    "sag 1": ("reports under-voltage", ""),
    "block swing": ("stuck position of swing", "it is jammed"),
}
OF_SERVOS = {
    "die bend": ("stale data of stream joints", "no answer of bend (id 7)"),
    "same-id bend": ("stale data of stream joints", "no answer of bend (id 7)"),
    "freeze 2": ("stale data of stream joints", "no servo answers"),
    "unplug": ("the port is gone", ""),
    "over-temperature bend": ("bend (id 7) reports over-temperature", "let it cool down"),
    "power-cycle bend": ("stale data of stream joints", "bend"),
    "block swing": ("stuck position of swing", "it is jammed"),
}
TRIED = {
    "damiao": OF_MOTORS,
    **dict.fromkeys(("robstride", "cubemars"), ("die bend", "over-temperature bend")),
    **dict.fromkeys(("moteus", "odrive"), ("die bend", "over-temperature bend", "same-id bend")),
    "feetech": OF_SERVOS,
    "dynamixel": ("die bend", "same-id bend", "power-cycle bend"),
}


@pytest.mark.parametrize("wire", WIRES)
def test_faults_end_a_motion_and_are_named(clock: SimulatedClock, tmp_path, wire):
    wrong = {}
    for line in TRIED[wire]:
        with served(clock, wire) as bench:
            servo = isinstance(bench, ServoBench)
            cause_after(bench, 1.2 if servo else 1.1, line)
            report = bench.session(tmp_path / "run.h5", goal(bench))
            stopped = str(report.stopped_by)
            assert report.file is not None
            rows = len(read_recording(report.file).streams["joints"].time)
            report.file.unlink()
            clock.sleep(0.5)
            loose = not servo or "die" in line or "over" in line
            still = loose or np.max(np.abs(bench.server.plant.arm.velocity)) < 0.05
            said = (OF_SERVOS if servo else OF_MOTORS)[line]
            if not all(words in stopped for words in said) or not still or rows < 50:
                wrong[line] = stopped, still, rows
    assert wrong == {}, wrong


@pytest.mark.parametrize(
    ("wire", "lines", "most"),
    [
        ("robstride", ("drop 2", "garbage 3", "truncate 1"), 10),
        ("dynamixel", ("drop 2", "garbage 1", "truncate 1", "wrong-sum 1"), 40),
    ],
)
def test_what_is_small_is_lost_and_counted(clock: SimulatedClock, tmp_path, wire, lines, most):
    with served(clock, wire) as bench:
        for number, line in enumerate(lines):
            cause_after(bench, 1.0 + 0.15 * number, line)
        report = bench.session(tmp_path / "run.h5", goal(bench))
        assert report.stopped_by is None
        assert 1 <= report.lost["joints"] <= most


@pytest.mark.parametrize(("wire", "after", "duration"), [("damiao", 0.5, 3.0), ("feetech", 1.0, 5.0)])
def test_without_an_answer_the_connection_is_lost(clock: SimulatedClock, tmp_path, wire, after, duration):
    with served(clock, wire) as bench:
        cause_after(bench, after, "die swing")
        report = bench.session(tmp_path / "run.h5", duration=duration)
    assert isinstance(report.error, ConnectionLostError)
    assert "no answer of swing (id 1)" in str(report.error)
    assert not isinstance(report.error, SafetyStopError)


@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize("wire", ["damiao", "feetech"])
def test_a_stall_of_the_computer_costs_what_it_did_not_ask_for(clock: SimulatedClock, wire, whole):
    with served(clock, wire) as bench, bench.opened() as driver:
        driver.start()
        driver.read(0.1)
        clock.sleep_until(driver._cycle.asked + 0.01 + 1e-4)  # the motors have been asked, and not all have answered
        driver.read(0.0)
        begun = clock.now()
        if whole:  # with the simulated motors: when they measured is not known
            clock.stall(0.6)
        else:
            clock.suspend(0.6, [thread.name for thread in bench.server._threads])
        batches = []
        while clock.now() < begun + 0.8:
            batches += driver.read(0.01)
        assert clock.stalled(begun) == pytest.approx(0.6, abs=0.01)
        assert driver.losses("joints") == f"{59 + whole} while this computer was late to ask, or to look"
    stamps = np.concatenate([batch.time for batch in batches]) - begun
    assert np.sum(stamps < 0.002) == (not whole)  # what had been asked, with its time
    assert not np.any((stamps > 0.002) & (stamps < 0.598))


def test_a_stall_ends_a_motion_and_not_a_recording(clock: SimulatedClock, tmp_path):
    for moves in (True, False):
        with served(clock, "damiao") as bench:
            clock.call_at(clock.now() + 1.1, lambda: clock.stall(0.6))
            to, duration = (goal(bench), None) if moves else (None, 1.9)
            report = bench.session(tmp_path / f"{moves}.h5", to, duration)
        assert ("this computer stalled for 0." in str(report.stopped_by)) == moves, report.stopped_by
        assert moves or (report.stopped_by is None and "this computer was late" in report.heavy_loss)


def test_silence_says_who_was_late(clock: SimulatedClock):
    for wire in ("damiao", "feetech"):
        with served(clock, wire) as bench, bench.opened() as driver:
            driver.start()
            clock.sleep(0.3)
            assert driver.silence("joints", 0.05) == "", wire
            bench.server.cause(parse_fault("freeze 2", "CAN motors", JOINTS))
            clock.sleep(0.3)
            assert driver.silence("joints", 0.05).endswith(" answers: check the power and the cable"), wire


@pytest.mark.parametrize("wire", WIRES)
def test_limp_on_stop(clock: SimulatedClock, wire):
    with served(clock, wire, on_stop="limp") as bench, bench.opened() as driver:
        assert any("THE ARM FALLS" in line for line in driver.cautions())
        driver.start()
        driver.take_control()
        assert all(stiff(bench))
        driver.stop()
        assert not any(stiff(bench))
        said = driver.notices()
        assert any("limp" in notice.message for notice in said)
        assert not any("did not answer" in notice.message for notice in said), said


def test_a_motor_that_is_not_switched_off_is_named(clock: SimulatedClock, monkeypatch):
    with served(clock, "odrive", on_stop="limp") as bench, bench.opened() as driver:
        driver.start()
        driver.take_control()
        monkeypatch.setattr(bench.server.motors[1], "_let_go", lambda: None)
        driver.stop()
        said = [notice.message for notice in driver.notices() if notice.level == "error"]
    assert said == ["bend (id 7) still drives after it was switched off 3 times: cut its power"]
