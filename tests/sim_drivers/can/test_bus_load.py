"""Frame lengths counted by hand and by the book, and who goes first on a bus."""

from __future__ import annotations

import numpy as np
import pytest
from each import each
from hypothesis import given
from hypothesis import strategies as st

from sim_drivers.can.bus_load import BusModel, Frame, exact_bits, worst_case_bits

frames = st.builds(
    lambda extended, identifier, data, remote: Frame(
        identifier % (1 << 29 if extended else 1 << 11), data, extended, remote
    ),
    st.booleans(),
    st.integers(0, (1 << 29) - 1),
    st.binary(max_size=8),
    st.booleans(),
)


def bits_one_by_one(frame: Frame) -> int:
    """ISO 11898-1 literally: the bits as a list, the CRC by shifting, a stuffed bit after five equal ones."""
    if frame.extended:
        head = [0, *number(frame.id >> 18, 11), 1, 1, *number(frame.id & 0x3FFFF, 18), int(frame.remote), 0, 0]
    else:
        head = [0, *number(frame.id, 11), int(frame.remote), 0, 0]
    bits = head + number(len(frame.data), 4)
    if not frame.remote:
        for byte in frame.data:
            bits += number(byte, 8)
    crc = 0
    for bit in bits:
        crc = (crc << 1) ^ (0x4599 if bit ^ crc >> 14 & 1 else 0)
        crc &= 0x7FFF
    sent: list[int] = []
    for bit in bits + number(crc, 15):
        sent.append(bit)
        if len(sent) >= 5 and len(set(sent[-5:])) == 1:
            sent.append(1 - sent[-1])
    return len(sent) + 1 + 2 + 7 + 3


def number(value: int, size: int) -> list[int]:
    return [value >> place & 1 for place in range(size - 1, -1, -1)]


@pytest.mark.parametrize(
    ("frame", "bits"),
    [
        # 00001 00000|1| 00000|1| 0000 0|1|0 111 00000|1| 00101: 19 bits, CRC 001110000000101, 4 stuffed.
        (Frame(0x080), 34 + 4 + 13),
        # 0 11111|0| 11111|0| 1 00000|1| 0 11111|0| 11111|0| 111 01000010101: 27 bits, CRC 111101000010101, 5 stuffed.
        (Frame(0x7FF, b"\xff"), 42 + 5 + 13),
    ],
)
def test_lengths_counted_by_hand(frame: Frame, bits: int) -> None:
    assert exact_bits(frame) == bits


@given(frames)
def test_the_tables_say_what_the_bits_say(frame: Frame) -> None:
    assert exact_bits(frame) == bits_one_by_one(frame)


@given(frames)
def test_a_frame_is_between_the_bounds(frame: Frame) -> None:
    size = (67 if frame.extended else 47) + (0 if frame.remote else 8 * len(frame.data))
    assert size <= exact_bits(frame) <= worst_case_bits(frame)


def test_the_known_worst_cases() -> None:
    assert [worst_case_bits(Frame(1, bytes(size))) for size in (0, 1, 7, 8)] == [55, 65, 125, 135]
    assert worst_case_bits(Frame(1, bytes(8), extended=True)) == 160


@each("frame", [Frame(0x800), Frame(-1), Frame(1, bytes(9)), Frame(1 << 29, extended=True)])
def test_what_is_no_frame_is_refused(frame: Frame) -> None:
    with pytest.raises(ValueError, match="no classic CAN frame"):
        exact_bits(frame)


def test_the_lowest_identifier_of_those_that_wait_goes_first() -> None:
    bus = BusModel(1e6, lambda _: 100)
    bus.submit(Frame(0x300), 0.0, own=True)
    for identifier in (0x200, 0x100):  # while the first is on the bus
        bus.submit(Frame(identifier), 50e-6, own=True)
    bus.submit(Frame(0x10), 1.0, own=True)  # much later: it must not hold the others back
    ends = [bus.pop() for _ in range(4)]
    assert [sent.frame.id for sent in ends] == [0x300, 0x100, 0x200, 0x10]
    np.testing.assert_allclose([sent.time for sent in ends], [100e-6, 200e-6, 300e-6, 1.0 + 100e-6])
    assert bus.peek() is None
    with pytest.raises(IndexError):
        bus.pop()


def test_a_standard_frame_goes_before_an_extended_one_of_the_same_base() -> None:
    bus = BusModel(1e6)
    bus.submit(Frame(0x123 << 18, extended=True), 0.0, own=True)
    bus.submit(Frame(0x123), 0.0, own=True)
    bus.submit(Frame(0x122 << 18 | 7, extended=True), 0.0, own=True)
    assert [bus.pop().frame.extended for _ in range(3)] == [True, False, True]


@given(st.lists(st.tuples(st.integers(0, 40), st.integers(0, 3000)), min_size=1, max_size=60))
def test_no_two_frames_at_once_and_none_forgotten(requests: list[tuple[int, int]]) -> None:
    bus = BusModel(1e6, lambda _: 100)
    ends, waiting = [], sorted(requests, key=lambda request: request[1])
    while waiting or bus.peek() is not None:
        end = bus.peek()
        if waiting and (end is None or waiting[0][1] * 1e-6 <= end):
            identifier, ready = waiting.pop(0)
            bus.submit(Frame(identifier), ready * 1e-6, own=True)
        else:
            ends.append(bus.pop().time)
    assert len(ends) + bus.lost == len(requests)
    assert bus.bits == 100 * len(ends)
    assert np.all(np.diff(ends) >= 100e-6 - 1e-12)


def test_the_newest_of_three_values_wins() -> None:
    bus = BusModel(1e6)
    bus.submit(Frame(0), 0.0, own=True)
    for value in (1, 2, 3):
        bus.submit(Frame(0x281, bytes([value])), 0.0, own=True, newest_wins=True)
    assert [bus.pop().frame.data for _ in range(3)] == [b"", b"\x01", b"\x03"]
    assert bus.lost == 1


def test_what_is_no_sample_is_never_overwritten() -> None:
    bus = BusModel(1e6)
    for value in range(10):
        bus.submit(Frame(0x581, bytes([value])), 0.0, own=True)
    assert [bus.pop().frame.data[0] for _ in range(10)] == list(range(10))


def lost_of(pdos: int, commands: int, rate: float, cycles: int = 400) -> int:
    """Frames lost when six drives answer SYNC at this rate, every frame as long as it can be."""
    bus = BusModel(1e6, worst_case_bits)
    content = bytes(8)

    def run_until(time: float) -> None:
        while (end := bus.peek()) is not None and end <= time:
            sent = bus.pop()
            if sent.frame.id == 0x80:
                for node in range(1, 7):
                    for number in range(pdos):
                        frame = Frame(0x180 + 0x100 * number + node, content)
                        bus.submit(frame, sent.time, own=True, newest_wins=True)

    for cycle in range(cycles):
        begin = cycle / rate
        run_until(begin)
        bus.submit(Frame(0x80), begin, own=False)
        for node in range(1, 7):
            for number in range(commands):
                frame = Frame(0x200 + 0x100 * number + node, content)
                bus.submit(frame, begin, own=False, newest_wins=True)
    return bus.lost


@pytest.mark.parametrize(("pdos", "commands", "rate"), [(2, 0, 597), (2, 1, 402), (3, 1, 303)])
def test_what_fits_fits_and_a_little_more_does_not(pdos: int, commands: int, rate: float) -> None:
    assert lost_of(pdos, commands, rate) == 0
    # Half a per cent too fast; the backlog needs its time to grow beyond a period.
    assert lost_of(pdos, commands, rate * 1.005) > 0
