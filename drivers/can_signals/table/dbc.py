"""Signals of a DBC file, read through cantools."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.bus_budget import FRAME_BYTES
from drivers.can.bus import EXTENDED
from drivers.can_signals.table.bits import BitField, ByteOrder
from drivers.can_signals.table.signals import identifier_text
from drivers.core.errors import UsageError
from drivers.core.files import DBC_FILE, read_bytes


@dataclass(frozen=True)
class DbcSignal:
    """A signal as the DBC file has it: physical value = scale · number + offset, in `unit`."""

    name: str  # of the signal
    message: str  # name of its message
    identifier: int  # of the frame; `EXTENDED` is added to one of 29 bits
    field: BitField  # its bits
    # scale, offset, unit: as they stand there
    scale: float
    offset: float
    unit: str
    multiplexer: BitField | None = None  # bits that say what else is in the frame; None without one
    selector: int | None = None  # the multiplexer's value with which this signal is in the frame; None without one


@dataclass(frozen=True)
class Dbc:
    """A DBC file."""

    path: Path  # of the file
    # name → signals of this name, one a message that has it; multiplexers are left out
    signals: Mapping[str, tuple[DbcSignal, ...]]
    unusable: Mapping[str, str]  # name → why the signal cannot be used


def load_dbc(path: Path) -> Dbc:
    """Read a DBC file.

    Raises:
        UsageError: cantools is missing, or the file cannot be read, is no DBC, or lets signals overlap.
    """
    try:
        import cantools
    except ImportError as error:
        raise UsageError(
            "a DBC file needs the package cantools", where=str(path), hint="pip install 'dynid[dbc]'"
        ) from error
    text = _text(read_bytes(path, DBC_FILE, UsageError))
    try:
        database = cantools.database.load_string(text, database_format="dbc", strict=True)
    except Exception as error:  # cantools lets those of its parser through, of many kinds
        raise UsageError(
            f"not a usable DBC file: {str(error) or type(error).__name__}",
            where=str(path),
            hint="overlapping signals and signals outside their message are refused",
        ) from error
    signals: dict[str, list[DbcSignal]] = {}
    unusable: dict[str, str] = {}
    for message in getattr(database, "messages", ()):
        by_name = {signal.name: signal for signal in message.signals}
        for signal in message.signals:
            if signal.is_multiplexer:
                continue
            try:
                converted = _signal(message, signal, by_name)
            except ValueError as error:
                unusable[signal.name] = f"{error} (message {message.name})"
            else:
                signals.setdefault(signal.name, []).append(converted)
    return Dbc(path, {name: tuple(all_of_name) for name, all_of_name in signals.items()}, unusable)


def _text(content: bytes) -> str:
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError:
        return content.decode("cp1252", errors="replace")  # what DBC editors write


def _signal(message: Any, signal: Any, by_name: Mapping[str, Any]) -> DbcSignal:
    identifier = message.frame_id | (EXTENDED if message.is_extended_frame else 0)
    if message.length > FRAME_BYTES:
        raise ValueError(f"frame {identifier_text(identifier)} has {message.length} bytes; CAN FD is not supported")
    multiplexer, selector = None, None
    if signal.multiplexer_signal is not None:
        selecting = by_name[signal.multiplexer_signal]
        if selecting.multiplexer_signal is not None:
            raise ValueError(f"its multiplexer {selecting.name} is itself multiplexed, which is not supported")
        values = signal.multiplexer_ids or []
        if len(values) != 1:
            raise ValueError(f"it is present for {len(values)} values of its multiplexer, which is not supported")
        multiplexer, selector = _field(selecting), int(values[0])
    return DbcSignal(
        signal.name,
        message.name,
        identifier,
        _field(signal),
        float(signal.scale),
        float(signal.offset),
        signal.unit or "",
        multiplexer,
        selector,
    )


def _field(signal: Any) -> BitField:
    order: ByteOrder = "little" if signal.byte_order == "little_endian" else "big"
    return BitField(int(signal.start), int(signal.length), order, bool(signal.is_signed), bool(signal.is_float))
