"""After SYNCs that were left out, the drives get new targets before the next SYNC applies the old ones."""

from __future__ import annotations

import time

import pytest

from drivers.can_bus import Sender
from drivers.canopen402.objects import SYNC
from drivers.canopen402.sync import TARGET_ROOM, SyncProducer

RATE = 50.0
TARGETS = 0x201


class NotedSender(Sender):
    """Notes (identifier, data, when) instead of sending."""

    def __init__(self) -> None:
        self.sent: list[tuple[int, bytes, float]] = []

    def send(self, identifier: int, data: bytes) -> float:
        return self.send_all([(identifier, data)])

    def send_all(self, frames: object) -> float:
        now = time.monotonic()
        self.sent += [(identifier, data, now) for identifier, data in frames]  # type: ignore[attr-defined]
        return now


@pytest.mark.parametrize("stall", [1.6, 1.9, 2.6])
def test_targets_of_syncs_left_out_are_replaced_before_the_next_one(stall: float) -> None:
    """`stall`: how long the thread is held up, in periods; the targets are the moments that they are for."""
    moments: list[float] = []

    def outputs(moment: float) -> list[tuple[int, bytes]]:
        moments.append(moment)
        if len(moments) == 6:
            time.sleep(stall / RATE)
        return [(TARGETS, len(moments).to_bytes(1, "little"))]

    sender = NotedSender()
    producer = SyncProducer(sender, RATE, outputs)
    producer.start()
    time.sleep(0.5)
    producer.stop()
    assert producer.skipped >= 1
    assert moments == sorted(moments)
    applied: list[float] = []
    newest, at = 0.0, 0.0
    for identifier, data, when in sender.sent:
        if identifier == SYNC:
            if newest:
                # What a SYNC applies is for the one before it, and had time to arrive.
                applied.append(when - newest)
                assert when - at > (TARGET_ROOM - 0.1) / RATE
        else:
            newest, at = moments[data[0] - 1], when
    assert max(applied) < 1.6 / RATE
