"""The keys of a can_frames connection in a robot file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import Field, ValidationInfo, field_validator, model_validator

from drivers.can.bus import EXTENDED
from drivers.can.settings import CanSettings
from drivers.can_signals.table.dbc import Dbc, load_dbc
from drivers.can_signals.table.signal_keys import (
    ALLOWED_IDENTIFIERS,
    EXTENDED_LIMIT,
    STANDARD_LIMIT,
    FrameKeys,
    SignalEntry,
    check_together,
    entries_named_by_rule,
    require_no_overlap,
)
from drivers.can_signals.table.signals import FixedFrame, FrameLayout, Signal, frame_layouts, identifier_text
from drivers.connection_settings import ConnectionSettings, Entries, Text, read_settings, refused
from drivers.core.errors import UsageError

MOST_SIGNALS = 4096
_FRAMES = 'a list of frames, such as [{id: 0x200, data: "01 00"}]'


class PollKeys(FrameKeys):
    """What makes the arm answer with one cycle of its frames: one frame, or several."""

    id: int | None = Field(None, description=ALLOWED_IDENTIFIERS)  # type: ignore[assignment]
    frames: Entries[FrameKeys] = Field((), description=_FRAMES)
    period: float | None = Field(None, ge=1e-4, le=10, description="[s]; left out, that of the rate")

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        if (self.id is None) == (not self.frames):
            raise refused("give either 'id' and 'data' of one frame, or 'frames', at least one frame")
        return self


class CommandKeys(ConnectionSettings):
    """Places of joint positions in frames that command the arm."""

    quantity: Literal["position"] = Field("position", description="dynid commands positions only")
    signals: Entries[SignalEntry] = Field(
        max_length=MOST_SIGNALS, description="a list of where each joint's position goes"
    )
    frames: Entries[FrameKeys] = Field((), description=f"the frames' other bits, {_FRAMES}")

    @field_validator("signals", mode="before")
    @classmethod
    def _positions(cls, signals: Any) -> Any:
        if not isinstance(signals, list):
            return signals
        return [{"quantity": "position", **signal} if isinstance(signal, dict) else signal for signal in signals]

    @field_validator("signals")
    @classmethod
    def _whole_arm(cls, entries: tuple[SignalEntry, ...], info: ValidationInfo) -> tuple[SignalEntry, ...]:
        signals = [entry.signal for entry in entries]
        for signal in signals:
            if signal.quantity not in ("position", "counter"):
                raise refused(f"{signal.label}", "allowed: position, or counter of the commands")
        named = [signal.joint for signal in signals if signal.quantity == "position"]
        for joint in (info.context or {})["joints"]:
            if named.count(joint) != 1:
                raise refused(
                    f"{named.count(joint) or 'no'} position of joint '{joint}'",
                    "each joint needs exactly one; an arm moves as a whole",
                )
        require_no_overlap(signals)
        return entries

    @model_validator(mode="after")
    def _templates_of_signals(self) -> Self:
        for frame in self.frames:
            if all(entry.signal.identifier != frame.identifier for entry in self.signals):
                raise refused(f"no signal is in frame {identifier_text(frame.identifier)}")
        return self


class CanFramesKeys(CanSettings):
    """The connection's keys, as the file has them."""

    rate: float = Field(ge=0.1, le=10_000, description="[Hz] of the cycles")
    timeout: float = Field(
        2.0, ge=0.1, le=300, description="[s] within which all of the arm's frames must have arrived once"
    )
    dbc: Text | None = Field(None, description="the path of a DBC file")
    signals: Entries[SignalEntry] = Field(
        max_length=MOST_SIGNALS,
        description=f"a list of mappings of keys, at most {MOST_SIGNALS}; or name a DBC file under 'dbc'",
    )
    cycle: int | None = Field(
        None,
        ge=0,
        le=EXTENDED_LIMIT,
        description="the identifier, not in quotes, of a frame that begins each cycle and has no signals",
    )
    poll: PollKeys | None = Field(None, description='a mapping such as {id: 0x100, data: "01"}')
    begin: Entries[FrameKeys] = Field((), description=f"{_FRAMES}, sent when the connection is opened")
    end: Entries[FrameKeys] = Field((), description=f"{_FRAMES}, sent when the connection is closed")
    start: Entries[FrameKeys] = Field((), description=f"{_FRAMES}, that enable the drives")
    stop: Entries[FrameKeys] = Field((), description=f"{_FRAMES}, that halt the arm")
    command: CommandKeys | None = Field(None, description="a mapping of keys with the list 'signals'")
    watchdog: float | None = Field(
        None, ge=1e-3, le=60, description="[s] without a command after which the arm stops by itself; default: unknown"
    )

    @field_validator("signals")
    @classmethod
    def _table(cls, entries: tuple[SignalEntry, ...], info: ValidationInfo) -> tuple[SignalEntry, ...]:
        check_together([entry.signal for entry in entries], (info.context or {})["joints"], info.data.get("rate"))
        return entries

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.cycle is not None and any(entry.signal.identifier == self.marker for entry in self.signals):
            raise refused(
                f"key 'cycle': frame {identifier_text(self.cycle)} has signals of its own",
                "the first of 'signals' says which frame begins a cycle; 'cycle' is for a frame without signals",
            )
        if self.poll is not None and self.poll.period is not None and abs(self.poll.period * self.rate - 1.0) > 0.01:
            raise refused(
                f"key 'poll.period': {self.poll.period:g} s contradicts the rate, {self.rate:g} Hz",
                f"each poll is answered by one cycle: {1 / self.rate:g} s",
            )
        if self.command is not None and not self.stop:
            raise refused(
                "key 'stop': a table that moves the arm must also define how it is halted",
                'give its frames, such as [{id: 0x200, data: "00"}]',
            )
        if self.command is None and self.watchdog is not None:
            raise refused(
                "key 'watchdog': the arm's watchdog of commands, but nothing that commands it", "add 'command'"
            )
        if self.command is None and self.start:
            raise refused("key 'start': frames that enable the arm, but none that command it", "add 'command'")
        return self

    @property
    def marker(self) -> int | None:
        """Identifier of the frame that begins a cycle, with `EXTENDED` added to one of 29 bits."""
        return self.cycle | EXTENDED if self.cycle is not None and self.cycle > STANDARD_LIMIT else self.cycle


@dataclass(frozen=True)
class Poll:
    """What makes the arm answer with one cycle of its frames."""

    frames: tuple[FixedFrame, ...]  # sent one after the other
    period: float  # [s]


@dataclass(frozen=True)
class CommandTable:
    """How joint positions become frames."""

    # one frame each; quantities `position` (one a joint) and `counter` (of the commands)
    layouts: tuple[FrameLayout, ...]
    templates: Mapping[int, bytes]  # identifier → the frame's other bits and its length


@dataclass(frozen=True)
class CanFramesSettings:
    """An arm whose frames are described by a table."""

    keys: CanFramesKeys  # as the file has them
    signals: tuple[Signal, ...]  # what it says
    poll: Poll | None  # None where the arm speaks by itself
    begin: tuple[FixedFrame, ...]  # frames that make it speak, sent when the connection is opened
    end: tuple[FixedFrame, ...]  # frames that silence it, sent when the connection is closed
    start: tuple[FixedFrame, ...]  # frames that enable its drives, sent before the first command
    stop: tuple[FixedFrame, ...]  # frames that halt it
    command: CommandTable | None  # None where the table cannot move the arm

    @property
    def identifiers(self) -> frozenset[int]:
        """Identifiers of the frames that are listened to."""
        marker = () if self.keys.marker is None else (self.keys.marker,)
        return frozenset((*(signal.identifier for signal in self.signals), *marker))

    @property
    def streams(self) -> tuple[str, ...]:
        """Names of the streams, `joints` first."""
        return tuple(dict.fromkeys(("joints", *(signal.stream for signal in self.signals))))

    def frame_layouts(self, stream: str) -> tuple[FrameLayout, ...]:
        """Return what comes together, of one stream."""
        return frame_layouts([signal for signal in self.signals if signal.stream == stream])


def parse_settings(
    connection: Mapping[str, object], joints: Sequence[str], folder: Path | None = None
) -> CanFramesSettings:
    """Check a connection's keys.

    Without `signals`, those of the DBC file are chosen whose name is a quantity, an underscore and a joint.

    A relative `dbc` starts at `folder`, the current folder where None.

    Raises:
        UsageError: names every key that is wrong, what was found and what is allowed; or the DBC file cannot be used.
    """
    dbc = _dbc(connection.get("dbc"), folder)
    if dbc is not None and connection.get("signals") is None:
        entries = entries_named_by_rule(dbc, joints)
        if not entries:
            raise UsageError(
                "no signal of the DBC file is named after a quantity and a joint",
                where=str(dbc.path),
                hint=f"such as position_{joints[0]}; or list the names of its signals under 'signals'",
            )
        connection = {**connection, "signals": entries}
    keys = read_settings(CanFramesKeys, connection, "can_frames", {"joints": joints, "dbc": dbc})
    poll, command = keys.poll, keys.command
    return CanFramesSettings(
        keys,
        tuple(entry.signal for entry in keys.signals),
        None if poll is None else Poll(_frames(poll.frames or (poll,)), poll.period or 1.0 / keys.rate),
        _frames(keys.begin),
        _frames(keys.end),
        _frames(keys.start),
        _frames(keys.stop),
        None if command is None else _command(command),
    )


def _dbc(path: object, folder: Path | None) -> Dbc | None:
    if not isinstance(path, str) or not path.strip():
        return None  # absent, or refused with the other keys
    return load_dbc((folder or Path()) / path.strip())


def _command(keys: CommandKeys) -> CommandTable:
    frames = _frames(keys.frames)
    return CommandTable(
        frame_layouts([entry.signal for entry in keys.signals]), {frame.identifier: frame.data for frame in frames}
    )


def _frames(keys: Sequence[FrameKeys]) -> tuple[FixedFrame, ...]:
    return tuple(key.frame for key in keys)
