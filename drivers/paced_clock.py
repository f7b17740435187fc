"""A clock for commands that goes no faster than the arm's own: one that lies must not make the arm move faster."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from drivers.core.clock import STALL_LIMIT, Clock
from drivers.core.errors import SafetyStopError

JITTER = 0.002
"""How much later than others [s] a sample may arrive."""
LATE = 0.001
"""A sleep that ends later than this [s] was a stall, as samples show that came meanwhile, or the clock jumped."""
COARSE = 0.02
"""An arm's time that comes less often than this [s] does not tell the one from the other: it is taken for a stall."""
DRIFT = 1e-3
"""Greatest difference of the rates of two sound clocks."""
LOST = 0.008
"""So long [s] commands wait for a sample that may be lost; longer where those before arrived ever later."""
HELD = 1.0
"""So long [s] commands wait for the arm's clock at most."""
RECOVERY = 5e-3
"""How much faster commands go, once samples arrive in time again, until they are as far as the host's clock."""
POLL = 5e-4
"""How often [s] it is looked for a newer time of the arm that stands."""


@dataclass(frozen=True)
class ArmTime:
    """The newest reading of an arm's own clock.

    Attributes:
        time: of the arm's clock [s].
        arrived: at this computer [s, host's monotonic clock].
        period: after which the next one is due [s].
    """

    time: float
    arrived: float
    period: float


class PacedClock(Clock):
    """The host's clock, held back where the arm's own does not show that the time has passed.

    Where the host's clock jumps ahead, this one goes on from where it was; where it runs faster than the arm's, this
    one gets ahead by a period of the arm's readings and their jitter, and then goes on as the arm's does. A stall, of
    which the arm's clock shows the length, is seen as it was.

    Args:
        clock: the host's.
        arm_time: the newest reading.
    """

    def __init__(self, clock: Clock, arm_time: Callable[[], ArmTime | None]) -> None:
        super().__init__()
        self._clock, self._arm_time = clock, arm_time
        self._newest = -math.inf
        self._offset = self._late = self._period = 0.0
        self._bound = -math.inf
        self._behind = 0.0
        self._asked = clock.now()

    def now(self) -> float:
        """Monotonic time [s]: the host's, or less."""
        host = self._clock.now()
        if self._behind and self._late <= JITTER:
            self._behind = max(0.0, self._behind - RECOVERY * max(0.0, host - self._asked))
        self._asked = host
        if host - self._behind > self._bound:
            self._look()
        return min(host - self._behind, self._bound)

    def sleep_until(self, moment: float) -> float:
        """Sleep until a time of this clock [s]; how late it became [s].

        Raises:
            SafetyStopError: the arm's clock stands.
        """
        explained = False
        while (late := self.now() - moment) < -1e-9 or (late > LATE and not explained):
            if late > LATE:
                self._explain(late)
                explained = True
                continue
            goal = min(moment, self._bound)
            slept = self._clock.sleep_until(self._clock.now() + goal - self.now())
            if goal < moment and not self._look():
                self._hold()
            elif slept > LATE:
                self._explain(slept)
                explained = True
        return max(0.0, late)

    def event(self) -> threading.Event:
        """An event of the host's clock."""
        return self._clock.event()

    def thread(self, target: Callable[..., object], name: str, args: Sequence[object] = ()) -> threading.Thread:
        """A thread of the host's clock."""
        return self._clock.thread(target, name, args)

    def _hold(self) -> None:
        """Wait until the arm's clock goes on, then go on from where it is; for a while only where samples stay away.

        Raises:
            SafetyStopError: it goes on too slowly, and then stands.
        """
        begun, suspect = self._clock.now(), self._late > JITTER
        while not self._look():
            waited = self._clock.now() - begun
            if waited > LOST and not suspect:  # frames were lost: whoever supervises the arm waits no longer than this
                self._behind = max(self._behind, self._clock.now() - self._bound)  # on from where it is
                if (released := self._newest + self._offset + STALL_LIMIT) > self._bound:
                    self._bound = released
                    return
            if waited > HELD:  # whoever supervises the arm has stopped it long before
                raise SafetyStopError(
                    f"the arm's own clock has shown nothing new for {HELD:g} s, and commands go no faster",
                    hint="do its samples stay away? Is this a virtual machine, whose clock jumps?",
                )
            self._clock.sleep(POLL)
        self._behind = self._late if self._late > JITTER else 0.0

    def _explain(self, late: float) -> None:
        """Find out whether a sleep that ended late [s] was a stall: the next reading arrives as others do then."""
        if self._period > COARSE:
            return
        begun = self._clock.now()
        while (host := self._clock.now()) - begun < self._period + JITTER:
            if self._look():
                self._behind = self._late if self._late > JITTER else self._behind
                return
            if host - self._behind <= self._bound:
                return
            self._clock.sleep(POLL)
        self._behind += late

    def _look(self) -> bool:
        """Take the arm's newest reading; whether there is a newer one."""
        reading = self._arm_time()
        if reading is None:
            return False
        passed = reading.time - self._newest
        if passed == 0.0:
            return False
        latency = reading.arrived - reading.time
        if passed < 0.0 or not math.isfinite(passed):
            self._offset = latency  # it began anew
        self._offset = min(self._offset + DRIFT * min(passed, 1.0), latency)
        self._late = latency - self._offset
        self._newest, self._period = reading.time, reading.period
        self._bound = max(self._bound, self._newest + self._offset + reading.period + JITTER)
        return True
