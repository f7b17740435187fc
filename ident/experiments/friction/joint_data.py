"""Equations of one joint: torque, and the columns of inertia, gravity and friction, over all periods."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from drivers.core.arrays import FloatArray
from ident.experiments.friction.single_joint import JointPeriod
from ident.friction.table import TERM
from ident.friction.terms import FrictionConditions, FrictionTerms
from ident.identify.friction.candidates import Candidate
from ident.model.dynamic_model import DynamicModel
from ident.model.joint_columns import JointColumn, column_signal
from ident.regression.comparison import lag_one
from ident.result.friction import FrictionStep
from ident.result.friction_experiment import JointFrictionExperiment

ALONE = ((0, 1.0),)
"""Motion and row of the column of a joint by itself."""


@dataclass(frozen=True, eq=False)
class JointExperiment:
    """Friction of one joint, and what its page shows beside."""

    stored: JointFrictionExperiment  # what friction.json holds of it
    terms: FrictionTerms  # of this one motor, shapes as estimated
    steps: tuple[FrictionStep, ...]  # terms that were tried
    points: FloatArray  # (4, P) velocity, temperature [K] (nan where unknown), load torque, measured friction


def friction_signal(
    model: DynamicModel, kind: str, shape: float, velocity: FloatArray, conditions: FrictionConditions
) -> FloatArray:
    """Signal (N,) of a friction column of one joint; its shape is an exponent or a Stribeck velocity."""
    column = JointColumn(kind, ALONE, ALONE, shape)
    signal = column_signal(model, column, velocity[None], np.zeros_like(velocity)[None], conditions)
    return np.broadcast_to(np.asarray(signal), velocity.shape)


def friction_torque(
    model: DynamicModel, joint: JointExperiment, velocity: FloatArray, kelvin: FloatArray, load: FloatArray
) -> FloatArray:
    """Friction torque (N,) of a joint at velocities, temperatures [K] and load torques (N,)."""
    conditions = FrictionConditions(load[None], kelvin[None])
    total = np.zeros_like(velocity)
    for kind, value in zip(joint.stored.kinds, joint.stored.values, strict=True):
        if kind in TERM:
            signal = friction_signal(model, kind, joint.terms.shape_of(kind, 0), velocity, conditions)
            total = total + value * signal
    return total


POSITION_BLOCKS = 24
"""Blocks of the jackknife over positions."""


class JointData:
    """The R filtered equations of one joint.

    Attributes:
        model: of the arm.
        periods: in which the joint moves alone.
        torque: (R,) [N·m or N].
        own: (R, o) inertia and gravity columns, each period's are 0 in the rows of the others.
        index: (R,) samples counted along the motion, repeated ones alike, without holes.
    """

    def __init__(self, model: DynamicModel, periods: Sequence[JointPeriod]) -> None:
        self.model, self.periods = model, periods
        self.torque: FloatArray = np.concatenate([period.filtered(period.torque[None])[0] for period in periods])
        self.own = self._own_columns()
        self.index = self._sample_index()

    @property
    def count(self) -> int:
        """Number of different samples."""
        return int(self.index.max()) + 1

    def _own_columns(self) -> FloatArray:
        """(R, o) inertia and gravity of each period, 0 in the rows of the others."""
        blocks = [
            period.filtered(np.concatenate([period.acceleration[None], period.gravity])) for period in self.periods
        ]
        own = np.zeros((len(self.torque), sum(len(block) for block in blocks)))
        row = column = 0
        for block in blocks:
            own[row : row + block.shape[1], column : column + len(block)] = block.T
            row, column = row + block.shape[1], column + len(block)
        return own

    def _sample_index(self) -> npt.NDArray[np.int64]:
        """(R,) samples counted along the motion, repeated ones alike, without holes."""
        phases = np.concatenate([period.phase[period.counted] for period in self.periods])
        return np.asarray(np.unique(phases, return_inverse=True)[1])

    def columns(self, candidates: Sequence[Candidate], loads: Sequence[FloatArray]) -> FloatArray:
        """(R, k) filtered friction columns, with the load torque (N,) of each period."""
        stacked = []
        for period, load in zip(self.periods, loads, strict=True):
            conditions = FrictionConditions(
                load[None], None if period.temperature is None else period.temperature[None]
            )
            signals = np.array(
                [
                    friction_signal(self.model, candidate.quantity, candidate.shape, period.velocity, conditions)
                    for candidate in candidates
                ]
            )
            stacked.append(period.filtered(signals).T)
        return np.concatenate(stacked)

    def load_torques(self, parameters: FloatArray) -> list[FloatArray]:
        """Gravity torque (N,) of each period by its inertia and first moments, parameters (≥ o,)."""
        loads, place = [], 0
        for period in self.periods:
            place += 1
            values = parameters[place : place + len(period.gravity)]
            loads.append(values @ period.gravity)
            place += len(period.gravity)
        return loads

    def load_slopes(self, coefficient: float, power: float, loads: Sequence[FloatArray]) -> FloatArray:
        """(R, o) by how much load friction changes with the inertia and gravity parameters of the periods."""
        slopes = np.zeros_like(self.own)
        row = column = 0
        for period, load in zip(self.periods, loads, strict=True):
            steepness = coefficient * power * np.abs(load) ** (power - 1.0) * np.sign(load)
            block = period.filtered(self.model.coulomb_direction(period.velocity) * steepness * period.gravity)
            column += 1  # the inertia's
            slopes[row : row + block.shape[1], column : column + len(block)] = block.T
            row, column = row + block.shape[1], column + len(block)
        return slopes

    def autocorrelation(self, residual: FloatArray) -> FloatArray:
        """(1,) of the residuals at lag one, within the periods."""
        counts = [int(period.counted.sum()) for period in self.periods]
        return lag_one([block[None] for block in np.split(residual, np.cumsum(counts)[:-1])])

    def position_blocks(self) -> npt.NDArray[np.int64]:
        """(R,) block of each equation by the joint's position: torque ripple is the same in every stroke."""
        position = self.sampled([period.position for period in self.periods])
        width = np.ptp(position) / POSITION_BLOCKS
        return np.asarray(np.minimum((position - position.min()) // width, POSITION_BLOCKS - 1), dtype=np.int64)

    def sampled(self, signals: Sequence[FloatArray]) -> FloatArray:
        """(R,) of signals (N,) of the periods, not filtered."""
        return np.concatenate([period.sampled(signal) for period, signal in zip(self.periods, signals, strict=True)])
