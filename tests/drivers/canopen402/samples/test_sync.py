"""The SYNC producer in simulated time: its schedule, stalls of this computer, and an adapter that refuses frames."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
import pytest
from simulated_clock import START, SimulatedClock

from drivers.can.bus import Sender
from drivers.canopen402.protocol.objects import SYNC
from drivers.canopen402.samples.sync import BEHIND, LATEST, PATIENCE, SPACING, TARGET_ROOM, SyncProducer
from drivers.core.errors import ConnectionLostError

RATE = 100.0
TARGETS = 0x201


class NotedSender(Sender):
    """Notes when [periods since the start] what was sent; refuses while it is told to."""

    def __init__(self, clock: SimulatedClock) -> None:
        self.sent: list[tuple[float, int, bytes]] = []
        self.refuses = False
        self._clock = clock

    def send_all(self, frames: Sequence[tuple[int, bytes]]) -> float:
        if self.refuses:
            raise ConnectionLostError("full")
        now = self._clock.now()
        self.sent += [(round((now - START) * RATE, 6), identifier, data) for identifier, data in frames]
        return now


def run(producer: SyncProducer, clock: SimulatedClock, periods: float) -> list[int]:
    """The slots of the SYNCs sent in so many periods."""
    producer.start()
    clock.sleep(periods / RATE)
    producer.stop()
    return [slot for slot, _ in producer.take()]


def test_syncs_follow_their_schedule_and_targets_follow_their_sync(clock: SimulatedClock) -> None:
    sender = NotedSender(clock)
    moments: list[float] = []

    def outputs(moment: float, left_out: int) -> list[tuple[int, bytes]]:
        moments.append(round((moment - START) * RATE, 6))
        return [(0x201, b"a"), (0x202, b"b")]

    producer = SyncProducer(sender, RATE, outputs, clock)
    producer.start()
    clock.sleep(1000.5 / RATE)
    producer.stop()
    slots = list(range(1, 1001))
    assert moments == slots
    frames = ((SYNC, b""), (0x201, b"a"), (0x202, b"b"))
    assert sender.sent == [(float(slot), *frame) for slot in slots for frame in frames]
    taken, times = zip(*producer.take(), strict=True)
    assert list(taken) == slots
    np.testing.assert_allclose(producer.clock(np.array(times)), np.array(slots) / RATE, atol=1e-9)
    assert (producer.count, producer.skipped) == (1000, 0)
    assert producer.latest == times[-1]
    assert not producer.running


def test_the_clock_goes_on_through_a_pause(clock: SimulatedClock) -> None:
    producer = SyncProducer(NotedSender(clock), RATE, lambda *_: (), clock)
    # It ends where its thread wakes for the next SYNC.
    assert run(producer, clock, 10.5) == list(range(1, 11))
    assert clock.now() == pytest.approx(START + 11 / RATE)
    clock.sleep(20.5 / RATE)
    assert run(producer, clock, 10.0) == list(range(32, 42))
    assert producer.skipped == 0


@pytest.mark.parametrize(
    ("lateness", "sent_at"),
    [(0.0, 10.0), (0.49, 10.49), (LATEST - 1e-3, 10.0 + LATEST - 1e-3), (LATEST + 1e-3, None), (0.99, None)],
)
def test_a_sync_is_late_by_half_a_period_at_most(clock: SimulatedClock, lateness: float, sent_at: float | None) -> None:
    sender = NotedSender(clock)
    producer = SyncProducer(sender, RATE, lambda *_: (), clock)
    # Just before it is due, this computer is busy with another program.
    clock.call_at(START + 9.999 / RATE, lambda: clock.stall((0.001 + lateness) / RATE))
    slots = run(producer, clock, 20.5)
    times = {round(slot): time for slot, (time, _, _) in zip(slots, sender.sent, strict=True)}
    assert times.get(10) == (None if sent_at is None else pytest.approx(sent_at))
    expected = {slot: float(slot) for slot in range(1, 21) if slot != 10}  # no other one is later or earlier
    assert {slot: time for slot, time in times.items() if slot != 10} == expected
    assert producer.skipped == (sent_at is None)


@pytest.mark.parametrize(("stall", "first_again"), [(0.7, 11), (1.3, 11), (1.7, 12), (5.7, 16), (250.2, 261)])
def test_what_a_stall_leaves_out_is_never_made_up_for(clock: SimulatedClock, stall: float, first_again: int) -> None:
    """`stall`: in periods, from SYNC 10 on."""
    producer = SyncProducer(NotedSender(clock), RATE, lambda *_: (), clock)
    clock.call_at(START + 10.0001 / RATE, lambda: clock.stall(stall / RATE))
    slots = run(producer, clock, 300.5)
    assert slots == [*range(1, 11), *range(first_again, 301)]
    assert producer.skipped == first_again - 11


@pytest.mark.parametrize("stall", [0.7, 1.3, 5.7, 0.99 * BEHIND * RATE, 1.5 * BEHIND * RATE])
def test_at_rest_syncs_are_sent_late_rather_than_left_out(clock: SimulatedClock, stall: float) -> None:
    """`stall`: in periods, from SYNC 10 on. What is older than `BEHIND` when the computer is back is left out."""
    sender = NotedSender(clock)
    producer = SyncProducer(sender, RATE, lambda *_: (), clock, lambda: True)
    clock.call_at(START + 10.0001 / RATE, lambda: clock.stall(stall / RATE))
    slots = run(producer, clock, 300.5)
    left_out = [slot for slot in range(1, 301) if slot not in slots]
    overdue = range(11, math.floor(10.0001 + stall) + 1)
    assert left_out == [slot for slot in overdue if 10.0001 + stall - slot > BEHIND * RATE]
    assert producer.skipped == len(left_out)
    times = np.array([time for time, _, _ in sender.sent])
    assert np.all(np.diff(times) > SPACING - 1e-6)
    late = times - slots
    assert late.min() > -1e-6
    assert late.max() <= BEHIND * RATE + SPACING
    np.testing.assert_allclose(late[-50:], 0.0, atol=1e-6)  # on schedule again


@pytest.mark.parametrize(
    ("stall", "expected"),
    [
        # Woken at 6.6: room for targets before SYNC 7, which are for SYNC 6's moment.
        (1.6, [(6.6, 6), (7.0, None)]),
        # Woken at 6.9: too near to SYNC 7, which would apply the old targets: it is left out, too.
        (1.9, [(6.9, 7), (8.0, None)]),
        (2.6, [(7.6, 7), (8.0, None)]),
        (2.64, [(7.64, 7), (8.0, None)]),
        (2.66, [(7.66, 8), (9.0, None)]),
    ],
)
def test_targets_of_syncs_left_out_are_replaced_before_the_next_one(
    clock: SimulatedClock, stall: float, expected: list[tuple[float, int | None]]
) -> None:
    """After SYNC 5 the thread is held up by `stall` periods; targets bear the number of the period they are for."""
    sender, told = NotedSender(clock), list[int]()

    def outputs(moment: float, left_out: int) -> list[tuple[int, bytes]]:
        number = round((moment - START) * RATE)
        told.append(left_out)
        if number == 5 and clock.now() < START + 5.5 / RATE:
            clock.stall(stall / RATE)
        return [(TARGETS, bytes([number]))]

    producer = SyncProducer(sender, RATE, outputs, clock)
    slots = run(producer, clock, 20.5)
    first = next(place for place, (time, _, _) in enumerate(sender.sent) if time > 5.0)
    assert sender.sent[first] == (pytest.approx(5.0 + stall), TARGETS, b"\x05")  # those that were being made
    shown = [(time, data[0] if data else None) for time, _, data in sender.sent[first + 1 : first + 3]]
    assert shown == expected
    assert producer.skipped == expected[1][0] - 6 == max(told)
    assert [slot for slot in range(1, 21) if slot not in slots] == list(range(6, round(expected[1][0])))
    # What a SYNC applies is for the one before it, and had time to arrive.
    for before, after in itertools.pairwise(sender.sent):
        if after[1] == SYNC:
            assert before[2][0] == after[0] - 1
            assert after[0] - before[0] > TARGET_ROOM


def test_an_adapter_may_refuse_for_a_moment_but_not_for_long(clock: SimulatedClock) -> None:
    sender = NotedSender(clock)
    producer = SyncProducer(sender, RATE, lambda *_: (), clock)
    producer.start()
    clock.sleep(10.5 / RATE)
    sender.refuses = True
    clock.sleep(0.8 * PATIENCE)
    sender.refuses = False
    clock.sleep(0.1)
    lost = round(0.8 * PATIENCE * RATE)
    assert producer.failure is None
    assert producer.skipped == lost
    begun = clock.now()
    sender.refuses = True
    assert clock.wait(lambda: producer.failure is not None, 2.0)
    # The first SYNC that is refused, and so long after it.
    assert PATIENCE < clock.now() - begun <= PATIENCE + 1.5 / RATE
    assert str(producer.failure) == "full"
    producer.stop()
    assert not producer.running
