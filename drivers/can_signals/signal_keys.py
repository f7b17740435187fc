"""The entries of `signals`: each says where a quantity stands, or which signal of the DBC file it is."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from drivers.can.bus import EXTENDED
from drivers.can_signals import keys
from drivers.can_signals.bits import FRAME_BITS, BitField, ByteOrder
from drivers.can_signals.dbc import Dbc, DbcSignal, load_dbc
from drivers.can_signals.signals import Signal, check_overlaps
from drivers.can_signals.units import FACTORS, to_si
from drivers.errors import UsageError
from drivers.streams import UNITS

WHOLE_ARM = ("time", "counter")
"""Quantities without a joint."""
STREAM_OF: Mapping[str, str] = {"temperature": "thermal", "fault": "status"}
"""Stream of a quantity where the entry names none; all others are in `joints`."""
MOST_SIGNALS = 4096
COUNTER_TURN = 4
"""Fewest rows after which a counter may begin anew: with less, a lost row could not be told from a repeated one."""

_COMMON = ("quantity", "joint", "unit", "stream")
_PLACE = ("id", "extended", "start", "length", "byte_order", "signed", "float", "scale", "offset", "multiplexer")
_FROM_DBC = ("signal", "message")
_STREAM_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,39}")


def parse_signals(
    connection: keys.Section, joints: Sequence[str], rate: float, folder: Path | None
) -> tuple[tuple[Signal, ...], keys.Pick]:
    """The signals of a connection, and what makes signals of further entries.

    Without `signals`, those of the DBC file are taken whose name is a quantity, an underscore and a joint.

    Raises:
        UsageError: names the entry, what was found and what is allowed.
    """
    dbc = None
    if connection.get("dbc") is not None:
        path = Path(keys.text(connection, "dbc", "the path of a DBC file"))
        try:
            dbc = load_dbc(path if folder is None else folder / path)
        except ValueError as error:  # a NUL in the path
            raise UsageError(f"no path: {error}", where="dbc") from error

    def pick(entry: keys.Section, where: str) -> Signal:
        return _signal(entry, where, joints, dbc)

    listed = connection.get("signals")
    if listed is None and dbc is not None:
        entries: list[tuple[keys.Section, str]] = []
        entries += [(entry, f"{dbc.path}: {entry['signal']}") for entry in _named_by_rule(dbc, joints)]
        if not entries:
            raise UsageError(
                "no signal of the DBC file is called after a quantity and a joint",
                where=str(dbc.path),
                hint=f"such as position_{joints[0]}; or list the names of its signals under 'signals'",
            )
    else:
        if not isinstance(listed, Sequence) or isinstance(listed, str) or not listed:
            raise keys.wrong("signals", listed, "a list of signals; or name a DBC file under 'dbc'")
        entries = [(keys.mapping(entry, f"signals[{n}]"), f"signals[{n}]") for n, entry in enumerate(listed)]
    if len(entries) > MOST_SIGNALS:
        raise UsageError(f"{len(entries)} signals are too many", where="signals", hint=f"at most {MOST_SIGNALS}")
    signals = tuple(pick(entry, where) for entry, where in entries)
    _check_together(signals, joints, rate)
    return signals, pick


def _named_by_rule(dbc: Dbc, joints: Sequence[str]) -> list[dict[str, object]]:
    entries: list[dict[str, object]] = []
    for name in dbc.signals:
        if name in WHOLE_ARM:
            entries.append({"quantity": name, "signal": name})
            continue
        for quantity in FACTORS:
            joint = name.removeprefix(f"{quantity}_")
            if joint != name and joint in joints:
                entries.append({"quantity": quantity, "joint": joint, "signal": name})
    return entries


def _signal(entry: keys.Section, where: str, joints: Sequence[str], dbc: Dbc | None) -> Signal:
    quantity = keys.text(entry, "quantity", ", ".join(FACTORS), where)
    if quantity not in FACTORS:
        raise keys.wrong("quantity", quantity, ", ".join(FACTORS), where)
    joint = entry.get("joint")
    if quantity in WHOLE_ARM:
        if joint is not None:
            raise UsageError(f"{quantity} belongs to the whole arm, not to a joint", where=f"{where}.joint")
        joint = ""
    elif not isinstance(joint, str) or joint not in joints:
        raise keys.wrong("joint", joint, ", ".join(joints), where)
    stream = entry.get("stream", STREAM_OF.get(quantity, "joints"))
    if not isinstance(stream, str) or not _STREAM_NAME.fullmatch(stream):
        raise keys.wrong("stream", stream, "a name of letters, digits and underscores", where)
    found = _from_dbc(entry, where, dbc) if "signal" in entry else _from_place(entry, where)
    unit = entry.get("unit", found.unit)
    if not isinstance(unit, str):
        raise keys.wrong("unit", unit, "a text", where)
    try:
        factor, shift = to_si(quantity, unit)
    except ValueError as error:
        raise UsageError(str(error), where=f"{where}.unit") from error
    gain, bias = factor * found.scale, factor * found.offset + shift
    if not 0.0 < abs(gain) < math.inf or not math.isfinite(bias):
        raise keys.wrong("scale", found.scale, "a number other than 0", where)
    return Signal(quantity, joint, found.identifier, found.field, gain, bias, found.multiplexer, found.selector, stream)


def _from_dbc(entry: keys.Section, where: str, dbc: Dbc | None) -> DbcSignal:
    keys.refuse_unknown(entry, (*_COMMON, *_FROM_DBC), where)
    if dbc is None:
        raise UsageError("names a signal of a DBC file, but there is no 'dbc'", where=f"{where}.signal")
    name = keys.text(entry, "signal", "the name of a signal in the DBC file", where)
    if name in dbc.unusable and name not in dbc.signals:
        raise UsageError(f"signal '{name}' cannot be used: {dbc.unusable[name]}", where=where)
    candidates = dbc.signals.get(name, ())
    if not candidates:
        close = difflib.get_close_matches(name, dbc.signals, 1)
        hint = f"did you mean '{close[0]}'?" if close else f"it has {len(dbc.signals)} signals"
        raise UsageError(f"{dbc.path.name} has no signal '{name}'", where=f"{where}.signal", hint=hint)
    message = entry.get("message")
    fitting = [one for one in candidates if message is None or one.message == message]
    if len(fitting) != 1:
        names = ", ".join(one.message for one in candidates)
        raise keys.wrong("message", message, f"one of those that have '{name}': {names}", where)
    return fitting[0]


def _from_place(entry: keys.Section, where: str) -> DbcSignal:
    keys.refuse_unknown(entry, (*_COMMON, *_PLACE), where)
    extended = keys.truth(entry, "extended", where, default=False)
    identifier = keys.identifier(entry, "id", where, allow_extended=extended)
    place = _field(entry, where, "little")
    multiplexer, selector = None, None
    if entry.get("multiplexer") is not None:
        place_of = f"{where}.multiplexer"
        section = keys.mapping(entry["multiplexer"], place_of)
        keys.refuse_unknown(section, ("start", "length", "byte_order", "value"), place_of)
        multiplexer = _field(section, place_of, place.byte_order)
        selector = keys.whole(section, "value", place_of, 0, int(multiplexer.range[1]))
    return DbcSignal(
        "",
        "",
        identifier | (EXTENDED if extended else 0),
        place,
        keys.finite(entry, "scale", where, 1.0),
        keys.finite(entry, "offset", where, 0.0),
        "",
        multiplexer,
        selector,
    )


def _field(section: keys.Section, where: str, default_order: ByteOrder) -> BitField:
    start = keys.whole(section, "start", where, 0, FRAME_BITS - 1)
    length = keys.whole(section, "length", where, 1, FRAME_BITS)
    order = section.get("byte_order", default_order)
    if order not in ("little", "big"):
        raise keys.wrong("byte_order", order, "little (Intel) or big (Motorola)", where)
    signed = keys.truth(section, "signed", where, default=False)
    floating = keys.truth(section, "float", where, default=False)
    try:
        return BitField(start, length, "big" if order == "big" else "little", signed, floating)
    except ValueError as error:
        raise UsageError(str(error), where=where) from error


def _check_together(signals: Sequence[Signal], joints: Sequence[str], rate: float) -> None:
    seen: set[tuple[str, str]] = set()
    for signal in signals:
        if (signal.quantity, signal.joint) in seen:
            raise UsageError(f"{signal.label} is there twice", where="signals")
        seen.add((signal.quantity, signal.joint))
    try:
        check_overlaps(signals)
    except ValueError as error:
        raise UsageError(str(error), where="signals") from error
    for joint in joints:
        if ("position", joint) not in seen:
            raise UsageError(
                f"no position of joint '{joint}'", where="signals", hint="a recording needs the position of every joint"
            )
    _check_streams(signals, joints)
    clocks = [signal for signal in signals if signal.quantity in WHOLE_ARM]
    if len(clocks) > 1:
        raise UsageError(
            f"both {clocks[0].label} and {clocks[1].label} tell the time", where="signals", hint="keep one"
        )
    for clock in clocks:
        _check_clock(clock, rate)


def _check_streams(signals: Sequence[Signal], joints: Sequence[str]) -> None:
    for quantity in UNITS:
        chosen = [signal for signal in signals if signal.quantity == quantity]
        streams = sorted({signal.stream for signal in chosen})
        if len(streams) > 1:
            raise UsageError(f"{quantity} is in several streams: {', '.join(streams)}", where="signals")
        if quantity == "position" and streams != ["joints"]:
            raise UsageError("positions belong to the stream 'joints'", where="signals", hint="leave 'stream' out")
        missing = [joint for joint in joints if all(signal.joint != joint for signal in chosen)]
        if streams == ["joints"] and missing:
            raise UsageError(
                f"{quantity} has no signal for joint '{missing[0]}'",
                where="signals",
                hint="give it for every joint, for none, or in a 'stream' of its own",
            )


def _check_clock(clock: Signal, rate: float) -> None:
    if clock.stream != "joints":
        raise UsageError(f"{clock.quantity} belongs to the stream 'joints'", where="signals", hint="leave 'stream' out")
    if clock.gain <= 0:
        raise UsageError(f"{clock.quantity} runs backwards", where="signals", hint="its scale must be positive")
    if clock.field.floating:
        return
    unit = 1.0 / rate if clock.quantity == "counter" else 1.0
    turn = clock.gain * 2.0**clock.field.length * unit * rate
    if turn < COUNTER_TURN:
        raise UsageError(
            f"{clock.quantity} begins anew after {turn:.3g} rows, too few to count lost ones",
            where="signals",
            hint=f"leave it out, or correct its scale; at least {COUNTER_TURN} rows",
        )
    if clock.gain * unit * rate > 1.0 + 1e-9:
        raise UsageError(
            f"{clock.quantity} has steps of {clock.gain * unit * rate:.3g} rows, too coarse to tell rows apart",
            where="signals",
            hint="leave it out, or correct its scale and unit",
        )
