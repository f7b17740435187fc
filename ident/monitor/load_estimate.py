"""The load on the tool, estimated while the arm moves: recursive least squares with an interval, frozen at rest."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from drivers.core.arrays import FloatArray, IndexArray
from ident.model.dynamics.pinocchio_model import PINOCCHIO_ORDER, pinocchio_model
from ident.model.load import moved_origin
from ident.model.parameters import INERTIAL
from ident.monitor.interval_torque import Intervals
from ident.monitor.observers import observer
from ident.monitor.thresholds import REST, Thresholds
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.result.models.model import Model

PRIOR = {"M": 50.0, "MX": 10.0, "MY": 10.0, "MZ": 10.0}
"""σ before any sample [kg, kg·m]; of the inertias `PRIOR_INERTIA`."""
PRIOR_INERTIA = 0.5
"""[kg·m²]"""
TOGETHER = 10
"""Samples that are averaged before they are evaluated."""
AT_ONCE = 100
"""Samples that are evaluated together, unless an estimate is asked for before: that costs a third."""
PINOCCHIO_PLACES = tuple(INERTIAL.index(symbol) for symbol in PINOCCHIO_ORDER)
"""Where Pinocchio's parameters of a body stand among ours."""
CORRELATION = 0.25
"""[s] for which a residual repeats itself: ripple and errors of the model last longer than the filter."""
SURE_SECONDS, SURE_MARGINS = 2.0, 3.0
"""Time in motion [s], and ratio of a load to its 95 % margin, from which on contacts are said to be a load."""
FEWEST_SECONDS = 0.5
"""Time in motion [s] from which on a load is given."""


@dataclass(frozen=True)
class ToolLoad:
    """A load on the tool."""

    mass: float  # [kg]
    margin: float  # of it, 95 % [kg]
    # (3,) from the tool point, axes of the last joint's frame [m]; None where the mass is not significant
    centre: FloatArray | None
    seconds: float  # in motion that it comes from [s]


def changed_load(load: ToolLoad | None) -> str:
    """Say that contacts are the weight of another load on the tool, in words; empty where it is not significant."""
    if load is None or load.seconds < SURE_SECONDS or abs(load.mass) < SURE_MARGINS * load.margin:
        return ""
    what = "a load" if load.mass > 0.0 else "the lack of a load"
    return (
        f"the external torque since the last contact fits {what} of {abs(load.mass):.2f} ± {load.margin:.2f} kg at the "
        "tool: if so, it is not a contact; identify the arm with this load"
    )


class LoadEstimator:
    """Estimates the load since its last `restart`.

    A load acts as external torque −Y·θ, with Y the regressor of a body at the tool. Both sides are averaged over a few
    samples and go through the same low-pass, as accelerations are second differences of positions. Joints near rest
    say nothing, for their friction is not known.

    Args:
        model: without the load.
        thresholds: whose spreads weigh the joints.
    """

    def __init__(self, model: Model, thresholds: Thresholds) -> None:
        self._model, self._thresholds = model.dynamics.model, thresholds
        self._moved = moved_origin(np.array(model.stored.robot_file.robot.workspace.tool))[list(PINOCCHIO_PLACES)]
        self._arm: Any = pinocchio_model(self._model)
        self._data = self._arm.createData()
        period = TOGETHER * thresholds.period
        self._filter = observer("direct", period, model.dof * (len(INERTIAL) + 1), thresholds.bandwidth)
        self._independent = min(1.0, period / CORRELATION)
        self._rows: list[FloatArray] = []
        self.restart()

    def restart(self) -> None:
        """Forget all; the next sample is the first."""
        deviations = np.array([PRIOR.get(name, PRIOR_INERTIA) for name in INERTIAL])
        self._information = np.diag(deviations**-2)
        # What the filter remembers is of the load before.
        self._rows, self._broken = [], True
        self._waiting = 0
        self._moment = np.zeros(len(INERTIAL))
        self._moving = 0

    def add(self, intervals: Intervals, way: IndexArray) -> None:
        """Take over samples, with each joint's way of motion (N, n)."""
        parts = (intervals.position, intervals.velocity, intervals.acceleration, intervals.external, way)
        rows = np.concatenate(parts, axis=1, dtype=np.float64)
        for first, end in pairwise([0, *intervals.restarted.nonzero()[0].tolist(), len(rows)]):
            if first < end and intervals.restarted[first]:
                self._take_over()
                self._rows, self._waiting, self._broken = [], 0, True
            self._rows.append(rows[first:end])
            self._waiting += end - first
        if self._waiting >= AT_ONCE:
            self._take_over()

    def _take_over(self) -> None:
        """Evaluate the whole blocks among the samples that wait."""
        count = self._waiting // TOGETHER
        if not count:
            return
        joints, rows = self._model.dof, np.concatenate(self._rows)
        self._rows = [rows[count * TOGETHER :]]
        self._waiting -= count * TOGETHER
        blocks = rows[: count * TOGETHER].reshape(count, TOGETHER, -1)
        position, velocity, acceleration, external, _ = np.split(blocks.mean(axis=1), 5, axis=1)
        columns = np.array([self.columns(*motion) for motion in zip(position, velocity, acceleration, strict=True)])
        both = np.concatenate([columns, external[:, :, None]], axis=2).reshape(count, -1)
        broken = np.zeros(count, dtype=bool)
        broken[0], self._broken = self._broken, False
        filtered = self._filter.apply(both, broken).reshape(count, joints, -1)
        ways = blocks[:, :, 4 * joints :].astype(np.intp)
        used = np.all(ways != REST, axis=1)
        weighted = (filtered / self._thresholds.spread[ways[:, -1], np.arange(joints)][:, :, None])[used]
        self._information += self._independent * weighted[:, :-1].T @ weighted[:, :-1]
        self._moment -= self._independent * weighted[:, :-1].T @ weighted[:, -1]
        self._moving += TOGETHER * int(np.count_nonzero(used.any(axis=1)))

    def columns(self, position: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
        """Joint torques (n, 10) per parameter of a body at the tool, for a motion (n,) [rad, rad/s, rad/s² or m…]."""
        import pinocchio as pin

        motion = self._model.tree_motion(position[:, None], velocity[:, None], acceleration[:, None])
        tree = [np.ascontiguousarray(part[:, 0]) for part in (motion.position, motion.velocity, motion.acceleration)]
        link = self._model.tool_link + 1
        pin.rnea(self._arm, self._data, *tree)
        body = pin.jointBodyRegressor(self._arm, self._data, link)
        pin.computeJointJacobians(self._arm, self._data, tree[0])
        jacobian = pin.getJointJacobian(self._arm, self._data, link, pin.ReferenceFrame.LOCAL)
        follow = motion.follow if motion.follow.ndim == 2 else motion.follow[..., 0]
        return np.asarray(follow.T @ (jacobian.T @ body @ self._moved))

    @property
    def estimate(self) -> ToolLoad | None:
        """The load; None before the arm has moved long enough."""
        self._take_over()
        seconds = self._moving * self._thresholds.period
        if seconds < FEWEST_SECONDS:
            return None
        covariance = np.linalg.inv(self._information)
        estimate = covariance @ self._moment
        at = INERTIAL.index("M")
        mass, margin = float(estimate[at]), WITHIN_95_PERCENT * float(np.sqrt(covariance[at, at]))
        centre = estimate[[INERTIAL.index(name) for name in ("MX", "MY", "MZ")]] / mass if mass > margin else None
        return ToolLoad(mass, margin, centre, seconds)
