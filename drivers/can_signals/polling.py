"""Frames sent at a fixed period, on an absolute schedule, in a thread of their own."""

from __future__ import annotations

from collections import deque

from drivers.can.bus import Sender
from drivers.can_signals.rows.assembly import Rows
from drivers.can_signals.settings import Poll
from drivers.core.clock import SYSTEM_CLOCK, BackgroundWork, Clock, set_timer_slack
from drivers.core.errors import ConnectionLostError

ANSWER_LIMIT = 0.1
"""A poll that has not been answered after so long [s] never will be."""
_KEPT = 100_000


class PollAnswers:
    """Counts polls that no frame answered.

    A stall of this computer makes answers late, and the count of those that are missing too large, but only until they
    have come: what was missing throughout `ANSWER_LIMIT` is lost.
    """

    def __init__(self) -> None:
        self._missing: int | None = None
        self._least = 0
        self._since = 0.0

    def unanswered(self, poller: Poller, rows: Rows) -> int:
        """Return how many more are known to be lost after these rows."""
        if not len(rows.host_time):
            if self._missing is not None:
                self._missing -= rows.incomplete
            return 0
        now = float(rows.host_time[-1])
        polls = poller.take_until(now)
        if self._missing is None:
            self._missing, self._least, self._since = 0, 0, now
            return 0
        self._missing += polls - len(rows.host_time) - rows.incomplete
        self._least = min(self._least, self._missing)
        if now - self._since < ANSWER_LIMIT:
            return 0
        lost, self._since = self._least, now
        self._missing -= lost  # less than nothing: more answers than polls, which are not a loss
        self._least = self._missing
        return max(0, lost)


class Poller(BackgroundWork):
    """Polls until it is stopped.

    Attributes:
        failure: what ended it; None while all is well.
        period: from one poll to the next [s].
        latest: when the newest poll was sent [s, host's monotonic clock].
    """

    def __init__(self, sender: Sender, poll: Poll, clock: Clock = SYSTEM_CLOCK) -> None:
        super().__init__("can poll", clock)
        self.failure: ConnectionLostError | None = None
        self._sender = sender
        self._frames = [(frame.identifier, frame.data) for frame in poll.frames]
        self.period = poll.period
        self.latest = clock.now()
        self._sent: deque[float] = deque(maxlen=_KEPT)

    def take_until(self, moment: float) -> int:
        """Return how many polls were sent before a time [s, host's monotonic clock] and not taken yet."""
        count = 0
        while self._sent and self._sent[0] < moment:
            self._sent.popleft()
            count += 1
        return count

    def _run(self) -> None:
        set_timer_slack()
        due = self._clock.now()
        while not self._ending.wait(max(0.0, due - self._clock.now())):
            try:
                self.latest = self._sender.send_all(self._frames)
                self._sent.append(self.latest)
            except ConnectionLostError as error:
                self.failure = error
                return
            # After a stall the schedule goes on from now: a burst of polls would stay without answers.
            due = max(due + self.period, self._clock.now() - self.period)
