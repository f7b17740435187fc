"""Several methods on the same data: errors on each held-out recording, and their paired differences (AUBO .3.4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import FloatArray
from ident.assessment.validation import LOW_SPEED, fit_errors
from ident.regression.comparison import TorqueSeries

MAIN_AXES = 3
"""Joints that carry the wrist, where an arm has at least `WRISTED` (AUBO Tables III and IV: elbow and wrist joints)."""

WRISTED = 5


@dataclass(frozen=True)
class JointGroup:
    """Joints whose largest errors are taken together."""

    name: str  # of the group
    joints: tuple[int, ...]  # their numbers, from 0
    members: tuple[str, ...]  # their names


@dataclass(frozen=True)
class RunErrors:
    """Errors of one model's torques on one held-out recording; nan where there is no such sample."""

    relative_error: float  # ‖τ − τ̂‖ / ‖τ‖, a ratio
    rmse: float  # root mean square over all joints [N·m]
    # low_speed_rmse, high_speed_rmse: the same below and above `LOW_SPEED` [N·m]
    low_speed_rmse: float
    high_speed_rmse: float
    # low_speed_max, high_speed_max: largest error in each group of joints [N·m]
    low_speed_max: tuple[float, ...]
    high_speed_max: tuple[float, ...]


@dataclass(frozen=True)
class PairedDifference:
    """Mean difference of two models' errors on the same recordings."""

    mean: float  # second minus first
    half_width: float  # of its 95 % interval (Student's t); inf with fewer than two recordings
    runs: int  # number of recordings

    @property
    def significant(self) -> bool:
        """Return whether the interval excludes zero."""
        return abs(self.mean) > self.half_width


def joint_groups(joints: Sequence[str]) -> tuple[JointGroup, ...]:
    """Main axes and wrist, apart; all joints in one group where the arm is too short for a wrist."""
    parts = {"all joints": 0} if len(joints) < WRISTED else {"main axes": 0, "wrist": MAIN_AXES}
    ends = [*list(parts.values())[1:], len(joints)]
    return tuple(
        JointGroup(name, tuple(range(start, end)), tuple(joints[start:end]))
        for (name, start), end in zip(parts.items(), ends, strict=True)
    )


def run_errors(series: Sequence[TorqueSeries], groups: Sequence[JointGroup]) -> RunErrors:
    """Errors over all segments of a recording together.

    Raises:
        DataError: no sample counts (the arm never moves).
    """
    counted = np.concatenate([torque.counted & np.isfinite(torque.predicted) for torque in series], axis=1)
    errors = np.abs(np.concatenate([torque.measured - torque.predicted for torque in series], axis=1))
    slow = np.abs(np.concatenate([torque.velocity for torque in series], axis=1)) < LOW_SPEED
    errors = np.where(counted, errors, 0.0)
    low, high = counted & slow, counted & ~slow
    return RunErrors(
        relative_error=fit_errors(series).relative_error,
        rmse=_rms(errors[counted]),
        low_speed_rmse=_rms(errors[low]),
        high_speed_rmse=_rms(errors[high]),
        low_speed_max=tuple(_largest(errors[list(group.joints)][low[list(group.joints)]]) for group in groups),
        high_speed_max=tuple(_largest(errors[list(group.joints)][high[list(group.joints)]]) for group in groups),
    )


def paired_difference(first: Sequence[float], second: Sequence[float]) -> PairedDifference:
    """Mean of second − first over the recordings that both have an error on."""
    from scipy.special import stdtrit

    differences = np.array(second, dtype=np.float64) - np.array(first, dtype=np.float64)
    differences = differences[np.isfinite(differences)]
    count = len(differences)
    if count == 0:
        return PairedDifference(float("nan"), float("inf"), 0)
    if count == 1:
        return PairedDifference(float(differences[0]), float("inf"), 1)
    half = float(stdtrit(count - 1, 0.975) * np.std(differences, ddof=1) / np.sqrt(count))
    return PairedDifference(float(np.mean(differences)), half, count)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float("nan")


def _largest(values: FloatArray) -> float:
    return float(np.max(values)) if len(values) else float("nan")
