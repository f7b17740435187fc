"""A motion on a grid of times, as the content of a trajectory file, and the interface of constraints."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, Protocol

import numpy as np

from daq.motion.fourier_quintic import FourierQuintic
from daq.motion.trajectories import FourierSeries, Motion, PointToPoint, RestToRest, SumOfSines
from daq.motion.trajectory_file import (
    FourierQuinticTrajectory,
    FourierTrajectory,
    PointsTrajectory,
    SinesTrajectory,
    Trajectory,
)
from drivers.core.arrays import FloatArray


@dataclass(frozen=True)
class JointPath:
    """A joint motion on a grid of times."""

    time: FloatArray  # (N,) [s]
    position: FloatArray  # (n, N) [rad or m]
    velocity: FloatArray  # (n, N) [rad/s or m/s]
    acceleration: FloatArray  # (n, N) [rad/s² or m/s²]


def repeated_for(motion: Motion, seconds: float) -> Motion:
    """The motion with so many of its repetitions as last `seconds`; one at least, which takes all of its values."""
    if not isinstance(motion, RestToRest | FourierQuintic):
        return motion
    once = replace(motion, periods=1)
    more = max(0.0, seconds - once.duration) * (motion.periods - 1) / max(motion.duration - once.duration, 1e-9)
    return replace(motion, periods=min(motion.periods, 1 + int(more)))


_FORMS: dict[type[Motion], tuple[str, type[Trajectory]]] = {
    FourierSeries: ("fourier", FourierTrajectory),
    FourierQuintic: ("fourier-quintic", FourierQuinticTrajectory),
    SumOfSines: ("sines", SinesTrajectory),
    PointToPoint: ("points", PointsTrajectory),
}
"""What a trajectory file calls a motion, whose fields are the file's keys."""


def trajectory_of(motion: Motion, robot: str, comment: str) -> Trajectory:
    """A motion as the content of a trajectory file for the robot of that name."""
    inner, further = motion, dict[str, Any]()
    if isinstance(motion, RestToRest):
        inner, further = motion.motion, {"ramp": motion.ramp}
        if isinstance(inner, FourierSeries):
            further["periods"] = motion.periods
    kind, form = _FORMS[type(inner)]
    values = {of.name: getattr(inner, of.name) for of in fields(inner)}  # type: ignore[arg-type]
    plain = {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in values.items()}
    return form.model_validate({"robot": robot, "comment": comment, "kind": kind, **plain, **further})


class Constraint(Protocol):
    """A limit on the motion; each value is a limit utilisation, 1 at the limit."""

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each value, for messages (`velocity of elbow`)."""

    def use(self, path: JointPath) -> FloatArray:
        """(m,) largest utilisation along the path, exactly on its grid; ≤ 1 is allowed."""

    def smooth_use(self, path: JointPath, sharpness: float) -> tuple[FloatArray, FloatArray]:
        """A smooth upper bound (m,) of `use` and its derivatives (m, 3, n, N).

        The bound is the soft maximum over the grid and tightens as `sharpness` grows.
        """
