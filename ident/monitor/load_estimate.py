"""The load on the tool, estimated while the arm moves: recursive least squares with an interval, frozen at rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import BoolArray, FloatArray
from ident.model.load import load_effect
from ident.model.parameters import INERTIAL
from ident.monitor.interval_torque import Intervals
from ident.monitor.thresholds import REST, Thresholds
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.result.model import Model

PRIOR = {"M": 50.0, "MX": 10.0, "MY": 10.0, "MZ": 10.0}
"""σ before any sample [kg, kg·m]; of the inertias `PRIOR_INERTIA`."""
PRIOR_INERTIA = 0.5
"""[kg·m²]"""
FEWEST_SECONDS = 0.5
"""Time in motion [s] from which on a load is given."""


@dataclass(frozen=True)
class LoadEstimate:
    """A load on the tool.

    Attributes:
        mass: [kg].
        margin: of it, 95 % [kg].
        centre: (3,) from the tool point, axes of the last joint's frame [m]; None where the mass is not significant.
        seconds: in motion that it comes from [s].
    """

    mass: float
    margin: float
    centre: FloatArray | None
    seconds: float


class LoadEstimator:
    """Estimates the load since its last `restart`.

    A load m acts as external torque −Y·θ, with Y the regressor of the tool link's ten parameters. Both sides go through
    the observer's filter, a low-pass to which q̈ belongs. Joints near rest say nothing, for their friction is not known.

    Args:
        model: without the load.
        thresholds: whose observer and spreads are used.
    """

    def __init__(self, model: Model, thresholds: Thresholds) -> None:
        dynamics = model.dynamics
        self._model, self._thresholds = model, thresholds
        self._effect = load_effect(dynamics.model, dynamics.base, model.stored.robot_file.robot)
        self._filters = [thresholds.observer() for _ in INERTIAL]
        # Filtered samples within a time constant repeat each other.
        self._independent = min(1.0, thresholds.bandwidth * thresholds.period / 2.0)
        self.restart()

    def restart(self) -> None:
        """Forget all; the next sample is the first."""
        deviations = np.array([PRIOR.get(name, PRIOR_INERTIA) for name in INERTIAL])
        self._information = np.diag(deviations**-2)
        self._moment = np.zeros(len(INERTIAL))
        self._moving = 0

    def add(
        self, intervals: Intervals, filtered: FloatArray, way: np.ndarray[tuple[int, ...], np.dtype[np.intp]]
    ) -> None:
        """Take over samples: their external torque through the observer (N, n), and each joint's way of motion."""
        if not len(intervals):
            return
        celsius = intervals.celsius
        rows = (
            self._model.regressor(intervals.position, intervals.velocity, intervals.acceleration, celsius)
            @ self._effect
        )
        columns = np.stack(
            [one.apply(rows[..., index], intervals.restarted) for index, one in enumerate(self._filters)], axis=-1
        )
        used: BoolArray = way != REST
        if not used.any():
            return
        spread = np.take_along_axis(self._thresholds.spread, way, axis=0)
        weighted = columns[used] / spread[used][:, None]
        self._information += self._independent * weighted.T @ weighted
        self._moment -= self._independent * weighted.T @ (filtered[used] / spread[used])
        self._moving += int(np.count_nonzero(used.any(axis=1)))

    @property
    def estimate(self) -> LoadEstimate | None:
        """The load; None before the arm has moved long enough."""
        seconds = self._moving * self._thresholds.period
        if seconds < FEWEST_SECONDS:
            return None
        covariance = np.linalg.inv(self._information)
        found = covariance @ self._moment
        at = INERTIAL.index("M")
        mass, margin = float(found[at]), WITHIN_95_PERCENT * float(np.sqrt(covariance[at, at]))
        centre = found[[INERTIAL.index(name) for name in ("MX", "MY", "MZ")]] / mass if mass > margin else None
        return LoadEstimate(mass, margin, centre, seconds)
