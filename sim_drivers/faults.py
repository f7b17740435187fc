"""Faults on request, of simulated controllers, drives, buses and sensors.

`FAULTS` is the table of all of them: the typed word, its arguments, and the servers that obey it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from drivers.core.errors import UsageError


@dataclass(frozen=True)
class Fault:
    """A fault that a person asks for."""


@dataclass(frozen=True)
class Counted(Fault):
    """One that concerns the next `count` of something."""

    count: int


@dataclass(frozen=True)
class Lasting(Fault):
    """One that ends after `duration` [s]."""

    duration: float


@dataclass(frozen=True)
class OfJoint(Fault):
    """One of the joint of index `joint`."""

    joint: int


class Drop(Counted):
    """Lose the next `count` data packages of every RTDE client, or sample frames of a bus; time continues."""


class Freeze(Lasting):
    """Send nothing for `duration` [s] and keep the connections; the data of that time are lost."""


class Cut(Fault):
    """Close every RTDE connection."""


class ProtectiveStop(Fault):
    """Stop protectively, as after a collision."""


class LocalControl(Fault):
    """The pendant takes the controller out of remote control: it takes no programs or stops from outside any more."""


@dataclass(frozen=True)
class Heat(Fault):
    """Warm the joint of index `joint` up by `celsius` [K]."""

    joint: int
    celsius: float


class BlockJoint(OfJoint):
    """Jam the joint of index `joint` for good: it stops at once and does not move."""


@dataclass(frozen=True)
class Stick(Fault):
    """What the joint of index `joint` reports as `quantity` stays what it is; without both, all of a thermometer."""

    quantity: str = ""
    joint: int = -1


@dataclass(frozen=True)
class Refuse(Fault):
    """Clients that connect from now on are refused an RTDE variable (NOT_FOUND)."""

    variable: str


@dataclass(frozen=True)
class Drift(Fault):
    """Move the joint of index `joint` away from its target at `velocity` [rad/s] while a program runs."""

    joint: int
    velocity: float


@dataclass(frozen=True)
class ClockJump(Fault):
    """The clock or counter in the samples jumps by `seconds` [s], and goes on from there; the arm does not."""

    seconds: float


class PowerCycle(OfJoint):
    """Interrupt the power of the drive of joint index `joint` for a moment."""


class HeartbeatStop(OfJoint):
    """The drive of joint index `joint` sends no heartbeat any more; all else continues."""


class OverTemperature(OfJoint):
    """The drive of joint index `joint` goes into fault, as if it were too hot."""


class BusOff(Lasting):
    """An error frame, then `duration` [s] without any frame in either direction."""


class Truncate(Counted):
    """Cut the next `count` sample frames short: the adapter's line, or the frame itself without an adapter."""


class Garbage(Counted):
    """Send `count` lines of random bytes through the adapter, or frames of random content without one."""


@dataclass(frozen=True)
class Unplug(Fault):
    """Pull the adapter or the thermometer out; it comes back after `duration` [s] if there is one."""

    duration: float | None = None


@dataclass(frozen=True)
class Mute(Fault):
    """Frames of one identifier are not sent for `duration` [s]; all else continues."""

    identifier: int
    duration: float


class Noise(Lasting):
    """Send random bytes in place of lines for `duration` [s], as at a wrong baud rate."""


class Replug(Fault):
    """Plug the thermometer in again; nothing where it is plugged in."""


class Die(OfJoint):
    """The servo of joint index `joint` neither answers nor drives any more, as with a broken cable."""


class SameId(OfJoint):
    """Another servo with the id of joint index `joint` answers at the same time."""


class Sag(Lasting):
    """The supply falls to half of its nominal voltage for `duration` [s]."""


class WrongSum(Counted):
    """The next `count` answers have a wrong sum."""


@dataclass(frozen=True)
class Latency(Fault):
    """The adapter hands answers on only every `seconds` [s] from now on."""

    seconds: float


class Echo(Fault):
    """The adapter returns what is sent from now on."""


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
    make: Callable[..., Fault]  # the fault of their values
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
    FaultEntry("drop", (COUNT,), Drop, (*ARMS, *SERVOS, *MOTORS)),
    FaultEntry("freeze", (SECONDS,), Freeze, (*ARMS, *SERVOS, *MOTORS)),
    FaultEntry("cut", (), Cut, ("UR controller",)),
    FaultEntry("protective-stop", (), ProtectiveStop, ("UR controller",)),
    FaultEntry("local-control", (), LocalControl, ("UR controller",)),
    FaultEntry("mute", (IDENTIFIER, SECONDS), Mute, ("signal-table arm",)),
    FaultEntry("clock-jump", (JUMP,), ClockJump, ("UR controller", "signal-table arm")),
    FaultEntry("power-cycle", (JOINT,), PowerCycle, ("CANopen drives", *SERVOS, *MOTORS)),
    FaultEntry("heartbeat-stop", (JOINT,), HeartbeatStop, ("CANopen drives",)),
    FaultEntry("over-temperature", (JOINT,), OverTemperature, (*CAN, *SERVOS, *MOTORS)),
    FaultEntry("bus-off", (SECONDS,), BusOff, (*CAN, *MOTORS)),
    FaultEntry("truncate", (COUNT,), Truncate, (*CAN, *SERVOS, *MOTORS)),
    FaultEntry("garbage", (COUNT,), Garbage, (*CAN, *SERVOS, *MOTORS)),
    FaultEntry("heat", (JOINT, CELSIUS), Heat, (*ARMS, *SERVOS, *MOTORS, "arm at rest")),
    FaultEntry("block", (JOINT,), BlockJoint, (*ARMS, *SERVOS, *MOTORS)),
    FaultEntry("stick", (QUANTITY, JOINT), Stick, ARMS),
    FaultEntry("stick", (), Stick, THERMOMETERS),
    FaultEntry("refuse", (VARIABLE,), Refuse, ("UR controller",)),
    FaultEntry("drift", (JOINT, SPEED), Drift, ("UR controller",)),
    FaultEntry("silent", (SECONDS,), Freeze, THERMOMETERS),
    FaultEntry("garbage", (SECONDS,), Noise, THERMOMETERS),
    FaultEntry("unplug", (), Unplug, ("CANopen drives", *SERVOS, *THERMOMETERS)),
    FaultEntry("unplug", (SECONDS,), Unplug, THERMOMETERS),
    FaultEntry("replug", (), Replug, THERMOMETERS),
    FaultEntry("die", (JOINT,), Die, (*SERVOS, *MOTORS)),
    FaultEntry("same-id", (JOINT,), SameId, (*SERVOS, *MOTORS)),
    FaultEntry("sag", (SECONDS,), Sag, (*SERVOS, *MOTORS)),
    FaultEntry("wrong-sum", (COUNT,), WrongSum, SERVOS),
    FaultEntry("latency", (SECONDS,), Latency, SERVOS),
    FaultEntry("echo", (), Echo, SERVOS),
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
                return entry.make(*values)
    raise UsageError(f"'{line.strip()}' is not a fault of the {server}", hint=usage(server, faults))
