"""The arm's own clock from a counter or a time stamp in its frames, which begins anew after so many counts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from drivers.can_signals.table.signals import Signal
from drivers.core.arrays import FloatArray

RESTART = 1.0
"""A clock that is so much [s] further on than the host's between two rows has been set, or its arm restarted."""


@dataclass(frozen=True)
class Times:
    """What the clock says about some rows.

    Attributes:
        kept: (N,) which of the rows are new.
        time: (M,) of those that are kept [s].
        lost: rows that are missing before or between them.
        restarted: how often the clock jumped.
    """

    kept: npt.NDArray[np.bool_]
    time: FloatArray
    lost: int
    restarted: int


class SourceClock:
    """Unwraps a counter (of rows) or a time.

    Args:
        signal: `counter`, a count a row, or `time` [s].
        rate: of the rows [Hz].
    """

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
        """Whether a value of the signal is that of the very next row."""
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
