"""Limits that drives keep themselves, and what they do at a quick stop (CiA 402-2); they are read, never written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.base import DeviceLimits
from drivers.canopen402.protocol import objects
from drivers.canopen402.protocol.sdo import RemoteDrive
from drivers.canopen402.samples.alignment import PER_MILLE, Scaling
from drivers.core.arrays import FloatArray

NO_WINDOW = 2**32 - 1
"""Value of 0x6065 that switches the supervision of the following error off."""
NO_TORQUE_LIMIT = 2**16 - 1
"""Value of 0x6072 that limits nothing."""
QUICK_STOP_ACTIONS = {
    0: "its voltage is cut, and the arm coasts",
    1: "slows down with 0x6084",
    2: "slows down with 0x6085",
    3: "slows down at the current limit",
    4: "slows down at the voltage limit",
    5: "slows down with 0x6084, and stays in quick stop",
    6: "slows down with 0x6085, and stays in quick stop",
    7: "slows down at the current limit, and stays in quick stop",
    8: "slows down at the voltage limit, and stays in quick stop",
}
"""Value of 0x605A → what the drive does."""
_RAMP = {1: objects.PROFILE_DECELERATION, 5: objects.PROFILE_DECELERATION}


@dataclass(frozen=True)
class DriveLimits:
    """What one drive says, in its own numbers; None where it has no such object, or does not limit."""

    # lowest, highest: position [counts], the home offset taken off
    lowest: int | None
    highest: int | None
    velocity: int | None  # [counts/s]
    torque: int | None  # [‰ of the rated torque]
    following_error: int | None  # largest [counts]
    quick_stop: int | None  # option (0x605A)
    deceleration: int | None  # of that quick stop [counts/s²]; None where it is not a ramp


def read_drive_limits(drive: RemoteDrive) -> DriveLimits:
    """Ask a drive.

    Raises:
        ConnectionFailedError: no answer, or too late.
    """
    lowest, highest = drive.read_optional(objects.LOWEST_POSITION), drive.read_optional(objects.HIGHEST_POSITION)
    home = drive.read_optional(objects.HOME_OFFSET) or 0
    limited = lowest is not None and highest is not None and lowest < highest  # else the drive limits nothing
    torque, window = drive.read_optional(objects.MAX_TORQUE), drive.read_optional(objects.FOLLOWING_ERROR_WINDOW)
    option = drive.read_optional(objects.QUICK_STOP_OPTION)
    ramp = None if option in (0, 3, 4, 7, 8) else _RAMP.get(option or 2, objects.QUICK_STOP_DECELERATION)
    return DriveLimits(
        lowest=lowest - home if limited and lowest is not None else None,
        highest=highest - home if limited and highest is not None else None,
        velocity=drive.read_optional(objects.MAX_PROFILE_VELOCITY) or None,
        torque=None if torque == NO_TORQUE_LIMIT else torque,
        following_error=None if window == NO_WINDOW else window,
        quick_stop=option,
        deceleration=None if ramp is None else drive.read_optional(ramp),
    )


def at_joints(limits: Sequence[DriveLimits], scaling: Scaling) -> DeviceLimits:
    """The drives' limits as those of the joints; unknown for joints that share a motor with others."""
    radians, n = np.abs(scaling.radians_per_count), len(limits)

    def column(name: str) -> FloatArray:
        return np.array([np.nan if (value := getattr(limit, name)) is None else float(value) for limit in limits])

    ends = np.stack([column("lowest"), column("highest")]) * scaling.radians_per_count + scaling.zero
    alone = np.ones(n, dtype=bool)
    if scaling.coupling is not None:
        others = (scaling.coupling != 0.0) & ~np.eye(n, dtype=bool)
        alone = ~(others.any(axis=0) | others.any(axis=1)) & (np.diag(scaling.coupling) == 1.0)
    unknown = np.where(alone, 1.0, np.nan)
    return DeviceLimits(
        lowest=ends.min(axis=0) * unknown,
        highest=ends.max(axis=0) * unknown,
        velocity=column("velocity") * radians * unknown,
        torque=column("torque") * PER_MILLE * scaling.rated_torque * unknown,
        following_error=column("following_error") * radians * unknown,
        stopping=column("deceleration") * radians * unknown,
        sources={
            "position": "0x607D",
            "velocity": "0x607F",
            "torque": "0x6072",
            "following_error": "0x6065",
            "stopping": "0x6085, or 0x6084 as 0x605A says",
        },
    )


def cautions_of(joints: Sequence[str], limits: Sequence[DriveLimits]) -> list[str]:
    """Return what a person should know of the drives' quick stop and supervision before they move an arm."""
    odd: dict[str, list[str]] = {}
    for joint, limit in zip(joints, limits, strict=True):
        if limit.quick_stop is None:
            odd.setdefault("0x605A does not exist: what a quick stop does is the manufacturer's choice", []).append(
                joint
            )
        elif limit.quick_stop not in QUICK_STOP_ACTIONS or limit.quick_stop == 0:
            action = QUICK_STOP_ACTIONS.get(limit.quick_stop, "what that means is the manufacturer's choice")
            odd.setdefault(f"quick stop option (0x605A) {limit.quick_stop}: {action}", []).append(joint)
        if limit.deceleration == 0:
            odd.setdefault("the deceleration of its quick stop is 0", []).append(joint)
        if limit.following_error is None:
            said = "the drive supervises no following error of its own (0x6065 does not exist, or is off)"
            odd.setdefault(said, []).append(joint)
    return [f"{', '.join(who)}: {what}" for what, who in odd.items()]
