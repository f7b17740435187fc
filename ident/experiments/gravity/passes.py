"""Slow passes in a recording, and the pairs of them that go the same way forth and back.

A pass is a segment in which no joint changes its direction and none is fast. Two passes are a pair where they go
through the same positions of all joints in opposite directions. Only samples in motion count: the friction of an arm
that rests in its controller can be anything between the two breakaway torques.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from drivers.core.arrays import FloatArray, IntArray
from drivers.core.errors import DataError
from drivers.core.text import first_few
from ident.model.base_parameters import BaseParameters, gravity_rows
from ident.model.dynamic_model import DynamicModel
from ident.signals.joint_signals import JointSignals

FASTEST, FASTEST_SLIDE = 0.4, 0.15
"""Peak velocity up to which a pass is slow [rad/s, m/s]: Coriolis torques are below 1 % of gravity's there."""

STILL, STILL_SLIDE = 0.01, 0.002
"""Velocity below which a joint rests [rad/s, m/s]; at least what two steps of its encoder look like."""

SHORTEST, SHORTEST_SLIDE = 0.02, 0.004
"""Way in common that a pair has at least [rad, m]."""

SAME_WAY = 0.12
"""Difference between the ways forth and back, over the length of the way in common."""

SMOOTHED = 0.1
"""Window of the velocity [s]."""

PARTNERS = 3
"""A pass is paired with one of the so many next ones."""

GAP = 5.0
"""Sampling periods without a sample that end a pass."""

GRID = 15
"""Positions along a pass at which the regressor is averaged."""


@dataclass(frozen=True, eq=False)
class SlowPass:
    """A segment of a recording in one direction."""

    samples: slice  # first and last, exclusive
    direction: IntArray  # (n,) −1, 0 or 1
    peak: FloatArray  # (n,) largest velocity [rad/s or m/s]
    way: FloatArray  # (n,) from its first to its last position [rad or m]


@dataclass(frozen=True, eq=False)
class Visit:
    """A pose that was passed in both directions."""

    pose: FloatArray  # (n,) the middle of the way in common [rad or m]
    time: float  # [s] between the two passes, from the recording's first sample
    direction: IntArray  # (n,) of the joints in the first pass: −1, 0 or 1
    torque: FloatArray  # (2, n) mean torque of the motors in either pass [N·m or N]
    rows: FloatArray  # (2, n, b) mean gravity rows of the same positions
    noise: FloatArray  # (n,) σ of the mean of both torques by white noise [N·m or N]
    recording: str  # label

    @property
    def mean(self) -> tuple[FloatArray, FloatArray]:
        """Torque (n,) and rows (n, b) without friction."""
        return self.torque.mean(axis=0), self.rows.mean(axis=0)


@dataclass(frozen=True, eq=False)
class Visits:
    """What a recording shows."""

    visits: list[Visit]  # in order of time
    # passes of a kind with those of the visits that nothing pairs: pose, direction, time [s]
    unbalanced: list[tuple[FloatArray, IntArray, float]]
    moved: IntArray  # (n,) whether each joint changed its position at all


def find_visits(signals: JointSignals, model: DynamicModel, base: BaseParameters) -> Visits:
    """The poses that a recording passes slowly in both directions.

    Raises:
        DataError: there is none; names the joint and pose of a pass in one direction where there is one.
    """
    sliding = np.array(model.sliding)
    passes = find_passes(signals, sliding)
    fastest, shortest = np.where(sliding, FASTEST_SLIDE, FASTEST), np.where(sliding, SHORTEST_SLIDE, SHORTEST)
    slow = [
        each_pass
        for each_pass in passes
        if np.all(each_pass.peak <= fastest) and np.any(np.abs(each_pass.way) >= shortest)
    ]
    visits, used = [], set[int]()
    for first, slow_pass in enumerate(slow):
        if first in used:
            continue
        for second in range(first + 1, min(first + 1 + PARTNERS, len(slow))):
            if second in used:
                continue
            visit = _visit(signals, slow_pass, slow[second], shortest, model, base)
            if visit is not None:
                visits.append(visit)
                used |= {first, second}
                break
    alone = [slow_pass for index, slow_pass in enumerate(slow) if index not in used]
    unbalanced = _unbalanced(signals, alone, [slow[index] for index in used], visits)
    if len(unbalanced) > len(visits) or not visits:
        raise DataError(
            _one_direction(model, unbalanced) or "contains no pose that is passed slowly in both directions",
            where=signals.label,
            hint="friction cancels only between the two directions: record dynid excite ROBOT --for gravity",
        )
    return Visits(visits, unbalanced, (np.ptp(signals.position, axis=0) > 0.0).astype(np.int64))


def find_passes(signals: JointSignals, sliding: FloatArray) -> list[SlowPass]:
    """Stretches in which no joint turns back, ended by rest, reversal or a gap."""
    time, position = signals.time, signals.position
    if len(time) < 10:
        return []
    period = float(np.median(np.diff(time)))
    window = max(3, round(SMOOTHED / period))
    steps = np.nan_to_num(signals.encoder_steps)
    window = min(window, len(time) // 3)
    velocity = np.gradient(uniform_filter1d(position, window, axis=0), time, axis=0)
    velocity = uniform_filter1d(velocity, window, axis=0)
    still = np.maximum(np.where(sliding, STILL_SLIDE, STILL), 2.0 * steps / (window * period))
    sign = (np.sign(velocity) * (np.abs(velocity) > still)).astype(np.int64)
    breaks = np.concatenate([np.diff(time) > GAP * period, [True]])
    passes: list[SlowPass] = []
    begin, direction = -1, np.zeros(position.shape[1], dtype=np.int64)

    def close(end: int) -> None:
        if end - begin >= window:
            inside = slice(begin, end)
            way = position[end - 1] - position[begin]
            passes.append(SlowPass(inside, direction.copy(), np.abs(velocity[inside]).max(axis=0), way))

    moving = np.any(sign != 0, axis=1)
    for sample in range(len(time)):
        if begin >= 0 and (not moving[sample] or np.any(direction * sign[sample] < 0)):
            close(sample)
            begin = -1
        if begin < 0 and moving[sample]:
            begin, direction = sample, np.zeros_like(direction)
        if begin >= 0:
            direction = np.where(direction == 0, sign[sample], direction)
            if breaks[sample]:
                close(sample + 1)
                begin = -1
    return passes


def _visit(
    signals: JointSignals,
    slow_pass: SlowPass,
    other: SlowPass,
    shortest: FloatArray,
    model: DynamicModel,
    base: BaseParameters,
) -> Visit | None:
    """The visit that two passes make; None where they do not go the same way forth and back."""
    moving = np.abs(slow_pass.way) >= shortest
    if np.any(np.sign(slow_pass.way[moving]) == np.sign(other.way[moving])) or not np.any(moving):
        return None
    main = int(np.argmax(np.abs(slow_pass.way) / shortest))
    ends = [np.sort(signals.position[slow.samples][[0, -1], main]) for slow in (slow_pass, other)]
    low, high = max(end[0] for end in ends), min(end[1] for end in ends)
    if high - low < max(shortest[main], 0.5 * min(abs(slow_pass.way[main]), abs(other.way[main]))):
        return None
    share = (np.arange(GRID) + 0.5) / GRID
    grid, weight = low + (high - low) * share, _weight(share)
    along = [_along(signals.position[slow.samples], main, grid) for slow in (slow_pass, other)]
    length = np.abs(np.ptp(along[0], axis=0))
    if np.any(np.abs(along[0] - along[1]).max(axis=0) > np.maximum(shortest, SAME_WAY * length)):
        return None
    means = [_mean_torque(signals, slow, main, low, high) for slow in (slow_pass, other)]
    rows = np.stack([np.einsum("k,kmb->mb", weight / weight.sum(), gravity_rows(model, base, path)) for path in along])
    common = slow_pass.way * (length / np.maximum(np.abs(slow_pass.way), 1e-12))
    return Visit(
        pose=0.5 * (along[0][GRID // 2] + along[1][GRID // 2]),
        time=float(signals.time[other.samples.start] - signals.time[0]),
        direction=np.where(np.abs(common) >= 0.5 * shortest, np.sign(slow_pass.way), 0.0).astype(np.int64),
        torque=np.stack([mean for mean, _ in means]),
        rows=rows,
        noise=0.5 * np.sqrt(means[0][1] ** 2 + means[1][1] ** 2),
        recording=signals.label,
    )


def _weight(share: FloatArray) -> FloatArray:
    """Hann's window over the way: ripple of a few periods hardly passes it."""
    return np.asarray(np.sin(np.pi * np.clip(share, 0.0, 1.0)) ** 2)


def _along(position: FloatArray, main: int, grid: FloatArray) -> FloatArray:
    """Positions (GRID, n) of all joints where one joint is at the grid's."""
    order = np.argsort(position[:, main], kind="stable")
    return np.stack([np.interp(grid, position[order, main], column) for column in position[order].T], axis=1)


def _mean_torque(
    signals: JointSignals, slow_pass: SlowPass, main: int, low: float, high: float
) -> tuple[FloatArray, FloatArray]:
    """Mean torque (n,) over the way, and its σ by white noise."""
    position, torque = signals.position[slow_pass.samples, main], signals.torque[slow_pass.samples]
    speed = np.abs(np.gradient(uniform_filter1d(position, 5), signals.time[slow_pass.samples]))
    share = (position - low) / (high - low)
    weight = _weight(share) * speed
    weight /= weight.sum()
    mean = weight @ torque
    trend = np.vander(share, 4)
    inside = weight > 0.0
    root = np.sqrt(weight[inside])[:, None]
    fit, *_ = np.linalg.lstsq(root * trend[inside], root * torque[inside], rcond=None)
    spread = np.sqrt(weight[inside] @ (torque[inside] - trend[inside] @ fit) ** 2)
    return mean, spread * float(np.sqrt(np.sum(weight**2)))


def _unbalanced(
    signals: JointSignals, alone: Sequence[SlowPass], paired: Sequence[SlowPass], visits: Sequence[Visit]
) -> list[tuple[FloatArray, IntArray, float]]:
    """Passes without a partner that are of a kind with those that have one, or all where none has, by their middle."""
    passes = []
    length = np.median([np.abs(slow_pass.way).max() for slow_pass in paired]) if paired else 0.0
    peak = np.median([slow_pass.peak.max() for slow_pass in paired]) if paired else np.inf
    for slow_pass in alone:
        pose = signals.position[(slow_pass.samples.start + slow_pass.samples.stop) // 2]
        near = any(np.all(np.abs(pose - visit.pose) < 0.5 * np.abs(slow_pass.way) + 1e-3) for visit in visits)
        alike = 0.5 * length <= np.abs(slow_pass.way).max() and slow_pass.peak.max() <= 1.3 * peak
        if alike and not near and (not paired or np.abs(slow_pass.way).max() <= 2.0 * length):
            passes.append((pose, slow_pass.direction, float(signals.time[slow_pass.samples.start] - signals.time[0])))
    return passes


def _one_direction(model: DynamicModel, unbalanced: Sequence[tuple[FloatArray, IntArray, float]]) -> str:
    if not unbalanced:
        return ""
    pose, direction, time = unbalanced[0]
    more = "" if len(unbalanced) == 1 else f", and so at {len(unbalanced) - 1} more poses"
    return f"passes {pose_text(model, pose, direction)} at {time:.1f} s in one direction only{more}"


def pose_text(model: DynamicModel, pose: FloatArray, direction: IntArray) -> str:
    """A pose and its moving joints in words."""
    words = {1: "upwards", -1: "downwards"}
    moving = [
        f"{name} at {value:.2f} {'m' if slides else 'rad'} {words[int(sign)]}"
        for name, value, sign, slides in zip(model.joint_names, pose, direction, model.sliding, strict=True)
        if sign
    ]
    return first_few(moving, 2)
