"""Targets for SYNCs from commands that another thread sends at the same rate, but at its own moments; and stops by SDO.

A drive that misses its master goes to pre-operational (CiA 301, object 0x1029); it neither hears an RPDO then, nor
answers SYNC, but it still answers SDO: `SdoStop` stops it.
"""

from __future__ import annotations

import contextlib
import math
import threading
from collections import deque
from collections.abc import Sequence

from drivers.can.bus import Sender
from drivers.canopen402.protocol.objects import CONTROLWORD, SDO_ANSWER, SDO_REQUEST, STATUSWORD
from drivers.canopen402.protocol.state_machine import POWERED, DriveState, drive_state
from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.errors import ConnectionLostError

BRIDGED = 3
"""SYNCs, or commands, left out in a row without a trace: drives bridge so many by going on with their velocity. After
them the target is that of the present moment; one of an earlier moment would throw the drives back."""
DELAY = 1 + BRIDGED
"""Periods by which targets follow the commands: so late a command may be, and the drives still move evenly."""
RUN_OUT = 1e-6
"""Periods beyond the last command from which on it is missed."""
CATCH_UP = 0.1
"""Further periods of the commands played in one of SYNC after a longer pause, so that the drives catch up gently."""

PATIENCE = 0.1
"""How long [s] a drive may take to answer SYNC before it is asked by SDO."""
REPEAT = 0.03
"""From one request to the next [s]."""
_READ, _WRITE = 0x40, 0x2B
_SIZE = slice(4, 4 + STATUSWORD.size)
_PLACE = bytes([*STATUSWORD.index.to_bytes(2, "little"), STATUSWORD.subindex])


class TargetPath:
    """Straight lines between commands, one a period, read once a SYNC, at its moment.

    Commands belong to a grid of periods, each sent at its tick or a little later; a sender that is late leaves ticks
    out. Without this, a thread that comes now before and now after SYNC would give the drives one command twice and two
    at once.

    Args:
        start: positions [counts] that the drives hold.
        period: of commands and SYNCs [s].
    """

    def __init__(self, start: Sequence[int], period: float) -> None:
        self._period = period
        self._begin = math.nan
        self._played = self._asked = math.nan
        self._points: deque[tuple[int, tuple[int, ...]]] = deque([(-DELAY, tuple(start))])
        self._lock = threading.Lock()
        self._moving = False
        self.run_out = False
        """Whether commands of a moving arm ceased, so that the next target would stop it at one stroke."""

    def put(self, now: float, counts: Sequence[int]) -> None:
        """Take a command (n,) [counts] sent at `now` [s, host's monotonic clock]."""
        with self._lock:
            if math.isnan(self._begin):
                self._begin = now
            last, held = self._points[-1]
            tick = max(last + 1, math.floor((now - self._begin) / self._period + 1e-6))
            self._begin = min(self._begin, now - tick * self._period)  # what came soonest after its tick shows the grid
            if tick - last > DELAY:
                self._points.append((tick - DELAY, held))  # after a pause, not at one stroke
            elif tick - last > 1 and len(self._points) > 1:
                self._bridge(tick, counts)
            self._points.append((tick, tuple(counts)))
            self._moving = held != tuple(counts)

    def _bridge(self, tick: int, counts: Sequence[int]) -> None:
        """Fill the ticks left out before this one by a parabola: a corner would be several times the acceleration.

        It goes through the last two commands and this one, and never leaves the range of the last and this one.
        """
        (before, earlier), (last, held) = self._points[-2], self._points[-1]
        gap, steady = tick - last, last - before
        for x in range(1, gap):
            filled = []
            for a, b, c in zip(earlier, held, counts, strict=True):
                slope, curvature = (c - b) / gap, ((c - b) / gap - (b - a) / steady) / (gap + steady)
                wanted = round(b + slope * x + curvature * x * (x - gap))
                filled.append(min(max(wanted, min(b, c)), max(b, c)))
            self._points.append((last + x, tuple(filled)))

    def at(self, moment: float) -> tuple[int, ...]:
        """The targets (n,) [counts] at a moment [s, host's monotonic clock]; the last command where none follows."""
        with self._lock:
            passed, self._asked = moment - self._asked, moment
            if not math.isnan(self._played):
                bridged = min(passed, (1 + BRIDGED) * self._period)
                moment = min(moment, self._played + bridged + CATCH_UP * self._period)
            self._played = moment
            if math.isnan(self._begin):
                return self._points[0][1]
            tick = (moment - self._begin) / self._period - DELAY
            while len(self._points) > 1 and self._points[1][0] <= tick:
                self._points.popleft()
            first, before = self._points[0]
            if len(self._points) == 1 or tick <= first:
                self.run_out = self.run_out or (self._moving and tick > first + RUN_OUT)
                return before
            second, after = self._points[1]
            share = (tick - first) / (second - first)
            return tuple(round(a + share * (b - a)) for a, b in zip(before, after, strict=True))


class SdoStop:
    """Asks drives for their statusword, and switches off those that are still powered; waits for none."""

    def __init__(self, sender: Sender, ids: Sequence[int], clock: Clock = SYSTEM_CLOCK) -> None:
        self._sender, self._ids, self._clock = sender, tuple(ids), clock
        self._index = {node: index for index, node in enumerate(ids)}
        self._answered = [(-math.inf, DriveState.UNKNOWN)] * len(self._ids)
        self._asked = [-math.inf] * len(self._ids)

    def on_answer(self, identifier: int, data: bytearray, arrived: float) -> None:
        """Take an answer to an SDO request, if it is one with a statusword; called by the receiving thread."""
        if len(data) == 8 and data[0] >> 5 == 2 and data[1:4] == _PLACE:
            state = drive_state(int.from_bytes(data[_SIZE], "little"))
            self._answered[self._index[identifier - SDO_ANSWER]] = arrived, state

    def is_off(self, index: int, asked: float, controlword: int) -> bool:
        """Whether a drive has said by SDO that it is without power.

        Args:
            index: of the drive.
            asked: when it was asked to be by PDO [s, host's monotonic clock]; what it said before does not count.
            controlword: for a drive that is still powered.
        """
        now = self._clock.now()
        answered, state = self._answered[index]
        answered_since = answered > max(asked, self._asked[index])
        if answered_since and state not in POWERED and state is not DriveState.UNKNOWN:
            return True
        if now - asked < PATIENCE or now - self._asked[index] < REPEAT:
            return False
        self._asked[index] = now
        request = bytes([_READ]) + _PLACE + bytes(4)
        if answered_since and state in POWERED:
            place = bytes([*CONTROLWORD.index.to_bytes(2, "little"), CONTROLWORD.subindex])
            request = bytes([_WRITE]) + place + CONTROLWORD.encode(controlword) + bytes(2)
        with contextlib.suppress(ConnectionLostError):
            self._sender.send(SDO_REQUEST + self._ids[index], request)
        return False
