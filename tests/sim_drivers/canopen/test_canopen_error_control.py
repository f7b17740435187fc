"""Simulated drives whose master falls silent, in virtual time: heartbeats awaited, life guarding, and what they do."""

from __future__ import annotations

import numpy as np
import pytest
from drive_bench import COUNTS, Bench

from drivers.canopen402.protocol.emcy import MASTER_MISSED
from sim_drivers.canopen.drive import LEFT_OPERATIONAL
from sim_drivers.canopen.object_dictionary import Abort

RAD = COUNTS / (2 * np.pi)
MASTER = 127
LIMIT = 0.3
"""Time limit of the heartbeat and of guarding, in these tests [s]."""
PERIOD = 0.0025
NO_ACTION, FAULT, DISABLE_VOLTAGE, QUICK_STOP = 0, 1, 2, 3


def watching(option: int, behaviour: int = 0) -> Bench:
    """Six drives that watch the heartbeat of node 127."""
    bench = Bench()
    bench.pass_time(0.1)
    bench.map_pdos()
    for node in range(1, 7):
        assert not bench.write(node, 0x1016, 1, MASTER << 16 | round(1e3 * LIMIT), 4)
        assert not bench.write(node, 0x6007, 0, option, 2)
        assert not bench.write(node, 0x1029, 1, behaviour, 1)
    return bench


def move(bench: Bench, seconds: float, *, beat: bool = True, guard: bool = False) -> None:
    """Drive all joints at 0.2 rad/s from where they stand, with signs of life every 40 cycles."""
    targets = bench.enable()
    for number in range(round(seconds / PERIOD)):
        way = 0.2 * number * PERIOD
        if number % 40 == 0:
            if beat:
                bench.send(0x700 + MASTER, b"\x05")
            for node in range(1, 7) if guard else ():
                bench.guard(node)
        bench.cycle(0x0F, [counts + round(way * RAD) for counts in targets])


def coast(bench: Bench, seconds: float) -> None:
    """Go on with SYNC and targets that ask for 0.2 rad/s, but without any sign of life."""
    drives = zip(bench.network.drives, bench.arm.position, strict=True)
    begin = [drive.axis.counts_of(position) for drive, position in drives]
    for number in range(round(seconds / PERIOD)):
        bench.cycle(0x0F, [counts + round(0.2 * number * PERIOD * RAD) for counts in begin])


@pytest.mark.parametrize(("option", "statusword"), [(FAULT, 0x08), (DISABLE_VOLTAGE, 0x40), (QUICK_STOP, 0x40)])
def test_drives_stop_when_the_masters_heartbeat_does(option: int, statusword: int) -> None:
    bench = watching(option)
    move(bench, 0.5)
    last = bench.time
    assert bench.emergencies() == []
    coast(bench, 0.5)  # targets alone keep nobody going
    assert bench.emergencies() == [(node, MASTER_MISSED, 0x11) for node in range(1, 7)]
    told = [sent.time for sent in bench.heard if 0x80 < sent.frame.id <= 0x86]
    # The last heartbeat was up to 0.1 s before `last`.
    assert all(last - 0.1 + LIMIT <= moment <= last + LIMIT + 0.02 for moment in told)
    assert {drive.nmt for drive in bench.network.drives} == {0x7F}
    assert {bench.read(node, 0x6041) & 0x4F for node in range(1, 7)} == {statusword}
    assert not np.any(bench.arm.velocity)


def test_a_quick_stop_is_along_its_ramp_and_is_not_taken_back_by_the_last_controlword() -> None:
    bench = watching(QUICK_STOP)
    for node in range(1, 7):
        assert not bench.write(node, 0x6085, 0, round(1.0 * RAD), 4)  # rad/s²
        assert not bench.write(node, 0x605A, 0, 6, 2)  # stays in quick stop active, from where 0x000F enables
    move(bench, 0.5)
    begun = bench.arm.position.copy()
    coast(bench, 0.45)
    bench.pass_time(0.5)
    assert not np.any(bench.arm.velocity)
    way = bench.arm.position - begun
    assert np.all(way > 0.2 * 0.2)
    assert {bench.read(node, 0x6041) & 0x6F for node in range(1, 7)} == {0x07}
    before = bench.arm.position.copy()
    bench.send(0, bytes([1, 0]))
    bench.pass_time(0.2)
    assert {bench.read(node, 0x6041) & 0x6F for node in range(1, 7)} == {0x07}
    np.testing.assert_allclose(bench.arm.position, before, atol=1e-9)


def test_no_action_leaves_the_drive_holding_its_last_target() -> None:
    bench = watching(NO_ACTION, behaviour=1)
    move(bench, 0.5)
    coast(bench, 0.5)
    assert [code for _, code, _ in bench.emergencies()] == [MASTER_MISSED] * 6
    assert {bench.read(node, 0x6041) & 0x6F for node in range(1, 7)} == {0x27}
    assert {drive.nmt for drive in bench.network.drives} == {0x05}


@pytest.mark.parametrize(("behaviour", "nmt"), [(0, 0x7F), (1, 0x05), (2, 0x04)])
def test_the_error_behaviour_chooses_the_nmt_state(behaviour: int, nmt: int) -> None:
    bench = watching(QUICK_STOP, behaviour)
    move(bench, 0.2)
    bench.pass_time(0.5)
    assert {drive.nmt for drive in bench.network.drives} == {nmt}
    assert not any(drive.enabled for drive in bench.network.drives)
    assert not np.any(bench.arm.velocity)


def test_nobody_is_watched_before_the_first_heartbeat_and_every_loss_is_told_once() -> None:
    bench = watching(QUICK_STOP)
    bench.pass_time(1.0)
    assert bench.emergencies() == []
    for _ in range(2):
        for _ in range(5):
            bench.send(0x700 + MASTER, b"\x05")
            bench.send(0x700 + 99, b"\x05")  # another node's
            bench.pass_time(0.1)
        bench.pass_time(1.0)
    lost = [(node, MASTER_MISSED, 0x11) for node in range(1, 7)]
    found = [(node, 0, 0) for node in range(1, 7)]
    assert bench.emergencies() == [*lost, *found, *lost]


def test_an_entry_that_is_cleared_watches_nobody() -> None:
    bench = watching(QUICK_STOP)
    bench.send(0x700 + MASTER, b"\x05")
    bench.pass_time(0.1)
    for node in range(1, 7):
        assert not bench.write(node, 0x1016, 1, 0, 4)
    bench.pass_time(1.0)
    assert bench.emergencies() == []


@pytest.mark.parametrize(
    ("index", "subindex", "value", "size", "abort"),
    [
        (0x1016, 2, MASTER << 16 | 50, 4, Abort.INCOMPATIBLE),  # the node is watched already
        (0x1016, 2, 128 << 16 | 50, 4, 0),  # no node id: not used
        (0x6007, 0, 4, 2, Abort.VALUE_RANGE),
        (0x6007, 0, -1, 2, Abort.VALUE_RANGE),
        (0x1029, 1, 3, 1, Abort.VALUE_RANGE),
    ],
)
def test_what_cannot_be_watched_or_done(index: int, subindex: int, value: int, size: int, abort: int) -> None:
    assert watching(QUICK_STOP).write(1, index, subindex, value, size) == abort


def guarded(bench: Bench, option: int) -> None:
    for node in range(1, 7):
        assert not bench.write(node, 0x100C, 0, 100, 2)
        assert not bench.write(node, 0x100D, 0, 3, 1)
        assert not bench.write(node, 0x6007, 0, option, 2)


def test_guarding_is_answered_with_a_bit_that_alternates() -> None:
    bench = Bench()
    bench.pass_time(0.1)
    assert [bench.guard(2) for _ in range(3)] == [b"\x7f", b"\xff", b"\x7f"]
    bench.send(0, bytes([1, 2]))
    assert [bench.guard(2), bench.guard(3), bench.guard(2)] == [b"\x85", b"\x7f", b"\x05"]
    bench.send(0, bytes([2, 2]))
    assert bench.guard(2) == b"\x84"  # also when stopped
    bench.send(0, bytes([0x82, 2]))
    bench.pass_time(0.01)
    assert bench.guard(2) == b"\x7f"  # begins anew
    bench.network.drives[1].error_control.muted = True
    assert bench.guard(2) is None
    bench.network.drives[1].error_control.muted = False
    assert not bench.write(2, 0x1017, 0, 1000, 2)
    bench.pass_time(0.02)
    assert bench.guard(2) is None  # it sends heartbeats instead
    bench.network.power_cycle(2)
    assert bench.guard(3) is None


def test_life_guarding_stops_the_drives() -> None:
    bench = Bench()
    bench.pass_time(0.1)
    bench.map_pdos()
    guarded(bench, QUICK_STOP)
    bench.pass_time(1.0)  # nobody has asked yet
    move(bench, 0.5, beat=False, guard=True)
    assert bench.emergencies() == []
    last = bench.time
    coast(bench, 0.5)
    told = [sent.time for sent in bench.heard if 0x80 < sent.frame.id <= 0x86]
    assert bench.emergencies() == [(node, MASTER_MISSED, 0x11) for node in range(1, 7)]
    # The last round of requests began up to 40 cycles and its own 18 ms before `last`.
    assert all(last - 0.12 + LIMIT <= moment <= last + LIMIT + 0.02 for moment in told)
    assert not np.any(bench.arm.velocity)
    assert not any(drive.enabled for drive in bench.network.drives)
    bench.guard(4)
    assert bench.emergencies()[-1] == (4, 0, 0)


def test_leaving_operational_obeys_the_abort_option() -> None:
    bench = watching(QUICK_STOP)
    move(bench, 0.2)
    bench.send(0, bytes([0x80, 5]))
    bench.pass_time(0.1)
    assert bench.emergencies() == [(5, LEFT_OPERATIONAL, 0x11)]
    assert bench.read(5, 0x6041) & 0x4F == 0x40
