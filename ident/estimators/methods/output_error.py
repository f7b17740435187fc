"""Closed-loop output error: positions of a simulated arm against the recorded ones (Landau and Karimi 1997).

Gauss-Newton with the sensitivities of the simulated motion. The loop is a stand-in: the recorded torque drives the arm,
and a soft PD controller holds it near the recorded motion (`ident.simulation.tracking`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import IdentificationError, ModelError
from ident.estimators.estimator import Estimation, EstimationLoop, Estimator, Setup
from ident.estimators.feasible.consistent import found_consistent
from ident.estimators.method import Method, NoOptions
from ident.estimators.torque_estimator import SystemEstimator, triangular_system
from ident.linear_algebra.triangular import QrAccumulator, triangular
from ident.model.dynamics.inverse_dynamics import InverseDynamics
from ident.model.regressor import regressor
from ident.regression.comparison import TorqueSeries
from ident.regression.estimate import estimate_of
from ident.regression.jackknife import CorrectedCovariance, FilteredRun
from ident.regression.least_squares import LeastSquares, weighted_least_squares
from ident.regression.moment_equations import MomentRows, moment_jackknife
from ident.regression.observability import whole_arm
from ident.regression.observation_matrix import Reduction
from ident.signals.prepared import Prepared, Segment
from ident.simulation.tracking import SIMULATION_STEP, Tracking, tracked

SIMULATION_SETTLED = 0.5
"""Largest change of a parameter, over its classical deviation. Smaller ones are noise of the simulation: where a
simulated joint reverses, the sampled sign of its velocity changes a sample earlier or later."""

SMOOTH = ("motor_inertia", "viscous", "inertial")
"""Kinds of parameters whose torque has a derivative by the motion."""

ITERATIONS = 15

DIFFERENCE = 1e-5
"""Steps of positions [rad] and velocities [rad/s] for the derivatives of the torque."""

STEPS_AT_ONCE = 1000

Torque = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
"""Positions, velocities, accelerations (n, m) → torques (n, m) without dry friction."""


def check_whole_arm(setup: Setup, method: str) -> None:
    """Refuse what cannot be simulated.

    Raises:
        IdentificationError: a joint stood still, so that the arm's parameters are not all known.
    """
    if setup.experiment != whole_arm(setup.kernel.model):
        raise IdentificationError(
            f"the method {method} simulates the whole arm, but not all joints moved or not all torques are used",
            hint="record a motion of all joints, or use --method wls",
        )


def simulable_arm(setup: Setup, reduction: Reduction, solution: LeastSquares) -> InverseDynamics:
    """A physically consistent arm near a solution.

    Raises:
        IdentificationError: there is none.
    """
    model = setup.kernel.model
    estimate = estimate_of(reduction, solution, solution.covariance, 1)
    consistent = found_consistent(model, setup.base, estimate, setup.robot_file)
    if consistent is None:
        raise IdentificationError(
            "no physically consistent arm is near the estimate, so nothing can be simulated", hint="use --method wls"
        )
    return InverseDynamics(model, setup.base, consistent.base)


@dataclass(frozen=True, eq=False)
class OutputRows:
    """Equations of one segment; a joint's position in place of its torque."""

    inverse: InverseDynamics  # the simulated model
    segment: Segment  # recorded motion and torque
    tracking: Tracking  # what the simulated arm made of it
    every: int  # steps of the simulation per equation

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
    every = max(1, round(1.0 / (SIMULATION_STEP * run.filtered_rate)))
    return [OutputRows(inverse, segment, tracked(inverse, segment), every) for segment in run.segments]


@dataclass(frozen=True, eq=False, kw_only=True)
class OutputEstimation(Estimation):
    """An estimate with its equations."""

    rows: tuple[OutputRows, ...]  # of every segment
    position_weights: FloatArray  # (n,) of the joints' equations [1/rad or 1/m]


@dataclass(frozen=True)
class OutputErrorEstimator(SystemEstimator):
    """Least squares of the positions' errors, each joint's divided by its standard deviation."""

    def estimate(self, runs: Sequence[Prepared], plain: Reduction, active: Sequence[int]) -> Estimation:
        """Simulate, linearise, solve, and so on."""
        reduction, solution = plain, self.solve(plain, active)
        weights = solution.weights
        changes: list[float] = []
        while len(changes) < ITERATIONS and (not changes or changes[-1] > SIMULATION_SETTLED):
            inverse = simulable_arm(self.setup, reduction, solution)
            try:
                rows = tuple(output_row for run in runs for output_row in output_rows(inverse, run))
            except ModelError as error:
                raise IdentificationError(
                    f"the identified arm cannot be simulated: {error.message}", hint="use --method wls"
                ) from error
            factors = [QrAccumulator(plain.column_count + 1) for _ in plain.joints]
            for row in rows:
                for entry in row:
                    factors[entry.motor].add(np.vstack([entry.regressor, entry.torque]))
            position_weights = _inverse_rms(rows)
            system = triangular(
                np.vstack([w * factor.factor() for w, factor in zip(position_weights, factors, strict=True)])
            )
            solved = triangular_system(plain, system, weights, active, "output-error", len(changes) + 1)
            moved = np.abs(solved.solution.parameters - solution.parameters)[list(active)]
            changes.append(float(np.max(moved / solved.solution.std[list(active)])))
            reduction, solution = solved.reduction, solved.solution
        return OutputEstimation(
            self.setup.kernel,
            reduction,
            solution,
            (EstimationLoop("simulation and fit", "σ", tuple(changes), changes[-1] <= SIMULATION_SETTLED),),
            passes=1 + len(changes),
            rows=rows,
            position_weights=position_weights,
        )

    def covariance(self, runs: Sequence[FilteredRun], estimation: Estimation) -> CorrectedCovariance:
        """Delete-block jackknife of the last linearised system."""
        assert isinstance(estimation, OutputEstimation)
        series = [row.series() for row in estimation.rows]
        return moment_jackknife(
            series, estimation.rows, replace(estimation.solution, weights=estimation.position_weights)
        )


def _inverse_rms(rows: Sequence[OutputRows]) -> FloatArray:
    """Weights (n,): one over the root mean square of each joint's error."""
    series = [row.series() for row in rows]
    squares = sum(np.sum(torque.residual**2, axis=1) for torque in series)
    count = sum(int(torque.used.sum()) for torque in series)
    return np.asarray(np.sqrt(max(count, 1) / np.maximum(squares, np.finfo(float).tiny)))


def _estimator(options: NoOptions, setup: Setup) -> Estimator:
    check_whole_arm(setup, "output-error")
    return OutputErrorEstimator(setup, weighted_least_squares)


def output_sensitivities(
    torque: Torque,
    regressor: Callable[[FloatArray, FloatArray, FloatArray], FloatArray],
    motion: tuple[FloatArray, FloatArray, FloatArray],
    gains: tuple[FloatArray, FloatArray],
    step: float,
) -> Iterator[FloatArray]:
    """Sensitivities (m, n, b) of the positions, chunk by chunk along the motion of an arm held near a recorded one.

    The departure δq that a change δθ causes solves

        M·δq̈ + (∂τ/∂q̇ + D)·δq̇ + (∂τ/∂q + K)·δq = −Y·δθ

    with τ the inverse dynamics without dry friction, whose direction is held, and Y the regressor. It is integrated by
    the trapezoidal rule for all parameters at once.

    Args:
        torque: inverse dynamics.
        regressor: (n, b, m) of chosen columns.
        motion: position, velocity, acceleration (n, N) of the simulated arm, `step` [s] apart.
        gains: K and D (n,) of the controller.
        step: [s].
    """
    dof, count = motion[0].shape
    stiffness, damping = (np.diag(gain) for gain in gains)
    state: tuple[FloatArray, FloatArray] | None = None
    for start in range(0, count, STEPS_AT_ONCE):
        chunk = tuple(signal[:, start : start + STEPS_AT_ONCE] for signal in motion)
        inertia, by_velocity, by_position = _derivatives(torque, *chunk)
        forced = -regressor(*chunk).transpose(2, 0, 1)
        by_velocity += damping
        by_position += stiffness
        implicit = np.linalg.inv(inertia + 0.5 * step * by_velocity + 0.25 * step**2 * by_position)
        if state is None:
            state = np.zeros((dof, forced.shape[2])), np.zeros((dof, forced.shape[2]))
        position, velocity = state
        out = np.empty(forced.shape)
        for sample in range(len(forced)):
            out[sample] = position
            rest = by_velocity[sample] @ velocity + by_position[sample] @ (position + 0.5 * step * velocity)
            change = step * (implicit[sample] @ (forced[sample] - rest))
            position = position + step * (velocity + 0.5 * change)
            velocity = velocity + change
        state = position, velocity
        yield out


def _derivatives(
    torque: Torque, position: FloatArray, velocity: FloatArray, acceleration: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """∂τ/∂q̈, ∂τ/∂q̇ and ∂τ/∂q (m, n, n), by central differences; the first is exact."""
    dof, count = position.shape
    result = [np.empty((count, dof, dof)) for _ in range(3)]
    signals = (acceleration, velocity, position)
    for matrices, signal, reach in zip(result, signals, (1.0, DIFFERENCE, DIFFERENCE), strict=True):
        for joint in range(dof):
            kept = signal[joint].copy()
            sides = []
            for sign in (1.0, -1.0):
                signal[joint] = kept + sign * reach
                sides.append(torque(position, velocity, acceleration))
            signal[joint] = kept
            matrices[:, :, joint] = ((sides[0] - sides[1]) / (2.0 * reach)).T
    return result[0], result[1], result[2]


METHOD = Method(
    "positions of a simulated arm that the recorded torque drives, compared with the recorded ones",
    "torque",
    NoOptions,
    _estimator,
)
