"""Signs of life: what drives hear from dynid (heartbeat, node guarding: CiA 301, 7.2.8.3.2)."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping, Sequence

from drivers.can.bus import REMOTE, Frame, Sender
from drivers.canopen402.protocol.objects import HEARTBEAT, STATE_OPERATIONAL, TPDO_BASES
from drivers.clock_rates import COMPARING_LIMIT, ClockRates
from drivers.core.clock import SYSTEM_CLOCK, BackgroundWork, Clock
from drivers.core.errors import ConnectionLostError

_POLL = 0.01


class HeartbeatClocks:
    """Compares clocks of several drives with this computer's, by heartbeats of a period [s].

    One drive alone may have another heartbeat time.
    """

    def __init__(self, count: int, period: float) -> None:
        self._period = period
        self._beats = [0] * count
        self._rates = [ClockRates("the drives' clock", "their heartbeat time (0x1017)") for _ in range(count)]
        self._said = [""] * count

    @property
    def wrong(self) -> str:
        """Return what is wrong, in words, where all drives whose heartbeats come agree; else empty."""
        said = [self._said[index] for index, beats in enumerate(self._beats) if beats]
        return said[0] if said and all(said) else ""

    def take(self, index: int, arrived: float) -> None:
        """A drive's heartbeat, which arrived at a time [s, host's monotonic clock]."""
        self._beats[index] += 1
        self._said[index] = self._rates[index].add(self._period * self._beats[index], arrived)

    def wait(self, clock: Clock) -> str:
        """Return what is wrong, once the clocks could be compared, or `COMPARING_LIMIT` has passed."""
        end = clock.now() + COMPARING_LIMIT
        while not any(rate.compared for rate in self._rates) and clock.now() < end:
            clock.sleep(_POLL)
        return self.wrong


class LifeSigns(BackgroundWork):
    """A thread that sends one of some frames after the other, at an interval [s], as long as this process runs.

    `before` is called with the number of a frame and the time [s, host's monotonic clock] before it is sent.
    """

    def __init__(
        self,
        sender: Sender,
        frames: Sequence[tuple[int, bytes]],
        interval: float,
        before: Callable[[int, float], None] | None = None,
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        super().__init__("life signs", clock)
        self._sender, self._frames, self._interval, self._before = sender, tuple(frames), interval, before

    def _run(self) -> None:
        due, turn = self._clock.now(), 0
        while not self._ending.wait(max(0.0, due - self._clock.now())):
            if self._before is not None:
                self._before(turn, self._clock.now())
            identifier, data = self._frames[turn]
            # An adapter that is gone shows elsewhere; one that is back must find the drives still cared for.
            with contextlib.suppress(ConnectionLostError):
                self._sender.send(identifier, data)
            turn = (turn + 1) % len(self._frames)
            due = max(due + self._interval, self._clock.now())  # after a stall no burst, and no drive is left out


def heartbeat(sender: Sender, own_id: int, period: float, clock: Clock = SYSTEM_CLOCK) -> LifeSigns:
    """Dynid's heartbeat, as that of a node with an id of its own, once a period [s]."""
    return LifeSigns(sender, [(HEARTBEAT + own_id, bytes([STATE_OPERATIONAL]))], period, clock=clock)


def guard_requests(
    sender: Sender, ids: Sequence[int], period: float, before: Callable[[int, float], None], clock: Clock = SYSTEM_CLOCK
) -> LifeSigns:
    """A remote frame to each node once a period [s], evenly spread; `before` gets its index."""
    frames = [(HEARTBEAT + node | REMOTE, bytes(1)) for node in ids]
    return LifeSigns(sender, frames, period / len(frames), before, clock)


class Silence:
    """Response time-outs of the drives, by the newest frame of each identifier."""

    def __init__(self, joints: Sequence[str], ids: Sequence[int], latest: Mapping[int, Frame]) -> None:
        self._joints, self._ids, self._latest = tuple(joints), tuple(ids), latest

    def who(self, since: float) -> tuple[str, float]:
        """The drives that have not sent both TPDOs since a time, and when the last of them had.

        Both times [s, host's monotonic clock]; no words where all have.
        """
        silent: dict[str, float] = {}
        for joint, node in zip(self._joints, self._ids, strict=True):
            heard = min(self._latest.get(base + node, (-math.inf,))[0] for base in TPDO_BASES)
            if heard < since:
                silent[f"{joint} (node {node})"] = heard
        words = "any drive" if len(silent) == len(self._ids) > 1 else ", ".join(silent)
        return words, max(silent.values(), default=-math.inf)

    def explain(self, now: float, drained: float, last_sync: float, limit: float) -> str:
        """Return why no row came for about `limit` [s]; empty where all drives answer.

        Times are of the host's monotonic clock [s]; all that arrived before `drained` is known.
        """
        recent = 0.5 * limit  # a row is handed out one SYNC after its frames came, and the session looks later still
        if now - last_sync > recent:
            return f"no SYNC sent for {now - last_sync:.2f} s"
        if now - drained > recent:
            return f"the bus was not read for {now - drained:.2f} s"
        who, heard = self.who(drained - recent)
        return f"no answer to SYNC of {who} for {drained - heard:.2f} s" if who else ""
