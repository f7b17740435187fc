from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing

import numpy as np
import pytest
from each import each
from exact_plant import ExactPlant
from rtde_in_process import HOST, NOWHERE, Motions, Network, RememberedArm, serving
from scripted_rtde import Cut, Never, Sample, ScriptedController, Step, Wait, paced, steady
from simulated_clock import START, SimulatedClock

from daq.session.play import unreported_safety
from drivers.base import Driver, DriverSettings, Identifying
from drivers.core.errors import (
    ConnectionFailedError,
    ConnectionLostError,
    DriverStateError,
    MotionRefusedError,
    UsageError,
)
from drivers.gains import DriveGain
from drivers.rtde.driver import DASHBOARD_TIMEOUT, ArmControl, RtdeDriver
from drivers.rtde.motion import STOP_LIMIT
from drivers.streams import Batch
from sim_drivers.rtde.server import RtdeServer

JOINTS = tuple(f"j{number}" for number in range(1, 7))
GAINS = tuple(DriveGain(float(number), 0.1) for number in range(1, 7))
PERIOD = 0.002
Make = Callable[..., ScriptedController]
MakeDriver = Callable[..., RtdeDriver]


def no_control(host: str, rate: float, timeout: float) -> ArmControl:
    raise AssertionError("this arm is not to be moved")


@pytest.fixture
def make_driver(clock: SimulatedClock) -> Iterator[MakeDriver]:
    made = ExitStack()

    def make(
        other: ScriptedController | Network,
        *,
        gains: Sequence[DriveGain] = GAINS,
        take_control: Callable[[str, float, float], ArmControl] = no_control,
        **keys: object,
    ) -> RtdeDriver:
        settings = DriverSettings(JOINTS, {"host": HOST, "timeout": 2.0} | keys, tuple(gains), clock=clock)
        return made.enter_context(closing(RtdeDriver(settings, other.connect, take_control)))

    with made:
        yield make


def read_all(driver: RtdeDriver, samples: int) -> dict[str, list[Batch]]:
    blocks: dict[str, list[Batch]] = {"joints": [], "thermal": [], "status": []}
    while sum(len(block.time) for block in blocks["joints"]) < samples:
        found = driver.read(0.2)
        assert found
        for block in found:
            blocks[block.stream].append(block)
    return blocks


def joined(blocks: list[Batch], quantity: str) -> np.ndarray:
    return np.concatenate([block.values[quantity] for block in blocks])


def times(blocks: list[Batch]) -> np.ndarray:
    return np.concatenate([block.time for block in blocks])


def test_it_tells_who_answers(controller: Make, make_driver: MakeDriver) -> None:
    script = controller(lambda number: [*steady(10.0, 10), Never()])
    driver = make_driver(script)
    assert isinstance(driver, Identifying)
    with pytest.raises(DriverStateError):
        driver.identify()
    driver.open()
    (identity,) = driver.identify()
    assert identity.controller == f"{HOST}:30004"
    assert identity.software.startswith("5.")
    assert identity.rate == 500.0
    assert identity.variables > 4


def test_blocks_are_what_the_streams_promise(controller: Make, make_driver: MakeDriver) -> None:
    driver: Driver = make_driver(controller(lambda number: [*steady(10.0, 1000), Never()]))
    driver.open()
    layouts = {layout.name: layout for layout in driver.streams()}
    assert {name: layout.rate for name, layout in layouts.items()} == {"joints": 500.0, "thermal": 20.0, "status": 10.0}
    driver.start()
    assert isinstance(driver, RtdeDriver)
    blocks = read_all(driver, 1000)
    for block in itertools.chain.from_iterable(blocks.values()):
        assert {values.dtype for values in block.values.values()} == {np.dtype(np.float64)}
        assert block.host_time.shape == block.time.shape
    clock = times(blocks["joints"])
    assert np.array_equal(clock, 10.0 + np.arange(1000) / 500)
    base = clock[:, np.newaxis] + np.arange(6) / 10
    for quantity, factor in (("position", 1), ("velocity", 2), ("current", 3), ("target_position", 4)):
        assert np.allclose(joined(blocks["joints"], quantity), factor * base)
    for quantity, factor in (("target_acceleration", 6), ("target_current", 7), ("target_torque", 8)):
        assert np.allclose(joined(blocks["joints"], quantity), factor * base)
    assert np.allclose(joined(blocks["joints"], "torque"), 3 * base * np.arange(1, 7))
    thermal = times(blocks["thermal"])
    assert np.allclose(thermal, 10.0 + np.arange(40) / 20)
    assert np.allclose(joined(blocks["thermal"], "temperature")[:, 0], 9 * thermal)
    assert len(times(blocks["status"])) == 20
    assert set(joined(blocks["status"], "robot_mode")[:, 0]) == {7.0}
    assert joined(blocks["status"], "joint_mode").shape == (20, 6)


@each("gains", [(), (*GAINS[:5], DriveGain(None)), (*GAINS[:5], DriveGain(1.0, 0.1, "torque"))])
def test_without_all_gains_there_is_current_but_no_torque(
    controller: Make, make_driver: MakeDriver, gains: tuple[DriveGain, ...]
) -> None:
    driver = make_driver(controller(lambda number: [*steady(1.0, 5), Never()]), gains=gains)
    driver.open()
    quantities = [channel.quantity for channel in driver.streams()[0].channels]
    assert "current" in quantities
    assert "torque" not in quantities
    driver.start()
    assert "torque" not in read_all(driver, 5)["joints"][0].values


def test_a_gap_is_counted_in_every_stream(controller: Make, make_driver: MakeDriver) -> None:
    steps = [sample for index, sample in enumerate(steady(10.0, 1000)) if not 300 <= index < 451]
    driver = make_driver(controller(lambda number: [*steps, Never()]))
    driver.open()
    driver.start()
    blocks = read_all(driver, len(steps))
    lost = {name: sum(block.lost for block in found) for name, found in blocks.items()}
    # 151 samples are missing, and with them six groups of 25 and three groups of 50 but for a sample of the last.
    assert lost["joints"] == 151
    assert (lost["thermal"], lost["status"]) == (6, 3)
    for name, period in (("thermal", 25), ("status", 50)):
        ticks = np.rint(times(blocks[name]) * 500).astype(int)
        assert len(set(ticks // period)) == len(ticks)


def test_a_clock_that_adds_up_its_periods_shifts_no_slow_sample(controller: Make, make_driver: MakeDriver) -> None:
    stamps = list(itertools.accumulate([PERIOD] * 1200))[899:]  # from 1.8 s on; 2.05 s has become 1024.9999 periods
    driver = make_driver(controller(lambda number: [*map(Sample, stamps), Never()]))
    driver.open()
    driver.start()
    blocks = read_all(driver, len(stamps))
    assert np.rint(times(blocks["thermal"]) / PERIOD).tolist() == list(range(900, 1201, 25))
    assert np.rint(times(blocks["status"]) / PERIOD).tolist() == list(range(900, 1201, 50))


def test_refused_variables_leave_their_channels_out(controller: Make, make_driver: MakeDriver) -> None:
    refuse = dict.fromkeys(("target_moment", "joint_temperatures", "joint_mode"), "NOT_FOUND")
    driver = make_driver(controller(lambda number: [*steady(1.0, 100), Never()], refuse=refuse))
    driver.open()
    layouts = {layout.name: [channel.quantity for channel in layout.channels] for layout in driver.streams()}
    assert set(layouts) == {"joints", "status"}
    assert "target_torque" not in layouts["joints"]
    assert layouts["status"] == ["robot_mode", "safety_mode", "runtime_state"]
    assert sum("left out" in notice.message for notice in driver.notices()) == 3
    driver.start()
    assert read_all(driver, 100)["thermal"] == []


def test_an_older_controller_has_its_own_rate(controller: Make, make_driver: MakeDriver) -> None:
    driver = make_driver(controller(lambda number: [*steady(1.0, 125, 125.0), Never()], major=3))
    driver.open()
    assert [round(layout.rate, 1) for layout in driver.streams()] == [125.0, 20.8, 10.4]
    driver.start()
    blocks = read_all(driver, 125)
    assert sum(block.lost for block in blocks["joints"]) == 0


def modes(**values: int) -> dict[str, list[float]]:
    return {name: [value] for name, value in values.items()}


def test_modes_become_notices_when_they_change(controller: Make, make_driver: MakeDriver) -> None:
    steps: list[Step] = [
        *steady(1.0, 10),
        Sample(1.02, modes(safety_mode=3)),
        Sample(1.022, modes(safety_mode=3, runtime_state=2)),
        Wait(0.1),
        Sample(1.024, modes(safety_mode=6)),
        Sample(1.026, modes(robot_mode=3)),
        Sample(1.028, modes(robot_mode=99)),
        Never(),
    ]
    driver = make_driver(controller(lambda number: steps))
    driver.open()
    driver.start()
    read_all(driver, 15)
    notices = driver.notices()
    assert all(bool(notice.hint) == (notice.level == "error") for notice in notices)
    found = [(round(notice.time, 3), notice.level, notice.message) for notice in notices]
    assert sorted(found) == sorted(
        [
            (1.0, "info", "robot mode: running"),
            (1.0, "info", "safety mode: normal"),
            (1.0, "info", "runtime state: stopped"),
            (1.02, "error", "safety mode: protective stop"),
            (1.022, "info", "runtime state: playing"),
            (1.024, "error", "safety mode: system emergency stop"),
            (1.024, "info", "runtime state: stopped"),
            (1.026, "info", "safety mode: normal"),
            (1.026, "error", "robot mode: power off"),
            (1.028, "error", "robot mode: unknown (99)"),
        ]
    )
    assert driver.notices() == []


def test_a_lost_connection_shows_on_every_read(controller: Make, make_driver: MakeDriver) -> None:
    driver = make_driver(controller(lambda number: [*steady(1.0, 20), Cut()]))
    driver.open()
    driver.start()
    read_all(driver, 20)
    for _ in range(2):
        with pytest.raises(ConnectionLostError):
            driver.read(1.0)
    driver.stop()
    driver.close()


def test_stop_and_start_again(controller: Make, make_driver: MakeDriver) -> None:
    starts = iter([1.0, 7.0])
    server = controller(lambda number: [*steady(next(starts), 10), Never()])
    driver = make_driver(server)
    driver.open()
    for begin in (1.0, 7.0):
        driver.start()
        assert times(read_all(driver, 10)["joints"])[0] == begin
        driver.stop()
        driver.stop()
    assert server.connections == 1
    driver.close()
    driver.close()


def test_after_a_loss_start_connects_again(clock: SimulatedClock, controller: Make, make_driver: MakeDriver) -> None:
    scripts = [[*steady(1.0, 5), Cut()], [*steady(3.0, 5), Never()]]
    driver = make_driver(controller(lambda number: scripts[number]))
    driver.open()
    driver.start()
    clock.sleep(0.1)
    driver.stop()
    driver.start()
    blocks = read_all(driver, 5)["joints"]
    assert times(blocks)[0] == 3.0
    assert sum(block.lost for block in blocks) == 0


def test_an_arm_of_another_make_is_refused() -> None:
    with pytest.raises(UsageError, match="moves 6 joints, but the robot file names 4"):
        RtdeDriver(DriverSettings(("a", "b", "c", "d"), {"host": "h"}, ()))


def test_nobody_there_leaves_the_driver_closed(
    clock: SimulatedClock, make_driver: MakeDriver, controller: Make
) -> None:
    server = controller(lambda number: [], mute_at="V")
    driver = make_driver(server, timeout=0.2)
    with pytest.raises(ConnectionFailedError):
        driver.open()
    assert clock.now() == pytest.approx(START + 0.2)
    server.mute_at = ""
    driver.open()


def test_motion_needs_the_port_that_ur_rtde_knows(controller: Make, make_driver: MakeDriver) -> None:
    driver = make_driver(controller(lambda number: [*steady(0.0, 5), Never()]), port=30005)
    driver.open()
    driver.start()
    with pytest.raises(DriverStateError, match="needs RTDE on port 30004"):
        driver.command(np.zeros(6))


@pytest.mark.parametrize("unknown", [np.nan, np.inf])
def test_nobody_takes_control_of_an_arm_at_an_unknown_position(
    controller: Make, make_driver: MakeDriver, unknown: float
) -> None:
    samples = [Sample(1.0 + step / 500, {"actual_q": [0, 0, 0, 0, unknown, 0]}) for step in range(5)]
    driver = make_driver(controller(lambda number: [*samples, Never()]))  # `no_control` raises
    driver.open()
    driver.start()
    read_all(driver, 5)
    with pytest.raises(DriverStateError, match="the first position, 0, ") as caught:
        driver.command(np.zeros(6))
    assert caught.value.where == "joint j5"
    for wrong in (np.full(6, unknown), np.zeros(5)):
        with pytest.raises(ValueError, match="6 finite numbers"):
            driver.command(wrong)


def test_motion_begins_where_the_arm_stands_and_ends_with_stop(clock: SimulatedClock, make_driver: MakeDriver) -> None:
    arm = RememberedArm(ExactPlant())
    server = RtdeServer(arm, ports=NOWHERE, clock=clock)
    with serving(server) as network:
        motions = Motions(clock, network.connect)
        driver = make_driver(network, take_control=motions.take_control)
        driver.open()
        driver.start()
        with pytest.raises(DriverStateError, match="no position of the arm is known"):
            driver.command(np.zeros(6))
        blocks = list(driver.read(1.0))
        position = blocks[0].values["position"][-1]
        with pytest.raises(DriverStateError, match=r"0\.200 rad away") as caught:
            driver.command(position + np.array([0, 0, 0.2, 0, 0, 0]))
        assert caught.value.where == "joint j3"
        assert not motions.made  # nobody took control
        for step in range(500):
            driver.command(position + 0.0002 * step)
            clock.sleep(PERIOD)
            blocks += driver.read(0.0)
        driver.stop()
        with pytest.raises(DriverStateError):
            driver.command(position)
        driver.close()
        assert server.controller.script is None
        clock.sleep(0.5)
    joints = [block for block in blocks if block.stream == "joints"]
    assert sum(block.lost for block in joints) == 0  # taking control costs no sample
    assert_recorded(joints, arm)
    # A lookahead of 0.1 s and a delay of 0.06 s behind at 0.1 rad/s when it is asked to stop.
    assert joints[-1].values["position"][-1, 0] - position[0] == pytest.approx(0.0002 * 499 - 0.016, abs=1e-3)
    assert np.all(arm.values("velocity")[-1] == 0.0)
    assert {notice.level for notice in driver.notices()} == {"info"}


def assert_recorded(joints: Sequence[Batch], arm: RememberedArm) -> None:
    """Every sample is the arm's, none is missing, and each was stamped in the period in which it was taken."""
    clock = times(list(joints))
    first = int(np.rint(clock[0] / PERIOD))
    expected = slice(first, first + len(clock))
    assert np.array_equal(clock, arm.times[expected])
    assert np.array_equal(joined(list(joints), "position"), arm.values("position")[expected])
    assert np.array_equal(joined(list(joints), "velocity"), arm.values("velocity")[expected])
    assert np.array_equal(joined(list(joints), "current"), arm.values("current")[expected])
    host = np.concatenate([block.host_time for block in joints])
    np.testing.assert_allclose(host - START, clock - PERIOD, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize(("version", "reachable"), [("5.22", True), ("5.22", False), ("10.10", True)])
def test_an_arm_whose_motion_was_killed_is_ended_by_the_dashboard_where_it_can_be(
    clock: SimulatedClock, make_driver: MakeDriver, version: str, reachable: bool
) -> None:
    server = RtdeServer(ExactPlant(), version=version, ports=NOWHERE, clock=clock)
    with serving(server) as network:
        motions = Motions(clock, network.connect)
        driver = make_driver(network, take_control=motions.take_control)
        driver.open()
        driver.start()
        position = driver.read(1.0)[0].values["position"][-1]
        driver.command(position)
        motions.kill()
        network.dead = not reachable
        begun = clock.now()
        driver.stop()
        assert clock.now() - begun < DASHBOARD_TIMEOUT
        (notice,) = (notice for notice in driver.notices() if notice.level == "error")
        ended = version == "5.22" and reachable
        assert ("was ended by its dashboard" if ended else "may still run") in notice.message
        clock.sleep(0.99)
        assert (server.controller.script is None) == ended
        clock.sleep(0.05)  # the controller's own watchdog
        assert server.controller.script is None
        driver.close()


def test_a_controller_out_of_reach_does_not_hold_up_the_stop(clock: SimulatedClock, make_driver: MakeDriver) -> None:
    server = RtdeServer(ExactPlant(), ports=NOWHERE, clock=clock)
    with serving(server) as network:
        motions = Motions(clock, network.connect)
        driver = make_driver(network, take_control=motions.take_control)
        driver.open()
        driver.start()
        driver.command(driver.read(1.0)[0].values["position"][-1])
        server.obey("freeze 60.0")
        clock.sleep(PERIOD)
        begun = clock.now()
        driver.stop()
        assert clock.now() - begun == pytest.approx(STOP_LIMIT + DASHBOARD_TIMEOUT)
        assert server.controller.script is None
        driver.close()


def test_a_controller_that_refuses_its_safety_status_is_not_moved_but_on_request(
    clock: SimulatedClock, make_driver: MakeDriver
) -> None:
    server = RtdeServer(ExactPlant(), ports=NOWHERE, clock=clock)
    with serving(server) as network:
        driver = make_driver(network)
        driver.open()
        assert (list(driver.unreported()), unreported_safety(driver, False)) == ([], "")
        driver.close()
        server.obey("refuse safety_mode")
        server.obey("refuse runtime_state")
        clock.sleep(2 * PERIOD)
        driver.open()
        with pytest.raises(MotionRefusedError, match="does not deliver safety_mode, runtime_state") as refused:
            unreported_safety(driver, False)
        assert "--without-safety-status" in refused.value.hint
        assert "safety_mode, runtime_state" in unreported_safety(driver, True)
        driver.start()
        assert driver.read(1.0)
        driver.close()


def test_an_arm_on_which_a_program_plays_is_not_taken(controller: Make, make_driver: MakeDriver) -> None:
    samples = [Sample(1.0 + step / 500, modes(runtime_state=2)) for step in range(5)]
    driver = make_driver(controller(lambda number: [*samples, Never()]))
    driver.open()
    driver.start()
    position = read_all(driver, 5)["joints"][0].values["position"][-1]
    for take in (driver.take_control, lambda: driver.command(position)):
        with pytest.raises(
            MotionRefusedError, match=r"a program is active on the controller \(runtime state: playing\)"
        ):
            take()


def test_commands_go_at_the_controllers_own_rate(
    clock: SimulatedClock, controller: Make, make_driver: MakeDriver
) -> None:
    slow = SlowMotion(clock)
    driver = make_driver(
        controller(lambda number: [*steady(1.0, 5, 125.0), Never()]), rate=125, take_control=slow.take_control
    )
    driver.open()
    assert (driver.streams()[0].rate, driver.command_rate()) == (125.0, 500.0)
    driver.start()
    read_all(driver, 5)
    driver.take_control()
    assert (slow.made, slow.rate) == (1, 500.0)


class SlowMotion:
    """Takes its time to stop, as an arm does."""

    def __init__(self, clock: SimulatedClock) -> None:
        self.made = 0
        self.stopping = False
        self._clock = clock

    def take_control(self, host: str, rate: float, timeout: float) -> SlowMotion:
        self.made += 1
        self.rate = rate
        return self

    def command(self, position: np.ndarray, due: float) -> None:
        assert not self.stopping

    def stop(self) -> bool:
        self.stopping = True
        self._clock.sleep(2.0)
        return True


def test_while_the_arm_is_braking_it_is_recorded_but_not_commanded(
    clock: SimulatedClock, controller: Make, make_driver: MakeDriver
) -> None:
    slow = SlowMotion(clock)
    driver = make_driver(controller(lambda number: paced(500.0, start=0.0)), take_control=slow.take_control)
    driver.open()
    driver.start()
    position = driver.read(1.0)[0].values["position"][-1]
    driver.command(position)
    stopper = clock.thread(driver.stop, "stopper")
    stopper.start()
    samples = 0
    begun = clock.now()
    while clock.now() - begun < 1.999:
        if slow.stopping:
            with pytest.raises(DriverStateError, match="being stopped"):
                driver.command(position)
        samples += sum(len(block.time) for block in driver.read(0.1) if block.stream == "joints")
    stopper.join()
    assert samples == 1000
    assert slow.made == 1
    with pytest.raises(DriverStateError, match="must be running"):
        driver.read(0.0)
    assert driver.notices()[-1].level == "info"  # it did confirm
