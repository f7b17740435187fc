"""Faults on request of a simulated arm that speaks a table of CAN frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from drivers.errors import UsageError
from sim_drivers.can.faults import BusOff, Garbage, OverTemperature, Truncate, parse_can_fault
from sim_drivers.faults import BlockJoint, Drop, Freeze, Heat, positive


@dataclass(frozen=True)
class Mute:
    """Frames of one identifier are not sent for `duration` [s]; all else goes on."""

    identifier: int
    duration: float


TableFault = Drop | Freeze | Garbage | Truncate | OverTemperature | Heat | BlockJoint | BusOff | Mute

USAGE = (
    "drop FRAMES | freeze SECONDS | mute IDENTIFIER SECONDS | garbage FRAMES | truncate FRAMES | bus-off SECONDS | "
    "over-temperature JOINT | heat JOINT CELSIUS | block JOINT"
)


def parse_table_fault(line: str, joints: Sequence[str]) -> TableFault:
    """Read a fault as a person types it; a joint goes by its name or number from 1, an identifier as 0x182.

    Raises:
        UsageError: not a fault of such an arm.
    """
    match line.split():
        case ["mute", identifier, seconds] if (duration := positive(seconds)) is not None:
            try:
                return Mute(int(identifier, 0), duration)
            except ValueError:
                raise UsageError(f"'{identifier}' is no identifier", hint="such as 0x182") from None
    try:
        fault = parse_can_fault(line, joints)
    except UsageError as error:
        raise UsageError(error.message, hint=USAGE) from error
    if not isinstance(fault, TableFault):
        raise UsageError(f"'{line.strip()}' is not a fault of this arm", hint=USAGE)
    return fault
