"""The bus budget: figures of six drives worked out by hand, and properties that no set of frames may break."""

from __future__ import annotations

import pytest
from each import each
from hypothesis import given
from hypothesis import strategies as st

from drivers.base import DriverSettings
from drivers.bus_budget import Budget, FrameGroup, can_frames, frame_bits
from drivers.can_signals.declaration import DECLARATION as TABLE
from drivers.canopen402.declaration import DECLARATION as DRIVES
from drivers.canopen402.declaration import synchronous_cycle
from drivers.core.errors import UsageError
from drivers.gains import DriveGain
from drivers.rtde.declaration import DECLARATION as CONTROLLER
from sim_drivers.can.bus_load import Frame, exact_bits, worst_case_bits

JOINTS = tuple(f"j{number}" for number in range(1, 7))
CANOPEN: dict[str, object] = {
    "interface": "virtual",
    "channel": "budget",
    "sync_rate": 300,
    "nodes": {joint: {"id": number} for number, joint in enumerate(JOINTS, start=1)},
}


def settings(keys: dict[str, object]) -> DriverSettings:
    return DriverSettings(JOINTS, keys, (DriveGain(1.0),) * 6)


def test_frames_as_long_as_the_literature_says() -> None:
    assert frame_bits(0) == 55
    assert frame_bits(8) == 135
    assert frame_bits(8, extended=True) == 160
    with pytest.raises(ValueError, match="0 to 8"):
        frame_bits(9)


@pytest.mark.parametrize("extended", [False, True])
@given(data=st.binary(max_size=8), identifier=st.integers(0, 0x7FF))
def test_no_frame_is_longer_and_the_simulated_bus_agrees(extended: bool, data: bytes, identifier: int) -> None:
    frame = Frame(identifier, data, extended)
    assert exact_bits(frame) <= frame_bits(len(data), extended=extended) == worst_case_bits(frame)


@each(("tpdos", "rpdos", "highest", "at_80_percent"), [(2, 0, 597, 478), (2, 1, 402, 322), (3, 1, 303, 243)])
def test_six_drives_at_a_megabit(tpdos: int, rpdos: int, highest: int, at_80_percent: int) -> None:
    budget = Budget(1e6, 400.0, synchronous_cycle(6, [8] * tpdos, [8] * rpdos))
    assert round(budget.highest_rate()) == highest
    assert round(budget.highest_rate(0.8)) == at_80_percent


groups = st.builds(can_frames, st.just("frames"), st.integers(1, 30), st.integers(0, 8), extended=st.booleans())


@given(
    st.lists(groups, min_size=1, max_size=5),
    st.lists(st.tuples(groups, st.floats(0.1, 50)), max_size=3),
    st.floats(1, 2000),
    st.sampled_from([125e3, 250e3, 500e3, 1e6]),
)
def test_the_highest_rate_fills_the_bus_and_more_never_takes_less(
    cycle: list[FrameGroup], beside: list[tuple[FrameGroup, float]], rate: float, bitrate: float
) -> None:
    budget = Budget(bitrate, rate, tuple(cycle), tuple(beside))
    full = budget.highest_rate()
    if full > 0:
        assert Budget(bitrate, full, tuple(cycle), tuple(beside)).load == pytest.approx(1.0)
    assert (budget.load > 1.0) == (rate > full) or budget.load == pytest.approx(1.0)
    assert Budget(bitrate, rate, (*cycle, can_frames("one more", 1, 0)), tuple(beside)).load > budget.load


def test_a_canopen_connection_is_counted_frame_by_frame() -> None:
    recording = DRIVES.budget_of(settings({**CANOPEN, "mode": "none"}))
    moving = DRIVES.budget_of(settings(CANOPEN))
    assert recording is not None
    assert moving is not None
    # TPDO1 carries 7 bytes, TPDO2 8, RPDO1 7.
    assert recording.cycle_bits == 55 + 6 * (125 + 135)
    assert moving.cycle_bits == 55 + 6 * (125 + 135 + 125)
    # Heartbeats of one byte; where the arm is moved, drives watch dynid's, too.
    assert recording.beside_rate == pytest.approx(6 * 65 / 0.1)
    assert moving.beside_rate == pytest.approx(7 * 65 / 0.1)
    assert moving.load == pytest.approx((2365 * 300 + 4550) / 1e6)
    guarded = DRIVES.budget_of(settings({**CANOPEN, "guarding": {"period": 0.2}}))
    assert guarded is not None
    # A remote frame has no data, however many bytes it asks for.
    assert guarded.beside_rate == pytest.approx(6 * (55 + 65) / 0.2)
    nodes = {joint: {"id": number, "temperature": {"index": 0x2031}} for number, joint in enumerate(JOINTS, start=1)}
    warm = DRIVES.budget_of(settings({**CANOPEN, "nodes": nodes}))
    assert warm is not None
    assert warm.beside_rate == pytest.approx(4550 + 5 * 6 * 2 * 135)


def test_frames_of_a_table_are_counted() -> None:
    signals = [
        {"quantity": "position", "joint": joint, "id": 0x181 + number // 2, "start": 32 * (number % 2), "length": 32}
        | {"signed": True, "scale": 0.0001, "unit": "rad"}
        for number, joint in enumerate(JOINTS)
    ]
    keys: dict[str, object] = {"interface": "virtual", "channel": "x", "rate": 200, "signals": signals}
    budget = TABLE.budget_of(settings(keys))
    assert budget is not None
    assert budget.cycle_bits == 3 * 135
    polled = TABLE.budget_of(settings({**keys, "poll": {"id": 0x100, "data": "01 00", "period": 0.005}}))
    assert polled is not None
    assert polled.cycle_bits == 3 * 135 + frame_bits(2)


def test_other_drivers_have_no_budget_and_wrong_keys_are_refused() -> None:
    assert CONTROLLER.budget_of(settings({"host": "127.0.0.1"})) is None
    with pytest.raises(UsageError):
        DRIVES.budget_of(settings({**CANOPEN, "bitrate": "fast"}))
