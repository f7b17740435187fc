"""Faults on request of simulated devices on a CAN bus, and of the adapter in front of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from drivers.errors import UsageError
from sim_drivers.faults import BlockJoint, Drop, Freeze, Heat, joint_number, parse_fault, positive


@dataclass(frozen=True)
class PowerCycle:
    """Take the power of joint number `joint`'s drive away for a moment."""

    joint: int


@dataclass(frozen=True)
class HeartbeatStop:
    """Joint number `joint`'s drive sends no heartbeat any more; all else goes on."""

    joint: int


@dataclass(frozen=True)
class OverTemperature:
    """Joint number `joint`'s drive falls into fault, as if it were too hot."""

    joint: int


@dataclass(frozen=True)
class BusOff:
    """An error frame, then `duration` [s] without any frame in either direction."""

    duration: float


@dataclass(frozen=True)
class Truncate:
    """Cut the next `frames` sample frames short: the adapter's line, or the frame itself where there is none."""

    frames: int


@dataclass(frozen=True)
class Garbage:
    """Send `frames` lines of rubbish through the adapter, or frames of random content where there is none."""

    frames: int


@dataclass(frozen=True)
class Unplug:
    """Pull the adapter out."""


CanFault = (
    Drop
    | Freeze
    | Heat
    | BlockJoint
    | PowerCycle
    | HeartbeatStop
    | OverTemperature
    | BusOff
    | Truncate
    | Garbage
    | Unplug
)

USAGE = (
    "drop N | freeze SECONDS | power-cycle JOINT | heartbeat-stop JOINT | over-temperature JOINT | bus-off SECONDS | "
    "truncate N | garbage N | unplug | heat JOINT CELSIUS | block JOINT"
)


def parse_can_fault(line: str, joints: Sequence[str]) -> CanFault:
    """Read a fault as a person types it; a joint goes by its name, or its number from 1.

    Raises:
        UsageError: not a fault, or a number that makes none.
    """
    match line.split():
        case ["power-cycle", joint]:
            return PowerCycle(joint_number(joint, joints))
        case ["heartbeat-stop", joint]:
            return HeartbeatStop(joint_number(joint, joints))
        case ["over-temperature", joint]:
            return OverTemperature(joint_number(joint, joints))
        case ["bus-off", seconds] if (duration := positive(seconds)) is not None:
            return BusOff(duration)
        case ["truncate", count] if count.isdecimal() and int(count) > 0:
            return Truncate(int(count))
        case ["garbage", count] if count.isdecimal() and int(count) > 0:
            return Garbage(int(count))
        case ["unplug"]:
            return Unplug()
        case ["drop" | "freeze" | "heat" | "block", *_]:
            try:
                fault = parse_fault(line, joints)
            except UsageError as error:
                raise UsageError(error.message, hint=USAGE) from error
            if isinstance(fault, Drop | Freeze | Heat | BlockJoint):
                return fault
    raise UsageError(f"'{line.strip()}' is not a fault", hint=USAGE)
