"""Errors of an estimate that neither residuals nor the jackknife show: delay, sticking, drive gains.

The jackknife sees errors that change from block to block. Two come back with every period of the motion: a torque that
lags by less than `dynid` corrects (a gravity torque that turns with the joint then looks like viscous friction), and
equations near reversals, where static friction is wrong. Both leave a trace in the data: the delay's own estimate, and
how far the parameters move without those equations, beyond what fewer equations move them by chance. Their squares are
added to the covariance, as the essential model's has the square of what the pruning changed.

Drive gains leave no trace. The torque of a joint is its gain times its motor's signal. Least squares is linear in the
torque, so a gain that is too high by the share ε of itself moves the parameters by ε·(WᵀΩW)⁻¹W_jᵀΩ_jτ_j, W_j and τ_j
that joint's rows. A robot file has the standard deviation of each gain, and not how the errors of the joints go
together. Those of one data sheet, or of one weighed load, are common: all masses then come out wrong by that share, and
nothing averages out over the joints. A ratio of them, such as a centre of mass, suffers from errors of single joints
instead. A variance is linear in the correlation, so the larger one of both extremes covers whatever lies between them.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from daq.robot.schema import Robot
from drivers.core.arrays import FloatArray
from drivers.core.errors import IdentificationError, UsageError
from ident.model.regressor import RegressorKernel
from ident.regression.jackknife import CorrectedCovariance
from ident.regression.least_squares import LeastSquares, excited_columns, solve_weighted
from ident.regression.observation_matrix import Reduction, only_torques, reduce_segments, stack_reductions
from ident.regression.velocity_reversals import without_reversals
from ident.signals.prepared import Prepared


def with_systematic_errors(
    corrected: CorrectedCovariance,
    kernel: RegressorKernel,
    runs: Sequence[Prepared],
    reduction: Reduction,
    weights: FloatArray,
    active: Sequence[int],
    torques: Sequence[int],
    delay: float,
) -> CorrectedCovariance:
    """The covariance with what a delay and sticking near reversals may have done to the parameters.

    Args:
        corrected: by the jackknife.
        kernel: of the base columns.
        runs: the data, without equations that the estimate rejected.
        reduction: of them.
        weights: (n,) of the motors' equations.
        active: base columns that were estimated (a).
        torques: motors whose equations count.
        delay: root mean square of the delay that is still in the data [s]; 0 where the delay is known.
    """
    chosen, total = list(active), corrected.covariance
    try:
        whole = solve_weighted(reduction, active, weights, "wls", 1)
    except IdentificationError:  # what a robust estimate counts little determines a parameter
        return corrected
    parts = [without_reversals(kernel, run) for run in runs]
    away = only_torques(
        stack_reductions([reduce_segments(kernel, run.segments, run.parallel_filter) for run in parts]), torques
    )
    if set(chosen) <= set(excited_columns(away)):
        try:
            rest = solve_weighted(away, active, weights, "wls", 1)
            moved = beyond_chance(
                (rest.parameters - whole.parameters)[chosen],
                np.diag(corrected.covariance) * (np.diag(rest.inverse) / np.diag(whole.inverse) - 1.0),
            )
            total = total + np.outer(moved, moved)
        except IdentificationError:  # too little is left to compare with
            pass
    if delay > 0.0:
        changes = []
        for run in runs:
            slopes = [np.gradient(segment.torque, axis=1) * segment.rate for segment in run.segments]
            changes.append(reduce_segments(kernel, run.segments, run.parallel_filter, slopes))
        lagging = only_torques(stack_reductions(changes), torques)
        moved = delay * solve_weighted(lagging, active, weights, "wls", 1).parameters[chosen]
        total = total + np.outer(moved, moved)
    return replace(corrected, covariance=total, random_std=np.sqrt(np.diag(corrected.covariance)))


def beyond_chance(moved: FloatArray, variance: FloatArray) -> FloatArray:
    """What is left of moves (a,) without what their variance (a,) explains: an estimate from fewer data moves anyway.

    The variance of the difference is the difference of the variances (Hausman, Econometrica 46, 1978).
    """
    excess = np.square(moved) - np.maximum(variance, 0.0)
    return np.asarray(np.sign(moved) * np.sqrt(np.maximum(excess, 0.0)))


def gain_sensitivity(reduction: Reduction, solution: LeastSquares) -> FloatArray:
    """Movement (b, n) of the base parameters over the relative change of each joint's gain; 0 where not estimated.

    Args:
        reduction: the torque equations, one factor per joint.
        solution: theirs, by `ols` or `wls`; the weights are those of the solution.

    Raises:
        UsageError: the solution is of equations without rows of a single joint, as those of the energy.
    """
    if len(solution.weights) != len(reduction.joints):
        raise UsageError(f"the rows of method {solution.method} belong to no single joint", hint="use wls or ols")
    place = {column: position for position, column in enumerate(solution.active)}
    scores = np.zeros((len(solution.active), len(reduction.joints)))
    for joint_index, joint in enumerate(reduction.joints):
        width = len(joint.columns)
        score = solution.weights[joint_index] ** 2 * (joint.factor[:, :width].T @ joint.factor[:, width])
        for column, value in zip(joint.columns, score.tolist(), strict=True):
            if column in place:
                scores[place[column], joint_index] = value
    moved = np.zeros((reduction.column_count, len(reduction.joints)))
    moved[list(solution.active)] = solution.inverse @ scores
    return moved


def relative_gain_std(robot: Robot, used: Collection[str]) -> FloatArray:
    """Standard deviation (n,) of each drive's gain over the gain, by the robot file; 0 where it names none.

    Args:
        robot: the arm.
        used: names of the joints whose torque a gain made; a recorded torque has no error of a gain.
    """
    drives = [robot.drive(name) for name in robot.joint_names]
    return np.array(
        [(drive.gain_std or 0.0) / abs(drive.gain) if drive.gain and drive.joint in used else 0.0 for drive in drives]
    )


def gain_deviations(moves: FloatArray) -> FloatArray:
    """Standard deviations (k,) of values by gains of unknown correlation: the larger of independent and common errors.

    Args:
        moves: (n, k) of the values by one standard deviation of each joint's gain.
    """
    return np.asarray(np.maximum(np.linalg.norm(moves, axis=0), np.abs(np.sum(moves, axis=0))))


def gain_covariances(moves: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Covariances (k, k) of the values by independent errors of the gains, and by one that is common to all.

    Args:
        moves: as of `gain_deviations`.
    """
    common = np.sum(moves, axis=0)
    return np.asarray(moves.T @ moves), np.outer(common, common)
