"""The streams of a recording out of frames: which there are, and the blocks that arrive."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Sequence

import numpy as np

from drivers.base import Notice
from drivers.can.bus import Frame
from drivers.can.receiver import NOTICE_PERIOD
from drivers.can_signals.polling import PollAnswers, Poller
from drivers.can_signals.rows.assembly import Assembler, Rows, SourceClock
from drivers.can_signals.settings import CanFramesSettings
from drivers.can_signals.table.signal_keys import WHOLE_ARM
from drivers.can_signals.table.signals import Signal, batches
from drivers.core.arrays import FloatArray
from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.text import counted
from drivers.gains import DriveGain, gives_torque, joint_torque, torque_channel
from drivers.streams import Batch, ChannelLayout, StreamLayout

RATE_TIME = 2.0
"""How long [s] rows are counted before their rate is judged."""
RATE_TIMES = 2
"""So often in a row the rate must be wrong: a computer that stalls makes arrivals late once, not twice."""
RATE_TOLERANCE = 0.05


class FrameStreams:
    """The streams of a table.

    Args:
        settings: with the table.
        joints: names.
        gains: of their drives; torques are made of currents where all are known.
        coupling: R (n, n) of q_motor = R·q_joint; None where each motor moves its own joint alone.
        notices: are appended to.
        host_clock: the host's.

    Attributes:
        joints: puts the rows of the stream `joints` together.
        clock: the arm's own; None where the table has neither counter nor time.
        latest_position: (n,) [rad] of the newest row; None before the first.
        last_row: when the newest row was taken [s, host's monotonic clock].
    """

    def __init__(
        self,
        settings: CanFramesSettings,
        joints: Sequence[str],
        gains: Sequence[DriveGain],
        coupling: FloatArray | None,
        notices: deque[Notice],
        host_clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        self._host_clock = host_clock
        self._settings, self._joints, self._gains = settings, tuple(joints), tuple(gains)
        self._coupling = coupling
        self._assemblers = {
            name: Assembler(
                settings.frame_layouts(name),
                settings.keys.marker if name == "joints" else None,
                0.5 / settings.keys.rate,
            )
            for name in settings.streams
        }
        self.joints = self._assemblers["joints"]
        self._clock_signal = next((signal for signal in settings.signals if signal.quantity in WHOLE_ARM), None)
        self.clock = SourceClock(self._clock_signal, settings.keys.rate) if self._clock_signal is not None else None
        self._troubles = Troubles(notices, host_clock)
        self._faults = FaultWatch(notices)
        self._rate_watch = RateWatch(notices, settings.keys.rate)
        self.forget()

    @property
    def missing(self) -> str:
        """Return what the last incomplete row lacked; empty where none was."""
        return self._troubles.missing

    def losses(self) -> str:
        """Return why rows of the joints were lost since `forget`, in words."""
        return self._troubles.losses()

    def forget(self) -> None:
        """Begin anew."""
        for assembler in self._assemblers.values():
            assembler.forget()
        if self.clock is not None:
            self.clock.forget()
        # arrivals and times of the newest rows of the joints
        self._arrivals = self._times = np.zeros(0)
        self._lost = 0
        self.latest_position: FloatArray | None = None
        self._latest_time: dict[str, float] = {}
        self.last_row = self._host_clock.now()
        self._answers = PollAnswers()
        self._troubles.forget()
        self._rate_watch.forget()
        self._faults.forget()

    def layouts(self) -> tuple[StreamLayout, ...]:
        """`joints` at the nominal rate, and as the table has them `thermal`, `status` and streams of its own."""
        layouts = []
        for name, assembler in self._assemblers.items():
            channels = []
            for quantity, members in self._columns(assembler).items():
                unit = "1" if quantity == "fault" else ""
                columns = tuple(assembler.signals[index].joint for index in members)
                channels.append(ChannelLayout(quantity, columns, unit, self._description(name, quantity)))
            if name == "joints" and self._knows_torque:
                channels.append(torque_channel(self._joints, self._coupling))
            layouts.append(StreamLayout(name, tuple(channels), self._settings.keys.rate if name == "joints" else 0.0))
        return tuple(layouts)

    def take(self, frames: Sequence[Frame], poller: Poller | None) -> list[Batch]:
        """The blocks that these frames complete; `poller` where the arm is polled."""
        grouped = dict(batches(frames))
        blocks = []
        for name, assembler in self._assemblers.items():
            rows = assembler.take(frames, grouped)
            self._troubles.note(rows, essential=name == "joints")
            if name == "joints":
                block = self._joints_block(rows, assembler, poller)
            else:
                block = self._other_block(name, rows, assembler)
            self._faults.note(assembler.signals, rows, self._on_joints_clock(rows.host_time))
            if len(block.time):
                blocks.append(block)
        return blocks

    @property
    def _knows_torque(self) -> bool:
        quantities = self._columns(self.joints)
        return "current" in quantities and "torque" not in quantities and gives_torque(self._gains, self._joints)

    def _columns(self, assembler: Assembler) -> dict[str, list[int]]:
        """Quantity → columns of the assembler's values in the joints' order."""
        columns: dict[str, list[int]] = {}
        for index, signal in enumerate(assembler.signals):
            if signal.quantity not in WHOLE_ARM:
                columns.setdefault(signal.quantity, []).append(index)
        order = {joint: index for index, joint in enumerate(self._joints)}
        for members in columns.values():
            members.sort(key=lambda index: order[assembler.signals[index].joint])
        return columns

    def _description(self, stream: str, quantity: str) -> str:
        what = f"{quantity} from the arm's CAN frames"
        if self._clock_signal is None:
            return f"{what}; time is the arrival of the cycle's first frame at this computer"
        if stream == "joints":
            return f"{what}; time is the arm's own {self._clock_signal.quantity}"
        return f"{what}; time is the arrival of its first frame, brought to the clock of the joints"

    def _joints_block(self, rows: Rows, assembler: Assembler, poller: Poller | None) -> Batch:
        self._lost += rows.incomplete if self.clock is None else 0
        values, host_time, times = rows.values, rows.host_time, rows.host_time
        if self.clock is not None and self._clock_signal is not None:
            stamped = self.clock.take(values[:, assembler.signals.index(self._clock_signal)], host_time)
            values, host_time, times = values[stamped.kept], host_time[stamped.kept], stamped.time
            self._lost += stamped.lost
            self._troubles.note_clock(int(np.sum(~stamped.kept)), stamped.restarted)
        elif poller is not None:
            self._lost += self._answers.unanswered(poller, rows)
        if not len(times):
            return Batch("joints", times, host_time)
        self._arrivals = np.append(self._arrivals[-1:], host_time)
        self._times = np.append(self._times[-1:], times)
        self.last_row = self._host_clock.now()
        self._rate_watch.note(host_time, self._lost)
        values_of = self._values(values, assembler)
        if self._knows_torque:
            values_of["torque"] = joint_torque(values_of["current"], self._gains, self._coupling)
        self.latest_position = values_of["position"][-1]
        lost, self._lost = self._lost, 0
        return Batch("joints", times, host_time, values_of, lost)

    def _other_block(self, name: str, rows: Rows, assembler: Assembler) -> Batch:
        times = self._on_joints_clock(rows.host_time)
        if not np.all(np.isfinite(times)):
            return Batch(name, np.zeros(0), np.zeros(0))
        # Arrivals jitter, and so does the way from one clock to the other; the stream's own time must not run back.
        before = self._latest_time.get(name, -math.inf)
        times = np.maximum(np.maximum.accumulate(times), before + 1e-6 * np.arange(1, len(times) + 1))
        self._latest_time[name] = float(times[-1]) if len(times) else before
        return Batch(name, times, rows.host_time, self._values(rows.values, assembler), rows.incomplete)

    def _on_joints_clock(self, host_time: FloatArray) -> FloatArray:
        """Arrivals (N,) on the clock of the joints, by the rows of theirs around them; nan before the first [s]."""
        if self.clock is None:
            return host_time
        if not len(self._times):
            return np.full(len(host_time), np.nan)
        outside = np.minimum(host_time - self._arrivals[0], 0.0) + np.maximum(host_time - self._arrivals[-1], 0.0)
        return np.asarray(np.interp(host_time, self._arrivals, self._times) + outside)

    def _values(self, values: FloatArray, assembler: Assembler) -> dict[str, FloatArray]:
        return {
            quantity: np.ascontiguousarray(values[:, members]) for quantity, members in self._columns(assembler).items()
        }


class Troubles:
    """Counts what went wrong, and says so at most once a second.

    Attributes:
        missing: what the last incomplete row lacked; empty where none was.
    """

    def __init__(self, notices: deque[Notice], clock: Clock = SYSTEM_CLOCK) -> None:
        self.missing = ""
        self._notices = notices
        self._clock = clock
        self._counts: dict[str, int] = {}
        self._reported = -math.inf
        self._lacked: Counter[str] = Counter()

    def forget(self) -> None:
        """Begin to count lost rows anew."""
        self._lacked.clear()

    def losses(self) -> str:
        """Frames that rows of the joints lacked since `forget`, in words."""
        return ", ".join(f"no {label}: {counted(count, 'time')}" for label, count in self._lacked.most_common())

    def note(self, rows: Rows, *, essential: bool) -> None:
        """Note what was wrong with some rows; `essential`: of the joints."""
        if rows.missing:
            self.missing = rows.missing[0].label
        if rows.incomplete and essential:
            self._lacked[self.missing or "another frame"] += rows.incomplete
        self._count("incomplete row(s)", rows.incomplete)
        self._count("frame(s) received twice", rows.duplicates)
        self._count("frame(s) too short for the table", rows.short)
        self._report()

    def note_clock(self, repeated: int, restarted: int) -> None:
        """Note rows whose time or counter was not new, and jumps of it."""
        self._count("row(s) dropped whose time or counter was not new", repeated)
        self._count("jump(s) of the arm's clock; was it restarted?", restarted)

    def _count(self, what: str, more: int) -> None:
        if more:
            self._counts[what] = self._counts.get(what, 0) + more

    def _report(self) -> None:
        now = self._clock.now()
        if not self._counts or now - self._reported < NOTICE_PERIOD:
            return
        for what, count in self._counts.items():
            lacked = f"; the last lacked {self.missing}" if what.startswith("incomplete") and self.missing else ""
            self._notices.append(Notice(math.nan, "warning", counted(count, what) + lacked))
        self._counts.clear()
        self._reported = now


class FaultWatch:
    """Tells when a signal `fault` stops being 0, as an error, and when it is 0 again."""

    def __init__(self, notices: deque[Notice]) -> None:
        self._notices = notices
        self._last: dict[str, float] = {}

    def forget(self) -> None:
        """Begin anew: what is in fault is reported again."""
        self._last.clear()

    def note(self, signals: Sequence[Signal], rows: Rows, times: FloatArray) -> None:
        """Look at the rows of a stream, which have these times (N,) [s]."""
        for column, signal in enumerate(signals):
            if signal.quantity != "fault" or not len(rows.values):
                continue
            values = rows.values[:, column]
            changes = np.flatnonzero(np.diff(values, prepend=self._last.get(signal.joint, 0.0)))
            for row in changes:
                when = float(times[row])
                if values[row] != 0.0:
                    self._notices.append(Notice(when, "error", f"{signal.label}: {values[row]:g}"))
                else:
                    self._notices.append(Notice(when, "info", f"{signal.label} is over"))
            self._last[signal.joint] = float(values[-1])


class RateWatch:
    """Tells once where the arm's cycles come at another rate [Hz] than the robot file says."""

    def __init__(self, notices: deque[Notice], rate: float) -> None:
        self._notices = notices
        self._rate = rate
        self.forget()

    def forget(self) -> None:
        """Begin anew."""
        self._begun: float | None = None
        self._count = 0
        self._wrong = 0
        self._judged = False

    def note(self, host_time: FloatArray, lost: int) -> None:
        """Rows that arrived at (N,) [s], and how many were lost with them."""
        if self._judged:
            return
        if self._begun is None:
            self._begun, self._count = float(host_time[0]), -1
        self._count += len(host_time) + lost
        elapsed = float(host_time[-1]) - self._begun
        if elapsed < RATE_TIME or self._count < RATE_TIME:
            return
        rate = self._count / elapsed
        self._begun, self._count = float(host_time[-1]), 0
        if abs(rate / self._rate - 1.0) <= RATE_TOLERANCE:
            self._judged = True
            return
        self._wrong += 1
        if self._wrong == RATE_TIMES:
            self._judged = True
            message = f"cycles come at {rate:.4g} Hz, but the robot file says {self._rate:g} Hz; correct its 'rate'"
            self._notices.append(Notice(math.nan, "warning", message))
