from __future__ import annotations

import re
import threading
import time
from collections.abc import Sequence

import numpy as np

from drivers.can_bus import Sender
from drivers.canopen402.sync import PATIENCE, SyncProducer
from drivers.errors import ConnectionLostError


class NotedSender(Sender):
    """Notes what is sent and when; refuses while `refuses` is set."""

    def __init__(self) -> None:
        self.sent: list[tuple[float, int]] = []
        self.refuses = threading.Event()

    def send_all(self, frames: Sequence[tuple[int, bytes]]) -> float:
        if self.refuses.is_set():
            raise ConnectionLostError("full")
        now = time.monotonic()
        self.sent += [(now, identifier) for identifier, _ in frames]
        return now


def run(producer: SyncProducer, seconds: float) -> None:
    producer.start()
    time.sleep(seconds)
    producer.stop()


def test_syncs_follow_a_fixed_schedule_and_are_never_made_up_for() -> None:
    sender = NotedSender()
    producer = SyncProducer(sender, 100.0, lambda moment: ())
    run(producer, 1.0)
    slots, times = (np.array(column) for column in zip(*producer.take(), strict=True))
    assert np.all(np.diff(slots) >= 1)
    assert len(slots) + producer.skipped >= 95
    late = producer.clock(times) - slots / 100.0
    assert np.all(late >= 0.0)
    assert np.all(late <= 0.5 / 100.0 + 1e-3)  # a later one is not sent
    assert np.all(np.diff(times) > 0.4 / 100.0)
    assert [identifier for _, identifier in sender.sent] == [0x80] * len(slots)
    assert list(times) == [moment for moment, _ in sender.sent]


def test_a_computer_that_is_late_leaves_syncs_out_and_keeps_the_schedule() -> None:
    calls = iter(range(10_000))

    def outputs(moment: float) -> list[tuple[int, bytes]]:
        if next(calls) == 10:
            time.sleep(0.057)  # into the second half of a period
        return [(0x201, b"")]

    producer = SyncProducer(NotedSender(), 100.0, outputs)
    run(producer, 0.5)
    slots = np.array([slot for slot, _ in producer.take()])
    assert producer.skipped >= 5
    assert slots[-1] - slots[0] + 1 == len(slots) + producer.skipped
    assert np.max(np.diff(slots)) >= 6


def test_targets_follow_their_sync() -> None:
    sender = NotedSender()
    producer = SyncProducer(sender, 100.0, lambda moment: [(0x201, b""), (0x202, b"")])
    run(producer, 0.2)
    sent = " ".join(f"{identifier:x}" for _, identifier in sender.sent)
    assert re.fullmatch("((80 )?201 202 ?)+", sent)
    assert sent.count("80") == producer.count > 5
    # Without a SYNC they go out where a busy computer left SYNCs out, once for each such gap.
    assert sent.count("201") - producer.count <= producer.skipped


def test_the_clock_goes_on_through_a_pause() -> None:
    producer = SyncProducer(NotedSender(), 100.0, lambda moment: ())
    run(producer, 0.1)
    first = producer.take()[-1][0]
    time.sleep(0.2)
    run(producer, 0.1)
    assert producer.take()[0][0] >= first + 20
    assert not producer.running


def test_an_adapter_may_refuse_for_a_moment_but_not_for_long() -> None:
    sender = NotedSender()
    producer = SyncProducer(sender, 200.0, lambda moment: ())
    producer.start()
    time.sleep(0.05)
    sender.refuses.set()
    time.sleep(0.4 * PATIENCE)
    sender.refuses.clear()
    time.sleep(0.1)
    assert producer.failure is None
    assert producer.skipped >= 1
    sender.refuses.set()
    end = time.monotonic() + 2.0
    while producer.running and time.monotonic() < end:
        time.sleep(0.01)
    assert str(producer.failure) == "full"
    producer.stop()
