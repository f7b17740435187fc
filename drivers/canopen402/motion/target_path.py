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
from drivers.core.clock import STALL_LIMIT, SYSTEM_CLOCK, Clock
from drivers.core.errors import ConnectionLostError

BRIDGED = 3
"""SYNCs left out in a row without a trace: drives bridge so many by going on with their velocity. After them the target
is that of the present moment; one of an earlier moment would throw the drives back."""
RETURN_TIME = 0.05
"""Time constant [s] by which targets return to the commands from where drives went on to without a SYNC. At one stroke
it would take up to ten times the acceleration of the motion."""
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


def delay_periods(period: float) -> int:
    """Periods [s] by which targets follow the commands: so late a command may be, and the drives still move evenly."""
    return max(1 + BRIDGED, math.ceil(STALL_LIMIT / period) + 1)


class TargetPath:
    """Straight lines between commands, one a period, read once a SYNC, at its moment.

    Commands belong to a grid of periods; a sender that is late leaves ticks out. Without this, a thread that comes now
    before and now after SYNC would give the drives one command twice and two at once.

    Args:
        start: positions [counts] that the drives hold.
        period: of commands and SYNCs [s].
    """

    def __init__(self, start: Sequence[int], period: float) -> None:
        self._period, self._delay = period, delay_periods(period)
        self._begin = math.nan
        self._played = self._asked = math.nan
        self._points: deque[tuple[int, tuple[int, ...]]] = deque([(-self._delay, tuple(start))])
        self._range = [(count, count) for count in start]
        # How far [counts], and how fast [counts a period], from the commands after SYNCs that were left out.
        self._astray = [(0.0, 0.0)] * len(start)
        self._given: deque[tuple[tuple[int, ...], list[tuple[float, float]]]] = deque(maxlen=3)
        self._lock = threading.Lock()
        self._moving = False
        self.run_out = False
        """Whether commands of a moving arm ceased, so that the next target would stop it at one stroke."""

    def put(self, due: float, counts: Sequence[int]) -> None:
        """Take a command (n,) [counts] that is due at a time [s, host's monotonic clock], or was sent then."""
        with self._lock:
            if math.isnan(self._begin):
                self._begin = due
            last, held = self._points[-1]
            tick = max(last + 1, math.floor((due - self._begin) / self._period + 1e-6))
            self._begin = min(self._begin, due - tick * self._period)  # what came soonest after its tick shows the grid
            if tick - last > self._delay:
                self._points.append((tick - self._delay, held))  # after a pause, not at one stroke
            self._points.append((tick, tuple(counts)))
            self._range = [(min(low, c), max(high, c)) for (low, high), c in zip(self._range, counts, strict=True)]
            self._moving = held != tuple(counts)

    def at(self, moment: float, left_out: int = 0) -> tuple[int, ...]:
        """The targets (n,) [counts] at a moment [s, host's monotonic clock]; the last command where none follows.

        Args:
            moment: of the last SYNC, in its schedule.
            left_out: SYNCs just before the next one that were not sent; the targets given last were not applied.
        """
        with self._lock:
            commanded = self._commanded(moment)
            if left_out:
                self._follow_the_drives(left_out, commanded)
            self._astray = [_closer(*astray, self._period) for astray in self._astray]
            targets = tuple(
                min(max(count + round(offset), low), high)
                for count, (offset, _), (low, high) in zip(commanded, self._astray, self._range, strict=True)
            )
            self._given.append((targets, self._astray))
            return targets

    def _follow_the_drives(self, left_out: int, commanded: tuple[int, ...]) -> None:
        """Begin where the drives went on to with their velocity; over so few periods the commands are a parabola."""
        if self._given:
            self._given.pop()
        if len(self._given) < 2 or left_out > BRIDGED:
            return
        (before, _), (last, astray) = list(self._given)[-2:]
        for _ in range(left_out):
            astray = [_closer(*one, self._period) for one in astray]
        self._astray = []
        for (offset, speed), earlier, latest, count in zip(astray, before, last, commanded, strict=True):
            gone_on = latest + (left_out + 1) * (latest - earlier)
            missed = (gone_on - count - _closer(offset, speed, self._period)[0]) / (left_out + 2)
            self._astray.append((offset + missed * left_out, speed + missed * 2.0 * left_out / (left_out + 1)))
        # Where the drives are when the next target reaches them: their velocity after it counts from there.
        here = tuple(latest + left_out * (latest - earlier) for earlier, latest in zip(before, last, strict=True))
        self._given.append((here, astray))

    def _commanded(self, moment: float) -> tuple[int, ...]:
        passed, self._asked = moment - self._asked, moment
        if not math.isnan(self._played):
            bridged = min(passed, (1 + BRIDGED) * self._period)
            moment = min(moment, self._played + bridged + CATCH_UP * self._period)
        self._played = moment
        if math.isnan(self._begin):
            return self._points[0][1]
        tick = (moment - self._begin) / self._period - self._delay
        while len(self._points) > 1 and self._points[1][0] <= tick:
            self._points.popleft()
        first, before = self._points[0]
        if len(self._points) == 1 or tick <= first:
            self.run_out = self.run_out or (self._moving and tick > first + RUN_OUT)
            return before
        second, after = self._points[1]
        share = (tick - first) / (second - first)
        return tuple(round(a + share * (b - a)) for a, b in zip(before, after, strict=True))


def _closer(offset: float, speed: float, period: float) -> tuple[float, float]:
    """Return how far and how fast from a target, a period [s] later; `speed` per period. Critically damped, exactly."""
    share = period / RETURN_TIME
    mixed = speed + share * offset
    decay = math.exp(-share)
    return (offset + mixed) * decay, (speed - share * mixed) * decay


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
        """Return whether a drive has said by SDO that it is without power.

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
