"""Leading an arm by hand: limp or carried, only while the key is held, and stopped by what stops any session."""

from __future__ import annotations

import os
import pty
import termios
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from motor_bench import MotorBench, motors, robot_file
from recorded_session import record_session
from servo_bench import servos
from simulated_clock import SimulatedClock
from true_results import true_result

from daq.commands.hand_guiding import KeyAtTerminal
from daq.recording.reader import read_recording
from daq.recording.recording import HAND_GUIDED
from daq.session.guiding import Compensation, Guiding, HandGate, load_compensation, require_guidable
from daq.session.session import SessionReport
from drivers.core.errors import MotionRefusedError, SafetyStopError, UsageError
from ident.monitor.compensation import WeightCompensation
from ident.result.result_file import result_json

HELD = np.array([-0.6, 0.4])
"""[rad] where the arm is held at first."""
SECONDS = 1.5
"""[s] that the key is held."""


class Person:
    """Says yes, and holds the key for a while; pulls at the arm meanwhile."""

    def __init__(self, clock: SimulatedClock, seconds: float = SECONDS, answer: bool = True) -> None:
        self._clock, self._seconds, self._answer = clock, seconds, answer
        self._begun: float | None = None
        self.cautions: Sequence[str] = ()

    def mind(self, cautions: Sequence[str]) -> None:
        self.cautions = cautions

    def ask(self) -> None:
        pass

    def answer(self) -> bool | None:
        return self._answer

    def held(self) -> bool:
        self._begun = self._begun if self._begun is not None else self._clock.now()
        return self._clock.now() - self._begun < self._seconds


@pytest.fixture(scope="module")
def model(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("model")
    (folder / "result.json").write_text(result_json(true_result(robot_file())), encoding="utf-8")
    return folder


def led(bench: MotorBench, path: Path, hand: Person, carrying: Compensation | None = None, **more) -> SessionReport:
    """The arm, held at `HELD`, then led."""
    guiding = Guiding(robot_file().robot, hand, carrying)
    for motor, angle in zip(bench.server.motors, HELD.tolist(), strict=True):
        bench.server.plant.arm.position[:] = HELD
        motor.hold(angle, bench.clock.now())
    bench.clock.sleep(0.5)
    with bench.opened(**more) as driver:
        hand.mind(require_guidable(driver, guiding).guiding_cautions(pushed=carrying is not None))
        return record_session(path, robot_file(), driver, clock=bench.clock, guiding=guiding)


@pytest.mark.parametrize("wire", ["damiao", "robstride", "moteus"])
def test_a_carried_arm_stays_where_it_is_left(clock: SimulatedClock, tmp_path, model, wire):
    """Released it does not fall; then it is held by its springs again, and the file says that a hand led it."""
    carrying = load_compensation(robot_file(), model)
    with motors(clock, wire) as bench:
        report = led(bench, tmp_path / "run.h5", Person(clock), carrying)
        assert report.stopped_by is None, report.stopped_by
        clock.sleep(1.0)
        assert bench.server.plant.arm.position == pytest.approx(HELD, abs=0.15)  # springs of 60 N·m/rad yield
        assert all(motor.enabled for motor in bench.server.motors)
    run = read_recording(tmp_path / "run.h5")
    position = run.streams["joints"].channels["position"].values
    said = [event.message for event in run.events]
    assert {"hand guiding begins: carried", "the key was released"} <= {*said}
    led_from = int(np.searchsorted(run.streams["joints"].time, run.events[0].time))
    assert np.ptp(position[led_from:], axis=0).max() < 0.01  # its weight is carried, and dry friction stops the rest
    assert run.complete


def test_a_limp_arm_falls_only_while_the_key_is_held(clock: SimulatedClock, tmp_path):
    for wire in ("damiao", "odrive", "cubemars"):
        with motors(clock, wire) as bench:
            hand = Person(clock, 0.3)
            report = led(bench, tmp_path / f"{wire}.h5", hand)
            assert any("THE ARM FALLS unless you carry it" in line for line in hand.cautions)
            assert report.stopped_by is None or "by hand" in report.stopped_by, report.stopped_by
            assert np.max(np.abs(bench.server.plant.arm.velocity)) < 0.05, wire
            assert bench.server.plant.arm.position[0] < HELD[0] - 0.05, wire  # it fell, and was caught
            assert all(motor.enabled for motor in bench.server.motors)


def test_what_falls_faster_than_a_hand_is_caught(clock: SimulatedClock, tmp_path):
    with motors(clock, on_stop="limp") as bench:
        report = led(bench, tmp_path / "run.h5", Person(clock, 5.0))
        assert isinstance(report.error, SafetyStopError)
        assert "than 1.5 rad/s by hand" in str(report.error)
        assert not any(motor.enabled for motor in bench.server.motors)


def test_it_is_refused_before_the_arm_is_let_go(clock: SimulatedClock, tmp_path, model):
    with motors(clock) as bench:
        report = led(bench, tmp_path / "run.h5", Person(clock, answer=False))
        assert isinstance(report.error, MotionRefusedError)
        assert report.file is None
        assert bench.server.plant.arm.position == pytest.approx(HELD, abs=0.1)
        wrong = WeightCompensation(robot_file(), model)
        wrong.torque = lambda position, velocity: np.array([-8.0, 0.0])  # type: ignore[method-assign]
        report = led(bench, tmp_path / "run.h5", Person(clock), wrong)
        assert "swing is held by" in str(report.error)
        assert "the model asks for -8" in str(report.error)
    for wire, said in (("cubemars", "no command time-out"), ("odrive", "no torques")):
        with motors(clock, wire) as bench, bench.opened() as driver, pytest.raises(UsageError, match=said):
            require_guidable(driver, Guiding(robot_file().robot, Person(clock), wrong))


def test_a_dead_program_leaves_no_torque(clock: SimulatedClock, model):
    """Its cycle lives on, or not: what it commanded last ends after a tenth of a second."""
    for wire in ("damiao", "moteus"):
        for alive in (True, False):
            with motors(clock, wire) as bench, bench.opened() as driver:
                driver.start()
                driver.read(0.1)
                driver.release(np.zeros(2))
                for _ in range(10):
                    driver.push(np.array([1.0, 0.5]))
                    clock.sleep(0.01)
                assert np.max(np.abs(bench.server.plant._pushing)) > 0.4
                if not alive:
                    driver._cycle.stop()
                clock.sleep(0.3)
                assert bench.server.plant._pushing == pytest.approx([0.0, 0.0], abs=0.005), (wire, alive)
                assert all(motor.enabled == alive for motor in bench.server.motors), (wire, alive)
                driver._cycle.failure = None


def test_the_gate_passes_nothing_that_breaks_a_limit():
    sent, now = [], [0.0]
    limits = robot_file().robot

    def gate() -> HandGate:
        made = HandGate(sent.append, limits, lambda: now[0])
        made.measured(0.0, HELD)
        return made

    gate().push(np.array([1.0, -1.0]))
    assert len(sent) == 1
    refused = gate()
    with pytest.raises(SafetyStopError, match=r"the model asks for 11 of swing, more than 10"):
        refused.push(np.array([11.0, 0.0]))
    with pytest.raises(SafetyStopError, match="asks for 11"):  # nothing after that
        refused.push(np.zeros(2))
    with pytest.raises(SafetyStopError, match="asks for nan"):
        gate().push(np.array([np.nan, 0.0]))
    now[0] = 0.2
    with pytest.raises(SafetyStopError, match=r"0.200 s old"):
        gate().push(np.zeros(2))
    fast = gate()
    fast.measured(0.2, HELD + [0.0, 0.4])
    with pytest.raises(SafetyStopError, match=r"bend moves at 2 rad/s, more than 1.5 rad/s by hand"):
        fast.check()
    out = gate()
    out.measured(0.2, np.array([-2.1, 0.0]))
    with pytest.raises(SafetyStopError, match="swing left its range"):
        out.check()
    assert len(sent) == 1


def test_servos_are_let_go_and_hold_again(clock: SimulatedClock):
    with servos(clock) as bench, bench.opened() as driver:
        driver.start()
        driver.read(0.2)
        assert "accept no torques" in driver.guiding_refusal(pushed=True)
        driver.release(None)
        assert not any(servo.get("torque_enable") for servo in bench.server.servos)
        clock.sleep(0.3)
        driver.stop()
        assert all(servo.get("torque_enable") for servo in bench.server.servos)
        assert not [notice for notice in driver.notices() if notice.level == "error"]


class Typist(KeyAtTerminal):
    """A person at a real terminal, who answers, and holds the space bar from then on until something happens."""

    def __init__(self, clock: SimulatedClock, answer: bytes = b"y\n") -> None:
        self.keyboard, screen = pty.openpty()
        self.screen = os.fdopen(screen, "r+b", buffering=0)
        reader, writer = (os.fdopen(screen, mode, closefd=False) for mode in ("r", "w"))
        self.settings = termios.tcgetattr(screen)
        self._typed_answer, self._time = answer, clock
        self.then: Callable[[], None] = lambda: None
        super().__init__((reader, writer), clock, asks=True)

    def ask(self) -> None:
        os.write(self.keyboard, b"y\n")  # typed before the question: it answers nothing
        super().ask()
        os.write(self.keyboard, self._typed_answer)
        now = self._time.now()
        if self._typed_answer == b"y\n":
            for number in range(8):
                self._time.call_at(now + 0.1 + 0.05 * number, self._press)
            self._time.call_at(now + 0.5, lambda: self.then())

    def _press(self) -> None:
        os.write(self.keyboard, b" ")

    def lose(self) -> None:
        os.close(self.keyboard)
        self.keyboard = -1

    def close(self) -> None:
        self.screen.close()
        if self.keyboard >= 0:
            os.close(self.keyboard)


def test_the_arm_is_let_go_only_while_the_space_bar_is_held_at_a_terminal(clock: SimulatedClock, tmp_path, model):
    carrying = load_compensation(robot_file(), model)
    lasted = {}
    for case in ("released", "another key", "terminal lost", "no"):
        with motors(clock) as bench:
            hand = Typist(clock, b"n\n" if case == "no" else b"y\n")
            if case == "another key":
                hand.then = lambda hand=hand: os.write(hand.keyboard, b" q")
            elif case == "terminal lost":
                hand.then = hand.lose
            with hand:
                report = led(bench, tmp_path / f"{case}.h5", hand, carrying)
            if case != "terminal lost":
                assert termios.tcgetattr(hand.screen) == hand.settings, case
            hand.close()
            if case == "no":
                assert "not confirmed" in str(report.error)
                assert not (tmp_path / "no.h5").exists()
                continue
            assert (report.error, report.stopped_by) == (None, None), case
            assert all(motor.enabled for motor in bench.server.motors), case
            assert bench.server.plant.arm.position == pytest.approx(HELD, abs=0.1), case
            run = read_recording(tmp_path / f"{case}.h5")
            times = {event.message.split(":")[0]: event.time for event in run.events}
            lasted[case] = times["the key was released"] - times[HAND_GUIDED]
    # Let go at the second press; 0.3 s without a press are a release, what else ends it does so at once.
    assert lasted["another key"] == pytest.approx(lasted["terminal lost"], abs=0.03)
    assert lasted["released"] - lasted["another key"] == pytest.approx(0.25, abs=0.1)
