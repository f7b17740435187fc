"""Leading an arm of CiA 402 drives by hand: carried by cyclic torques, and stopped by whatever ends that."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from canopen_recording import Bench, arm_on_bus
from recorded_session import record_session
from simulated_clock import SimulatedClock
from true_results import true_result

from daq.recording.reader import read_recording
from daq.session.guiding import Guiding, load_compensation, require_guidable
from daq.session.session import SessionReport
from drivers.canopen402.protocol.objects import MODE_CYCLIC_TORQUE
from drivers.core.errors import SafetyStopError, UsageError
from ident.result.result_file import result_json
from sim_drivers.canopen.drive import SimulatedDrive


@dataclass
class Person:
    """Says yes, and holds the key for a while."""

    clock: SimulatedClock
    seconds: float = 1.0
    begun: float = float("nan")

    def mind(self, cautions: Sequence[str]) -> None:
        pass

    def ask(self) -> None:
        pass

    def answer(self) -> bool:
        return True

    def held(self) -> bool:
        if np.isnan(self.begun):
            self.begun = self.clock.now()
        return bool(self.clock.now() - self.begun < self.seconds)


@functools.cache
def true_model() -> str:
    with arm_on_bus(opened=False) as bench:
        return result_json(true_result(bench.robot_file))


@pytest.fixture(autouse=True, scope="module")
def _before_any_clock() -> None:
    true_model()


def led(
    bench: Bench, folder: Path, seconds: float = 1.0, while_led: Callable[[], object] | None = None
) -> tuple[SessionReport, Path]:
    """The arm, led; the action comes half a second after it was let go."""
    (folder / "result.json").write_text(true_model(), encoding="utf-8")
    carrying = load_compensation(bench.robot_file, folder)
    hand = Person(bench.clock, seconds)
    guiding = Guiding(bench.robot_file.robot, hand, carrying)
    require_guidable(bench.driver, guiding)
    path = folder / "run.h5"
    if while_led is not None:

        def wait() -> None:
            while not all(drive.axis.objects.number(0x6060) == MODE_CYCLIC_TORQUE for drive in drives(bench)):
                bench.clock.sleep(0.01)
            bench.clock.sleep(0.5)
            while_led()

        bench.clock.thread(wait, "watch").start()
    return record_session(path, bench.robot_file, bench.driver, clock=bench.clock, guiding=guiding), path


def drives(bench: Bench) -> Sequence[SimulatedDrive]:
    return bench.server.network.drives


def test_a_carried_arm_stays_and_is_held_by_its_brakes_afterwards(tmp_path: Path) -> None:
    with arm_on_bus() as bench:
        report, path = led(bench, tmp_path)
        assert report.stopped_by is None, report.stopped_by
        assert bench.rests()
    run = read_recording(path)
    assert {"hand guiding begins: carried", "the key was released"} <= {event.message for event in run.events}
    position = run.streams["joints"].channels["position"].values
    begun = next(event.time for event in run.events if "hand guiding" in event.message)
    assert np.ptp(position[np.searchsorted(run.streams["joints"].time, begun) :], axis=0).max() < 0.01


@pytest.mark.parametrize(
    ("action", "reason"),
    [
        ("push", "by hand"),  # an arm that runs: harder than a hand
        ("stall", "computer stalled for 0.07 s"),
        ("over-temperature 2", "temperature too high"),
    ],
)
def test_what_ends_it_stops_the_arm(tmp_path: Path, action: str, reason: str) -> None:
    with arm_on_bus() as bench:

        def act() -> None:
            if action == "push":
                for drive in drives(bench):
                    drive.axis.setup.__dict__["rated_torque"] *= 3.0
            elif action == "stall":
                bench.clock.suspend(0.07, but=("canopen-nodes", "watch"))
            else:
                bench.server.obey(action)

        report, _ = led(bench, tmp_path, 3.0, act)
        assert isinstance(report.error, SafetyStopError), report.stopped_by
        assert reason in str(report.error).lower()
        assert bench.rests()


def test_torques_that_cease_stop_the_drives_though_the_program_lives(tmp_path: Path) -> None:
    with arm_on_bus() as bench:
        driver, clock = bench.driver, bench.clock
        driver.start()
        for _ in range(10):
            driver.read(0.1)
        driver.take_control()
        driver.release(np.zeros(3))
        driver.push(np.ones(3))
        clock.sleep(0.05)
        assert [drive.axis.pushed for drive in drives(bench)] == pytest.approx([1.0] * 3, abs=0.05)
        clock.sleep(1.0)
        assert all(drive.axis.pushed is None for drive in drives(bench))
        assert np.max(np.abs(bench.plant.velocity)) < 0.02
        driver.read(0.1)
        driver.stop()
        assert any("no torque was commanded for 0.1 s" in notice.message for notice in driver.notices())


def test_it_is_refused_limp_and_where_a_drive_would_not_notice_the_end_of_this_computer(tmp_path: Path) -> None:
    with arm_on_bus() as bench:
        robot = bench.robot_file.robot
        with pytest.raises(UsageError, match="held by their brakes"):
            require_guidable(bench.driver, Guiding(robot, Person(bench.clock)))
        controls = list(bench.driver._configured.controls)
        controls[1] = type(controls[1])(True, None, controls[1].abort_option)
        object.__setattr__(bench.driver._configured, "controls", tuple(controls))
        assert "shoulder_lift_joint" in bench.driver.guiding_refusal(pushed=True)
