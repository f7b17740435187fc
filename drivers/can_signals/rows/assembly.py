"""Rows of a stream from frames that each bring some of its columns.

A row holds what the frames of one cycle say. A cycle begins with the frame that is named first, or with any frame that
has come in this cycle already (the first one was lost then). A row with a frame missing is lost, never filled up with
values of another cycle.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from drivers.can.bus import Frame
from drivers.can_signals.table.signal_keys import WHOLE_ARM
from drivers.can_signals.table.signals import FrameBatch, FrameLayout, Signal, batches, decode
from drivers.core.arrays import FloatArray

ENOUGH = 10
"""Cycles after which the order is known."""
CLEAR_PAUSE = 1.5
"""How much longer than every other pause that before the first frame must be; else the order is unknown."""


STEADY_SHARE = 0.9
"""Share of the frames that must come after the same one as before; else their order changes."""


@dataclass(frozen=True)
class Order:
    """How the frames of a cycle come."""

    first: int  # index of the layout that begins a cycle; the table's first where that is unknown
    span: float  # from the first layout to the last [s]; infinite where that is unknown
    # numbers of the layouts as they come, the first one in front; None where that changes
    sequence: tuple[int, ...] | None


class CycleOrder:
    """Watches the frames of some layouts."""

    def __init__(self, layouts: Sequence[FrameLayout]) -> None:
        self._layouts = tuple(layouts)
        self._pauses: list[list[float]] = [[] for _ in layouts]
        self._followed_by: list[Counter[int]] = [Counter() for _ in layouts]
        self._last: tuple[int, float] | None = None

    def take(self, frames: Sequence[Frame]) -> None:
        """Look at frames in the order of their arrival."""
        grouped = batches(frames)
        events: list[tuple[int, int]] = []
        for index, layout in enumerate(self._layouts):
            if (batch := grouped.get(layout.identifier)) is not None:
                events.extend((which, index) for which in decode(layout, batch)[0].tolist())
        for which, index in sorted(events):
            arrived = frames[which][0]
            if self._last is not None:
                before, when = self._last
                self._followed_by[before][index] += 1
                self._pauses[index].append(arrived - when)
            else:
                self._pauses[index].append(0.0)
            self._last = index, arrived

    def never_seen(self) -> tuple[FrameLayout, ...]:
        """Parts of which no frame has come yet."""
        return tuple(layout for layout, pauses in zip(self._layouts, self._pauses, strict=True) if not pauses)

    @property
    def enough(self) -> bool:
        """Return whether every frame has come often enough to know their order."""
        return all(len(pauses) > ENOUGH for pauses in self._pauses)

    def result(self) -> Order:
        """The order, as far as it is known."""
        if len(self._layouts) == 1 or not self.enough:
            return Order(0, math.inf, None)
        pauses = np.array([float(np.median(pauses[1:])) for pauses in self._pauses])
        first = int(np.argmax(pauses))
        others = np.delete(pauses, first)
        if pauses[first] > CLEAR_PAUSE * np.max(others):
            return Order(first, float(np.sum(others)), self._sequence(first))
        return Order(0, math.inf, self._sequence(0))

    def _sequence(self, first: int) -> tuple[int, ...] | None:
        sequence = [first]
        while len(sequence) < len(self._layouts):
            following = self._followed_by[sequence[-1]]
            index, times = following.most_common(1)[0]
            if index in sequence or times < STEADY_SHARE * following.total():
                return None
            sequence.append(index)
        return tuple(sequence)


LATE, SHORT = 0.75, 0.6
"""Shares of the pause between two cycles: a frame that is so much late is suspect; that it was late and not of the next
cycle shows where that cycle's first frame follows within a pause so short. (Of two cycles mixed: 1 or more, and 1.)"""


@dataclass(frozen=True)
class Rows:
    """Complete rows, and what was wrong with others."""

    host_time: FloatArray  # (N,) arrival of the cycle's first frame [s, the host's monotonic clock]
    values: FloatArray  # (N, k), a column for each of the assembler's signals
    incomplete: int = 0  # cycles in which a frame was missing
    missing: tuple[FrameLayout, ...] = ()  # layouts that the last of these lacked
    duplicates: int = 0  # frames that came twice
    short: int = 0  # frames with too few data bytes


@dataclass
class Assembled:
    """What some frames have brought so far; see `Rows`."""

    times: list[float] = field(default_factory=list)
    rows: list[FloatArray] = field(default_factory=list)
    incomplete: int = 0
    missing: tuple[FrameLayout, ...] = ()
    duplicates: int = 0


class Assembler:
    """Puts the rows of one stream together.

    Args:
        layouts: of the stream; the first begins a cycle where there is no `marker`, until an order is expected.
        marker: identifier of a frame that begins a cycle and holds none of the layouts; None where there is none.
        repeat_window: a frame that comes again within so many seconds, as the next of its stream and with the same
            data, is the same one twice, as CAN allows after an error in the last bit. Not looked for where each cycle
            is one frame.
    """

    def __init__(self, layouts: Sequence[FrameLayout], marker: int | None, repeat_window: float) -> None:
        self._layouts = tuple(layouts)
        self._marker = marker
        self._repeat_window = repeat_window if len(layouts) > 1 else 0.0
        self.signals: tuple[Signal, ...] = tuple(signal for layout in layouts for signal in layout.signals)
        self.first = 0
        self._longest = self._short_pause = math.inf
        self._rank: dict[int, int] = {}
        self._clock: SourceClock | None = None
        self._clock_column: int | None = None
        self.forget()

    def expect(self, order: Order, period: float, clock: SourceClock | None) -> None:
        """Know how the frames of a cycle come: in which order, and how long they take of the period [s].

        A frame that comes before one that it should follow is of the cycle before, and left out. A row that took
        clearly too long is either one whose later frames were received late, or holds frames of two cycles of which
        the others were lost: the clock tells by the next cycle, or else the pause until then.
        """
        self.first = order.first
        pause = period - order.span
        if pause > 0.0:
            self._longest, self._short_pause = order.span + LATE * pause, SHORT * pause
        if order.sequence is not None:
            self._rank = {index: rank for rank, index in enumerate(order.sequence)}
        names = [signal.quantity for signal in self._layouts[self.first].signals]
        self._clock = clock
        self._clock_column = next((names.index(name) for name in WHOLE_ARM if name in names), None)

    def forget(self) -> None:
        """Begin anew: the next row begins with the next cycle."""
        self._row: dict[int, FloatArray] = {}
        self._begun = self._first_part = 0.0
        self._waiting: tuple[float, float, dict[int, FloatArray], bool] | None = None
        self._after_loss = False
        self._complete = True
        self._synchronised = False
        self._last: tuple[int, float, bytes] = (-1, 0.0, b"")

    @property
    def wanted(self) -> int:
        """Return how many frames at least are missing until the next row can be given out."""
        if self._waiting is not None:
            return 1
        return len(self._layouts) - (0 if self._complete else len(self._row))

    def take(self, frames: Sequence[Frame], batches: dict[int, FrameBatch]) -> Rows:
        """The rows that these frames complete; `batches` are the same frames by identifier."""
        events: list[tuple[int, int, FloatArray | None]] = []
        short = 0
        for index, layout in enumerate(self._layouts):
            if (batch := batches.get(layout.identifier)) is None:
                continue
            order, values, too_short = decode(layout, batch)
            short += too_short
            events.extend(zip(order.tolist(), [index] * len(order), values, strict=True))
        if self._marker is not None and (batch := batches.get(self._marker)) is not None:
            events.extend((order, -1, None) for order in batch.order.tolist())
        events.sort(key=lambda event: event[0])
        assembled = Assembled()
        for which, index, brought in events:
            arrived, _, data = frames[which]
            last, when, before = self._last
            self._last = (index, arrived, data)
            if index == last and arrived - when < self._repeat_window and data == before:
                assembled.duplicates += 1
            else:
                self._add(index, brought, arrived, assembled)
        values = np.array(assembled.rows) if assembled.rows else np.empty((0, len(self.signals)))
        return Rows(
            np.array(assembled.times), values, assembled.incomplete, assembled.missing, assembled.duplicates, short
        )

    def _add(self, index: int, brought: FloatArray | None, arrived: float, assembled: Assembled) -> None:
        first = brought is None if self._marker is not None else index == self.first
        again = not first and index in self._row and arrived - self._first_part <= self._longest < math.inf
        if again and brought is not None and self._after_loss and self._waiting is not None:
            # What came first was what the cycle before lacked, overtaken by this one.
            begun, ended, row, _ = self._waiting
            self._waiting = begun, ended, row | {index: brought}, False
            return
        if first or index in self._row:
            self._settle(arrived, assembled, brought if first else None, first)
            if not self._complete and self._synchronised:
                assembled.incomplete += 1
                self._after_loss = True
                assembled.missing = tuple(
                    layout for index, layout in enumerate(self._layouts) if index not in self._row
                )
            self._synchronised = self._synchronised or first
            self._row, self._complete, self._begun = {}, False, arrived
        if brought is None or not self._synchronised:
            return
        if self._rank:
            self._row = {other: row for other, row in self._row.items() if self._rank[other] < self._rank[index]}
        if not self._row:
            self._first_part = arrived
            if arrived - self._begun > self._longest:
                self._begun = arrived  # all frames behind the marker, and the next marker, were lost
        self._row[index] = brought
        if len(self._row) == len(self._layouts):
            self._complete = True
            late = arrived - self._first_part > self._longest
            if late or self._after_loss:
                self._waiting = self._begun, arrived, self._row, late
            else:
                self._give(self._begun, self._row, assembled)

    def _give(self, begun: float, row: dict[int, FloatArray], assembled: Assembled) -> None:
        assembled.times.append(begun)
        assembled.rows.append(np.concatenate([row[index] for index in range(len(self._layouts))]))

    def _settle(self, arrived: float, assembled: Assembled, brought: FloatArray | None, first: bool) -> None:
        """Give a row out, or up, that took too long or follows a loss, at the frame that begins the next cycle."""
        if self._waiting is None:
            return
        begun, ended, row, late = self._waiting
        self._waiting, self._after_loss = None, False
        if not late:
            whole = True
        elif brought is not None and self._clock is not None and self._clock_column is not None:
            before = float(row[self.first][self._clock_column])
            whole = self._clock.follows(before, float(brought[self._clock_column]))
        else:
            whole = first and arrived - ended < self._short_pause
        if whole:
            self._give(begun, row, assembled)
        else:
            # Of the two cycles that it mixes, one that is still going on is counted at its own end.
            assembled.incomplete += 2 if first else 1


RESTART = 1.0
"""A clock that is so much [s] further on than the host's between two rows has been set, or its arm restarted."""


@dataclass(frozen=True)
class Times:
    """What the clock says about some rows."""

    kept: npt.NDArray[np.bool_]  # (N,) which of the rows are new
    time: FloatArray  # (M,) of those that are kept [s]
    lost: int  # rows that are missing before or between them
    restarted: int  # how often the clock jumped


class SourceClock:
    """Unwraps a counter, a count a row, or a time [s], of rows at a rate [Hz]."""

    def __init__(self, signal: Signal, rate: float) -> None:
        self._rate = rate
        self._unit = 1.0 / rate if signal.quantity == "counter" else 1.0
        field = signal.field
        self._modulus = np.inf if field.floating else abs(signal.gain) * 2.0**field.length * self._unit
        self._last: tuple[float, float, float] | None = None

    def forget(self) -> None:
        """Begin anew."""
        self._last = None

    def follows(self, before: float, after: float) -> bool:
        """Return whether a value of the signal is that of the very next row."""
        step = (after - before) * self._unit
        if np.isfinite(self._modulus):
            step %= self._modulus
        return 0.5 < step * self._rate < 1.5

    def take(self, values: FloatArray, host_time: FloatArray) -> Times:
        """Times of rows with these values (N,) of the signal, which arrived at (N,) [s]."""
        if not len(values):
            return Times(np.ones(0, dtype=bool), np.empty(0), 0, 0)
        reading = values * self._unit
        begun = self._last is None
        zero = float(reading[0]) if np.isfinite(reading[0]) else 0.0
        last, host, time = self._last if self._last is not None else (zero, float(host_time[0]), zero)
        steps = np.diff(reading, prepend=last)
        elapsed = np.diff(host_time, prepend=host)
        modulus = self._modulus
        if np.isfinite(modulus):
            steps = np.mod(steps, modulus)
            # Rounding must not make a repeated value a whole turn.
            steps[steps > modulus - 1e-6 / self._rate] = 0.0
            # A silence may be longer than the clock takes to begin anew; only the host's clock knows how much.
            turns = round((float(elapsed.sum()) - float(steps.sum())) / modulus)
            if turns > 0:
                steps[int(np.argmax(elapsed))] += turns * modulus
        jumped = (steps - elapsed > RESTART) | (steps < 0.0) | ~np.isfinite(steps)
        steps[jumped] = np.maximum(np.rint(elapsed[jumped] * self._rate), 1.0) / self._rate
        kept = steps > 0.0
        if begun:
            kept[0] = True
        missing = np.maximum(np.rint(steps * self._rate) - 1.0, 0.0)
        if begun:
            missing[0] = 0.0
        times = time + np.cumsum(steps)
        self._last = float(reading[-1]), float(host_time[-1]), float(times[-1])
        return Times(kept, times[kept], int(missing.sum()), int(jumped.sum()))
