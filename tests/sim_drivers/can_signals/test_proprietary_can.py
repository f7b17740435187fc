"""The arm that speaks a table of CAN frames, and the driver that reads the same table."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated_clock import SimulatedClock
from table_arm_bench import (
    CYCLE_TIME,
    JOINTS,
    KEYS,
    PERIOD,
    POSE,
    RATE,
    ROBOT,
    ROBOT_FILE,
    STEP,
    Noting,
    connection_of,
    keys,
    noted_by,
    opened,
    read_for,
    served,
    session,
)
from unchecked import unchecked_play

from daq.motion.trajectories import slow_move
from daq.recording.reader import read_recording
from drivers.can_signals.driver import CanFramesDriver, Commander
from drivers.can_signals.settings import CommandTable, parse_settings
from drivers.can_signals.table.signals import FrameLayout, batches, decode, frame_layouts
from drivers.core.errors import UsageError
from sim_drivers.can_signals.arm import FAULT_COMMAND, TableArm
from sim_drivers.can_signals.server import ProprietaryCanServer
from sim_drivers.plant.plant import Plant

DBC = Path(__file__).resolve().parents[2] / "drivers" / "aubo_i5.dbc"


@cache
def layouts() -> tuple[FrameLayout, ...]:
    return tuple(frame_layouts(parse_settings(KEYS, JOINTS).signals))


def decoded(frames: list[Any]) -> dict[tuple[str, str], float]:
    grouped = batches([(0.0, frame.id, frame.data) for frame in frames])
    found = {}
    for part in layouts():
        if part.identifier in grouped:
            _, values, _ = decode(part, grouped[part.identifier])
            for row in values:
                found |= {(s.quantity, s.joint): value for s, value in zip(part.signals, row, strict=True)}
    return found


@pytest.fixture
def talker() -> TableArm:
    plant = Noting()
    table = TableArm(plant, ROBOT.joints, parse_settings(KEYS, JOINTS))
    plant.talker = table
    return table


def test_the_dbc_file_says_the_same_as_the_table() -> None:
    by_table = parse_settings(KEYS, JOINTS)
    from_dbc = {key: value for key, value in KEYS.items() if key not in ("signals", "command", "start", "stop")}
    by_file = parse_settings(from_dbc | {"dbc": str(DBC)}, JOINTS)
    assert set(by_file.signals) == set(by_table.signals)
    commands = [{"joint": joint, "signal": f"command_{joint}"} for joint in JOINTS]
    by_both = parse_settings(KEYS | {"dbc": str(DBC), "command": {"signals": commands}}, JOINTS)
    assert replace(by_both, keys=by_table.keys) == by_table


def test_what_is_decoded_is_what_was_measured(talker: TableArm) -> None:
    for cycle in range(6):
        talker.advance(PERIOD)
        found = decoded(talker.cycle())
        measured = talker.arm.noted[cycle]  # type: ignore[attr-defined]
        assert found["counter", ""] == cycle
        for number, joint in enumerate(JOINTS):
            assert abs(found["position", joint] - measured.position[number]) <= STEP / 2
            assert abs(found["velocity", joint] - measured.velocity[number]) <= np.deg2rad(0.005) + 1e-12
            assert abs(found["current", joint] - measured.current[number]) <= 0.0005 + 1e-12
            assert found["fault", joint] == 0
        warm = [joint for joint in JOINTS if ("temperature", joint) in found]
        assert warm == [JOINTS[2 * (cycle % 3)], JOINTS[2 * (cycle % 3) + 1]]
        assert found["temperature", warm[0]] == pytest.approx(23.0)


@cache
def commands() -> CommandTable:
    table = parse_settings(KEYS, JOINTS).command
    assert table is not None
    return table


def command(talker: TableArm, position: np.ndarray) -> None:
    for identifier, data in Commander(commands(), JOINTS).frames(position):
        talker.obey(identifier, data)


def test_commands_are_followed_once_enabled(talker: TableArm) -> None:
    start = talker.arm.position.copy()  # type: ignore[attr-defined]
    command(talker, start + 0.01)
    talker.advance(0.1)
    assert np.allclose(talker.arm.measure().target_position, start)  # not enabled
    talker.obey(0x200, b"\1\1")
    assert talker.enabled
    for tick in range(240):
        command(talker, start + 0.1 * (1 - np.cos(np.pi * min((tick + 1) / 200, 1.0))) / 2)
        talker.advance(PERIOD)
    measured = talker.arm.measure()
    assert np.allclose(measured.target_position, start + 0.1, atol=STEP)
    assert np.allclose(measured.position, start + 0.1, atol=2e-3)
    assert not np.any(talker._faults)


@pytest.mark.parametrize("phase", [0.0, 0.4])
def test_acceleration_at_the_samples_is_that_of_the_motion(talker: TableArm, phase: float) -> None:
    """Samples and commands come at one rate: a ripple of the reference between two commands, always sampled at the
    same place, would give every torque an error in proportion to velocity or acceleration."""
    start = talker.arm.position.copy()  # type: ignore[attr-defined]
    talker.obey(0x200, b"\1\1")
    samples = []
    for tick in range(800):
        talker.advance(phase * PERIOD)
        pace = min(tick / 200, 1.0)
        command(talker, start + 0.15 * pace * np.sin(2 * np.pi * tick * PERIOD + np.arange(6)) - 0.15 * pace)
        talker.advance((1.0 - phase) * PERIOD)
        plant = talker.arm
        samples.append((plant.position, plant.velocity, plant.acceleration))  # type: ignore[attr-defined]
    position, velocity, acceleration = np.array(samples)[300:].transpose(1, 0, 2)
    smooth = np.gradient(np.gradient(position, PERIOD, axis=0), PERIOD, axis=0)
    error = acceleration - smooth
    assert np.max(np.abs(np.sum(error * velocity, 0) / np.sum(velocity**2, 0))) < 0.05  # 1.0 to 1.4 /s once
    assert np.max(np.abs(np.sum(error * smooth, 0) / np.sum(smooth**2, 0))) < 0.02


def test_commands_left_out_are_bridged(talker: TableArm) -> None:
    start = talker.arm.measure().target_position
    talker.obey(0x200, b"\1\1")
    speeds = []
    for tick in range(200):
        if tick not in (100, 140, 141, 142):
            command(talker, start + 0.5 * PERIOD * tick)
        talker.advance(PERIOD)
        speeds.append(talker.arm.measure().target_velocity)
    assert talker.enabled
    assert np.allclose(speeds[60:], 0.5, atol=0.01)


def test_commands_that_come_late_and_in_a_bunch_do_not_throw_the_arm(talker: TableArm) -> None:
    start = talker.arm.measure().target_position
    talker.obey(0x200, b"\1\1")
    speeds = []
    for tick in range(200):
        late = {100: 1.3, 101: 0.3, 140: 2.6, 141: 1.6, 142: 0.6}.get(tick, 0.0)  # in periods
        due = (tick + late) * PERIOD - talker._time + 0.001
        talker.advance(max(due, 0.0))
        command(talker, start + 0.5 * PERIOD * tick)
        speeds.append(talker.arm.measure().target_velocity)
    assert np.allclose(speeds[60:], 0.5, atol=0.06)


@pytest.mark.parametrize("stall", [5, 8, 30])
def test_a_motion_that_is_resumed_after_a_stall_where_it_was_goes_on_softly(talker: TableArm, stall: int) -> None:
    start = talker.arm.measure().target_position
    talker.obey(0x200, b"\1\1")
    speeds = []
    for tick in range(300):
        command(talker, start + 0.5 * PERIOD * tick)
        for _ in range(1 + stall if tick == 150 else 1):
            talker.advance(PERIOD)
            speeds.append(talker.arm.measure().target_velocity)
    steps = np.diff(np.array(speeds)[60:], axis=0)
    assert np.max(np.abs(steps)) < 0.35  # [rad/s] a period
    assert np.max(np.abs(speeds[60:])) < 0.75
    assert np.allclose(speeds[-40:], 0.5, atol=0.01)


def test_a_stop_halts_a_moving_arm(talker: TableArm) -> None:
    talker.obey(0x200, b"\1\1")
    position = talker.arm.measure().target_position
    for _ in range(40):
        position = position + 0.5 * PERIOD
        command(talker, position)
        talker.advance(PERIOD)
    assert np.all(talker.arm.measure().velocity > 0.3)
    talker.obey(0x200, b"\0\0")
    command(talker, position + 0.5 * PERIOD)
    talker.advance(0.5)
    assert not talker.enabled
    assert np.all(np.abs(talker.arm.measure().velocity) < 0.01)
    assert np.all(talker.arm.measure().position < position + 0.05)


@pytest.mark.parametrize("jump", [0.2, 4.0])
def test_commands_outside_the_limits_are_a_fault(talker: TableArm, jump: float) -> None:
    talker.obey(0x200, b"\1\1")
    position = talker.arm.measure().target_position
    position[2] += jump
    command(talker, position)
    assert not talker.enabled
    found = decoded(talker.cycle())
    assert [found["fault", joint] for joint in JOINTS] == [0, 0, FAULT_COMMAND, 0, 0, 0]
    talker.obey(0x200, b"\1\1")
    assert decoded(talker.cycle())["fault", JOINTS[2]] == 0


def test_a_steady_motion_above_the_speed_limit_is_a_fault_and_a_bunch_of_late_commands_is_none(
    talker: TableArm,
) -> None:
    def run(share: float) -> bool:
        talker.obey(0x200, b"\1\1")
        position = talker.arm.measure().target_position
        for tick in range(100):
            position = position + share * talker._speed * PERIOD
            command(talker, position)
            if tick % 4 == 3:  # four at once
                talker.advance(4 * PERIOD)
        return talker.enabled

    assert run(0.2)
    talker.obey(0x200, b"\0\0")
    talker.advance(1.0)
    assert not run(-1.3)


def test_a_table_that_no_plant_can_fill_is_refused() -> None:
    signals = [
        *KEYS["signals"],
        *({"quantity": "voltage", "joint": j, "id": 0x400 + n, "start": 0, "length": 16} for n, j in enumerate(JOINTS)),
    ]
    for signal in signals[-6:]:
        signal["unit"] = "V"
    with pytest.raises(UsageError, match="does not measure voltage"):
        ProprietaryCanServer(Plant(ROBOT_FILE), ROBOT, keys(signals=signals))


@pytest.fixture
def server(clock: SimulatedClock) -> Iterator[ProprietaryCanServer]:
    with served(clock) as made:
        yield made


@pytest.fixture
def driver(server: ProprietaryCanServer, clock: SimulatedClock) -> Iterator[CanFramesDriver]:
    """Yield the open driver of the server's arm."""
    with opened(connection_of(server), clock) as made:
        yield made


def test_a_motion_is_recorded_as_the_plant_made_it(
    server: ProprietaryCanServer, driver: CanFramesDriver, clock: SimulatedClock, tmp_path: Path
) -> None:
    path = tmp_path / "run.h5"
    motion = slow_move(POSE, POSE + 0.15, ROBOT.joints, share=0.1)
    report = session(path, driver, clock, unchecked_play(motion, ROBOT))
    assert report.stopped_by is None
    assert report.punctuality is not None
    assert (report.punctuality.skipped, report.punctuality.max_ms) == (0, 0.0)
    recording = read_recording(path)
    joints = recording.streams["joints"]
    cycles = np.rint(joints.time / PERIOD).astype(int)
    assert np.allclose(joints.time, cycles * PERIOD, rtol=0, atol=1e-9)
    # Everything that was sent has come, in order.
    assert np.all(np.diff(cycles) == 1)
    assert report.lost["joints"] == 0
    position = joints.channels["position"].values
    assert np.max(np.abs(position - noted_by(server, "position", cycles))) <= STEP / 2
    current = joints.channels["current"].values
    assert np.max(np.abs(current - noted_by(server, "current", cycles))) <= 0.0005 + 1e-9
    assert np.allclose(joints.channels["torque"].values, current * [ROBOT.drive(name).gain for name in JOINTS])
    assert np.all(np.ptp(position, axis=0) > 0.149)
    thermal = recording.streams["thermal"]
    assert abs(len(thermal.time) - len(cycles) / 3) <= 1
    assert thermal.channels["temperature"].values.shape[1] == 6
    assert not server.status().enabled


def test_a_row_is_handed_out_when_its_last_frame_came(
    server: ProprietaryCanServer, driver: CanFramesDriver, clock: SimulatedClock
) -> None:
    """Frames of other streams among those of the joints, here temperatures, hold nothing back."""
    driver.start()
    for _ in range(200):
        for block in driver.read(1.0):
            if block.stream == "joints":
                assert len(block.time) == 1
                assert clock.now() - block.host_time[0] < CYCLE_TIME


FAULTS = {
    "drop": ("drop 3", 1, "incomplete row"),
    "truncate": ("truncate 2", 1, "2 frames too short for the table"),
    "freeze": ("freeze 0.2", 40, "1 incomplete row; the last lacked frame 0x381"),
    "mute": ("mute 0x182 0.2", 40, f"the last lacked frame 0x182 (position of {JOINTS[2]}, position of {JOINTS[3]})"),
    "bus-off": ("bus-off 0.2", 40, "1 error frame"),
    "garbage": ("garbage 20", 0, ""),
}
"""A fault, the rows that it costs, and what is told of it."""


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_costs_its_rows_and_nothing_else(
    server: ProprietaryCanServer, driver: CanFramesDriver, clock: SimulatedClock, fault: str
) -> None:
    caused, costs, told = FAULTS[fault]
    driver.start()
    blocks = read_for(driver, clock, 0.3)
    server.obey(caused)
    blocks += read_for(driver, clock, 1.2)
    cycles = np.rint(np.concatenate([block.time for block in blocks]) * RATE).astype(int)
    position = np.concatenate([block.values["position"] for block in blocks])
    assert np.max(np.abs(position - noted_by(server, "position", cycles))) <= STEP / 2
    assert sum(block.lost for block in blocks) == costs
    assert sum(np.diff(cycles) - 1) == costs
    assert np.sum(np.diff(cycles) > 1) == (costs > 0)  # all in one go
    warned = "; ".join(notice.message for notice in driver.notices() if notice.level == "warning")
    assert told in warned
    assert bool(told) is bool(warned)


def test_an_arm_that_is_polled_answers(clock: SimulatedClock) -> None:
    connection = keys(poll={"id": 0x100, "data": "01"})
    connection["signals"] = [signal for signal in connection["signals"] if signal["quantity"] != "counter"]
    with ProprietaryCanServer(Plant(ROBOT_FILE, position=POSE), ROBOT, connection, clock=clock) as server:
        clock.sleep(0.05)
        assert server.status().cycles == 0
        with opened(connection, clock) as driver:
            driver.start()
            blocks = read_for(driver, clock, 0.5 + PERIOD / 2)
        assert sum(len(block.time) for block in blocks) == 0.5 * RATE
        assert sum(block.lost for block in blocks) == 0


def test_a_bus_that_is_too_slow_loses_frames_as_a_real_one(clock: SimulatedClock) -> None:
    # Eight frames of some 110 bits, 200 times a second, are 180 kbit/s.
    plant = Plant(ROBOT_FILE, position=POSE)
    with ProprietaryCanServer(plant, ROBOT, keys(bitrate=100_000), clock=clock) as server:
        clock.sleep(0.5)
        status = server.status()
    assert status.cycles == 0.5 * RATE
    assert status.lost > 0.3 * 8 * status.cycles
    assert status.load == pytest.approx(1.0, abs=0.02)
    assert status.stalls == 0


def test_time_stands_still_for_an_arm_whose_computer_stalls(
    server: ProprietaryCanServer, clock: SimulatedClock
) -> None:
    clock.sleep(0.5)
    before = server.status()
    clock.stall(0.2)
    clock.sleep(0.1)
    caught_up = server.status()
    assert caught_up.time - before.time == pytest.approx(0.3, abs=1e-6)
    assert caught_up.stalls == 0
    clock.stall(1.0)
    clock.sleep(0.1)
    assert server.status().time - caught_up.time == pytest.approx(0.1, abs=PERIOD)
    assert server.status().stalls == 1


def test_typed_faults() -> None:
    server = ProprietaryCanServer(Plant(ROBOT_FILE), ROBOT, keys())
    server.obey("drop 3")
    server.obey(f"over-temperature {JOINTS[0]}")
    server.obey("mute 0x182 0.5")
    server.obey("bus-off 0.5")
    for line in ("unplug", "power-cycle 1", "nonsense", "mute 0x182", "mute 0x182 -1"):
        with pytest.raises(UsageError) as caught:
            server.obey(line)
        assert "garbage N" in caught.value.hint
    with pytest.raises(UsageError, match="'elbow' is not an identifier"):
        server.obey("mute elbow 1")
