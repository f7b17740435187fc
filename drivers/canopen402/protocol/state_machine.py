"""The state machine of a drive (CiA 402-2, figure of states): statuswords read, controlwords chosen."""

from __future__ import annotations

from enum import Enum

SHUTDOWN = 0x0006
SWITCH_ON = 0x0007
ENABLE_OPERATION = 0x000F
DISABLE_VOLTAGE = 0x0000
QUICK_STOP = 0x0002
FAULT_RESET = 0x0080
NEW_SET_POINT = 0x0010
"""Controlword bit 4 in profile position mode."""
CHANGE_AT_ONCE = 0x0020
"""Controlword bit 5 in profile position mode: a new set-point replaces the one under way."""

WARNING_BIT = 0x0080
INTERNAL_LIMIT_BIT = 0x0800
SET_POINT_ACKNOWLEDGED = 0x1000
"""Statusword bit 12 in profile position mode."""
FOLLOWING_ERROR = 0x2000
"""Statusword bit 13 in the position modes."""


class DriveState(Enum):
    """State of a drive's power stage."""

    NOT_READY = "not ready to switch on"
    SWITCH_ON_DISABLED = "switch on disabled"
    READY = "ready to switch on"
    SWITCHED_ON = "switched on"
    ENABLED = "operation enabled"
    QUICK_STOP = "quick stop active"
    FAULT_REACTION = "fault reaction active"
    FAULT = "fault"
    UNKNOWN = "unknown"


_BY_STATUSWORD = (
    (0x4F, 0x00, DriveState.NOT_READY),
    (0x4F, 0x40, DriveState.SWITCH_ON_DISABLED),
    (0x6F, 0x21, DriveState.READY),
    (0x6F, 0x23, DriveState.SWITCHED_ON),
    (0x6F, 0x27, DriveState.ENABLED),
    (0x6F, 0x07, DriveState.QUICK_STOP),
    (0x4F, 0x0F, DriveState.FAULT_REACTION),
    (0x4F, 0x08, DriveState.FAULT),
)
"""Mask, value, state (CiA 402-2, table of statusword bits)."""

ENABLING = (
    (DISABLE_VOLTAGE, DriveState.SWITCH_ON_DISABLED),
    (SHUTDOWN, DriveState.READY),
    (SWITCH_ON, DriveState.SWITCHED_ON),
    (ENABLE_OPERATION, DriveState.ENABLED),
)
"""Controlwords to operation enabled and the state that each leads to; it begins anew whatever the state was before,
but never leaves a fault."""

FAULTY = frozenset({DriveState.FAULT, DriveState.FAULT_REACTION})
POWERED = frozenset({DriveState.ENABLED, DriveState.QUICK_STOP, DriveState.FAULT_REACTION})
"""States in which the motor may still be moved by the drive."""


def drive_state(statusword: int) -> DriveState:
    """Return what a statusword says; UNKNOWN for a pattern that the standard does not have."""
    for mask, value, state in _BY_STATUSWORD:
        if statusword & mask == value:
            return state
    return DriveState.UNKNOWN


def supports_mode(supported: int, mode: int) -> bool:
    """Return whether object 0x6502 names a mode of operation (bit mode − 1)."""
    return bool(supported >> (mode - 1) & 1)
