"""Columns of a recording that hold another signal than they say, and positions that jump."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from daq.recording.quality.outliers import Cause, PositionJump
from daq.recording.recording import JOINTS_STREAM, MOTOR_SIGNALS, Recording
from daq.recording.unit_plausibility import DEGREES, displacement_ratios
from drivers.core.arrays import FloatArray, true_runs
from drivers.core.text import first_few
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
"""Jumps, standstills, or joints whose signals wrap, that a sentence lists."""

FROZEN, FROZEN_ROWS, FROZEN_MOVES = 0.5, 20.0, 0.1
"""Time [s] of one value from which on a motor signal stands still, in how many times the usual run of one value, and
the part of its joint's range that the joint moves meanwhile."""

WRAPPED, FEWEST_WRAPS, WRAP_LAG = 0.8, 3, 3
"""Part of a signal's range that it jumps where it wraps, how often at least, and the samples before and after in which
its joint does not reverse: there friction jumps, too."""

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
            shown = [f"{jump.joint} by {jump.size:+.3g} at {jump.time - first:.2f} s" for jump in found]
            text = f"{of}the position jumps between two samples of {first_few(shown, MOST_SHOWN, '; ')}: {meaning}"
            checks.append(raised(name, text, sorted({jump.joint for jump in found}) if cause != "rows" else []))
    return checks


def column_checks(recording: Recording, of: str = "") -> list[Check]:
    """Motor signals that are the motion or each other, stand still or wrap, and positions that are the velocity."""
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
        if "position" in values:
            checks += _motor_checks(stream.time, signal, joints, values[signal], values["position"], of)
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


def _motor_checks(
    time: FloatArray, signal: str, joints: Sequence[str], values: FloatArray, position: FloatArray, of: str
) -> list[Check]:
    """Columns of a motor signal (N, n) that stand still while their joint moves, or that wrap."""
    frozen = {joint: found for j, joint in enumerate(joints) if (found := _frozen(time, values[:, j], position[:, j]))}
    checks = []
    if frozen:
        shown = [
            f"{joint} from {time[a] - time[0]:.1f} to {time[b] - time[0]:.1f} s" for joint, (a, b) in frozen.items()
        ]
        text = (
            f"{of}the {signal} stands still while its joint moves: {first_few(shown, MOST_SHOWN, '; ')}: its bus or "
            "sensor failed; identify without this time (--start, --stop), or leave this torque out (--torques-of)"
        )
        checks.append(raised("torque-frozen", text, frozen))
    wraps = [joint for j, joint in enumerate(joints) if _wraps(values[:, j], position[:, j])]
    if wraps:
        text = (
            f"{of}the {signal} of {first_few(wraps, MOST_SHOWN)} jumps from one end of its range to the other: it "
            "overflows; record it with more bits, or add its range where it jumps"
        )
        checks.append(raised("torque-wraps", text, wraps))
    return checks


def _frozen(time: FloatArray, values: FloatArray, position: FloatArray) -> tuple[int, int] | None:
    """First and last sample of the longest run of one value, if it is far longer than most and no limit's."""
    runs = true_runs(np.concatenate([values[1:] == values[:-1], [False]]))
    if not runs:
        return None
    start, stop = max(runs, key=lambda run: run[1] - run[0])
    lengths = np.ones(len(values))
    for first, last in runs:
        lengths[first : last + 1] = last - first + 1
    others = np.delete(lengths, slice(start, stop + 1))
    moved = float(np.ptp(position[start : stop + 1])) > FROZEN_MOVES * float(np.ptp(position))
    clips = values[start] in (values.min(), values.max()) and np.sum(values == values[start]) > stop - start + 1
    lasts = len(others) > 0 and time[stop] - time[start] >= FROZEN and stop - start >= FROZEN_ROWS * np.median(others)
    return (start, stop) if moved and lasts and not clips else None


def _wraps(values: FloatArray, position: FloatArray) -> bool:
    """Return whether a signal (N,) often jumps over all of its range, mostly away from its joint's reversals."""
    change, span = np.abs(np.diff(values)), float(np.ptp(values))
    jumps = np.flatnonzero(change > WRAPPED * span)
    if not span > 0.0 or len(jumps) < FEWEST_WRAPS or np.quantile(change, 0.9) > 0.1 * span:
        return False
    before, after = (np.clip(jumps + shift, 0, len(values) - 1) for shift in (-WRAP_LAG, WRAP_LAG))
    moved = (position[jumps] - position[before]) * (position[after] - position[jumps])
    return bool(np.mean(moved > 0.0) > 0.5)


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
