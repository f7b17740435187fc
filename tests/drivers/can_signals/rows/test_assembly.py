from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.can.bus import Frame
from drivers.can_signals.rows.assembly import Assembler, CycleOrder, Order, Rows, SourceClock
from drivers.can_signals.table.bits import BitField
from drivers.can_signals.table.signals import FrameLayout, Signal, batches, frame_layouts

PERIOD = 0.005
SPACING = 0.0004
MARKER = 0x80


def parts(count: int) -> tuple[FrameLayout, ...]:
    return frame_layouts([Signal("position", f"j{n}", 0x181 + n, BitField(0, 32)) for n in range(count)])


def bus(count: int, cycles: int, *, marker: bool = False, still: bool = False) -> list[Frame]:
    """Frames of some cycles; each holds the number of its cycle."""
    frames: list[Frame] = []
    for cycle in range(cycles):
        start = 10.0 + cycle * PERIOD
        if marker:
            frames.append((start - SPACING, MARKER, b""))
        value = 7 if still else cycle
        frames += [(start + n * SPACING, 0x181 + n, value.to_bytes(4, "little")) for n in range(count)]
    return frames


def assembler(count: int, *, marker: bool = False, in_order: bool = True) -> Assembler:
    made = Assembler(parts(count), MARKER if marker else None, 0.5 * PERIOD)
    made.expect(Order(0, (count - 1) * SPACING, tuple(range(count)) if in_order else None), PERIOD, None)
    return made


def fed(made: Assembler, frames: list[Frame], cuts: list[int]) -> list[Rows]:
    """The frames in pieces, and the beginning of one more cycle, which settles what is in doubt until then."""
    if any(identifier > 0x181 for _, identifier, _ in frames):
        begin = 10.0 + PERIOD * math.ceil((frames[-1][0] - 10.0) / PERIOD + 1e-6)
        marked = any(identifier == MARKER for _, identifier, _ in frames)
        frames = [*frames, (begin - SPACING / 2, MARKER if marked else 0x181, bytes(4))]
    edges = [0, *sorted(min(cut, len(frames)) for cut in cuts), len(frames)]
    pieces = [frames[low:high] for low, high in pairwise(edges)]
    return [made.take(piece, dict(batches(piece))) for piece in pieces]


def values(found: list[Rows]) -> np.ndarray:
    return np.concatenate([rows.values for rows in found])


CUTS = st.lists(st.integers(0, 200), max_size=10)


@given(st.integers(1, 5), st.integers(1, 20), CUTS, st.booleans())
def test_every_cycle_becomes_a_row(count: int, cycles: int, cuts: list[int], marker: bool) -> None:
    found = fed(assembler(count, marker=marker), bus(count, cycles, marker=marker), cuts)
    assert np.array_equal(values(found), np.arange(cycles)[:, np.newaxis] * np.ones(count))
    assert sum(rows.incomplete + rows.duplicates for rows in found) == 0
    begun = np.concatenate([rows.host_time for rows in found])
    assert np.allclose(begun, 10.0 + PERIOD * np.arange(cycles) - (SPACING if marker else 0.0))


@settings(max_examples=100)
@given(st.data(), st.integers(2, 5), st.booleans())
def test_no_row_mixes_cycles_whatever_is_lost(data: st.DataObject, count: int, marker: bool) -> None:
    frames = bus(count, 20, marker=marker)
    dropped = data.draw(st.sets(st.integers(0, len(frames) - 1), max_size=len(frames) // 2))
    kept = [frame for number, frame in enumerate(frames) if number not in dropped]
    found = fed(assembler(count, marker=marker), kept, data.draw(CUTS))
    rows = values(found)
    assert np.all(rows == rows[:, :1])
    assert np.all(np.diff(rows[:, 0]) > 0)
    # A cycle of which every frame came is never given up.
    size = count + marker
    whole = {cycle for cycle in range(20) if not dropped & set(range(cycle * size, (cycle + 1) * size))}
    assert whole <= set(rows[:, 0])


@given(st.data(), st.integers(1, 5), st.booleans())
def test_no_row_comes_before_as_many_frames_as_are_wanted(data: st.DataObject, count: int, marker: bool) -> None:
    frames = bus(count, 10, marker=marker)
    dropped = data.draw(st.sets(st.integers(0, len(frames) - 1), max_size=4))
    made, wanted = assembler(count, marker=marker), 1
    for frame in [frame for number, frame in enumerate(frames) if number not in dropped]:
        rows = made.take([frame], dict(batches([frame])))
        assert wanted <= 1 or not len(rows.values)
        wanted = max(wanted - 1, made.wanted)
    if not dropped and not marker:
        assert made.wanted == count  # a whole cycle is behind it


@given(st.integers(2, 5), st.integers(3, 12), st.data())
def test_one_lost_frame_costs_one_row_and_is_named(count: int, cycles: int, data: st.DataObject) -> None:
    lost_cycle = data.draw(st.integers(1, cycles - 2))
    lost_part = data.draw(st.integers(0, count - 1))
    frames = bus(count, cycles)
    del frames[lost_cycle * count + lost_part]
    found = fed(assembler(count), frames, data.draw(CUTS))
    assert values(found)[:, 0].tolist() == [cycle for cycle in range(cycles) if cycle != lost_cycle]
    assert sum(rows.incomplete for rows in found) == 1
    assert [rows.missing for rows in found if rows.missing] == [(parts(count)[lost_part],)]


@given(st.integers(2, 5), st.data(), st.booleans())
def test_a_frame_that_comes_twice_changes_nothing(count: int, data: st.DataObject, still: bool) -> None:
    frames = bus(count, 8, still=still)
    number = data.draw(st.integers(0, len(frames) - 1))
    arrived, identifier, content = frames[number]
    frames.insert(number + 1, (arrived + 0.0001, identifier, content))
    found = fed(assembler(count), frames, data.draw(CUTS))
    assert len(values(found)) == 8
    assert sum(rows.duplicates for rows in found) == 1
    assert sum(rows.incomplete for rows in found) == 0


@given(st.integers(2, 5), st.data())
def test_a_frame_that_is_overtaken_by_the_next_cycle_costs_one_row(count: int, data: st.DataObject) -> None:
    frames = bus(count, 10)
    last = data.draw(st.integers(1, 8)) * count - 1
    late = data.draw(st.integers(1, count - 1))
    frames.insert(last + late, (frames[last + late][0], *frames.pop(last)[1:]))
    found = fed(assembler(count), frames, data.draw(CUTS))
    rows = values(found)
    assert np.all(rows == rows[:, :1])
    assert len(rows) == 9
    assert sum(one.incomplete for one in found) == 1


@given(st.integers(2, 4), st.booleans(), CUTS)
def test_the_counter_tells_late_frames_from_lost_ones(count: int, lost: bool, cuts: list[int]) -> None:
    def placed(number: int) -> list[Signal]:
        return [Signal("counter" if number == 0 else "position", f"j{number}", 0x181 + number, BitField(0, 32))]

    made = Assembler(frame_layouts([signal for n in range(count) for signal in placed(n)]), None, 0.5 * PERIOD)
    made.expect(Order(0, (count - 1) * SPACING, tuple(range(count))), PERIOD, clock(32))
    frames = bus(count, 10)
    middle = range(4 * count + 1, 5 * count + 1)  # from the second frame of a cycle to the first of the next one
    if lost:
        frames = [frame for number, frame in enumerate(frames) if number not in middle]
    else:
        frames = [(t + PERIOD if number > 4 * count else t, *rest) for number, (t, *rest) in enumerate(frames)]
    found = fed(made, frames, cuts)
    rows = values(found)
    assert np.all(rows == rows[:, :1])
    assert rows[:, 0].tolist() == ([0, 1, 2, 3, 6, 7, 8, 9] if lost else list(range(10)))


def test_an_arm_that_stands_still_in_one_frame_is_no_duplicate() -> None:
    frames = [(10.0 + 1e-5 * n, 0x181, b"\7\0\0\0") for n in range(5)]  # all at once, after a stall
    found = fed(assembler(1), frames, [])
    assert len(values(found)) == 5


@given(st.integers(2, 5), st.data())
def test_frames_received_late_lose_no_row(count: int, data: st.DataObject) -> None:
    frames = bus(count, 20)
    for _ in range(3):  # stalls: what came meanwhile is received at their end
        begin = data.draw(st.floats(10.0, 10.09))
        end = begin + data.draw(st.floats(0.0, 0.04))
        late = (end + 1e-5 * n for n in range(len(frames)))
        frames = [(next(late) if begin <= frame[0] < end else frame[0], *frame[1:]) for frame in frames]
    frames = [(max(time, frames[max(n - 1, 0)][0]), *rest) for n, (time, *rest) in enumerate(frames)]
    made = assembler(count)
    found = fed(made, [*frames, (11.0, 0x181, bytes(4))], data.draw(CUTS))
    rows = values(found)
    assert np.all(rows == rows[:, :1])
    # A stall that ends within the pause after a cycle may hide whether its late frames were of this cycle.
    assert len(rows) + sum(one.incomplete for one in found) / 2 >= 20


def test_nothing_is_told_of_the_cycle_in_whose_middle_we_came() -> None:
    found = fed(assembler(3), bus(3, 5)[1:], [])
    assert values(found)[:, 0].tolist() == [1, 2, 3, 4]
    assert sum(rows.incomplete for rows in found) == 0


def test_short_frames_are_counted_and_their_row_is_lost() -> None:
    frames = bus(2, 5)
    arrived, identifier, content = frames[5]
    frames[5] = (arrived, identifier, content[:3])
    found = fed(assembler(2), frames, [])
    assert values(found)[:, 0].tolist() == [0, 1, 3, 4]
    assert (found[0].short, found[0].incomplete) == (1, 1)


@given(st.integers(2, 6), st.integers(0, 5), st.integers(0, 5))
def test_the_longest_pause_tells_the_first_frame(count: int, first: int, joined: int) -> None:
    first %= count
    order = CycleOrder(parts(count))
    frames = []
    for cycle in range(20):
        for place in range(count):
            number = (first + place) % count
            frames.append((cycle * PERIOD + place * SPACING, 0x181 + number, bytes(4)))
    order.take(frames[:joined])
    order.take(frames[joined:])
    assert order.enough
    assert order.never_seen() == ()
    told = order.result()
    assert told.first == first
    assert told.span == pytest.approx((count - 1) * SPACING)
    assert told.sequence == tuple((first + place) % count for place in range(count))


def test_frames_at_even_distances_do_not_tell_an_order() -> None:
    order = CycleOrder(parts(4))
    assert order.never_seen() == parts(4)
    order.take([(n * 0.001, 0x181 + (n + 1) % 4, bytes(4)) for n in range(80)])
    assert order.result() == Order(0, math.inf, (0, 1, 2, 3))


def test_an_order_that_changes_is_none() -> None:
    order = CycleOrder(parts(3))
    numbers = [(0, 1, 2) if cycle % 2 else (0, 2, 1) for cycle in range(30)]
    order.take(
        [(c * PERIOD + k * SPACING, 0x181 + n, bytes(4)) for c, ns in enumerate(numbers) for k, n in enumerate(ns)]
    )
    assert order.result().first == 0
    assert order.result().sequence is None


def clock(bits: int = 8, quantity: str = "counter", gain: float = 1.0, *, floating: bool = False) -> SourceClock:
    return SourceClock(Signal(quantity, "", 0x181, BitField(0, bits, floating=floating), gain), 1.0 / PERIOD)


@given(st.integers(2, 16), st.integers(0, 70000), st.lists(st.integers(1, 3), min_size=2, max_size=300), CUTS)
def test_a_counter_that_begins_anew_gives_one_time_axis(
    bits: int, start: int, steps: list[int], cuts: list[int]
) -> None:
    # Two bits begin anew after four rows: then no more than two rows may be missing.
    counts = start + np.cumsum(steps)
    host = 100.0 + PERIOD * counts
    made = clock(bits)
    edges = [0, *sorted(min(cut, len(counts)) for cut in cuts), len(counts)]
    told = [made.take((counts[low:high] % 2**bits).astype(float), host[low:high]) for low, high in pairwise(edges)]
    times = np.concatenate([one.time for one in told])
    assert np.allclose(np.diff(times), PERIOD * np.diff(counts))
    assert sum(one.lost for one in told) == int(np.sum(np.diff(counts) - 1))
    assert all(one.kept.all() for one in told)
    assert sum(one.restarted for one in told) == 0


def test_a_silence_longer_than_the_counter_is_measured_by_the_host() -> None:
    made = clock(8)
    counts = np.array([250, 251, 251 + 1000, 1252])
    told = made.take((counts % 256).astype(float), 50.0 + PERIOD * counts)
    assert np.allclose(np.diff(told.time), PERIOD * np.diff(counts))
    assert told.lost == 999


def test_repeated_counts_are_left_out() -> None:
    told = clock(16).take(np.array([5.0, 6.0, 6.0, 7.0]), np.array([0.0, 0.005, 0.006, 0.010]))
    assert told.kept.tolist() == [True, True, False, True]
    assert told.lost == 0


@each("value", [3.0, 4e9, math.nan])
def test_an_arm_that_restarts_goes_on_in_time(value: float) -> None:
    made = clock(32, floating=math.isnan(value))
    made.take(np.array([100_000.0, 100_001.0]), np.array([1.0, 1.005]))
    told = made.take(np.array([value, value + 1]), np.array([2.005, 2.010]))
    assert told.restarted >= 1
    assert told.time[0] == pytest.approx(100_001 * PERIOD + 1.0)
    assert np.diff(told.time) == pytest.approx([PERIOD])


@given(st.lists(st.integers(1, 4), min_size=2, max_size=200))
def test_a_time_stamp_in_milliseconds(steps: list[int]) -> None:
    cycles = np.cumsum(steps)
    stamps = np.floor(cycles * PERIOD * 1000) % 65536
    told = clock(16, "time", 1e-3).take(1e-3 * stamps, 3.0 + PERIOD * cycles)
    assert np.allclose(np.diff(told.time), PERIOD * np.diff(cycles))
    assert told.lost == int(np.sum(np.diff(cycles) - 1))
