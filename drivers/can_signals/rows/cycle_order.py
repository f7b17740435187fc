"""Which frame begins a cycle: the one before which the bus is silent for longest."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.can.bus import Frame
from drivers.can_signals.table.signals import Part, batches, decode

ENOUGH = 10
"""Cycles from which an order is told."""
CLEAR = 1.5
"""How much longer than every other pause that before the first frame must be; else nobody can tell."""


STEADY = 0.9
"""Share of the frames that must come after the same one as before; else their order changes."""


@dataclass(frozen=True)
class Order:
    """How the frames of a cycle come.

    Attributes:
        first: number of the part that begins a cycle; the table's first where nobody can tell.
        span: from the first part to the last [s]; infinite where nobody can tell.
        sequence: numbers of the parts as they come, the first one in front; None where that changes.
    """

    first: int
    span: float
    sequence: tuple[int, ...] | None


class CycleOrder:
    """Watches the frames of some parts.

    Args:
        parts: in the table's order.
    """

    def __init__(self, parts: Sequence[Part]) -> None:
        self._parts = tuple(parts)
        self._pauses: list[list[float]] = [[] for _ in parts]
        self._followed_by: list[Counter[int]] = [Counter() for _ in parts]
        self._last: tuple[int, float] | None = None

    def take(self, frames: Sequence[Frame]) -> None:
        """Look at frames in the order of their arrival."""
        grouped = batches(frames)
        events: list[tuple[int, int]] = []
        for number, part in enumerate(self._parts):
            if (batch := grouped.get(part.identifier)) is not None:
                events.extend((which, number) for which in decode(part, batch)[0].tolist())
        for which, number in sorted(events):
            arrived = frames[which][0]
            if self._last is not None:
                before, when = self._last
                self._followed_by[before][number] += 1
                self._pauses[number].append(arrived - when)
            else:
                self._pauses[number].append(0.0)
            self._last = number, arrived

    def never_seen(self) -> tuple[Part, ...]:
        """Parts of which no frame has come yet."""
        return tuple(part for part, pauses in zip(self._parts, self._pauses, strict=True) if not pauses)

    @property
    def enough(self) -> bool:
        """Whether every part has come often enough to tell their order."""
        return all(len(pauses) > ENOUGH for pauses in self._pauses)

    def told(self) -> Order:
        """The order, as far as it can be told."""
        if len(self._parts) == 1 or not self.enough:
            return Order(0, math.inf, None)
        pauses = np.array([float(np.median(pauses[1:])) for pauses in self._pauses])
        first = int(np.argmax(pauses))
        others = np.delete(pauses, first)
        if pauses[first] > CLEAR * np.max(others):
            return Order(first, float(np.sum(others)), self._sequence(first))
        return Order(0, math.inf, self._sequence(0))

    def _sequence(self, first: int) -> tuple[int, ...] | None:
        sequence = [first]
        while len(sequence) < len(self._parts):
            following = self._followed_by[sequence[-1]]
            number, times = following.most_common(1)[0]
            if number in sequence or times < STEADY * following.total():
                return None
            sequence.append(number)
        return tuple(sequence)
