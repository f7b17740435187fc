"""A table of CAN signals: which bits of which frame are which quantity of which joint, decoded in batches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from drivers.bus_budget import FRAME_BYTES
from drivers.can.bus import EXTENDED, Frame
from drivers.can_signals.table.bits import BitField, Payloads, stack
from drivers.core.arrays import FloatArray


@dataclass(frozen=True)
class Signal:
    """A number in a frame, as one quantity of one joint: SI = gain · number + bias."""

    quantity: str  # position, current, …; also time, counter, fault
    joint: str  # its name; empty for a quantity of the whole arm
    identifier: int  # of the frame; `EXTENDED` is added to one of 29 bits
    field: BitField  # its bits
    gain: float = 1.0  # SI (°C) a count
    bias: float = 0.0  # SI (°C) at count 0
    # bits of the frame that say what else is in it; None where it is always the same
    multiplexer: BitField | None = None
    selector: int | None = None  # the multiplexer's value with which this signal is in the frame; None without one
    stream: str = "joints"  # where its samples go

    @property
    def label(self) -> str:
        """Return what a message calls it."""
        return f"{self.quantity} of {self.joint}" if self.joint else self.quantity

    @property
    def limits(self) -> tuple[float, float]:
        """Lowest and highest value that its bits hold."""
        low, high = sorted(self.gain * number + self.bias for number in self.field.range)
        return low, high

    def values(self, payloads: Payloads) -> FloatArray:
        """Values (N,) in frames (N, 8)."""
        return np.asarray(self.gain * self.field.decode(payloads) + self.bias)

    def encode(self, value: float) -> int:
        """A frame, as a little-endian number of 64 bits, that holds this value to the nearest count, and zeros.

        Raises:
            ValueError: the value does not fit.
        """
        return self.field.encode((value - self.bias) / self.gain)


@dataclass(frozen=True)
class FixedFrame:
    """A frame that is sent as it stands."""

    identifier: int  # `EXTENDED` is added to one of 29 bits
    data: bytes  # 0 to 8 bytes


@dataclass(frozen=True)
class FrameLayout:
    """Signals of a table that come together: those of one frame, for one value of its multiplexer."""

    identifier: int  # of the frame
    selector: int | None  # value of the multiplexer; None without one
    multiplexer: BitField | None  # its bits; None without one
    signals: tuple[Signal, ...]  # the signals, in the table's order
    size: int  # bytes that the frame must have

    @property
    def label(self) -> str:
        """Return what a message calls it."""
        which = "" if self.selector is None else f" with {self.selector} in its multiplexer"
        return f"frame {identifier_text(self.identifier)}{which} ({', '.join(signal.label for signal in self.signals)})"


def frame_layouts(signals: Sequence[Signal]) -> tuple[FrameLayout, ...]:
    """The signals' layouts, in the order in which the signals name them."""
    grouped: dict[tuple[int, int | None], list[Signal]] = {}
    for signal in signals:
        grouped.setdefault((signal.identifier, signal.selector), []).append(signal)
    layouts = []
    for (identifier, selector), members in grouped.items():
        multiplexer = next((signal.multiplexer for signal in members), None)
        fields = [signal.field for signal in members] + ([multiplexer] if multiplexer is not None else [])
        size = max(field.size for field in fields)
        layouts.append(FrameLayout(identifier, selector, multiplexer, tuple(members), size))
    return tuple(layouts)


def check_overlaps(signals: Sequence[Signal]) -> None:
    """See that no bit has two meanings, and that all of a frame agree on its multiplexer.

    Raises:
        ValueError: names the signals and the frame.
    """
    by_frame: dict[int, list[Signal]] = {}
    for signal in signals:
        by_frame.setdefault(signal.identifier, []).append(signal)
    for identifier, members in by_frame.items():
        where = f"in frame {identifier_text(identifier)}"
        multiplexed = [signal for signal in members if signal.multiplexer is not None]
        for signal in multiplexed[1:]:
            if _place(signal.multiplexer) != _place(multiplexed[0].multiplexer):
                raise ValueError(f"{multiplexed[0].label} and {signal.label} have different multiplexers {where}")
        for signal in members:
            for other in multiplexed[:1]:
                if other.multiplexer is not None and signal.field.bits & other.multiplexer.bits:
                    raise ValueError(f"{signal.label} overlaps the multiplexer {where}")
        for signal, other in combinations(members, 2):
            apart = signal.selector is not None and other.selector is not None and signal.selector != other.selector
            shared = signal.field.bits & other.field.bits
            if shared and not apart:
                raise ValueError(f"{signal.label} and {other.label} overlap {where}, bit {min(shared)}")


def _place(field: BitField | None) -> frozenset[int] | None:
    return field.bits if field is not None else None


@dataclass(frozen=True)
class FrameBatch:
    """Frames of one identifier."""

    order: npt.NDArray[np.int64]  # (N,) their numbers among all frames that were taken together
    payloads: Payloads  # (N, 8)
    sizes: npt.NDArray[np.int64]  # (N,) data bytes


def batches(frames: Sequence[Frame]) -> Mapping[int, FrameBatch]:
    """Frames by their identifier."""
    grouped: dict[int, list[int]] = {}
    for number, (_, identifier, _) in enumerate(frames):
        grouped.setdefault(identifier, []).append(number)
    return {
        identifier: FrameBatch(
            np.array(numbers),
            stack([frames[number][2] for number in numbers]),
            np.array([len(frames[number][2]) for number in numbers]),
        )
        for identifier, numbers in grouped.items()
    }


def decode(layout: FrameLayout, batch: FrameBatch) -> tuple[npt.NDArray[np.int64], FloatArray, int]:
    """Return what the frames of a layout's identifier say about it.

    Returns:
        (M,) numbers of the frames that hold it; (M, k) values of its signals; how many frames were too short.
    """
    held = batch.sizes >= layout.size
    if layout.multiplexer is not None:
        # A frame that is too short may not even hold its multiplexer; then it is unknown whether it is this layout.
        with_selector = batch.sizes >= layout.multiplexer.size
        chosen = layout.multiplexer.raw(batch.payloads) == np.uint64(layout.selector or 0)
        short = int(np.sum(with_selector & chosen & ~held))
        held = held & chosen
    else:
        short = int(np.sum(~held))
    payloads = batch.payloads if held.all() else batch.payloads[held]
    values = np.empty((len(payloads), len(layout.signals)))
    for column, signal in enumerate(layout.signals):
        values[:, column] = signal.values(payloads)
    return batch.order[held], values, short


def encode(layout: FrameLayout, values: Sequence[float], template: bytes = b"") -> bytes:
    """A frame that holds these values of a layout's signals; its other bits and its length are the template's.

    Raises:
        ValueError: a value does not fit; names its signal.
    """
    size = max(len(template), layout.size)
    word = int.from_bytes(template, "little")
    for signal, value in zip(layout.signals, values, strict=True):
        try:
            placed = signal.encode(value)
        except ValueError as error:
            low, high = signal.limits
            raise ValueError(
                f"{signal.label}, {value:.6g}, does not fit into its {signal.field.length} bits, which hold "
                f"{low:.6g} to {high:.6g}"
            ) from error
        word = _put(word, signal.field, placed)
    if layout.multiplexer is not None:
        word = _put(word, layout.multiplexer, layout.multiplexer.encode(float(layout.selector or 0)))
    return word.to_bytes(FRAME_BYTES, "little")[:size]


def _put(word: int, field: BitField, placed: int) -> int:
    mask = sum(1 << bit for bit in field.bits)
    return word & ~mask | placed


def identifier_text(identifier: int) -> str:
    """An identifier as people write it."""
    return f"0x{identifier & ~EXTENDED:08X}" if identifier & EXTENDED else f"0x{identifier:03X}"
