"""An arm on a virtual CAN bus that sends a test's cycles; for the tests of can_frames."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import count

import can

from drivers.core.clock import Clock

RATE = 100.0
ANSWER_TIME = 0.001
"""Delay of the answer to a poll [s]."""
JOINTS = ("shoulder", "elbow")
_CHANNELS = count()

Cycle = Callable[[int], Sequence[tuple[int, bytes]]]
"""Frames of a cycle by its number."""


def two_frames(number: int) -> list[tuple[int, bytes]]:
    """Positions 0.1 and −0.2 rad, velocities 0, a counter of 8 bits."""
    shoulder, elbow = (value.to_bytes(2, "little", signed=True) for value in (1000, -2000))
    return [(0x181, shoulder + bytes(2) + bytes([number % 256])), (0x182, elbow + bytes(2))]


def connection(channel: str, *, counter: bool = False, **more: object) -> dict[str, object]:
    """The keys of a connection to an arm that sends `two_frames`."""
    signals: list[dict[str, object]] = []
    for number, joint in enumerate(JOINTS):
        place = {"joint": joint, "id": 0x181 + number, "length": 16, "signed": True}
        signals.append({"quantity": "position", **place, "start": 0, "scale": 1e-4, "unit": "rad"})
        signals.append({"quantity": "velocity", **place, "start": 16, "scale": 1e-3, "unit": "rad/s"})
    if counter:
        signals.append({"quantity": "counter", "id": 0x181, "start": 32, "length": 8})
    keys = {"interface": "virtual", "channel": channel, "rate": RATE, "timeout": 1.0, "signals": signals}
    return keys | more


def moving(channel: str, **more: object) -> dict[str, object]:
    """The same with command frames."""
    return connection(
        channel,
        start=[{"id": 0x200, "data": "01"}],
        stop=[{"id": 0x200, "data": "00"}],
        command={
            "signals": [
                {"joint": joint, "id": 0x201, "start": 16 * n, "length": 16, "signed": True}
                | {"scale": 1e-4, "unit": "rad"}
                for n, joint in enumerate(JOINTS)
            ]
        },
        **more,
    )


class ScriptedCanArm:
    """Sends cycles at `RATE`, or one per poll; keeps what it receives.

    Args:
        clock: of the test.
        cycle: frames of a cycle.
        poll: identifier of the frame that makes it answer; None to send by itself.
    """

    def __init__(self, clock: Clock, cycle: Cycle = two_frames, poll: int | None = None) -> None:
        self.channel = f"scripted-{next(_CHANNELS)}"
        self._clock = clock
        self.cycle = cycle
        self.heard: list[tuple[int, bytes]] = []
        self.heard_at: list[float] = []
        self.number = 0
        self._poll = poll
        self._bus = can.Bus(interface="virtual", channel=self.channel)
        self._ending = clock.event()
        self._thread = clock.thread(self._run, "scripted arm")
        self._thread.start()

    def close(self) -> None:
        self._ending.set()
        self._thread.join()
        self._bus.shutdown()

    def _run(self) -> None:
        begun = self._clock.now()
        while not self._ending.is_set():
            due = begun + self.number / RATE
            message = self._bus.recv(max(0.0, min(due - self._clock.now(), 0.01)) if self._poll is None else 0.01)
            if message is not None:
                self.heard.append((message.arbitration_id, bytes(message.data)))
                self.heard_at.append(self._clock.now())
                if message.arbitration_id == self._poll:
                    self._clock.sleep(ANSWER_TIME)
                    self._speak()
            if self._poll is None and self._clock.now() >= due:
                self._speak()

    def _speak(self) -> None:
        for identifier, data in self.cycle(self.number):
            self._bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))
        self.number += 1
