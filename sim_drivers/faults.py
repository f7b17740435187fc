"""Faults on request: what a simulated controller and its network can be asked to do wrong."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from queue import Empty, SimpleQueue

from drivers.errors import UsageError


@dataclass(frozen=True)
class Drop:
    """Lose the next `packages` data packages of every client that is connected; the controller's time goes on."""

    packages: int


@dataclass(frozen=True)
class Freeze:
    """Say nothing for `duration` [s] and keep the connections; what would have been said is lost."""

    duration: float


@dataclass(frozen=True)
class Cut:
    """Close every RTDE connection."""


@dataclass(frozen=True)
class ProtectiveStop:
    """Stop protectively, as after a collision."""


@dataclass(frozen=True)
class Heat:
    """Warm joint number `joint` (from 0) up by `celsius`."""

    joint: int
    celsius: float


@dataclass(frozen=True)
class BlockJoint:
    """Jam joint number `joint` (from 0) for good: it stops at once and moves no more."""

    joint: int


@dataclass(frozen=True)
class Drift:
    """Carry joint number `joint` (from 0) away from its target at `velocity` [rad/s] while a program runs."""

    joint: int
    velocity: float


Fault = Drop | Freeze | Cut | ProtectiveStop | Heat | BlockJoint | Drift

USAGE = "drop N | freeze SECONDS | cut | protective-stop | heat JOINT CELSIUS | block JOINT | drift JOINT RAD/S"


class Faults:
    """Faults waiting for the server's next period; may be called from any thread."""

    def __init__(self) -> None:
        self._waiting: SimpleQueue[Fault] = SimpleQueue()

    def request(self, fault: Fault) -> None:
        """Make it happen."""
        self._waiting.put(fault)

    def drop(self, packages: int) -> None:
        """Lose the next data packages."""
        self.request(Drop(packages))

    def freeze(self, duration: float) -> None:
        """Say nothing for a while [s]."""
        self.request(Freeze(duration))

    def cut(self) -> None:
        """Close every RTDE connection."""
        self.request(Cut())

    def protective_stop(self) -> None:
        """Stop protectively."""
        self.request(ProtectiveStop())

    def heat(self, joint: int, celsius: float) -> None:
        """Warm a joint up."""
        self.request(Heat(joint, celsius))

    def block(self, joint: int) -> None:
        """Jam a joint."""
        self.request(BlockJoint(joint))

    def drift(self, joint: int, velocity: float) -> None:
        """Carry a joint away from its target [rad/s]."""
        self.request(Drift(joint, velocity))

    def take(self) -> list[Fault]:
        """What was requested since the last call."""
        taken: list[Fault] = []
        while True:
            try:
                taken.append(self._waiting.get_nowait())
            except Empty:
                return taken


def parse_fault(line: str, joints: Sequence[str]) -> Fault:
    """Read a fault as a person types it; a joint goes by its name, or its number from 1.

    Raises:
        UsageError: not a fault, or a number that makes none.
    """
    match line.split():
        case ["drop", count] if count.isdecimal() and int(count) > 0:
            return Drop(int(count))
        case ["freeze", seconds] if (duration := positive(seconds)) is not None:
            return Freeze(duration)
        case ["cut"]:
            return Cut()
        case ["protective-stop"]:
            return ProtectiveStop()
        case ["heat", joint, celsius] if (rise := positive(celsius)) is not None:
            return Heat(joint_number(joint, joints), rise)
        case ["block", joint]:
            return BlockJoint(joint_number(joint, joints))
        case ["drift", joint, speed] if (velocity := _finite(speed)) is not None:
            return Drift(joint_number(joint, joints), velocity)
    raise UsageError(f"'{line.strip()}' is not a fault", hint=USAGE)


def joint_number(text: str, joints: Sequence[str]) -> int:
    """The number from 0 of a joint that goes by its name, or its number from 1.

    Raises:
        UsageError: there is no such joint.
    """
    if text in joints:
        return joints.index(text)
    if text.isdecimal() and 1 <= int(text) <= len(joints):
        return int(text) - 1
    raise UsageError(f"no joint is called '{text}'", hint=f"1 to {len(joints)}, or {', '.join(joints)}")


def _finite(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def positive(text: str) -> float | None:
    """A positive finite number; None where it is none."""
    value = _finite(text)
    return value if value is not None and value > 0 else None
