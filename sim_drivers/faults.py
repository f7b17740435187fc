"""Faults on request, of simulated controllers, drives, buses and sensors.

`FAULTS` is the table of all of them: the typed word, its arguments, and the servers that obey it. What each does is in
docs/faults.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from drivers.core.errors import UsageError


@dataclass(frozen=True)
class Fault:
    """A fault that a person asks for."""

    word: str  # as typed
    values: tuple[Any, ...] = ()  # of its arguments; of a joint its index


ServerKind = str
"""Who obeys a fault, in words; the arm at rest is one that only its thermometer watches."""


STICKING = ("position", "velocity", "current", "torque", "temperature")
"""Quantities that can stick."""


def joint_index(text: str, joints: Sequence[str]) -> int:
    """The index of a joint that goes by its name, or its number from 1.

    Raises:
        UsageError: there is no such joint.
    """
    if text in joints:
        return joints.index(text)
    if text.isdecimal() and 1 <= int(text) <= len(joints):
        return int(text) - 1
    raise UsageError(f"no joint is called '{text}'", hint=f"1 to {len(joints)}, or {', '.join(joints)}")


def _identifier(text: str, _: Sequence[str]) -> int:
    try:
        return int(text, 0)
    except ValueError:
        raise UsageError(f"'{text}' is not an identifier", hint="such as 0x182") from None


def _number(above: float, most: float) -> Callable[[str, Sequence[str]], float | None]:
    def read(text: str, _: Sequence[str]) -> float | None:
        try:
            value = float(text)
        except ValueError:
            return None
        return value if above < value <= most and math.isfinite(value) else None

    return read


@dataclass(frozen=True)
class Argument:
    """An argument of a fault."""

    name: str  # in the usage text
    unit: str  # of its value; empty for a count, a joint or an identifier
    # gives the value of a text, on an arm with these joint names; None outside its bounds
    read: Callable[[str, Sequence[str]], float | str | None]


COUNT = Argument("N", "", lambda text, _: int(text) if text.isdecimal() and int(text) > 0 else None)
SECONDS = Argument("SECONDS", "s", _number(0.0, math.inf))
CELSIUS = Argument("CELSIUS", "K", _number(0.0, 1000.0))
JUMP = Argument("JUMP", "s", _number(-math.inf, math.inf))
SPEED = Argument("RAD/S", "rad/s", _number(-math.inf, math.inf))
JOINT = Argument("JOINT", "", joint_index)
QUANTITY = Argument("QUANTITY", "", lambda text, _: text if text in STICKING else None)
VARIABLE = Argument("VARIABLE", "", lambda text, _: text)
IDENTIFIER = Argument("IDENTIFIER", "", _identifier)


@dataclass(frozen=True)
class FaultEntry:
    """A row of the table of faults."""

    word: str  # as typed
    arguments: tuple[Argument, ...]  # behind it
    servers: tuple[ServerKind, ...]  # that obey it

    @property
    def usage(self) -> str:
        """The word and its arguments."""
        return " ".join([self.word, *(argument.name for argument in self.arguments)])


ARMS: tuple[ServerKind, ...] = ("UR controller", "CANopen drives", "signal-table arm")
CAN: tuple[ServerKind, ...] = ("CANopen drives", "signal-table arm")
SERVOS: tuple[ServerKind, ...] = ("serial servos",)
MOTORS: tuple[ServerKind, ...] = ("CAN motors",)
THERMOMETERS: tuple[ServerKind, ...] = ("thermometer", "arm at rest")

FAULTS = (
    FaultEntry("drop", (COUNT,), (*ARMS, *SERVOS, *MOTORS)),
    FaultEntry("freeze", (SECONDS,), (*ARMS, *SERVOS, *MOTORS)),
    FaultEntry("cut", (), ("UR controller",)),
    FaultEntry("protective-stop", (), ("UR controller",)),
    FaultEntry("local-control", (), ("UR controller",)),
    FaultEntry("mute", (IDENTIFIER, SECONDS), ("signal-table arm",)),
    FaultEntry("clock-jump", (JUMP,), ("UR controller", "signal-table arm")),
    FaultEntry("power-cycle", (JOINT,), ("CANopen drives", *SERVOS, *MOTORS)),
    FaultEntry("heartbeat-stop", (JOINT,), ("CANopen drives",)),
    FaultEntry("over-temperature", (JOINT,), (*CAN, *SERVOS, *MOTORS)),
    FaultEntry("bus-off", (SECONDS,), (*CAN, *MOTORS)),
    FaultEntry("truncate", (COUNT,), (*CAN, *SERVOS, *MOTORS)),
    FaultEntry("garbage", (COUNT,), (*CAN, *SERVOS, *MOTORS)),
    FaultEntry("heat", (JOINT, CELSIUS), (*ARMS, *SERVOS, *MOTORS, "arm at rest")),
    FaultEntry("block", (JOINT,), (*ARMS, *SERVOS, *MOTORS)),
    FaultEntry("stick", (QUANTITY, JOINT), ARMS),
    FaultEntry("stick", (), THERMOMETERS),
    FaultEntry("refuse", (VARIABLE,), ("UR controller",)),
    FaultEntry("drift", (JOINT, SPEED), ("UR controller",)),
    FaultEntry("silent", (SECONDS,), THERMOMETERS),
    FaultEntry("garbage", (SECONDS,), THERMOMETERS),
    FaultEntry("unplug", (), ("CANopen drives", *SERVOS, *THERMOMETERS)),
    FaultEntry("unplug", (SECONDS,), THERMOMETERS),
    FaultEntry("replug", (), THERMOMETERS),
    FaultEntry("die", (JOINT,), (*SERVOS, *MOTORS)),
    FaultEntry("same-id", (JOINT,), (*SERVOS, *MOTORS)),
    FaultEntry("sag", (SECONDS,), (*SERVOS, *MOTORS)),
    FaultEntry("wrong-sum", (COUNT,), SERVOS),
    FaultEntry("latency", (SECONDS,), SERVOS),
    FaultEntry("echo", (), SERVOS),
)


def usage(server: ServerKind, faults: Sequence[FaultEntry] = FAULTS) -> str:
    """The faults of a table that a server obeys, as typed."""
    return " | ".join(entry.usage for entry in faults if server in entry.servers)


def parse_fault(line: str, server: ServerKind, joints: Sequence[str], faults: Sequence[FaultEntry] = FAULTS) -> Fault:
    """Read a typed fault; a joint is given by name or number from 1, an identifier as 0x182.

    Raises:
        UsageError: not a fault of this server, or an argument out of its bounds.
    """
    word, *texts = line.split() or [""]
    for entry in faults:
        if entry.word == word and server in entry.servers and len(entry.arguments) == len(texts):
            values = [argument.read(text, joints) for argument, text in zip(entry.arguments, texts, strict=True)]
            if None not in values:
                return Fault(word, tuple(values))
    raise UsageError(f"'{line.strip()}' is not a fault of the {server}", hint=usage(server, faults))
