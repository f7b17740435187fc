"""Least squares over a free and a loaded run at once: base parameters in common, the load in the loaded run only."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from pydantic import Field

from drivers.core.arrays import FloatArray
from drivers.core.errors import DataError
from ident.experiments.run_pair import FREE, LOADED, BlockGrams, RunPair, block_grams, weighted_blocks, widened
from ident.model.load import KnownLoad, LoadColumns, load_columns
from ident.model.parameters import MASS
from ident.regression.estimate import Estimate, estimate_of
from ident.regression.jackknife import BlockSums, jackknife_covariance, least_squares_moves
from ident.regression.least_squares import LeastSquares, excited_columns, ordinary_least_squares
from ident.regression.observation_matrix import JointFactor, Reduction
from ident.regression.systematic_errors import gain_deviations, gain_sensitivity, relative_gain_std
from ident.regression.total_least_squares import signal_noise
from ident.stored import Real, Stored


class LoadParameter(Stored):
    """One identifiable combination of load parameters, in the tool frame."""

    name: str
    expression: str
    unit: str
    value: Real = Field(description="null where the two motions do not excite it")
    std: Real = Field(description="both causes together")
    noise_std: Real = Field(description="from noise and errors that change along the motion")
    gain_std: Real = Field(description="from the drive gains' standard deviations, their errors independent or common")


class CentreOfMass(Stored):
    """Centre of mass of the load in the tool frame [m]."""

    value: list[float]
    std: list[float]


@dataclass(frozen=True)
class LoadEstimate:
    """An identified load: its parameters, and the matrices of all equations that test them, too large for a file."""

    columns: LoadColumns  # identifiable combinations
    parameters: list[LoadParameter]  # (k) their values
    covariance: FloatArray  # (k, k) from noise and errors that change along the motion
    # (n, k) of the combinations by one standard deviation of each joint's drive gain; zero where the file names none
    gain_moves: FloatArray
    known: KnownLoad | None  # parameters held fixed
    standard: FloatArray  # (10,) standard parameters in the tool frame; nan for those that only combinations reveal
    standard_covariance: FloatArray  # (10, 10) as `covariance`; 0 where `standard` is nan
    standard_gain_moves: FloatArray  # (n, 10) as `gain_moves`; 0 where `standard` is nan
    estimate: Estimate  # of the arm's base parameters and these combinations together, from noise alone
    estimate_gain_moves: FloatArray  # (n, a) of the same by one standard deviation of each gain

    @property
    def values(self) -> FloatArray:
        """(k,) of the combinations; nan where these two motions do not excite one."""
        return np.array([parameter.value for parameter in self.parameters])

    def standard_deviations(self, directions: FloatArray) -> FloatArray:
        """Standard deviations (m,), both causes together, of combinations (m, 10) of the standard parameters."""
        noise = np.einsum("mi,ij,mj->m", directions, self.standard_covariance, directions)
        return np.asarray(np.hypot(np.sqrt(noise), gain_deviations(self.standard_gain_moves @ directions.T)))

    @property
    def centre(self) -> CentreOfMass | None:
        """Centre of mass; None where mass or first moments are unknown."""
        mass, moments = self.standard[MASS], self.standard[6:9]
        if not np.all(np.isfinite(moments)) or not mass > 0:
            return None
        centre = moments / mass
        slope = np.zeros((3, 10))
        slope[:, 6:9] = np.eye(3) / mass
        slope[:, MASS] = -centre / mass
        return CentreOfMass(value=centre.tolist(), std=self.standard_deviations(slope).tolist())


@dataclass(frozen=True)
class SeparateRuns:
    """Each run separately: base parameters (b,), weights (n,), and how each block moves the active ones (B, a)."""

    active: tuple[int, ...]
    parameters: tuple[FloatArray, FloatArray]
    weights: tuple[FloatArray, FloatArray]
    moves: tuple[FloatArray, FloatArray]


def identify_separately(pair: RunPair) -> tuple[SeparateRuns, BlockGrams]:
    """Both runs by themselves, on the columns that each of them excites, and the blocks for all jackknives.

    Raises:
        DataError: they excite no column in common.
    """
    active = tuple(
        column for column in pair.active if all(column in _excited(run.reduction, pair.active) for run in pair.runs)
    )
    if not active:
        raise DataError("the two motions excite no base parameter in common", hint="move the same joints in both runs")
    # A joint's noise is what its own columns leave of its torque: weights by the whole model's residuals would give
    # joints away whose drive gains are wrong, and need not settle.
    weights = [_weights(run.reduction) for run in pair.runs]
    solutions = [
        ordinary_least_squares(_weighted(run.reduction, weight), active)
        for run, weight in zip(pair.runs, weights, strict=True)
    ]
    parameters = (solutions[FREE].parameters, solutions[LOADED].parameters)
    grams = block_grams(pair, parameters)
    unchanged, chosen = (np.zeros((pair.base.count, 0)), np.zeros(pair.base.count)), [*active, pair.base.count]
    moves = [
        _moves(weighted_blocks(pair, grams, run, weights[run], unchanged, chosen), solutions[run])
        for run in (FREE, LOADED)
    ]
    return SeparateRuns(active, parameters, (weights[FREE], weights[LOADED]), (moves[FREE], moves[LOADED])), grams


def change_between(separate: SeparateRuns) -> tuple[FloatArray, FloatArray]:
    """Loaded minus free active parameters (a,), and the covariance of that; blocks that both runs share count once."""
    active = list(separate.active)
    difference = separate.parameters[LOADED][active] - separate.parameters[FREE][active]
    return difference, jackknife_covariance(separate.moves[LOADED] - separate.moves[FREE])


def estimate_load(
    pair: RunPair,
    grams: BlockGrams,
    effect: FloatArray,
    weights: tuple[FloatArray, FloatArray],
    known: KnownLoad | None,
) -> LoadEstimate:
    """Joint least squares over both runs, each joint's rows weighted as in the separate runs.

    Raises:
        DataError: nothing is known of the load, and the motions show none of its parameters.
    """
    columns = load_columns(effect, () if known is None else known.known)
    shift = np.zeros(pair.base.count) if known is None else effect @ known.values
    count, size = pair.base.count, pair.base.count + len(columns.names)
    system = _joint_system(pair, columns.effect, shift, weights)
    excited = set(excited_columns(system))
    active = tuple(i for i in range(size) if i in excited and (i >= count or i in pair.active))
    places = [place for place, column in enumerate(active) if column >= count]
    if not places and known is None:
        raise DataError(
            "the two motions show no parameter of a load",
            where=pair.runs[LOADED].label,
            hint="move more joints, the last ones too: dynid excite ROBOT --loaded",
        )
    solution = ordinary_least_squares(system, active)  # its rows are weighted already
    unchanged = (np.zeros_like(columns.effect), np.zeros(count))
    summed = weighted_blocks(pair, grams, FREE, weights[FREE], unchanged, [*active, size])
    summed += weighted_blocks(pair, grams, LOADED, weights[LOADED], (columns.effect, shift), [*active, size])
    covariance = jackknife_covariance(_moves(summed, solution))
    # The known part of the load is no torque of the drives: their gains act on the torques as they were measured.
    measured = _joint_system(pair, columns.effect, np.zeros(count), weights)
    parts = np.split(gain_sensitivity(measured, solution)[list(active)].T, 2)  # each (n, a)
    robot, gain_moves = pair.robot_file.robot, np.zeros_like(parts[FREE])
    for part, run in zip(parts, pair.runs, strict=True):
        gain_moves += part * relative_gain_std(robot, run.gains_used)[:, None]
    estimate = estimate_of(system, solution, covariance, grams.count)
    return _with_standard(columns, known, estimate, gain_moves, count)


def _with_standard(
    columns: LoadColumns, known: KnownLoad | None, estimate: Estimate, gain_moves: FloatArray, count: int
) -> LoadEstimate:
    size = len(columns.names)
    places = [place for place, column in enumerate(estimate.active) if column >= count]
    identified = [estimate.active[place] - count for place in places]
    values = np.full(size, np.nan)
    values[identified] = estimate.values[places]
    covariance = np.full((size, size), np.nan)
    covariance[np.ix_(identified, identified)] = estimate.covariance[np.ix_(places, places)]
    moves = np.full((len(gain_moves), size), np.nan)
    moves[:, identified] = gain_moves[:, places]
    standard, spread, standard_moves = np.full(10, np.nan), np.zeros((10, 10)), np.zeros((len(gain_moves), 10))
    if known is not None:
        standard[list(known.known)] = known.values[list(known.known)]
    alone = [i for i in range(size) if np.count_nonzero(columns.projection[i]) == 1 and i in identified]
    kept = [columns.kept[i] for i in alone]
    standard[kept] = values[alone]
    spread[np.ix_(kept, kept)] = covariance[np.ix_(alone, alone)]
    standard_moves[:, kept] = moves[:, alone]
    noise_std, gain_std = np.sqrt(np.diag(covariance)), gain_deviations(moves)
    return LoadEstimate(
        columns=columns,
        parameters=[
            LoadParameter(name=name, expression=text, unit=unit, value=value, std=std, noise_std=noise, gain_std=gain)
            for name, text, unit, value, std, noise, gain in zip(
                columns.names,
                columns.expressions,
                columns.units,
                values.tolist(),
                np.hypot(noise_std, gain_std).tolist(),
                noise_std.tolist(),
                gain_std.tolist(),
                strict=True,
            )
        ],
        covariance=covariance,
        gain_moves=moves,
        known=known,
        standard=standard,
        standard_covariance=spread,
        standard_gain_moves=standard_moves,
        estimate=estimate,
        estimate_gain_moves=gain_moves,
    )


def relative_error(reduction: Reduction, parameters: FloatArray) -> float:
    """‖τ − W·x‖/‖τ‖ of a run over all of its motors, from their triangular factors; base parameters x (b,)."""
    left = whole = 0.0
    for joint in reduction.joints:
        residual = joint.factor[:, -1] - joint.factor[:, :-1] @ parameters[list(joint.columns)]
        left += float(residual @ residual)
        whole += float(joint.factor[:, -1] @ joint.factor[:, -1])
    return float(np.sqrt(left / whole)) if whole > 0 else float("nan")


def _joint_system(
    pair: RunPair, effect: FloatArray, shift: FloatArray, weights: tuple[FloatArray, FloatArray]
) -> Reduction:
    """Both runs under each other, weighted: free joints, then loaded ones; base columns, then the load's."""
    count, size = pair.base.count, pair.base.count + effect.shape[1]
    joints = []
    for which, run in enumerate(pair.runs):
        for joint, weight in zip(run.reduction.joints, weights[which], strict=True):
            if which == FREE:
                joints.append(JointFactor(joint.columns, weight * joint.factor, joint.rows))
                continue
            wide = widened(joint.columns, count, effect, shift)
            chosen = [*joint.columns, *range(count, size)]
            joints.append(JointFactor(tuple(chosen), weight * joint.factor @ wide[:, [*chosen, size]], joint.rows))
    return Reduction(
        joints=tuple(joints),
        column_count=size,
        torque_count=1,
        samples=sum(run.reduction.samples for run in pair.runs),
        method=pair.runs[FREE].reduction.method,
    )


def _weights(reduction: Reduction) -> FloatArray:
    """(n,) what each joint's rows are multiplied with: one over its noise."""
    rows = np.array([float(joint.rows) for joint in reduction.joints])
    noise = signal_noise([joint.factor for joint in reduction.joints], rows)
    # A joint without any torque has no noise to go by; the smallest one's weight keeps it from ruling.
    return np.asarray(1.0 / np.where(noise > 0, noise, noise.max(initial=0.0) or 1.0))


def _weighted(reduction: Reduction, weights: FloatArray) -> Reduction:
    joints = tuple(
        replace(joint, factor=weight * joint.factor) for joint, weight in zip(reduction.joints, weights, strict=True)
    )
    return replace(reduction, joints=joints)


def _excited(reduction: Reduction, among: tuple[int, ...]) -> tuple[int, ...]:
    excited = set(excited_columns(reduction))
    return tuple(column for column in among if column in excited)


def _moves(blocks: FloatArray, solution: LeastSquares) -> FloatArray:
    """(B, a) how far leaving out each block moves the active parameters; `blocks` (B, a + 1, a + 1) are weighted."""
    gram = blocks[:, :-1, :-1]
    score = blocks[:, :-1, -1] - gram @ solution.parameters[list(solution.active)]
    return least_squares_moves(BlockSums(gram, score), np.asarray(np.linalg.inv(solution.inverse)))
