from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from typing import Any

import can
import numpy as np
import pytest
from scripted_can_arm import ANSWER_TIME, JOINTS, RATE, ScriptedCanArm, connection, moving, two_frames
from simulated_clock import START, SimulatedClock

from drivers.base import Attributing, Driver, DriverSettings, Notice
from drivers.can_signals.driver import SILENCE_LIMIT, STOP_INTERVAL, STOP_LIMIT, CanFramesDriver
from drivers.can_signals.streams import RATE_TIME, RATE_TIMES
from drivers.core.errors import ConnectionFailedError, ConnectionLostError, DriverStateError, UsageError
from drivers.core.text import counted
from drivers.gains import DriveGain
from drivers.standstill import REST_WINDOW
from drivers.streams import Batch

GAINS = (DriveGain(2.0, 0.1), DriveGain(-3.0, 0.1))
Arm = Callable[..., ScriptedCanArm]
Make = Callable[..., CanFramesDriver]
PERIOD = 1.0 / RATE


@pytest.fixture
def arm(clock: SimulatedClock) -> Iterator[Arm]:
    with ExitStack() as made:
        yield lambda *args, **keys: made.enter_context(closing(ScriptedCanArm(clock, *args, **keys)))


@pytest.fixture
def make_driver(clock: SimulatedClock) -> Iterator[Make]:
    with ExitStack() as made:
        yield lambda keys: made.enter_context(
            closing(CanFramesDriver(DriverSettings(JOINTS, keys, GAINS, clock=clock)))
        )


def started(driver: CanFramesDriver) -> CanFramesDriver:
    driver.open()
    driver.start()
    return driver


Read = Callable[[Driver, float], list[Batch]]


@pytest.fixture
def read_for(clock: SimulatedClock) -> Read:
    """Reads a driver for so long [s], until the middle between two cycles of the arm."""

    def read(driver: Driver, seconds: float) -> list[Batch]:
        cycle = math.floor((clock.now() - START) * RATE + 1e-6)
        end, blocks = START + (cycle + 0.5) * PERIOD + seconds, []
        while (left := end - clock.now()) > 0.0:
            blocks += driver.read(min(left, 0.05))
        return blocks

    return read


def joined(blocks: list[Batch], quantity: str, stream: str = "joints") -> np.ndarray:
    return np.concatenate([block.values[quantity] for block in blocks if block.stream == stream])


def lost(blocks: list[Batch]) -> int:
    return sum(block.lost for block in blocks if block.stream == "joints")


def said(notices: list[Notice], level: str) -> str:
    return "\n".join(notice.message for notice in notices if notice.level == level)


def test_blocks_are_what_the_streams_promise(arm: Arm, make_driver: Make, read_for: Read) -> None:
    def cycle(number: int) -> list[tuple[int, bytes]]:
        return [*two_frames(number), (0x183, bytes([number % 2, 40 + number % 2])), (0x184, b"\0")]

    keys = connection(arm(cycle).channel)
    signals: Any = keys["signals"]
    for number, joint in enumerate(JOINTS):
        warm = {"quantity": "temperature", "joint": joint, "id": 0x183, "start": 8, "length": 8, "unit": "degC"}
        signals.append(warm | {"multiplexer": {"start": 0, "length": 8, "value": 1 - number}})
    signals.append({"quantity": "fault", "joint": "elbow", "id": 0x184, "start": 0, "length": 8})
    driver: Driver = make_driver(keys)
    driver.open()
    layouts = {layout.name: layout for layout in driver.streams()}
    assert list(layouts) == ["joints", "thermal", "status"]
    assert layouts["joints"].rate == RATE
    driver.start()
    blocks = read_for(driver, 0.5)
    for block in blocks:
        assert {values.dtype for values in block.values.values()} == {np.dtype(np.float64)}
        assert np.array_equal(block.time, block.host_time)  # nobody else tells the time
    assert {block.stream for block in blocks} == set(layouts)
    assert np.allclose(joined(blocks, "position"), [0.1, -0.2])
    assert len(joined(blocks, "position")) == 0.5 * RATE
    assert np.allclose(joined(blocks, "temperature", "thermal"), [41.0, 40.0])
    assert len(joined(blocks, "temperature", "thermal")) == 0.25 * RATE
    assert layouts["status"].channels[0].columns == ("elbow",)
    assert "arrival" in layouts["joints"].channels[0].description
    assert lost(blocks) == 0
    assert [notice for notice in driver.notices() if notice.level != "info"] == []


def test_current_becomes_torque_through_the_gains(arm: Arm, make_driver: Make, read_for: Read) -> None:
    keys = connection(arm().channel)
    signals: Any = keys["signals"]
    for signal in signals:
        if signal["quantity"] == "velocity":
            signal |= {"quantity": "current", "unit": "mA", "offset": 500}
    driver = started(make_driver(keys))
    blocks = read_for(driver, 0.2)
    assert np.allclose(joined(blocks, "current"), 0.5)
    assert np.allclose(joined(blocks, "torque"), [1.0, -1.5])


def test_the_counter_tells_time_and_losses(arm: Arm, make_driver: Make, read_for: Read) -> None:
    def cycle(number: int) -> list[tuple[int, bytes]]:
        return [] if number % 50 in (20, 21, 22) else two_frames(number)

    driver = started(make_driver(connection(arm(cycle).channel, counter=True)))
    blocks = read_for(driver, 1.2)
    cycles = RATE * np.concatenate([block.time for block in blocks])
    told = [number for number in range(round(cycles[0]), round(cycles[-1]) + 1) if number % 50 not in (20, 21, 22)]
    assert np.allclose(cycles, told)
    assert lost(blocks) == 9
    assert "own counter" in driver.streams()[0].channels[0].description


def test_other_streams_have_the_joints_clock(arm: Arm, make_driver: Make, read_for: Read) -> None:
    """Those before the first row of the joints have no time, and do not spoil that of the others."""

    def cycle(number: int) -> list[tuple[int, bytes]]:
        return [(0x184, bytes([number % 256])), *two_frames(number)]

    made = arm(cycle)
    keys = connection(made.channel, counter=True)
    signals: Any = keys["signals"]
    signals.append({"quantity": "fault", "joint": "elbow", "id": 0x184, "start": 0, "length": 8})
    driver = make_driver(keys)
    driver.open()
    made.cycle = lambda number: cycle(number)[:1]
    driver.start()
    assert all(not len(block.time) for block in read_for(driver, 0.05))
    made.cycle = cycle
    blocks = [block for block in read_for(driver, 0.4) if block.stream == "status"]
    times = np.concatenate([block.time for block in blocks])
    assert len(times) >= 0.38 * RATE
    assert np.allclose(times, joined(blocks, "fault", "status")[:, 0] / RATE, rtol=0, atol=0.5 * PERIOD)


def test_an_incomplete_row_is_lost_and_its_frame_named(arm: Arm, make_driver: Make, read_for: Read) -> None:
    def cycle(number: int) -> list[tuple[int, bytes]]:
        return two_frames(number)[: 1 if number % 10 == 5 else 2]

    driver = started(make_driver(connection(arm(cycle).channel)))
    blocks = read_for(driver, 1.2)
    assert (len(joined(blocks, "position")), lost(blocks)) == (108, 12)
    warnings = said(list(driver.notices()), "warning")
    assert "incomplete rows; the last lacked frame 0x182 (position of elbow, velocity of elbow)" in warnings


def test_the_frame_after_the_pause_begins_a_cycle(arm: Arm, make_driver: Make, read_for: Read) -> None:
    def cycle(number: int) -> list[tuple[int, bytes]]:
        counted = (number % 1000).to_bytes(2, "little") + bytes(2)
        return [(0x182, counted), (0x181, counted)]

    driver = started(make_driver(connection(arm(cycle).channel)))
    blocks = read_for(driver, 0.5)
    position = joined(blocks, "position")
    assert np.array_equal(position[:, 0], position[:, 1])
    assert "a cycle begins with frame 0x182" in said(list(driver.notices()), "info")


def test_a_marker_begins_a_cycle(arm: Arm, make_driver: Make, read_for: Read) -> None:
    def cycle(number: int) -> list[tuple[int, bytes]]:
        counted = (number % 1000).to_bytes(2, "little") + bytes(2)
        frames = [(0x181, counted), (0x182, counted)]
        return [(0x80, b""), *(frames if number % 2 else frames[::-1])]

    driver = started(make_driver(connection(arm(cycle).channel, cycle=0x80)))
    blocks = read_for(driver, 0.5)
    position = joined(blocks, "position")
    assert np.array_equal(position[:, 0], position[:, 1])
    assert np.allclose(np.diff(position[:, 0]), 1e-4)
    assert lost(blocks) == 0


def test_polls_are_sent_on_time_answered_and_counted(
    arm: Arm, make_driver: Make, read_for: Read, clock: SimulatedClock
) -> None:
    unanswered = (50, 70, 71, 72, 149)
    made = arm(lambda number: [] if number in unanswered else two_frames(number), poll=0x100)
    driver = started(make_driver(connection(made.channel, poll={"id": 0x100, "data": "01 00"})))
    blocks = read_for(driver, 2.0)
    assert set(made.heard) == {(0x100, b"\1\0")}
    assert np.allclose(np.diff(made.heard_at), PERIOD, rtol=0, atol=1e-9)
    rows = joined(blocks, "position")
    assert lost(blocks) == len(unanswered)
    assert made.heard_at[-1] > clock.now() - PERIOD - 1e-9
    assert len(rows) == 2.0 * RATE - len(unanswered)


def test_a_bus_that_no_longer_carries_what_is_sent_ends_the_session(
    arm: Arm, make_driver: Make, read_for: Read, clock: SimulatedClock
) -> None:
    """socketcan hands a sent frame back once the bus has carried it, as the virtual bus does when it is asked to."""
    made = arm(poll=0x100)
    keys = connection(made.channel, poll={"id": 0x100}) | {"options": {"receive_own_messages": True}}
    driver = started(make_driver(keys))
    blocks = read_for(driver, 0.5)
    assert len(joined(blocks, "position")) == 0.5 * RATE  # what comes back is no sample
    clock.stall(0.2)
    read_for(driver, 0.5)
    driver._bus.receive_own_messages = False  # type: ignore[union-attr]
    begun = clock.now()
    with pytest.raises(ConnectionLostError, match=r"nothing that was sent for 0\.05 s came back"):
        read_for(driver, 1.0)
    assert clock.now() - begun < 0.05 + 3 * PERIOD


def test_polls_after_a_stall_go_on_from_now(arm: Arm, make_driver: Make, read_for: Read, clock: SimulatedClock) -> None:
    made = arm(poll=0x100)
    driver = started(make_driver(connection(made.channel, poll={"id": 0x100})))
    read_for(driver, 0.5)
    before = len(made.heard)
    clock.stall(0.2)
    end = clock.now()
    blocks = read_for(driver, 1.0)
    # One that was overdue, and two that catch up: no burst.
    heard = end + np.concatenate([ANSWER_TIME * np.arange(3), PERIOD * np.arange(1, 101)])
    assert np.allclose(made.heard_at[before:], heard, rtol=0, atol=1e-9)
    assert lost(blocks) == 0


def test_what_does_not_come_is_named(arm: Arm, make_driver: Make, clock: SimulatedClock) -> None:
    made = arm(lambda number: two_frames(number)[:1])
    driver = make_driver(connection(made.channel, timeout=0.3))
    begun = clock.now()
    with pytest.raises(ConnectionFailedError) as caught:
        driver.open()
    assert clock.now() - begun == pytest.approx(0.3, abs=0.03)  # and the receiving thread looks once more
    assert "no frame 0x182 (position of elbow, velocity of elbow) within 0.3 s; heard: 0x181" in caught.value.message
    with pytest.raises(ConnectionFailedError, match="frame 0x080 that begins a cycle"):
        make_driver(connection(arm().channel, timeout=0.3, cycle=0x80)).open()
    made.cycle = two_frames
    driver.open()  # a second try is allowed


def test_a_bus_that_does_not_exist_is_said(make_driver: Make) -> None:
    with pytest.raises(ConnectionFailedError, match="no interface 'nothing'"):
        make_driver(connection("c", interface="nothing")).open()


def test_silence_ends_the_session_and_names_the_frame(
    arm: Arm, make_driver: Make, read_for: Read, clock: SimulatedClock
) -> None:
    made = arm()
    driver = started(make_driver(connection(made.channel)))
    read_for(driver, 0.1)
    begun = clock.now()
    made.cycle = lambda number: two_frames(number)[:1]
    with pytest.raises(
        ConnectionLostError, match=r"no complete row of the joints for 0.5 s: frame 0x182 .* is missing"
    ):
        read_for(driver, 2.0)
    assert clock.now() - begun == pytest.approx(SILENCE_LIMIT)  # half a period longer since the last row
    driver.stop()


def test_a_fault_of_the_arm_is_an_error(arm: Arm, make_driver: Make, read_for: Read) -> None:
    made = arm(lambda number: [*two_frames(number), (0x184, b"\0")])
    keys = connection(made.channel)
    signals: Any = keys["signals"]
    signals.append({"quantity": "fault", "joint": "elbow", "id": 0x184, "start": 0, "length": 8})
    driver = started(make_driver(keys))
    read_for(driver, 0.1)
    assert said(list(driver.notices()), "error") == ""
    made.cycle = lambda number: [*two_frames(number), (0x184, b"\7")]
    read_for(driver, 0.1)
    assert said(list(driver.notices()), "error") == "fault of elbow: 7"
    made.cycle = lambda number: [*two_frames(number), (0x184, b"\0")]
    read_for(driver, 0.1)
    assert said(list(driver.notices()), "info") == "fault of elbow is over"


def test_another_rate_than_the_files_is_said(arm: Arm, make_driver: Make, read_for: Read) -> None:
    driver = started(make_driver(connection(arm().channel, rate=150)))
    read_for(driver, RATE_TIMES * RATE_TIME - 0.1)
    assert said(list(driver.notices()), "warning") == ""
    read_for(driver, 0.2)
    assert "cycles come at 100 Hz, but the robot file says 150 Hz" in said(list(driver.notices()), "warning")


def test_one_pause_is_no_other_rate(arm: Arm, make_driver: Make, read_for: Read) -> None:
    made = arm(lambda number: [] if 60 <= number < 90 else two_frames(number))
    driver = started(make_driver(connection(made.channel)))
    assert len(joined(read_for(driver, 3.0 * RATE_TIME), "position")) == 3.0 * RATE_TIME * RATE - 30
    assert said(list(driver.notices()), "warning") == ""


def test_frames_that_are_too_short_are_said(arm: Arm, make_driver: Make, read_for: Read) -> None:
    made = arm()
    driver = started(make_driver(connection(made.channel)))
    made.cycle = lambda number: [(identifier, data[:3]) for identifier, data in two_frames(number)]
    with pytest.raises(ConnectionLostError):
        read_for(driver, 1.0)
    assert "too short for the table" in said(list(driver.notices()), "warning")


@pytest.mark.parametrize("unknown", [math.nan, math.inf])
def test_an_arm_at_an_unknown_position_is_not_enabled(
    arm: Arm, make_driver: Make, read_for: Read, unknown: float
) -> None:
    made = arm(lambda number: [(0x181, struct.pack("<ff", 0.1, unknown))])
    keys = moving(made.channel)
    keys["signals"] = [
        {
            "quantity": "position",
            "joint": joint,
            "id": 0x181,
            "start": 32 * n,
            "length": 32,
            "float": True,
            "unit": "rad",
        }
        for n, joint in enumerate(JOINTS)
    ]
    driver = started(make_driver(keys))
    read_for(driver, 0.1)
    with pytest.raises(DriverStateError, match=r"measured one, (nan|inf)") as caught:
        driver.command(np.array([0.1, -0.2]))
    assert caught.value.where == "joint elbow"
    assert made.heard == []


def test_the_arm_is_enabled_commanded_and_stopped(
    arm: Arm, make_driver: Make, read_for: Read, clock: SimulatedClock
) -> None:
    made = arm()
    driver = started(make_driver(moving(made.channel)))
    with pytest.raises(DriverStateError, match="no position of the arm is known"):
        driver.command(np.array([0.1, -0.2]))
    read_for(driver, 0.1)
    with pytest.raises(DriverStateError, match=r"0\.110 rad away"):
        driver.command(np.array([0.1, -0.31]))
    assert made.heard == []
    driver.command(np.array([0.1, -0.2]))
    driver.command(np.array([0.11, -0.19]))
    clock.sleep(0.01)
    positions = [values.to_bytes(2, "little", signed=True) for values in (1000, -2000, 1100, -1900)]
    assert made.heard == [(0x200, b"\1"), (0x201, positions[0] + positions[1]), (0x201, positions[2] + positions[3])]
    with pytest.raises(DriverStateError, match="does not fit into its 16 bits"):
        driver.command(np.array([0.11, -4.0]))
    for wrong in (np.zeros(3), np.array([np.nan, 0.0])):
        with pytest.raises(ValueError, match="2 finite numbers"):
            driver.command(wrong)
    begun = clock.now()
    driver.stop()
    # Again and again, until the arm has shown that it is at rest.
    repeats = len(made.heard) - 3
    assert made.heard[3:] == [(0x200, b"\0")] * repeats
    assert np.allclose(made.heard_at[3:], begun + STOP_INTERVAL * np.arange(repeats), rtol=0, atol=1e-9)
    assert REST_WINDOW <= clock.now() - begun <= REST_WINDOW + 2 * PERIOD
    assert (repeats - 1) * STOP_INTERVAL <= clock.now() - begun <= repeats * STOP_INTERVAL
    driver.stop()
    assert len(made.heard) == 3 + repeats
    assert said(list(driver.notices()), "error") == ""
    with pytest.raises(DriverStateError):
        driver.command(np.array([0.1, -0.2]))


@pytest.mark.parametrize("when", [0.5 * STOP_INTERVAL, 3.0 * STOP_INTERVAL])
def test_a_command_during_a_stop_does_not_start_the_arm_again(
    arm: Arm, make_driver: Make, read_for: Read, clock: SimulatedClock, when: float
) -> None:
    made = arm()
    driver = started(make_driver(moving(made.channel)))
    read_for(driver, 0.1)
    driver.command(np.array([0.1, -0.2]))
    refused: list[str] = []

    def command() -> None:
        with pytest.raises(DriverStateError) as caught:
            driver.command(np.array([0.1, -0.2]))
        refused.append(caught.value.message)

    late = clock.call_at(clock.now() + when, command)
    driver.stop()
    late.join()
    assert refused == ["the arm is being stopped"]
    assert set(made.heard[2:]) == {(0x200, b"\0")}


def test_an_arm_that_goes_on_moving_is_reported(
    arm: Arm, make_driver: Make, read_for: Read, clock: SimulatedClock
) -> None:
    def cycle(number: int) -> list[tuple[int, bytes]]:
        return [(0x181, (20 * number % 30000).to_bytes(2, "little") + bytes(2)), (0x182, bytes(4))]

    driver = started(make_driver(moving(arm(cycle).channel)))
    position = joined(read_for(driver, 0.2), "position")[-1]
    driver.command(position)
    begun = clock.now()
    driver.stop()
    assert STOP_LIMIT <= clock.now() - begun <= STOP_LIMIT + 0.05
    assert "that it is at rest" in said(list(driver.notices()), "error")


@pytest.mark.parametrize("deaf_for", [0.05, 0.5])
def test_an_arm_that_is_cut_off_during_the_first_stop_frames_is_stopped_later(
    arm: Arm, make_driver: Make, read_for: Read, clock: SimulatedClock, deaf_for: float
) -> None:
    """It neither hears nor sends for a while, as with a loose plug."""
    made = arm()
    driver = started(make_driver(moving(made.channel)))
    read_for(driver, 0.1)
    driver.command(np.array([0.1, -0.2]))
    clock.sleep(0.01)
    cycle, heard_at = made.cycle, made.heard_at
    made.cycle = lambda number: ()
    made.heard_at = []  # what it misses

    def plug_in() -> None:
        made.cycle, made.heard_at, made.heard = cycle, heard_at, []

    clock.call_at(clock.now() + deaf_for, plug_in)
    driver.stop()
    assert set(made.heard) == {(0x200, b"\0")}
    assert said(list(driver.notices()), "error") == ""


def test_a_frame_that_does_not_come_is_named_and_counted(arm: Arm, make_driver: Make, read_for: Read) -> None:
    made = arm(lambda number: two_frames(number)[: 1 if number % 10 == 5 else 2])
    driver = started(make_driver(connection(made.channel)))
    assert isinstance(driver, Attributing)
    blocks = read_for(driver, 1.0)
    elbow = "frame 0x182 (position of elbow, velocity of elbow)"
    assert driver.losses("joints") == f"no {elbow}: {counted(lost(blocks), 'time')}"
    assert lost(blocks) == 10
    assert driver.silence("joints", 0.05) == driver.losses("thermal") == ""
    made.cycle = lambda number: two_frames(number)[:1]
    read_for(driver, 0.1)
    assert driver.silence("joints", 0.05) == f"no {elbow}"
    driver.stop()
    assert driver.silence("joints", 0.05) == ""


def test_a_bus_that_breaks_while_the_arm_moves(
    arm: Arm, make_driver: Make, monkeypatch: pytest.MonkeyPatch, read_for: Read
) -> None:
    driver = started(make_driver(moving(arm().channel)))
    read_for(driver, 0.1)
    driver.command(np.array([0.1, -0.2]))

    def gone(*_: object, **__: object) -> None:
        raise can.CanOperationError("gone")

    bus = driver._bus
    monkeypatch.setattr(bus, "send", gone)
    monkeypatch.setattr(bus, "recv", gone)
    with pytest.raises(ConnectionLostError):
        driver.command(np.array([0.1, -0.2]))
    with pytest.raises(ConnectionLostError):
        read_for(driver, 2.0)
    driver.stop()
    assert "could not be sent" in said(list(driver.notices()), "error")
    driver.close()


def test_a_table_without_commands_moves_nothing(arm: Arm, make_driver: Make, read_for: Read) -> None:
    made = arm()
    driver = started(make_driver(connection(made.channel, stop=[{"id": 0x200}])))
    read_for(driver, 0.1)
    with pytest.raises(DriverStateError, match="cannot move the arm"):
        driver.command(np.array([0.1, -0.2]))
    driver.stop()
    assert made.heard == []


def test_begin_and_end_frames_frame_the_connection(arm: Arm, make_driver: Make, clock: SimulatedClock) -> None:
    made = arm()
    driver = make_driver(connection(made.channel, begin=[{"id": 1, "data": "aa"}], end=[{"id": 1, "data": "bb"}]))
    driver.open()
    driver.close()
    clock.sleep(0.01)
    assert made.heard == [(1, b"\xaa"), (1, b"\xbb")]


def test_wrong_keys_are_refused_at_once() -> None:
    with pytest.raises(UsageError, match="unknown key 'host'"):
        CanFramesDriver(DriverSettings(JOINTS, connection("c", host="1.2.3.4"), GAINS))
