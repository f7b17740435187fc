"""Joint positions as command frames."""

from __future__ import annotations

from collections.abc import Sequence

from drivers.can_signals.settings import CommandTable
from drivers.can_signals.table.signals import Signal, encode
from drivers.core.arrays import FloatArray
from drivers.core.errors import DriverStateError


class Commander:
    """Encodes one position after the other; counts them where the table has a counter.

    Args:
        table: of the command frames.
        joints: in the order of every position.
    """

    def __init__(self, table: CommandTable, joints: Sequence[str]) -> None:
        self._table = table
        self._index = {joint: index for index, joint in enumerate(joints)}
        self._count = 0

    def frames(self, position: FloatArray) -> list[tuple[int, bytes]]:
        """The frames (identifier, data) of a joint position (n,) [rad].

        Raises:
            DriverStateError: a joint's position does not fit into its bits.
        """
        frames = []
        for layout in self._table.layouts:
            values = [self._value(signal, position) for signal in layout.signals]
            try:
                data = encode(layout, values, self._table.templates.get(layout.identifier, b""))
            except ValueError as error:
                raise DriverStateError(str(error), hint="the command table cannot express this motion") from error
            frames.append((layout.identifier, data))
        self._count += 1
        return frames

    def _value(self, signal: Signal, position: FloatArray) -> float:
        if signal.quantity == "position":
            return float(position[self._index[signal.joint]])
        low, high = signal.field.range
        return signal.gain * (low + self._count % (high - low + 1.0)) + signal.bias
