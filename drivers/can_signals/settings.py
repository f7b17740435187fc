"""The keys of a can_frames connection in a robot file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path

from drivers.can.bus import EXTENDED
from drivers.can_signals import keys
from drivers.can_signals.bits import FRAME_BYTES
from drivers.can_signals.signal_keys import parse_signals
from drivers.can_signals.signals import Part, Signal, check_overlaps, identifier_text, parts_of
from drivers.errors import UsageError

LARGEST_OPTIONS = 100


@dataclass(frozen=True)
class FixedFrame:
    """A frame that is sent as it stands.

    Attributes:
        identifier: `EXTENDED` is added to one of 29 bits.
        data: 0 to 8 bytes.
    """

    identifier: int
    data: bytes


@dataclass(frozen=True)
class Poll:
    """What makes the arm answer with one cycle of its frames.

    Attributes:
        frames: sent one after the other.
        period: [s].
    """

    frames: tuple[FixedFrame, ...]
    period: float


@dataclass(frozen=True)
class CommandTable:
    """How joint positions become frames.

    Attributes:
        parts: one frame each; quantities `position` (one a joint) and `counter` (of the commands).
        templates: identifier → the frame's other bits and its length.
    """

    parts: tuple[Part, ...]
    templates: Mapping[int, bytes] = field(default_factory=dict)


@dataclass(frozen=True)
class CanFramesSettings:
    """An arm whose frames are told by a table.

    Attributes:
        interface, channel, bitrate, options: see `drivers.can.bus.open_bus`.
        rate: of the cycles, nominal [Hz].
        timeout: how long [s] the arm may take until all of its frames have come once.
        signals: what it says.
        cycle: identifier of a frame that begins each cycle and that no signal is in; None for the first signal's frame.
        poll: None where the arm speaks by itself.
        begin: frames that make it speak, sent when the connection is opened.
        end: frames that silence it, sent when the connection is closed.
        start: frames that enable its drives, sent before the first command.
        stop: frames that halt it.
        command: None where the table cannot move the arm.
    """

    interface: str
    channel: str | int
    rate: float
    signals: tuple[Signal, ...]
    bitrate: int = 1_000_000
    options: Mapping[str, object] = field(default_factory=dict)
    timeout: float = 2.0
    cycle: int | None = None
    poll: Poll | None = None
    begin: tuple[FixedFrame, ...] = ()
    end: tuple[FixedFrame, ...] = ()
    start: tuple[FixedFrame, ...] = ()
    stop: tuple[FixedFrame, ...] = ()
    command: CommandTable | None = None

    @property
    def identifiers(self) -> frozenset[int]:
        """Of the frames that are listened to."""
        marker = () if self.cycle is None else (self.cycle,)
        return frozenset((*(signal.identifier for signal in self.signals), *marker))

    @property
    def streams(self) -> tuple[str, ...]:
        """Names of the streams, `joints` first."""
        return tuple(dict.fromkeys(("joints", *(signal.stream for signal in self.signals))))

    def parts(self, stream: str) -> tuple[Part, ...]:
        """What comes together, of one stream."""
        return parts_of([signal for signal in self.signals if signal.stream == stream])


_KEYS = (*(f.name for f in fields(CanFramesSettings)), "dbc", "with")


def parse_settings(
    connection: Mapping[str, object], joints: Sequence[str], folder: Path | None = None
) -> CanFramesSettings:
    """Check a connection's keys.

    Args:
        connection: the keys beside `driver`; `with` belongs to others.
        joints: names of the arm's joints.
        folder: what a relative `dbc` starts at; the current folder where None.

    Raises:
        UsageError: names the key, what was found and what is allowed.
    """
    keys.refuse_unknown(connection, _KEYS, "")
    options = connection.get("options", {})
    if (
        not isinstance(options, Mapping)
        or len(options) > LARGEST_OPTIONS
        or not all(isinstance(key, str) for key in options)
    ):
        raise keys.wrong("options", options, "a mapping of python-can's arguments for this interface")
    channel = connection.get("channel")
    if isinstance(channel, bool) or not isinstance(channel, str | int) or channel == "":
        raise keys.wrong("channel", channel, "what the interface calls its bus, such as can0")
    rate = keys.number(connection, "rate", "", 0.1, 10_000.0, "Hz")
    signals, pick = parse_signals(connection, joints, rate, folder)
    cycle = None
    if connection.get("cycle") is not None:
        cycle = keys.identifier(connection, "cycle", "", allow_extended=True)
        if any(signal.identifier == cycle for signal in signals):
            raise UsageError(
                f"frame {identifier_text(cycle)} has signals of its own",
                where="cycle",
                hint="the first of 'signals' says which frame begins a cycle; 'cycle' is for a frame without signals",
            )
    lists = {name: _frames(connection, name) for name in ("begin", "end", "start", "stop")}
    command = _command(connection, joints, pick)
    if command is not None and not lists["stop"]:
        raise UsageError(
            "a table that moves the arm must also say how it is halted",
            where="stop",
            hint='give its frames, such as [{id: 0x200, data: "00"}]',
        )
    if command is None and lists["start"]:
        raise UsageError("frames that enable the arm, but none that command it", where="start", hint="add 'command'")
    return CanFramesSettings(
        interface=keys.text(connection, "interface", "a bus that python-can knows, such as socketcan"),
        channel=channel,
        rate=rate,
        signals=signals,
        bitrate=keys.whole(connection, "bitrate", "", 1000, 1_000_000, default=1_000_000),
        options=dict(options),
        timeout=keys.number(connection, "timeout", "", 0.1, 300.0, "s", default=2.0),
        cycle=cycle,
        poll=_poll(connection, rate),
        command=command,
        **lists,
    )


def _poll(connection: Mapping[str, object], rate: float) -> Poll | None:
    given = connection.get("poll")
    if given is None:
        return None
    section = keys.mapping(given, "poll")
    keys.refuse_unknown(section, ("id", "data", "extended", "frames", "period"), "poll")
    if ("id" in section) == ("frames" in section):
        raise UsageError("give either 'id' and 'data' of one frame, or 'frames'", where="poll")
    if "frames" in section:
        frames = _frames(section, "frames", "poll.")
        if not frames:
            raise keys.wrong("frames", section["frames"], "at least one frame", "poll")
    else:
        frames = (_frame({key: section[key] for key in section if key != "period"}, "poll"),)
    period = keys.number(section, "period", "poll", 1e-4, 10.0, "s", default=1.0 / rate)
    if abs(period * rate - 1.0) > 0.01:
        raise UsageError(
            f"the period, {period:g} s, contradicts the rate, {rate:g} Hz",
            where="poll.period",
            hint=f"each poll is answered by one cycle: {1 / rate:g} s",
        )
    return Poll(frames, period)


def _command(connection: Mapping[str, object], joints: Sequence[str], pick: keys.Pick) -> CommandTable | None:
    given = connection.get("command")
    if given is None:
        return None
    section = keys.mapping(given, "command")
    keys.refuse_unknown(section, ("quantity", "signals", "frames"), "command")
    if section.get("quantity", "position") != "position":
        raise keys.wrong("quantity", section.get("quantity"), "position; dynid commands nothing else", "command")
    listed = section.get("signals")
    if not isinstance(listed, Sequence) or isinstance(listed, str) or not listed:
        raise keys.wrong("signals", listed, "a list of where each joint's position goes", "command")
    signals = []
    for number, entry in enumerate(listed):
        where = f"command.signals[{number}]"
        entry = keys.mapping(entry, where)
        signal = pick({"quantity": "position", **entry}, where)
        if signal.quantity not in ("position", "counter"):
            raise keys.wrong("quantity", signal.quantity, "position, or counter of the commands", where)
        signals.append(signal)
    named = [signal.joint for signal in signals if signal.quantity == "position"]
    for joint in joints:
        if named.count(joint) != 1:
            raise UsageError(
                f"{named.count(joint) or 'no'} position of joint '{joint}'",
                where="command.signals",
                hint="each joint needs exactly one; an arm is moved as a whole",
            )
    try:
        check_overlaps(signals)
    except ValueError as error:
        raise UsageError(str(error), where="command.signals") from error
    parts = parts_of(signals)
    templates = {frame.identifier: frame.data for frame in _frames(section, "frames", "command.")}
    for identifier in templates:
        if all(part.identifier != identifier for part in parts):
            raise UsageError(f"no signal is in frame {identifier_text(identifier)}", where="command.frames")
    return CommandTable(parts, templates)


def _frames(section: Mapping[str, object], key: str, prefix: str = "") -> tuple[FixedFrame, ...]:
    given = section.get(key)
    if given is None:
        return ()
    if not isinstance(given, Sequence) or isinstance(given, str):
        raise keys.wrong(key, given, 'a list of frames, such as [{id: 0x200, data: "01 00"}]', prefix.rstrip("."))
    return tuple(_frame(keys.mapping(one, f"{prefix}{key}[{n}]"), f"{prefix}{key}[{n}]") for n, one in enumerate(given))


def _frame(section: Mapping[str, object], where: str) -> FixedFrame:
    keys.refuse_unknown(section, ("id", "data", "extended"), where)
    extended = keys.truth(section, "extended", where, default=False)
    identifier = keys.identifier(section, "id", where, allow_extended=extended)
    data = section.get("data", "")
    allowed = f'up to {FRAME_BYTES} bytes in hexadecimal, such as "01 0F"; in quotes'
    if not isinstance(data, str):
        raise keys.wrong("data", data, allowed, where)
    try:
        content = bytes.fromhex(data)
    except ValueError:
        raise keys.wrong("data", data, allowed, where) from None
    if len(content) > FRAME_BYTES:
        raise keys.wrong("data", data, allowed, where)
    return FixedFrame(identifier | (EXTENDED if extended else 0), content)
