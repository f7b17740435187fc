"""Receiving: frames are stored in a thread of their own until they are taken, stamped by the clock of their arrival."""

from __future__ import annotations

import contextlib
import math
import select
from collections import deque
from collections.abc import Callable, Container

import can

from drivers.base import Level, Notice, drained
from drivers.can.bus import EXTENDED, Frame, error_frame_words, is_bus_off, is_unreadable, reason
from drivers.core.clock import SYSTEM_CLOCK, BackgroundWork, Clock
from drivers.core.errors import ConnectionLostError
from drivers.core.text import counted

# Interfaces whose time stamps are the kernel's or the sender's clock of day, so that they give a frame's age.
_STAMPED_BY_CLOCK = frozenset({"SocketcanBus", "UdpMulticastBus", "VirtualBus"})
_CLOCK_CHECK = 0.1
_OLDEST = 1.0
_JITTER = 1e-3

POLL = 0.005
"""How long [s] the receiving thread waits for a frame before it looks whether it shall end."""
BUFFER_FRAMES = 200_000
"""Frames that may wait to be taken: 40 s of six drives at 400 Hz."""
CLASSICAL_BYTES = 8
"""Most data bytes of a frame that is not CAN FD."""
NOTICE_PERIOD = 1.0
"""At most one notice of a kind in so many seconds."""
FAULTY_LIMIT = 1000
"""Unreadable frames without a sound one in between, after which the adapter counts as lost."""


class ArrivalClock:
    """Takes stamps of frames to the host's monotonic clock."""

    def __init__(self, bus: can.BusABC, clock: Clock) -> None:
        self._clock = clock
        self._stamped = type(bus).__name__ in _STAMPED_BY_CLOCK
        self._offset, self._checked = 0.0, -math.inf
        self._last = -math.inf

    def arrived(self, message: can.Message) -> float:
        """Arrival [s, the host's monotonic clock], from the frame's own stamp where it is the clock of day.

        It never runs back, also where the clock of day is set meanwhile.
        """
        now = self._clock.now()
        if not self._stamped:
            return now
        arrived = message.timestamp - self._offset
        if now - self._checked > _CLOCK_CHECK or not self._last <= arrived <= now:
            self._offset, self._checked = _clock_offset(self._clock), now
            arrived = message.timestamp - self._offset
        plausible = max(now - _OLDEST, self._last - _JITTER) < arrived <= now
        self._last = max(arrived, self._last) if plausible else now
        return self._last


def _clock_offset(clock: Clock) -> float:
    """Clock of day minus monotonic clock [s]; the least disturbed of three readings."""
    best = (math.inf, 0.0)
    for _ in range(3):
        before, day, after = clock.now(), clock.time_of_day(), clock.now()
        best = min(best, (after - before, day - 0.5 * (before + after)))
    return best[1]


class Receiver(BackgroundWork):
    """Stores what comes on a bus, in a thread of its own, until it is taken.

    All frames are stored where `stored` is None, those of CAN FD where `fd`. `other` is called with every other frame
    (identifier, data, arrival [s]) in the receiving thread, and must be quick. `own` takes the identifier of a frame
    that a program of this computer sent, and says whether it was this program.
    """

    def __init__(
        self,
        bus: can.BusABC,
        stored: Container[int] | None = None,
        other: Callable[[int, bytes, float], None] | None = None,
        clock: Clock = SYSTEM_CLOCK,
        own: Callable[[int], bool] | None = None,
        *,
        fd: bool = False,
    ) -> None:
        super().__init__(f"can {bus.channel_info}", clock)
        self.overflow = 0
        """Frames dropped because `take` stayed away."""
        self.latest: dict[int, Frame] = {}
        """The newest stored frame of every identifier."""
        self._bus = bus
        self._stored = stored
        self._other = other
        self._own = own
        self._fd = fd
        self._stamps = ArrivalClock(bus, clock)
        self._ring: deque[Frame] = deque()
        self._arrival = clock.condition()
        self._wanted = 1
        self.drained = -math.inf
        """Everything that arrived before this time [s, host's monotonic clock] has been stored or passed on."""
        self.failure: ConnectionLostError | None = None
        """Why nothing comes any more; None while all is well."""
        self._troubles: dict[str, tuple[int, float]] = {}
        self._notices: deque[Notice] = deque()

    def take(self, timeout: float = 0.0, at_least: int = 1) -> list[Frame]:
        """Stored frames since the last call, waiting at most `timeout` [s] until there are `at_least` so many.

        Raises:
            ConnectionLostError: none is left, and the adapter is gone or the bus off.
        """
        with self._arrival:
            self._wanted = at_least
            self._arrival.wait_for(lambda: len(self._ring) >= at_least or self.failure is not None, timeout)
            frames = list(self._ring)
            self._ring.clear()
        if not frames and self.failure is not None:
            raise self.failure
        return frames

    def pending(self) -> bool:
        """Return whether frames wait in the adapter's socket, since the thread that takes them is late; else no."""
        try:
            return bool(select.select([self._bus.fileno()], [], [], 0.0)[0])
        except (NotImplementedError, can.CanError, OSError, ValueError, TypeError):
            return False

    def notices(self) -> list[Notice]:
        """Notices since the last call: error frames, truncated and unreadable ones."""
        self._report_troubles(self._clock.now() - NOTICE_PERIOD)
        return drained(self._notices)

    def report_rest(self) -> None:
        """Put into the notices what was counted and not reported yet, since it came so often."""
        self._report_troubles(math.inf)

    def _run(self) -> None:
        faulty = 0
        while not self._ending.is_set():
            asked = self._clock.now()
            try:
                message = self._bus.recv(POLL)
            except (can.CanError, OSError) as error:
                if self._ending.is_set():
                    return
                if not is_unreadable(error):
                    self._fail(f"the CAN adapter is gone: {reason(error)}", "is it plugged in, and the interface up?")
                    return
                faulty = self._skip_unreadable(faulty)
            except (ValueError, IndexError, KeyError, TypeError) as error:  # what slcan makes of a garbled line
                if self._ending.is_set():
                    return
                del error
                faulty = self._skip_unreadable(faulty)
            else:
                if message is None:
                    self.drained = max(self.drained, asked)
                    continue
                faulty = 0
                if not self._keep(message):
                    return
            if faulty > FAULTY_LIMIT:
                self._fail(f"{faulty} unreadable frames in a row", "is this the right port, bit rate and adapter?")
                return

    def _keep(self, message: can.Message) -> bool:
        arrived = self._stamps.arrived(message)
        if message.is_error_frame:
            return self._note_error(message, arrived)
        if message.is_remote_frame:
            self.drained = arrived
            return True
        if not self._fd and (message.is_fd or message.dlc > CLASSICAL_BYTES):
            self._trouble("CAN FD frame(s) dropped", arrived)
            self.drained = arrived
            return True
        identifier, data = message.arbitration_id, bytes(message.data)
        if message.is_extended_id:
            identifier |= EXTENDED
        if not message.is_rx and self._own is not None and self._own(identifier):
            pass
        elif len(data) != message.dlc:
            self._trouble("truncated frame(s) dropped", arrived)
        elif self._stored is None or identifier in self._stored:
            self._store((arrived, identifier, data))
        elif self._other is not None:
            try:
                self._other(identifier, data, arrived)
            except Exception as error:  # a malformed answer of one node must not end the reception of all
                self._trouble(f"frame(s) 0x{identifier:X} not understood ({type(error).__name__})", arrived)
        self.drained = arrived
        return True

    def _store(self, frame: Frame) -> None:
        self.latest[frame[1]] = frame
        with self._arrival:
            if len(self._ring) >= BUFFER_FRAMES:
                self._ring.popleft()
                if not self.overflow:
                    self._report("warning", "CAN frames were not read for too long: the oldest were dropped")
                self.overflow += 1
            self._ring.append(frame)
            if len(self._ring) >= self._wanted:
                self._arrival.notify_all()

    def _note_error(self, message: can.Message, arrived: float) -> bool:
        if type(self._bus).__name__ != "SocketcanBus":
            self._trouble("error frame(s)", arrived)
            return True
        if is_bus_off(message):
            self._fail(
                "the adapter is off the bus (bus-off)",
                "check wiring, termination and bit rate; then take the interface down and up again",
            )
            return False
        words = error_frame_words(message)
        self._trouble(f"error frame(s): {words}" if words else "error frame(s)", arrived)
        return True

    def _skip_unreadable(self, faulty: int) -> int:
        # slcan keeps a line that it cannot decode, and would meet it again for ever.
        flush = getattr(self._bus, "flush", None)
        if flush is not None:
            with contextlib.suppress(can.CanError, OSError):
                flush()
        self._trouble("unreadable frame(s) dropped", self._clock.now())
        return faulty + 1

    def _trouble(self, what: str, now: float) -> None:
        with self._arrival:
            count, reported = self._troubles.get(what, (0, -math.inf))
            self._troubles[what] = (count + 1, reported)
        self._report_troubles(now - NOTICE_PERIOD)

    def _report_troubles(self, reported_before: float) -> None:
        with self._arrival:
            for what, (count, reported) in self._troubles.items():
                if count and reported <= reported_before:
                    self._report("warning", counted(count, what))
                    self._troubles[what] = (0, self._clock.now())

    def _report(self, level: Level, message: str) -> None:
        self._notices.append(Notice(math.nan, level, message))

    def _fail(self, message: str, hint: str) -> None:
        with self._arrival:
            self.failure = ConnectionLostError(message, where=str(self._bus.channel_info), hint=hint)
            self._arrival.notify_all()
