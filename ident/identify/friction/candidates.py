"""Sums of squares of every friction model that could be chosen, from one pass over the data.

Each motor's equations get the columns of all candidates beside those of the base parameters: |q̇|^α and Stribeck terms
on grids of their shapes, load and temperature terms. Their Gram matrices, block by block of the data, answer for any
choice of columns what fits best and how well it predicts the blocks that it was not fitted to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers.core.arrays import FloatArray
from ident.friction.table import LEAST_CURVATURE_SPAN, LEAST_TEMPERATURE_SPAN, OPTIONS, POSITION_KINDS, TERM
from ident.friction.terms import FrictionConditions
from ident.model.dynamic_model import DynamicModel
from ident.model.joint_columns import JointColumn, column_signal, combined, joint_column
from ident.model.parameters import StandardParameter
from ident.model.regressor import LoadTorqueKernel
from ident.signals.prepared import Prepared, Segment
from ident.signals.segments import REST_FLOOR

CANDIDATE_KINDS = tuple(
    kind for kind in TERM if kind not in POSITION_KINDS and any(kind in option.kinds for option in OPTIONS)
)
"""Kinds of the columns that some option asks for, and one motion can tell."""

FOLDS = 6

INDEPENDENT = 1e-4
"""A column with a smaller share of its length independent of the others cannot be chosen beside them."""


@dataclass(frozen=True)
class Candidate:
    """A column that a motor's friction could have: its signal, and the signal's shape."""

    quantity: str
    shape: float = 1.0


@dataclass(frozen=True, eq=False)
class CandidateGrams:
    """Gram matrices of all columns, by motor and fold of the data."""

    candidates: tuple[tuple[Candidate, ...], ...]  # of each motor, e of them
    columns: tuple[tuple[int, ...], ...]  # of each motor, the base columns in its equations
    # of each motor (FOLDS, k + e + 1, k + e + 1): its k base columns, its candidates, its torque
    grams: tuple[FloatArray, ...]
    rows: FloatArray  # (FOLDS, n) equations
    base_count: int  # number b of base columns

    @property
    def width(self) -> int:
        """Number of candidates per motor."""
        return len(self.candidates[0])

    def index(self, motor: int, candidate: int) -> int:
        """Place of a motor's candidate among all columns."""
        return self.base_count + motor * self.width + candidate

    def places(self, motor: int) -> list[int]:
        """Places of the motor's own columns and of the torque among all columns."""
        last = self.base_count + len(self.grams) * self.width
        return [*self.columns[motor], *(self.index(motor, extra) for extra in range(self.width)), last]

    def weighted(self, weights: FloatArray) -> FloatArray:
        """(FOLDS, d, d) of all motors' equations times their weights (n,); the torque is the last column."""
        size = self.base_count + len(self.grams) * self.width + 1
        total = np.zeros((FOLDS, size, size))
        for motor, gram in enumerate(self.grams):
            places = np.array(self.places(motor))
            total[:, places[:, None], places] += weights[motor] ** 2 * gram
        return total

    def residual_sums(self, parameters: FloatArray) -> FloatArray:
        """Sum of squared residuals (n,) for values (d − 1,) of all columns."""
        values = np.append(parameters, -1.0)
        sums = [
            values[self.places(motor)] @ gram.sum(axis=0) @ values[self.places(motor)]
            for motor, gram in enumerate(self.grams)
        ]
        return np.asarray(np.maximum(np.array(sums), 0.0))


def solve_columns(gram: FloatArray, chosen: Sequence[int]) -> FloatArray | None:
    """Values (d − 1,) of all columns that fit the last one best with the chosen ones; None where they depend."""
    from scipy.linalg import lapack

    picked = np.array(chosen)
    scale = np.sqrt(gram[picked, picked])
    if not np.all(scale > 0.0):
        return None
    root, failed = lapack.dpotrf(gram[picked[:, None], picked] / (scale[:, None] * scale), lower=True, clean=False)
    if failed or np.min(np.diagonal(root)) < INDEPENDENT:
        return None
    values, _ = lapack.dpotrs(root, gram[picked, -1] / scale, lower=True)
    parameters = np.zeros(len(gram) - 1)
    parameters[picked] = values / scale
    return parameters


def squared_error(gram: FloatArray, parameters: FloatArray) -> float:
    """Sum of squared residuals of values (d − 1,)."""
    values = np.append(parameters, -1.0)
    return max(float(values @ gram @ values), 0.0)


def candidates_of(model: DynamicModel, speeds: FloatArray, warmed: float = 0.0) -> tuple[tuple[Candidate, ...], ...]:
    """All candidates of each motor, of motors with these greatest speeds (n,); loads where the model has a load torque.

    Args:
        model: whose friction is asked for.
        speeds: (n,) [rad/s or m/s].
        warmed: by how much the temperature of every joint differs in the data, at least [K]; 0 where one is unknown.
    """
    loads = model.terms.load_torque is not None
    return tuple(
        tuple(
            candidate
            for kind in CANDIDATE_KINDS
            for candidate in term_candidates(kind, speed, loads=loads, warmed=warmed)
        )
        for speed in speeds.tolist()
    )


def term_candidates(kind: str, speed: float, *, loads: bool = False, warmed: float = 0.0) -> tuple[Candidate, ...]:
    """The candidates of one kind, one per shape on its grid, of a motor with this greatest speed [rad/s or m/s].

    None of the temperature where it hardly differed: the data fit such terms, which are wrong at any other temperature.
    """
    term = TERM[kind]
    if term.needs == "load" and not loads:
        return ()
    if term.needs == "temperature":
        least = LEAST_CURVATURE_SPAN if kind == "temperature_curvature" else LEAST_TEMPERATURE_SPAN
        if not warmed >= least:
            return ()
    if term.shape is None:
        return (Candidate(kind),)
    return tuple(Candidate(kind, speed * share if term.shape.relative else share) for share in term.shape.grid)


def position_candidates(dof: int) -> tuple[tuple[Candidate, ...], ...]:
    """Candidates that depend on the position, of each of n motors."""
    own = tuple(candidate for kind in POSITION_KINDS for candidate in term_candidates(kind, 1.0))
    return (own,) * dof


def motor_motion(model: DynamicModel, motor: int) -> JointColumn:
    """The column of a motor's Coulomb friction, whether the model has it or not."""
    joint = model.active[motor]
    return joint_column(model, StandardParameter(f"Fs{joint + 1}", "coulomb", joint, "Fs"))


def greatest_speeds(model: DynamicModel, runs: Sequence[Prepared]) -> FloatArray:
    """Greatest speed (n,) of each motor, at least `REST_FLOOR` [rad/s or m/s]: shapes are shares of it."""
    motions = [motor_motion(model, motor).motion for motor in range(model.dof)]
    return np.array(
        [
            max(
                REST_FLOOR,
                *(
                    float(np.max(np.abs(combined(motion, segment.velocity))))
                    for run in runs
                    for segment in run.segments
                ),
            )
            for motion in motions
        ]
    )


def candidate_signals(
    model: DynamicModel, segment: Segment, candidates: tuple[tuple[Candidate, ...], ...]
) -> FloatArray:
    """(e·n, N) the candidates' signals, the first of all motors first."""
    loads = any(TERM[candidate.quantity].needs == "load" for candidate in candidates[0])
    load = LoadTorqueKernel(model).torque(segment.position) if loads else None
    conditions = FrictionConditions(load, segment.temperature, position=segment.position)
    motions = [motor_motion(model, motor) for motor in range(model.dof)]
    return np.array(
        [
            column_signal(
                model,
                replace(motions[motor], quantity=of_motor[place].quantity, shape=of_motor[place].shape),
                segment.velocity,
                segment.acceleration,
                conditions,
            )
            for place in range(len(candidates[0]))
            for motor, of_motor in enumerate(candidates)
        ]
    )
