"""Columns of a recording that hold another signal than they say, and positions that jump."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from daq.recording.quality.outliers import Cause, PositionJump
from daq.recording.recording import JOINTS_STREAM, MOTOR_SIGNALS, Recording
from daq.recording.unit_plausibility import DEGREES, displacement_ratios
from drivers.core.arrays import FloatArray
from ident.verdict.catalogue import raised
from ident.verdict.check import Check

SAME = 1e-3
"""Difference of two columns over the largest value up to which they are one signal; no arm's torque is as near."""

UNITS = (1.0, DEGREES, 1.0 / DEGREES, 1e3, 1e-3)
"""Factors between the units of one signal."""

AGREE = 0.02
"""Departure from 1 of the change of one column over the integral of another, up to which this is its derivative."""

STEADY = 4.0
"""Mean of a column over its standard deviation; torques that are all steadier do not follow the motion."""

FEW_MOVE = 3
"""Joints at least that move where torques are called too steady: a lift alone holds its weight all the time."""

MOVES = 0.1
"""Range of positions [rad or m] from which on a joint counts as moving there."""

MOST_SHOWN = 4
"""Jumps that a sentence lists."""

MOST = 1e100
"""Greater values, whose squares overflow, are refused elsewhere."""

_JUMPS: dict[Cause, tuple[str, str]] = {
    "zero": (
        "position-jump",
        "its encoder lost counts or its zero there, so the angles on one side are wrong: identify from the other side "
        "(--start, --stop)",
    ),
    "turn": ("position-wraps", "a full turn, as for wrapped angles: no velocity is derived across it"),
    "rows": (
        "rows-missing",
        "together with other joints, while the stamps go on: rows are missing or duplicated there; no velocity is "
        "derived across it",
    ),
}


def jump_checks(jumps: Sequence[PositionJump], first: float, of: str = "") -> list[Check]:
    """The checks of jumps of the positions in a recording with a first stamp [s]; `of` begins their sentences."""
    checks = []
    for cause, (name, meaning) in _JUMPS.items():
        found = [jump for jump in jumps if jump.cause == cause]
        if found:
            shown = [f"{one.joint} by {one.size:+.3g} at {one.time - first:.2f} s" for one in found[:MOST_SHOWN]]
            more = f" and {len(found) - MOST_SHOWN} more" if len(found) > MOST_SHOWN else ""
            text = f"{of}the position jumps between two samples of {'; '.join(shown)}{more}: {meaning}"
            checks.append(raised(name, text, sorted({one.joint for one in found}) if cause != "rows" else []))
    return checks


def column_checks(recording: Recording, of: str = "") -> list[Check]:
    """Motor signals that are the motion or each other, and positions that are the velocity."""
    stream = recording.streams.get(JOINTS_STREAM)
    if stream is None or "position" not in stream.channels or len(stream.time) < 2:
        return []
    joints = stream.channels["position"].columns
    values = {
        name: one.values
        for name, one in stream.channels.items()
        if one.columns == joints and np.all(np.abs(one.values) <= MOST)
    }
    checks = []
    motion = [name for name in ("position", "velocity") if name in values]
    for signal in (name for name in MOTOR_SIGNALS if name in values):
        for name in motion:
            same = [j for j, (a, b) in enumerate(zip(values[signal].T, values[name].T, strict=True)) if _is(a, b)]
            if same:
                names = [joints[joint] for joint in same]
                text = f"{of}the {signal} of {', '.join(names)} is the {name}: check which column was used"
                checks.append(raised("motion-as-torque", text, names))
        moving = np.ptp(values["position"], axis=0) > MOVES if "position" in values else np.zeros(0, dtype=bool)
        level, change = np.abs(values[signal].mean(axis=0)), values[signal].std(axis=0)
        if np.sum(moving) >= FEW_MOVE and np.all(level > STEADY * change) and np.any(change > 0.0):
            text = (
                f"{of}the {signal} of all joints hardly changes while they move: check which column was used: it may "
                "be a temperature or a voltage"
            )
            checks.append(raised("steady-torque", text))
        for one, other in combinations(range(len(joints)), 2):
            first, second = values[signal][:, one], values[signal][:, other]
            if np.array_equal(first, second) and np.ptp(first):
                text = f"{of}{joints[one]} and {joints[other]} have the same {signal}: one column was used for both"
                checks.append(raised("same-column", text, [joints[one], joints[other]]))
    if len(motion) == 2 and np.all(np.isfinite(stream.time)):
        position, velocity = values["position"], values["velocity"]
        forward = displacement_ratios(stream.time, position, velocity)
        back = displacement_ratios(stream.time, velocity, position)
        names = [
            joint
            for joint, right, turned in zip(joints, forward, back, strict=True)
            if right is None and turned is not None and abs(turned - 1.0) < AGREE
        ]
        if names:
            text = (
                f"{of}position and velocity of {', '.join(names)} are swapped: the first is the rate of change "
                "of the second"
            )
            checks.append(raised("position-velocity-exchanged", text, names))
    return checks


def _is(signal: FloatArray, motion: FloatArray) -> bool:
    """Return whether two columns (N,) are one signal, in any units and with either sign."""
    largest = float(np.max(np.abs(motion), initial=0.0))
    if not np.ptp(motion) > SAME * largest:
        return False
    product = float(signal @ motion)
    factor = np.sign(product) * min(
        UNITS, key=lambda unit: abs(np.log(max(abs(product), 1e-300) / (motion @ motion) / unit))
    )
    return bool(np.max(np.abs(signal - factor * motion)) <= SAME * abs(factor) * largest)
