"""Simulated drives in virtual time: NMT, PDO mapping, motion, faults, and a bus that is too full."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from drive_bench import COUNTS, Bench
from each import each
from exact_plant import ExactPlant
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.core.errors import UsageError
from sim_drivers.can.bus_load import Frame, worst_case_bits
from sim_drivers.canopen.drive import FOLLOWING_ERROR, OVER_TEMPERATURE
from sim_drivers.canopen.object_dictionary import Abort, entries

RAD = COUNTS / (2 * np.pi)


def test_every_drive_says_that_it_has_booted() -> None:
    bench = Bench()
    assert [(sent.frame.id, sent.frame.data) for sent in bench.pass_time(0.1)] == [
        (0x700 + node, b"\x00") for node in range(1, 7)
    ]
    assert bench.read(4, 0x1018, 4) == 4
    assert bench.read(4, 0x1000) == 0x00020192


def test_swapped_drives_keep_their_serial_numbers() -> None:
    bench = Bench(swapped=(1, 2))
    bench.pass_time(0.1)
    assert [bench.read(node, 0x1018, 4) for node in range(1, 7)] == [1, 3, 2, 4, 5, 6]


def test_positions_are_those_of_the_arm() -> None:
    nodes = {f"j{number}": {"id": number, "counts_per_turn": 4096} for number in range(1, 7)}
    nodes["j3"] |= {"direction": -1, "zero": 0.25}
    bench = Bench(nodes=nodes)
    bench.pass_time(0.1)
    counts = [bench.read(node, 0x6064, signed=True) for node in range(1, 7)]
    expected = np.linspace(-0.5, 0.5, 6)
    expected[2] = -(expected[2] - 0.25)
    np.testing.assert_allclose(counts, expected * 4096 / (2 * np.pi), atol=0.5)


def test_a_gear_is_read_from_the_drive() -> None:
    bench = Bench(nodes={f"j{number}": {"id": number} for number in range(1, 7)})
    bench.pass_time(0.1)
    turn = bench.read(1, 0x608F, 1) / bench.read(1, 0x608F, 2) * bench.read(1, 0x6091, 1) / bench.read(1, 0x6091, 2)
    assert bench.read(1, 0x6064, signed=True) == round(-0.5 * turn / (2 * np.pi))


def test_counts_that_no_encoder_has_are_refused() -> None:
    with pytest.raises(UsageError, match="integer number"):
        Bench(nodes={f"j{number}": {"id": number, "counts_per_turn": 1000.5} for number in range(1, 7)})


def test_heartbeats_come_at_the_time_that_was_written() -> None:
    bench = Bench()
    bench.pass_time(0.1)
    assert not bench.write(2, 0x1017, 0, 100, 2)
    beats = [sent for sent in bench.pass_time(1.0) if sent.frame.id == 0x702]
    assert len(beats) == pytest.approx(10, abs=1)
    assert {sent.frame.data for sent in beats} == {b"\x7f"}
    np.testing.assert_allclose(np.diff([sent.time for sent in beats]), 0.1, atol=0.006)
    bench.send(0, bytes([1, 2]))
    assert bench.pass_time(0.2)[-1].frame.data == b"\x05"


def test_pdos_go_only_in_operational_and_as_they_are_mapped() -> None:
    bench = Bench()
    bench.pass_time(0.1)
    bench.map_pdos()
    told = bench.cycle(0, [0] * 6)
    assert told.keys() == set(range(1, 7))
    assert {one.status for one in told.values()} == {0x250}
    second = [sent.frame.data for sent in bench.heard if sent.frame.id == 0x281][-1]
    assert struct.unpack("<ihh", second) == (0, 0, 0)  # at rest, and without voltage no current
    bench.send(0, bytes([0x80, 0]))
    bench.pass_time(0.01)
    assert bench.cycle(0, [0] * 6) == {}


def test_another_mapping_and_another_rate_are_obeyed() -> None:
    bench = Bench()
    bench.pass_time(0.1)
    assert not bench.write(1, 0x1802, 1, 1 << 31 | 0x381, 4)
    assert not bench.write(1, 0x1A02, 0, 0, 1)
    assert not bench.write(1, 0x1A02, 1, 0x20310110, 4)
    assert not bench.write(1, 0x1A02, 2, 0x60640020, 4)
    assert not bench.write(1, 0x1A02, 0, 2, 1)
    assert not bench.write(1, 0x1802, 2, 3, 1)
    assert not bench.write(1, 0x1802, 1, 0x381, 4)
    bench.send(0, bytes([1, 1]))
    bench.pass_time(0.005)
    for _ in range(9):
        bench.send(0x80)
        bench.pass_time(0.005)
    heard = [sent.frame.data for sent in bench.heard if sent.frame.id == 0x381]
    assert len(heard) == 3
    assert struct.unpack("<hi", heard[0]) == (250, round(-0.5 * RAD))


def test_an_event_driven_pdo_comes_with_every_change() -> None:
    bench = Bench()
    bench.pass_time(0.1)
    bench.send(0, bytes([1, 1]))
    bench.pass_time(0.05)
    assert not bench.write(1, 0x6040, 0, 0x06, 2)
    bench.pass_time(0.05)
    words = [sent.frame.data for sent in bench.heard if sent.frame.id == 0x181]
    assert words == [b"\x50\x02", b"\x31\x02"]


@each(
    ("index", "subindex", "value", "size", "abort"),
    [
        (0x1A00, 1, 0x60640020, 4, Abort.DEVICE_STATE),  # while the PDO exists
        (0x1800, 1, 0x182, 4, Abort.DEVICE_STATE),
        (0x1800, 1, 1 << 31 | 0x80, 4, Abort.VALUE_RANGE),
        (0x1800, 2, 250, 1, Abort.VALUE_RANGE),
        (0x1A01, 0, 9, 1, Abort.PDO_LENGTH),
        (0x6060, 0, 3, 1, Abort.VALUE_RANGE),
        (0x605A, 0, 7, 2, Abort.VALUE_RANGE),
        (0x6064, 0, 0, 4, Abort.READ_ONLY),
        (0x6040, 0, 0, 4, Abort.TOO_LONG),
        (0x607A, 0, 0, 2, Abort.TOO_SHORT),
        (0x1018, 9, 0, 4, Abort.NO_SUBINDEX),
        (0x7000, 0, 0, 4, Abort.NO_OBJECT),
    ],
)
def test_what_a_drive_refuses(index: int, subindex: int, value: int, size: int, abort: Abort) -> None:
    bench = Bench()
    bench.pass_time(0.1)
    assert bench.write(1, index, subindex, value, size) == abort


@each("mapped", [0x10000020, 0x60640010, 0x70000008, 0x10080008])
def test_what_cannot_be_mapped(mapped: int) -> None:
    bench = Bench()
    bench.pass_time(0.1)
    assert not bench.write(1, 0x1A01, 0, 0, 1)
    assert bench.write(1, 0x1A01, 1, mapped, 4) in (Abort.NOT_MAPPABLE, Abort.NO_OBJECT)
    assert bench.write(1, 0x1600, 0, 0, 1) == Abort.DEVICE_STATE
    assert not bench.write(1, 0x1400, 1, 1 << 31 | 0x201, 4)
    assert not bench.write(1, 0x1600, 0, 0, 1)
    assert bench.write(1, 0x1600, 1, 0x60640020, 4) == Abort.NOT_MAPPABLE  # nobody tells a drive where it is


def test_cyclic_positions_move_the_arm_within_a_cycle_or_two() -> None:
    bench = Bench()
    bench.pass_time(0.1)
    bench.map_pdos()
    start = np.array(bench.enable())
    largest = 0.0
    for number in range(400):
        way = 0.2 * (1 - np.cos(np.pi * number * 0.0025))
        told = bench.cycle(0x0F, [int(counts) for counts in start + round(way * RAD)])
        error = np.array([told[node].position for node in range(1, 7)]) - start - round(way * RAD)
        largest = max(largest, float(np.max(np.abs(error))) / RAD)
    assert {one.status for one in told.values()} == {0x1237}
    assert largest < 0.63 * 0.006  # the highest speed times 2½ cycles
    assert bench.network.counts.lost == 0


def test_a_joint_without_voltage_is_held_by_its_brake() -> None:
    bench = Bench()
    bench.pass_time(0.1)
    bench.map_pdos()
    before = bench.arm.position.copy()
    for word in (0x00, 0x06, 0x07):
        bench.cycle(word, [100_000] * 6)
    bench.pass_time(0.2)
    np.testing.assert_allclose(bench.arm.position, before, atol=1e-12)


def test_a_quick_stop_stops_along_its_ramp_and_disables() -> None:
    bench = Bench()
    bench.pass_time(0.1)
    bench.map_pdos()
    targets = bench.enable()
    for number in range(100):
        bench.cycle(0x0F, [counts + round(0.0025 * number * RAD) for counts in targets])
    assert not bench.write(1, 0x6085, 0, round(4 * RAD), 4)  # others: 20 rad/s²
    speed = bench.arm.velocity[0]
    assert speed == pytest.approx(1.0, abs=0.02)
    begun = bench.arm.position.copy()
    states = []
    for _ in range(120):
        told = bench.cycle(0x02, [0] * 6)
        states.append([told[node].status & 0x6F for node in (1, 2)])
    assert states[0] == [0x07, 0x07]
    assert states[-1] == [0x40, 0x40]
    way = bench.arm.position - begun
    assert way[0] == pytest.approx(1 / 8, abs=0.006)
    assert way[1] == pytest.approx(1 / 40, abs=0.006)
    assert not np.any(bench.arm.velocity)


def test_a_target_far_away_is_a_following_error_and_no_jump() -> None:
    bench = Bench()
    bench.pass_time(0.1)
    bench.map_pdos()
    targets = bench.enable()
    before = bench.arm.position.copy()
    bench.cycle(0x0F, [targets[0] + round(0.5 * RAD), *targets[1:]])
    told = bench.cycle(0x0F, targets)
    assert told[1].status & 0x4F == 0x08
    assert told[1].status & 0x2000
    assert told[2].status & 0x6F == 0x27
    assert bench.emergencies() == [(1, FOLLOWING_ERROR, 0x21)]
    np.testing.assert_allclose(bench.arm.position, before, atol=1e-4)


@pytest.mark.parametrize(("mode", "fastest", "reached"), [(8, 1000, 2000), (1, 20_000, 2000), (1, 1000, 1000)])
def test_software_limits_of_position_and_profile_velocity(mode: int, fastest: int, reached: int) -> None:
    bench = Bench()
    bench.pass_time(0.1)
    bench.map_pdos()
    targets = bench.enable(mode)
    assert not bench.write(3, 0x607C, 0, 500, 4)  # the home offset is taken off
    assert not bench.write(3, 0x607D, 2, targets[2] + 2500, 4)
    assert not bench.write(3, 0x607F, 0, fastest, 4)  # of profiles
    for step in range(400):
        goal = targets[2] + (min(20 * step, 4000) if mode == 8 else 4000)
        told = bench.cycle(0x1F if step else 0x0F, [*targets[:2], goal, *targets[3:]], mode)
    assert told[3].position - targets[2] == pytest.approx(reached, abs=25)
    assert told[3].status & 0x86F == 0x827  # enabled, an internal limit is active
    assert told[2].status & 0x86F == 0x027


def test_the_window_of_the_following_error_is_the_masters() -> None:
    bench = Bench()
    bench.pass_time(0.1)
    bench.map_pdos()
    targets = bench.enable()
    assert not bench.write(2, 0x6065, 0, 1000, 4)
    assert not bench.write(3, 0x6065, 0, 2**32 - 1, 4)
    for _ in range(3):
        told = bench.cycle(0x0F, [targets[0], targets[1] + 1500, targets[2] + 1500, *targets[3:]])
    bench.pass_time(0.1)
    assert bench.emergencies() == [(2, FOLLOWING_ERROR, 0x21)]
    assert told[3].status & 0x6F == 0x27


def test_a_hot_drive_falls_into_fault_and_is_reset_by_its_master() -> None:
    bench = Bench()
    bench.pass_time(0.1)
    bench.map_pdos()
    targets = bench.enable()
    bench.arm.heat(2, 57.0)
    told = bench.cycle(0x0F, targets)
    assert told[3].status & 0x80  # a warning first
    bench.arm.heat(2, 10.0)
    for _ in range(4):
        told = bench.cycle(0x0F, targets)
    assert told[3].status & 0x4F == 0x08
    assert bench.read(3, 0x603F) == OVER_TEMPERATURE
    assert bench.read(3, 0x2031, 1) == 940
    bench.cycle(0x80, targets)
    for _ in range(4):
        told = bench.cycle(0x00, targets)
    assert told[3].status & 0x4F == 0x08  # still hot
    bench.arm.heat(2, -20.0)
    bench.cycle(0x00, targets)
    told = bench.cycle(0x80, targets)
    assert told[3].status & 0x6F == 0x40
    assert bench.cycle(0x0F, targets)[3].status & 0x6F == 0x40
    assert [one for one in bench.emergencies() if one[0] == 3] == [(3, OVER_TEMPERATURE, 0x09), (3, 0, 0)] * 2


def test_leaving_operational_while_enabled_is_a_fault() -> None:
    bench = Bench()
    bench.pass_time(0.1)
    bench.map_pdos()
    bench.enable()
    bench.send(0, bytes([0x80, 5]))
    bench.pass_time(0.01)
    assert bench.emergencies() == [(5, 0x8100, 0x11)]


def test_a_power_cycle_forgets_everything() -> None:
    bench = Bench()
    bench.pass_time(0.1)
    bench.map_pdos()
    bench.enable()
    bench.network.power_cycle(0)
    silent = bench.pass_time(0.9)
    bench.send(0x601, struct.pack("<BHB4x", 0x40, 0x6041, 0))
    silent += bench.pass_time(0.05)
    assert not [sent for sent in silent if sent.frame.id in (0x181, 0x581, 0x701)]
    assert (0x701, b"\x00") in [(sent.frame.id, sent.frame.data) for sent in bench.pass_time(0.2)]
    assert bench.read(1, 0x6041) == 0x250
    assert bench.read(1, 0x1A00, 1) == 0x60410010


def test_reset_of_the_communication_keeps_the_drives_parameters() -> None:
    bench = Bench()
    bench.pass_time(0.1)
    assert not bench.write(1, 0x6081, 0, 1234, 4)
    assert not bench.write(1, 0x1017, 0, 500, 2)
    bench.send(0, bytes([0x82, 1]))
    assert (0x701, b"\x00") in [(sent.frame.id, sent.frame.data) for sent in bench.pass_time(0.01)]
    assert (bench.read(1, 0x6081), bench.read(1, 0x1017)) == (1234, 0)


def test_profile_positions_with_their_handshake() -> None:
    bench = Bench()
    bench.pass_time(0.1)
    bench.map_pdos()
    start = bench.enable(mode=1)
    goal = [counts + round(0.3 * RAD) for counts in start]
    told = bench.cycle(0x1F, goal, mode=1)
    assert told[1].status & 0x1000  # acknowledged
    assert not told[1].status & 0x400
    told = bench.cycle(0x1F, start, mode=1)  # no edge, no new set-point
    told = bench.cycle(0x0F, start, mode=1)
    assert not told[1].status & 0x1000
    bench.cycle(0x1F, start, mode=1)  # waits until the first is reached
    for _ in range(300):
        told = bench.cycle(0x0F, start, mode=1)
        if bench.arm.position[0] > -0.5 + 0.2999:
            break
    assert bench.arm.position[0] == pytest.approx(-0.2, abs=1e-3)
    for _ in range(400):
        told = bench.cycle(0x0F, start, mode=1)
    assert told[1].status & 0x400
    np.testing.assert_allclose(bench.arm.position, np.linspace(-0.5, 0.5, 6), atol=1e-5)


def test_halt_and_relative_set_points() -> None:
    bench = Bench()
    bench.pass_time(0.1)
    bench.map_pdos()
    bench.enable(mode=1)
    way = [round(0.3 * RAD)] * 6
    bench.cycle(0x5F, way, mode=1)
    for _ in range(60):
        bench.cycle(0x0F, way, mode=1)
    for _ in range(80):
        bench.cycle(0x10F, way, mode=1)
    halted = bench.arm.position[0]
    assert not np.any(bench.arm.velocity)
    assert halted < -0.21
    for _ in range(400):
        told = bench.cycle(0x0F, way, mode=1)
    assert told[1].status & 0x400
    assert bench.arm.position[0] == pytest.approx(-0.2, abs=1e-5)


def cycles_seen(rate: float, length: int, cycles: int = 300) -> tuple[int, int]:
    """Fewest answers of a drive to so many SYNCs with everything mapped, and what was lost."""
    bench = Bench(length=lambda frame: worst_case_bits(Frame(frame.id, bytes(length if frame.data else 0))))
    bench.pass_time(0.1)
    bench.map_pdos()
    bench.heard.clear()
    base = bench.network.counts.lost
    begin = bench.time
    for number in range(cycles):
        for node in range(1, 7):
            bench.send(0x200 + node, struct.pack("<Hbi", 0, 0, 0))
        bench.send(0x80)
        bench.pass_time(begin + (number + 1) / rate - bench.time)
    bench.pass_time(0.1)
    heard = [
        sum(sent.frame.id == base_id + node for sent in bench.heard)
        for base_id in (0x180, 0x280)
        for node in range(1, 7)
    ]
    return min(heard), bench.network.counts.lost - base


def test_a_rate_that_the_bus_cannot_carry_loses_samples() -> None:
    # Frames of 8 bytes as the budget counts them: 12 TPDOs, 6 RPDOs, SYNC are 2485 bits, hence 402 Hz at most.
    assert cycles_seen(402, 8) == (300, 0)
    fewest, lost = cycles_seen(430, 8)
    assert fewest < 300
    assert lost > 0


def test_a_stall_of_the_machine_loses_nothing() -> None:
    bench = Bench()
    bench.pass_time(0.1)
    bench.map_pdos()
    bench.heard.clear()
    begin = bench.time
    for number in range(80):
        bench.network.arrive(Frame(0x80), begin + number * 0.0025)
    bench.pass_time(0.21)  # all at once
    assert sum(sent.frame.id == 0x286 for sent in bench.heard) == 80
    assert bench.network.counts.lost == 0
    bench.network.advance(bench.time + 5.0)
    assert bench.network.counts.stalls == 1


@settings(max_examples=60)
@given(st.lists(st.tuples(st.integers(0, 0x7FF), st.binary(max_size=8)), max_size=30))
def test_no_frames_break_the_drives(frames: list[tuple[int, bytes]]) -> None:
    bench = Bench(ExactPlant())
    bench.pass_time(0.1)
    for identifier, data in frames:
        bench.send(identifier, data)
        bench.pass_time(0.002)
    bench.send(0, bytes([0x82, 0]))
    bench.pass_time(0.1)
    assert bench.read(1, 0x1018, 4) == 1


def test_the_sheet_lists_every_object_with_a_value() -> None:
    bench = Bench()
    bench.pass_time(0.1)
    for index, subindex in entries(1):
        answer = bench.ask(1, struct.pack("<BHB4x", 0x40, index, subindex))
        assert answer[0] & 0xE0 == 0x40, (hex(index), subindex, answer.hex())
