"""The entries of `signals`: each says where a quantity stands, or which signal of the DBC file it is."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, Self

from pydantic import Discriminator, Field, PrivateAttr, Tag, ValidationInfo, field_validator, model_validator

from drivers.bus_budget import FRAME_BYTES
from drivers.can.bus import EXTENDED
from drivers.can_signals.table.bits import FRAME_BITS, BitField, ByteOrder
from drivers.can_signals.table.dbc import Dbc, DbcSignal
from drivers.can_signals.table.signals import FixedFrame, Signal, check_overlaps
from drivers.connection_settings import ConnectionSettings, refused
from drivers.core.text import did_you_mean
from drivers.core.units import conversion, factors, normalised
from drivers.streams import UNITS

STANDARD_LIMIT = 0x7FF
EXTENDED_LIMIT = 0x1FFFFFFF
ALLOWED_IDENTIFIERS = f"0x0 to 0x{STANDARD_LIMIT:X}, not in quotes; with 'extended: true' up to 0x{EXTENDED_LIMIT:X}"


class IdentifiedKeys(ConnectionSettings):
    """Identifier of a frame."""

    extended: bool = Field(False, description="whether the identifier has 29 bits")
    id: int = Field(description=ALLOWED_IDENTIFIERS)

    @field_validator("id")
    @classmethod
    def _fits(cls, identifier: int | None, info: ValidationInfo) -> int | None:
        limit = EXTENDED_LIMIT if info.data.get("extended", True) else STANDARD_LIMIT
        if identifier is not None and not 0 <= identifier <= limit:
            raise refused(f"{identifier:#x} is not from 0x0 to 0x{limit:X}")
        return identifier

    @property
    def identifier(self) -> int:
        """The frame's identifier, with `EXTENDED` added to one of 29 bits."""
        return self.id | (EXTENDED if self.extended else 0)


class FrameKeys(IdentifiedKeys):
    """A frame that is sent as it stands."""

    data: str = Field("", description=f'up to {FRAME_BYTES} bytes in hexadecimal, such as "01 0F"; in quotes')

    @field_validator("data")
    @classmethod
    def _bytes(cls, data: str) -> str:
        try:
            count = len(bytes.fromhex(data))
        except ValueError:
            raise refused(f"{data!r} is not hexadecimal") from None
        if count > FRAME_BYTES:
            raise refused(f"has {count} bytes")
        return data

    @property
    def frame(self) -> FixedFrame:
        """The frame."""
        return FixedFrame(self.identifier, bytes.fromhex(self.data))


class BitKeys(ConnectionSettings):
    """Bits of a frame."""

    start: int = Field(ge=0, le=FRAME_BITS - 1, description="the first bit")
    length: int = Field(ge=1, le=FRAME_BITS, description="[bit]")


class MultiplexerKeys(BitKeys):
    """Bits that say what else is in the frame."""

    byte_order: Literal["little", "big"] | None = Field(None, description="Intel or Motorola; left out, the signal's")
    value: int = Field(ge=0, description="of the multiplexer, 0 or more, with which the signal is in the frame")


WHOLE_ARM = ("time", "counter")
"""Quantities without a joint."""
STREAM_OF: Mapping[str, str] = {"temperature": "thermal", "fault": "status"}
"""Stream of a quantity where the entry names none; all others are in `joints`."""
COUNTER_TURN = 4
"""Fewest rows after which a counter may begin anew: with less, a lost row is indistinguishable from a repeated one."""


_ANGLE = factors("rad", "mrad", "urad", "deg", "mdeg", "rev")
_VELOCITY = factors(*(f"{unit}/s" for unit in _ANGLE), "rpm", "1/min")
_ACCELERATION = factors(*(f"{unit}/s^2" for unit in _ANGLE), "rpm/s")
_CURRENT = factors("a", "ma")
_TORQUE = factors("nm", "mnm", "cnm", "knm")
_NONE = factors("1", "")

FACTORS: Mapping[str, Mapping[str, float]] = {
    "position": _ANGLE,
    "velocity": _VELOCITY,
    "acceleration": _ACCELERATION,
    "current": _CURRENT,
    "voltage": factors("v", "mv"),
    "torque": _TORQUE,
    "temperature": factors("degc", "c", "k", "degf", "f"),
    "target_position": _ANGLE,
    "target_velocity": _VELOCITY,
    "target_acceleration": _ACCELERATION,
    "target_current": _CURRENT,
    "target_torque": _TORQUE,
    "time": factors("s", "ms", "us", "ns"),
    "counter": _NONE,
    "fault": _NONE,
}
"""Quantity → unit, as `normalised` spells it → factor; a temperature's unit may have an offset too, see `to_si`."""


def to_si(quantity: str, unit: str) -> tuple[float, float]:
    """Factor and offset so that SI = factor · value + offset.

    Raises:
        ValueError: the quantity does not have this unit; says which it may have.
    """
    allowed = FACTORS[quantity]
    spelled = normalised(unit)
    if spelled not in allowed:
        given = f"unit '{unit}'" if unit else "no unit"
        raise ValueError(f"{given} of {quantity} cannot be converted; allowed: {', '.join(filter(None, allowed))}")
    return conversion(spelled)


class SignalKeys(ConnectionSettings):
    """What an entry says beside the place; the validation's context has `joints` and `dbc`."""

    quantity: str = Field(description=", ".join(FACTORS))
    joint: str = Field("", validate_default=True, description="the name of a joint")
    unit: str | None = Field(None, description="the unit of the signal's values")
    stream: str | None = Field(
        None, pattern=r"^[A-Za-z][A-Za-z0-9_]{0,39}$", description="a name of letters, digits and underscores"
    )
    _signal: Signal = PrivateAttr()

    @property
    def signal(self) -> Signal:
        """The signal that the entry describes."""
        return self._signal

    @field_validator("quantity")
    @classmethod
    def _known(cls, quantity: str) -> str:
        if quantity not in FACTORS:
            raise refused(f"{quantity!r} is not a quantity")
        return quantity

    @field_validator("joint")
    @classmethod
    def _of_the_arm(cls, joint: str, info: ValidationInfo) -> str:
        joints, quantity = (info.context or {})["joints"], info.data.get("quantity")
        if quantity in WHOLE_ARM and joint:
            raise refused(f"{quantity} belongs to the whole arm, not to a joint", "leave it out")
        if quantity is not None and quantity not in WHOLE_ARM and joint not in joints:
            raise refused(f"{joint!r} is not a joint", f"allowed: {', '.join(joints)}")
        return joint

    @model_validator(mode="after")
    def _resolve(self, info: ValidationInfo) -> Self:
        place = self._place(info.context or {})
        try:
            factor, shift = to_si(self.quantity, place.unit if self.unit is None else self.unit)
        except ValueError as error:
            raise refused(str(error)) from error
        gain, bias = factor * place.scale, factor * place.offset + shift
        if not 0.0 < abs(gain) < math.inf or not math.isfinite(bias):
            raise refused(f"scale {place.scale:g} with offset {place.offset:g}", "a scale other than 0")
        stream = self.stream or STREAM_OF.get(self.quantity, "joints")
        bits = place.identifier, place.field, gain, bias, place.multiplexer, place.selector
        self._signal = Signal(self.quantity, self.joint, *bits, stream)
        return self

    def _place(self, context: Mapping[str, Any]) -> DbcSignal:
        raise NotImplementedError


class NamedSignal(SignalKeys):
    """A signal of the DBC file."""

    signal_name: str = Field(alias="signal", description="the name of a signal in the DBC file")
    message: str | None = Field(None, description="the message that contains it, if several do")

    def _place(self, context: Mapping[str, Any]) -> DbcSignal:
        name = self.signal_name
        dbc: Dbc | None = context["dbc"]
        if dbc is None:
            raise refused(f"signal '{name}' is one of a DBC file, but there is no 'dbc'")
        if name in dbc.unusable and name not in dbc.signals:
            raise refused(f"signal '{name}' cannot be used: {dbc.unusable[name]}")
        candidates = dbc.signals.get(name, ())
        if not candidates:
            hint = did_you_mean(name, dbc.signals) or f"it has {len(dbc.signals)} signals"
            raise refused(f"{dbc.path.name} has no signal '{name}'", hint)
        fitting = [candidate for candidate in candidates if self.message in (None, candidate.message)]
        if len(fitting) != 1:
            names = ", ".join(candidate.message for candidate in candidates)
            given = "is missing" if self.message is None else f"is {self.message!r}"
            raise refused(f"'message' {given}", f"allowed: one of those that have '{name}': {names}")
        return fitting[0]


class PlacedSignal(SignalKeys, IdentifiedKeys, BitKeys):
    """A signal by its bits."""

    byte_order: Literal["little", "big"] = Field("little", description="Intel or Motorola")
    signed: bool = Field(False, description="two's complement")
    floating: bool = Field(False, alias="float", description="IEEE 754")
    scale: float = Field(1.0, description="of a count, other than 0")
    offset: float = Field(0.0, description="in the signal's unit")
    multiplexer: MultiplexerKeys | None = Field(
        None, description="a mapping of keys such as {start: 0, length: 8, value: 1}"
    )

    def _place(self, context: Mapping[str, Any]) -> DbcSignal:
        own = _field(self, self.byte_order, signed=self.signed, floating=self.floating)
        if (keys := self.multiplexer) is None:
            return DbcSignal("", "", self.identifier, own, self.scale, self.offset, "")
        multiplexer = _field(keys, keys.byte_order or self.byte_order)
        if keys.value > multiplexer.range[1]:
            raise refused(f"multiplexer.value is {keys.value}", f"allowed: 0 to {int(multiplexer.range[1])}")
        return DbcSignal("", "", self.identifier, own, self.scale, self.offset, "", multiplexer, keys.value)


def _field(keys: BitKeys, order: ByteOrder, *, signed: bool = False, floating: bool = False) -> BitField:
    try:
        return BitField(keys.start, keys.length, order, signed, floating)
    except ValueError as error:
        raise refused(str(error)) from error


def _kind(entry: object) -> str:
    named = isinstance(entry, NamedSignal) or (isinstance(entry, dict) and "signal" in entry)
    return NamedSignal.__name__ if named else PlacedSignal.__name__


SignalEntry = Annotated[
    Annotated[PlacedSignal, Tag(PlacedSignal.__name__)] | Annotated[NamedSignal, Tag(NamedSignal.__name__)],
    Discriminator(_kind),
]


def entries_named_by_rule(dbc: Dbc, joints: Sequence[str]) -> list[dict[str, object]]:
    """Entries for the signals of a DBC file whose name is a quantity, an underscore and a joint."""
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


def check_together(signals: Sequence[Signal], joints: Sequence[str], rate: float | None) -> None:
    """Refuse signals that make no table; the clock is not checked where the rate [Hz] is None."""
    seen: set[tuple[str, str]] = set()
    for signal in signals:
        if (signal.quantity, signal.joint) in seen:
            raise refused(f"{signal.label} appears twice")
        seen.add((signal.quantity, signal.joint))
    require_no_overlap(signals)
    for joint in joints:
        if ("position", joint) not in seen:
            raise refused(f"no position of joint '{joint}'", "a recording needs the position of every joint")
    _check_streams(signals, joints)
    clocks = [signal for signal in signals if signal.quantity in WHOLE_ARM]
    if len(clocks) > 1:
        raise refused(f"both {clocks[0].label} and {clocks[1].label} are times", "keep one")
    for clock in clocks:
        _check_clock(clock, rate)


def require_no_overlap(signals: Sequence[Signal]) -> None:
    """Refuse signals that share bits."""
    try:
        check_overlaps(signals)
    except ValueError as error:
        raise refused(str(error)) from error


def _check_streams(signals: Sequence[Signal], joints: Sequence[str]) -> None:
    for quantity in UNITS:
        chosen = [signal for signal in signals if signal.quantity == quantity]
        streams = sorted({signal.stream for signal in chosen})
        if len(streams) > 1:
            raise refused(f"{quantity} is in several streams: {', '.join(streams)}")
        if quantity == "position" and streams != ["joints"]:
            raise refused("positions belong to the stream 'joints'", "leave 'stream' out")
        missing = [joint for joint in joints if all(signal.joint != joint for signal in chosen)]
        if streams == ["joints"] and missing:
            raise refused(
                f"{quantity} has no signal for joint '{missing[0]}'",
                "give it for every joint, for none, or in a 'stream' of its own",
            )


def _check_clock(clock: Signal, rate: float | None) -> None:
    if clock.stream != "joints":
        raise refused(f"{clock.quantity} belongs to the stream 'joints'", "leave 'stream' out")
    if clock.gain <= 0:
        raise refused(f"{clock.quantity} decreases", "its scale must be positive")
    if clock.field.floating or rate is None:
        return
    step = clock.gain * (1.0 if clock.quantity == "counter" else rate)  # rows per count
    turn = step * 2.0**clock.field.length
    if turn < COUNTER_TURN:
        raise refused(
            f"{clock.quantity} begins anew after {turn:.3g} rows, too few to count lost ones",
            f"leave it out, or correct its scale; at least {COUNTER_TURN} rows",
        )
    if step > 1.0 + 1e-9:
        raise refused(
            f"{clock.quantity} has steps of {step:.3g} rows, too coarse to tell rows apart",
            "leave it out, or correct its scale and unit",
        )
