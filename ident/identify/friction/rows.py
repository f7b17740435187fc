"""The filtered equations of the identification data, kept in memory, with friction columns that change.

A search of friction solves the same data many times; what differs from one model to the next is a few friction columns.
Bodies, motor inertia and offset are evaluated and filtered once; hundreds to thousands of filtered samples remain.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from drivers.core.arrays import FloatArray
from ident.friction.terms import FrictionConditions, States
from ident.identify.friction.candidates import FOLDS, Candidate, CandidateGrams, candidate_signals
from ident.linear_algebra.triangular import triangular
from ident.model.base_parameters import BaseParameters
from ident.model.dynamic_model import DynamicModel
from ident.model.joint_columns import JointColumn, column_signal, joint_column
from ident.model.presliding import presliding_states
from ident.model.regressor import LoadTorqueKernel, RegressorKernel
from ident.regression.observation_matrix import JointFactor, Reduction, filtered_samples
from ident.signals.filters import ZeroPhaseFilter
from ident.signals.prepared import Prepared, Segment

MOST_SAMPLES = 20_000
"""Filtered samples that are kept; of more, every second, third… one: friction's shapes need no more."""


@dataclass(frozen=True, eq=False)
class _SegmentRows:
    """One segment's filtered samples, M of them."""

    segment: Segment  # not filtered
    run_filter: ZeroPhaseFilter  # its parallel filter
    packed: FloatArray  # (kernel.row_count, M) of the plain model's columns
    torque: FloatArray  # (n, M)
    # fitted, compared: (n, M) which equations the fit uses, and which the error of a delivered model counts
    fitted: npt.NDArray[np.bool_]
    compared: npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class FoldSums:
    """[W τ]ᵀ[W τ] (FOLDS, n, b + 1, b + 1) by block and motor, of the fitted and of the compared equations."""

    fitted: FloatArray
    compared: FloatArray


class FrictionRows:
    """All equations of some runs.

    Args:
        plain: the arm without further friction terms.
        base: its base parameters.
        runs: the data.
    """

    def __init__(self, plain: DynamicModel, base: BaseParameters, runs: Sequence[Prepared]) -> None:
        self._kernel = RegressorKernel(plain, base.columns)
        count = sum(len(segment.time) // run.parallel_filter.factor for run in runs for segment in run.segments)
        self.every = slice(None, None, max(1, -(-count // MOST_SAMPLES)))
        self._segments = [part for run in runs for part in self._kept(run)]
        names = [plain.parameters[column].name for column in base.columns]
        self._places = {name: place for place, name in enumerate(names)}
        self._given: dict[_SegmentRows, tuple[object, FrictionConditions]] = {}

    def _kept(self, run: Prepared) -> Iterator[_SegmentRows]:
        for segment in run.segments:
            whole = replace(segment, reversing=None)
            parts = [
                (filtered_sample.regressor.copy(), filtered_sample.torque.copy(), filtered_sample.used)
                for filtered_sample in filtered_samples(self._kernel, whole, run.parallel_filter, segment.torque)
            ]
            if not parts:
                continue
            packed, torque, used = (np.concatenate(values, axis=-1) for values in zip(*parts, strict=True))
            filtered = slice(None, None, run.parallel_filter.factor)
            reversing, resting = (
                np.zeros_like(torque, dtype=np.bool_) if mask is None else mask[:, filtered]
                for mask in (segment.reversing, segment.resting)
            )
            yield _SegmentRows(
                segment,
                run.parallel_filter,
                packed[:, self.every],
                torque[:, self.every],
                (used & ~reversing)[:, self.every],
                (used & ~resting)[:, self.every],
            )

    def reduction(self, model: DynamicModel, base: BaseParameters, torques: Sequence[int]) -> Reduction:
        """The system of a model that differs from the plain one in its friction, and of some motors' torques."""
        blocks: list[list[FloatArray]] = [[] for _ in range(model.dof)]
        columns: list[tuple[int, ...]] = [()] * model.dof
        for part in self._segments:
            for motor, (of_motor, rows) in enumerate(self._equations(model, base, part)):
                columns[motor] = of_motor
                if motor in torques:
                    blocks[motor].append(rows[:, part.fitted[motor]])
        joints = []
        for of_motor, rows_of in zip(columns, blocks, strict=True):
            stacked = np.concatenate([*rows_of, np.zeros((len(of_motor) + 1, 0))], axis=1)
            joints.append(JointFactor(of_motor, triangular(stacked.T), stacked.shape[1]))
        samples = sum(int(np.any(segment.fitted, axis=0).sum()) for segment in self._segments)
        return Reduction(tuple(joints), base.count, 1, samples, "QR of kept equations")

    def fold_sums(self, model: DynamicModel, base: BaseParameters, folds: Sequence[npt.NDArray[np.int64]]) -> FoldSums:
        """Sums of squares of a model's columns and the torque, by block of the data.

        Args:
            model: the arm.
            base: its base parameters.
            folds: block (M,) of each filtered sample, an array per segment of all runs.
        """
        size = base.count + 1
        sums = FoldSums(*(np.zeros((FOLDS, model.dof, size, size)) for _ in range(2)))
        for segment, fold in zip(self._segments, folds, strict=True):
            for motor, (of_motor, rows) in enumerate(self._equations(model, base, segment)):
                places = np.array([*of_motor, base.count])
                for total, counts in ((sums.fitted, segment.fitted[motor]), (sums.compared, segment.compared[motor])):
                    for block in np.unique(fold[self.every]):
                        inside = rows[:, counts & (fold[self.every] == block)]
                        total[block, motor][places[:, None], places] += inside @ inside.T
        return sums

    def candidate_grams(
        self,
        model: DynamicModel,
        base: BaseParameters,
        folds: Sequence[npt.NDArray[np.int64]],
        candidates: tuple[tuple[Candidate, ...], ...],
    ) -> CandidateGrams:
        """Gram matrices of a model's columns and all candidates.

        Args:
            model: has the load torque, where there are load candidates.
            base: its base parameters.
            folds: block (M,) of each filtered sample, an array per segment of all runs.
            candidates: of each motor.
        """
        dof, width = model.dof, len(candidates[0])
        columns: list[tuple[int, ...]] = [()] * dof
        grams: list[FloatArray] = []
        count = np.zeros((FOLDS, dof))
        for segment, fold in zip(self._segments, folds, strict=True):
            signals = segment.run_filter.apply(candidate_signals(model, segment.segment, candidates))[:, self.every]
            for motor, (of_motor, rows) in enumerate(self._equations(model, base, segment)):
                columns[motor] = of_motor
                if len(grams) == motor:
                    grams.append(np.zeros((FOLDS, len(rows) + width, len(rows) + width)))
                gram = grams[motor]
                stacked = np.concatenate([rows[:-1], signals[motor::dof], rows[-1:]])
                for block in np.unique(fold[self.every]):
                    inside = stacked[:, segment.fitted[motor] & (fold[self.every] == block)]
                    gram[block] += inside @ inside.T
                    count[block, motor] += inside.shape[1]
        return CandidateGrams(candidates, tuple(columns), tuple(grams), count, base.count)

    def _equations(
        self, model: DynamicModel, base: BaseParameters, part: _SegmentRows
    ) -> Iterator[tuple[tuple[int, ...], FloatArray]]:
        """Base columns in each motor's equations, and these with the torque (k + 1, M)."""
        of_motor: list[list[tuple[int, FloatArray]]] = [[] for _ in range(model.dof)]
        segment = part.segment
        conditions = self._conditions(model, part)
        new: list[tuple[int, JointColumn]] = []
        for place, standard in enumerate(base.columns):
            parameter = model.parameters[standard]
            column = None if parameter.kind == "inertial" else joint_column(model, parameter)
            if column is not None and self._changed(parameter.name, column, conditions.presliding):
                new.append((place, column))
                continue
            kept = self._places[parameter.name]
            for motor, rows in enumerate(self._kernel.joint_rows):
                if kept in rows.columns:
                    of_motor[motor].append((place, part.packed[rows.rows.start + rows.columns.index(kept)]))
        if new:
            signals = np.array(
                [column_signal(model, column, segment.velocity, segment.acceleration, conditions) for _, column in new]
            )
            filtered = part.run_filter.apply(signals)[:, self.every]
            for (place, column), row in zip(new, filtered, strict=True):
                for motor, factor in column.rows:
                    of_motor[motor].append((place, factor * row))
        for motor, entries in enumerate(of_motor):
            ordered = sorted(entries, key=lambda entry: entry[0])
            yield tuple(place for place, _ in ordered), np.array([*(row for _, row in ordered), part.torque[motor]])

    def _conditions(self, model: DynamicModel, part: _SegmentRows) -> FrictionConditions:
        """Return what friction depends on along a segment; kept until load torque or travels change."""
        needed = model.terms.load_torque if model.needs_load_torque else None
        key, segment = (needed, model.presliding), part.segment
        if part not in self._given or self._given[part][0] != key:
            load = None if needed is None else LoadTorqueKernel(model).torque(segment.position)
            states = presliding_states(model, segment.velocity, segment.rate)
            self._given[part] = key, FrictionConditions(load, segment.temperature, states, segment.position)
        return self._given[part][1]

    def _changed(self, name: str, column: JointColumn, states: States) -> bool:
        """Return whether a column is none of the plain model's."""
        if name not in self._places or (column.quantity == "viscous" and column.shape != 1.0):
            return True
        return column.quantity == "coulomb" and column.motion in states
