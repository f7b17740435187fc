"""Equations of the closed-loop output error: the positions of a simulated arm against the recorded ones.

The recorded torque drives the simulated arm, a soft PD controller holds it near the recorded motion, as in
`ident.simulation.tracking`. Linearised at the simulated parameters θ₀, q_recorded − q_simulated = S·(θ − θ₀).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ident.model.inverse_dynamics import InverseDynamics
from ident.model.regressor import regressor
from ident.regression.comparison import TorqueSeries
from ident.regression.moment_equations import MomentRows
from ident.signals.prepared import Prepared, Segment
from ident.simulation.output_sensitivity import output_sensitivities
from ident.simulation.tracking import STEP, Tracking, tracked

SMOOTH = ("motor_inertia", "viscous", "inertial")
"""Kinds of parameters whose torque has a derivative by the motion."""


@dataclass(frozen=True, eq=False)
class OutputRows:
    """Equations of one segment; a joint's position in place of its torque.

    Attributes:
        inverse: the simulated model.
        segment: recorded motion and torque.
        tracking: what the simulated arm made of it.
        every: steps of the simulation per equation.
    """

    inverse: InverseDynamics
    segment: Segment
    tracking: Tracking
    every: int

    def series(self) -> TorqueSeries:
        """Recorded and simulated positions [rad or m] at the equations' times."""
        every = slice(None, None, self.every)
        time = self.tracking.motion.time[every]
        nearest = np.searchsorted(self.segment.time - self.segment.time[0], time - 1e-9)
        used = self.segment.used[np.minimum(nearest, len(self.segment.used) - 1)]
        return TorqueSeries(
            time=time,
            measured=self.tracking.position[every].T,
            predicted=self.tracking.motion.position[every].T,
            velocity=self.tracking.velocity[every].T,
            used=used,
        )

    def __iter__(self) -> Iterator[MomentRows]:
        """Stream them, joint by joint within a chunk."""
        inverse, motion = self.inverse, self.tracking.motion
        model, base, parameters = inverse.model, inverse.base, inverse.parameters
        smooth = np.where([kind in SMOOTH for kind in base.kinds], parameters, 0.0)
        along = InverseDynamics(model, base, smooth)
        step = float(motion.time[1] - motion.time[0])
        acceleration = np.gradient(motion.velocity, step, axis=0, edge_order=2)
        states = tuple(np.ascontiguousarray(signal.T) for signal in (motion.position, motion.velocity, acceleration))
        chunks = output_sensitivities(
            along.torque,
            lambda q, rate, change: regressor(model, q, rate, change, base.columns),
            (states[0], states[1], states[2]),
            (self.tracking.stiffness, self.tracking.damping),
            step,
        )
        series, begin = self.series(), 0
        for chunk in chunks:
            steps = begin + np.arange(len(chunk))
            begin += len(chunk)
            chosen = steps % self.every == 0
            samples = steps[chosen] // self.every
            used = series.used[samples]
            samples, sensitivity = samples[used], chunk[chosen][used]
            for motor in range(model.dof):
                rows = np.ascontiguousarray(sensitivity[:, motor].T)
                right = series.residual[motor, samples] + parameters @ rows
                yield MomentRows(motor, samples, tuple(range(base.count)), rows, rows, right)


def output_rows(inverse: InverseDynamics, run: Prepared) -> list[OutputRows]:
    """Simulate a run's segments.

    Raises:
        ModelError: the model cannot be simulated, or the motion diverges.
    """
    every = max(1, round(1.0 / (STEP * run.filtered_rate)))
    return [OutputRows(inverse, segment, tracked(inverse, segment), every) for segment in run.segments]
