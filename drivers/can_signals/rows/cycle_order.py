"""Which frame begins a cycle: the one before which the bus is silent for longest."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.can.bus import Frame
from drivers.can_signals.table.signals import FrameLayout, batches, decode

ENOUGH = 10
"""Cycles after which the order is known."""
CLEAR_PAUSE = 1.5
"""How much longer than every other pause that before the first frame must be; else the order is unknown."""


STEADY_SHARE = 0.9
"""Share of the frames that must come after the same one as before; else their order changes."""


@dataclass(frozen=True)
class Order:
    """How the frames of a cycle come.

    Attributes:
        first: index of the layout that begins a cycle; the table's first where that is unknown.
        span: from the first layout to the last [s]; infinite where that is unknown.
        sequence: numbers of the layouts as they come, the first one in front; None where that changes.
    """

    first: int
    span: float
    sequence: tuple[int, ...] | None


class CycleOrder:
    """Watches the frames of some layouts.

    Args:
        layouts: in the table's order.
    """

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
        """Whether every frame has come often enough to know their order."""
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
