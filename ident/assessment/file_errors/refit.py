"""Gains, lengths, joint zeros and gravity's direction estimated together with the parameters, one at a time.

Joints share parameters, and gravity and inertia of one body reach several of them through the lengths between: a gain,
a length or an angle of the robot file that is wrong leaves a residual of its own form. Beside the parameters x further
unknowns are estimated by Gauss-Newton: a factor g on the model's torque of a joint, τ_j = g·W_j x, a shift of a joint's
origin or of its zero, or the two angles of gravity's direction. Weights of the joints are estimated anew with them. The
doubled log-likelihood ratio against the file's values says whether that is more than chance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.linalg

from drivers.core.arrays import FloatArray
from drivers.core.errors import IdentificationError
from ident.assessment.file_errors.unknowns import (
    SHIFTS,
    Deviation,
    Unknown,
    in_unknown_gravity,
    scaled,
    shifted,
    shifted_origins,
    tangents,
)
from ident.assessment.instants import BLOCKS, Instants
from ident.linear_algebra.triangular import solved_factor, triangular
from ident.model.dynamic_model import DynamicModel
from ident.model.regressor import RegressorKernel, model_torque
from ident.regression.least_squares import LeastSquares
from ident.regression.observability import Experiment, experiment_base

SHIFT_STEP = 1e-3
"""[m or rad] by which a joint's origin or zero is shifted for the derivative of the torque."""

DEPENDENT = 1e-10
"""Singular value over the largest one below which columns count as dependent."""

SEEN_SHARE = 1e-6
"""Share of a column's norm that the parameters must leave of it, else the data do not show it."""

STATIONARY_ITERATIONS = 8
RELINEARISATIONS = 6
WEIGHTS_SETTLED = 1e-3
"""Relative change of the sums of squares that ends the iteration of the joints' weights."""

SETTLED_STEP = 0.05
"""A step of less than this many σ ends the iteration."""

GAINS = (1e-3, 1e3)
"""Range of the factor on a gain."""

UNCERTAIN_START = 3.0
"""A joint's share in the smallest singular vector, over the singular value, below which its sign is noise."""

LARGEST_STEP = 0.5
"""[rad] by which gravity's direction turns in one iteration."""

TINY = float(np.finfo(float).tiny)

THROUGHOUT = 0.3
"""Share of a deviation's likelihood that any block of the recording may be left out for."""

TELLING = 0.3
DISTINGUISHABLE = 10.0
"""Lengths are estimated together as far as each shows a change by this share with so many σ beside the others."""


class Refit:
    """The equations of a recording at its instants, to be solved with one more unknown.

    Attributes:
        model, experiment: as believed.
        columns: standard columns of the base parameters.
        active: indices of the base parameters that were estimated.
        instants: the recording.
        used: joints whose equations are used.
        rows: (n,) how many equations each joint has.
        regressor: (n, b, N) of the columns.
    """

    def __init__(
        self,
        model: DynamicModel,
        experiment: Experiment,
        columns: Sequence[int],
        instants: Instants,
        solution: LeastSquares,
    ) -> None:
        self.model, self.experiment, self.columns = model, experiment, tuple(columns)
        self.active, self.instants = list(solution.active), instants
        rows = instants.counted.sum(axis=1)
        self.used = [n for n in experiment.torques if rows[n] and solution.weights[n] > 0]
        self.rows = np.where(np.isin(np.arange(model.dof), self.used), rows, 0).astype(np.float64)
        self.regressor = instants.filtered_regressor(RegressorKernel(model, self.columns))
        self._file = solution.parameters
        self._plain = self._blocks(self.regressor, self.active, np.empty((0, *instants.torque.shape)))
        self._file_fit = _settled(self._plain, self.rows, 0)

    @property
    def relative_errors(self) -> FloatArray:
        """(n,) of each joint's equations at the robot file's values; 0 where none are used."""
        power = np.sum(np.where(self.instants.counted, self.instants.torque, 0.0) ** 2, axis=1)
        return np.asarray(np.sqrt(np.where(self.rows > 0, self._file_fit.sums / np.maximum(power, TINY), 0.0)))

    def as_believed(self, unknown: Unknown) -> Deviation:
        """An unknown at the robot file's value."""
        parameters = self._all(self._file_fit.parameters)
        return Deviation(unknown, 0.0, 0.0, 0.0, parameters, self.model, self.columns)

    def unknowns(self) -> list[Unknown]:
        """Everything that may be wrong."""
        found = [Unknown("length", joint, axis) for joint, axis in shifted_origins(self.model)]
        found += [Unknown("scale")] if len(found) > 1 else []
        found += [Unknown("gain", joint) for joint in self.used]
        moving = [joint for joint in range(self.model.dof) if joint not in self.experiment.locked]
        if not self.model.transmission.closed:
            found += [Unknown("zero", j) for j in moving if not self.model.joints[self.model.active[j]].prismatic]
            found += [Unknown("late", joint) for joint in moving if joint in self.used]
        return [*found, Unknown("gravity")] if np.any(self.model.gravity) else found

    @cached_property
    def deviations(self) -> list[Deviation]:
        """Every unknown that the data show, linearised once at the file's value."""
        if len(self.used) < 2:
            return []
        shifts = [unknown for unknown in self.unknowns() if unknown.kind in SHIFTS]
        slopes = [self.slope(unknown, 0.0, self._file) for unknown in shifts]
        blocks = self._blocks(self.regressor, self.active, np.array(slopes).reshape(-1, *self.instants.torque.shape))
        width = len(self.active)
        found = []
        for number, unknown in enumerate(shifts):
            own = {n: block[:, [*range(width), width + number, -1]] for n, block in blocks.items()}
            solved = _settled(own, self.rows, 1)
            if solved.unknown is not None and solved.covariance is not None:
                found.append(self._deviation(unknown, float(solved.unknown[0]), solved.covariance[0, 0], solved))
        others = [unknown for unknown in self.unknowns() if unknown not in shifts]
        return [*found, *(one for unknown in others if (one := self.deviation(unknown, 1)) is not None)]

    def deviation(
        self, unknown: Unknown, relinearisations: int = RELINEARISATIONS, start: float | FloatArray | None = None
    ) -> Deviation | None:
        """One unknown beside the parameters; None where these take its place.

        Args:
            unknown: which.
            relinearisations: how often the model is linearised anew where the estimate is.
            start: where the first one is: a gain's factor, a shift [m or rad] of a length or zero, or gravity (3,)
                [m/s²]; the file's value where None.
        """
        if len(self.used) < 2:
            return None
        if unknown.kind == "gain":
            return self._gain(unknown, 1.0 if start is None else float(start))
        if unknown.kind == "gravity":
            return self._gravity(unknown, relinearisations, None if start is None else np.asarray(start))
        return self._shift(unknown, relinearisations, 0.0 if start is None else float(start))

    def lengths(self) -> Deviation | None:
        """All lengths that the data show, together; None where these are fewer than two.

        Its value is the largest shift over its standard deviation.
        """
        origins = shifted_origins(self.model)
        if len(self.used) < 2 or len(origins) < 2:
            return None
        sizes = np.array([abs(self.model.joints[joint].translation[axis]) for joint, axis in origins])
        chosen: list[int] = []
        values, model, regressor, parameters = np.zeros(len(origins)), self.model, self.regressor, self._file
        solved = None
        for _ in range(RELINEARISATIONS):
            slopes = np.array([self._length_slope(model, origin, parameters) for origin in origins])
            chosen = chosen or self._distinguishable(slopes, sizes)
            solved = self._solved(regressor, self.active, slopes[chosen])
            if len(chosen) < 2 or solved.unknown is None or solved.covariance is None:
                return None
            most = LARGEST_STEP * sizes[chosen]
            step = np.clip(solved.unknown, -most, most)
            values[chosen] += step
            model = self.model
            for (joint, axis), value in zip(origins, values, strict=True):
                model = shifted(model, joint, axis, float(value))
            parameters = self._all(solved.parameters)
            if np.all(np.abs(step) < SETTLED_STEP * np.sqrt(np.diag(solved.covariance))):
                break
            regressor = self.instants.filtered_regressor(RegressorKernel(model, self.columns))
        if solved is None or solved.covariance is None:
            return None
        parts = [Unknown("length", *origins[n]) for n in chosen]
        return self._together(Unknown("lengths"), parts, values[chosen], solved.covariance, solved, model)

    def gains(self) -> Deviation | None:
        """All gains but the strongest joint's, together; None where these are fewer than two, or not all positive.

        Its value is the largest deviation over its standard deviation. They start from the smallest singular vector of
        [W −τ…]: parameters x, and a factor on each recorded torque.
        """
        width, number = len(self.active), {n: place for place, n in enumerate(self.used)}
        if len(self.used) < 3:
            return None
        sizes = np.array([np.linalg.norm(self._plain[n][:, -1]) for n in self.used])
        stacked = np.vstack(
            [
                np.hstack([one[:, :width], -one[:, -1:] / size * (np.arange(len(number)) == number[n])])
                for (n, one), size in zip(self._plain.items(), np.maximum(sizes, TINY), strict=True)
            ]
        )
        norms = np.maximum(np.linalg.norm(stacked[:, :width], axis=0), TINY)
        rest = triangular(np.hstack([stacked[:, :width] / norms, stacked[:, width:]]))[width:, width:]
        _, spread, directions = np.linalg.svd(rest)
        strongest = int(np.argmax(np.abs(directions[-1])))
        torques = directions[-1] / directions[-1][strongest]
        if np.any(torques < -UNCERTAIN_START * spread[-1]):
            return None
        # Noise of strong joints hides what weak ones need.
        weak = float(np.min(torques[torques > 0.0]))
        starts = sizes / sizes[strongest] / np.maximum(torques, np.where(torques > 0.0, 0.0, weak))
        starts = np.clip(starts, *GAINS)
        others = {n: float(starts[place]) for n, place in number.items() if place != strongest}
        solved = _settled(self._plain, self.rows, 0, others)
        if solved.unknown is None or solved.covariance is None:
            return None
        whole, parts = Unknown("gains", self.used[strongest]), [Unknown("gain", n) for n in others]
        return self._together(whole, parts, solved.unknown, solved.covariance, solved, self.model)

    def _together(
        self,
        whole: Unknown,
        parts: Sequence[Unknown],
        values: FloatArray,
        covariance: FloatArray,
        solved: _Solved,
        model: DynamicModel,
    ) -> Deviation:
        """Several unknowns (k,) as one; its value is the largest over its standard deviation."""
        std = np.sqrt(np.diag(covariance))
        largest = float(np.max(np.abs(values) / std))
        each = tuple(zip(parts, values.tolist(), std.tolist(), strict=True))
        parameters = self._all(solved.parameters)
        return Deviation(whole, largest, 1.0, self._likelihood(solved), parameters, model, self.columns, each)

    def _length_slope(self, model: DynamicModel, origin: tuple[int, int], parameters: FloatArray) -> FloatArray:
        """(n, N) derivative of a model's torque by a length."""
        ends = [(shifted(model, *origin, step), self.instants) for step in (SHIFT_STEP, -SHIFT_STEP)]
        return self._difference(ends, parameters)

    def _difference(self, ends: Sequence[tuple[DynamicModel, Instants]], parameters: FloatArray) -> FloatArray:
        """(n, N) derivative of the torque by what is `SHIFT_STEP` ahead at the first end, and behind at the second."""
        ahead, behind = (model_torque(model, self.columns, parameters, *moved.motion) for model, moved in ends)
        return np.asarray((ahead - behind) / (2.0 * SHIFT_STEP))

    def _distinguishable(self, slopes: FloatArray, sizes: FloatArray) -> list[int]:
        """Lengths of slopes (k, n, N) whose changes by `TELLING` the parameters and each other leave visible."""
        blocks = self._blocks(self.regressor, self.active, slopes)
        width = len(self.active)
        parts = [np.sqrt(self.rows[n] / max(self._file_fit.sums[n], TINY)) * one for n, one in blocks.items()]
        rest = triangular(np.vstack(parts))[width:-1, width:-1] * TELLING * sizes
        _, factor, order = scipy.linalg.qr(rest, pivoting=True, mode="economic")
        return sorted(int(n) for n, size in zip(order, np.abs(np.diag(factor)), strict=False) if size > DISTINGUISHABLE)

    def opposite_gravity(self) -> Deviation:
        """Gravity exactly opposite to the file's, a sign and no number to be estimated."""
        model = replace(self.model, gravity=-self.model.gravity)
        regressor = self.instants.filtered_regressor(RegressorKernel(model, self.columns))
        solved = self._solved(regressor, self.active)
        parameters = self._all(solved.parameters)
        likelihood = self._likelihood(solved)
        return Deviation(Unknown("gravity"), float(np.pi), 0.0, likelihood, parameters, model, self.columns)

    def shifted(self, unknown: Unknown, value: float) -> tuple[DynamicModel, Instants]:
        """Model and instants with a length, all of them, a zero or a position's time changed."""
        if unknown.kind == "zero":
            return self.model, self.instants.shifted(unknown.joint, value)
        if unknown.kind == "late":
            return self.model, self.instants.later(unknown.joint, value)
        if unknown.kind == "scale":
            return scaled(self.model, 1.0 + value), self.instants
        if unknown.axis is None:
            raise ValueError(f"{unknown} is no length")
        return shifted(self.model, unknown.joint, unknown.axis, value), self.instants

    def _gain(self, unknown: Unknown, factor: float) -> Deviation | None:
        joint = unknown.joint
        solved = _settled(self._plain, self.rows, 0, {joint: factor})
        if solved.unknown is None or solved.covariance is None:
            return None
        return self._deviation(unknown, float(solved.unknown[0]), solved.covariance[0, 0], solved)

    def _shift(self, unknown: Unknown, relinearisations: int, value: float) -> Deviation | None:
        parameters, solved = None if value else self._file, None
        for _ in range(relinearisations):
            model, moved = self.shifted(unknown, value)
            regressor = moved.filtered_regressor(RegressorKernel(model, self.columns)) if value else self.regressor
            if parameters is None:
                parameters = self._all(self._solved(regressor, self.active).parameters)
            slope = self.slope(unknown, value, parameters)
            solved = self._solved(regressor, self.active, slope[None])
            if solved.unknown is None or solved.covariance is None:
                return None
            step = float(solved.unknown[0])
            value += step
            parameters = self._all(solved.parameters)
            if abs(step) < SETTLED_STEP * np.sqrt(solved.covariance[0, 0]):
                break
        if solved is None or solved.covariance is None:
            return None
        return self._deviation(unknown, value, solved.covariance[0, 0], solved)

    def slope(self, unknown: Unknown, value: float, parameters: FloatArray) -> FloatArray:
        """(n, N) derivative of the model's torque by one of `SHIFTS` at a value."""
        return self._difference([self.shifted(unknown, value + step) for step in (SHIFT_STEP, -SHIFT_STEP)], parameters)

    def _gravity(self, unknown: Unknown, relinearisations: int, start: FloatArray | None) -> Deviation | None:
        size = float(np.linalg.norm(self.model.gravity))
        try:
            columns = experiment_base(in_unknown_gravity(self.model), [self.experiment]).columns
        except IdentificationError:
            return None
        weightless, *parts = self._gravity_parts
        everything = list(range(len(columns)))
        gravity = self.model.gravity if start is None else size * start / np.linalg.norm(start)
        across, solved = np.empty((0, 3)), None
        for _ in range(relinearisations):
            regressor = weightless + sum(g * part for g, part in zip(gravity, parts, strict=True))
            if solved is None:
                solved = self._solved(regressor, everything)
            pulls = np.array([np.einsum("nbN,b->nN", part, solved.parameters) for part in parts])
            across = _most_seen_first(tangents(gravity), pulls)
            for seen in (2, 1):  # in a plane, one angle only
                solved = self._solved(regressor, everything, size * np.tensordot(across[:seen], pulls, 1))
                if solved.unknown is not None:
                    break
            if solved.unknown is None or solved.covariance is None:
                return None
            across = across[: len(solved.unknown)]
            turn = solved.unknown
            length = float(np.linalg.norm(turn))
            turn = turn * min(1.0, LARGEST_STEP / length) if length else turn
            gravity = gravity + size * (turn @ across)
            gravity = size * gravity / np.linalg.norm(gravity)
            if length < SETTLED_STEP * np.sqrt(np.trace(solved.covariance)):
                break
        if solved is None or solved.covariance is None:
            return None
        cosine = float(gravity @ self.model.gravity) / size**2
        angle = float(np.arccos(np.clip(cosine, -1.0, 1.0)))
        # The direction in which the angle grows; the largest variance where it has none.
        away = across @ (cosine * gravity - self.model.gravity) / size
        length = float(np.linalg.norm(away))
        along = away / length if length > 1e-9 else np.linalg.eigh(solved.covariance)[1][:, -1]
        deviation = self._deviation(unknown, angle, float(along @ solved.covariance @ along), solved)
        return replace(deviation, model=replace(self.model, gravity=gravity), columns=columns)

    @cached_property
    def _gravity_parts(self) -> list[FloatArray]:
        """Regressors (n, b, N) without gravity, and what 1 m/s² along each axis of the base adds."""
        columns = experiment_base(in_unknown_gravity(self.model), [self.experiment]).columns
        weightless = self._of_gravity(columns, np.zeros(3))
        return [weightless, *(self._of_gravity(columns, axis) - weightless for axis in np.eye(3))]

    def _of_gravity(self, columns: Sequence[int], gravity: FloatArray) -> FloatArray:
        return self.instants.filtered_regressor(RegressorKernel(replace(self.model, gravity=gravity), columns))

    def _deviation(self, unknown: Unknown, value: float, variance: float, solved: _Solved) -> Deviation:
        model = self.model
        if unknown.kind in ("length", "scale"):
            model, _ = self.shifted(unknown, value)
        parameters = solved.parameters if unknown.kind == "gravity" else self._all(solved.parameters)
        likelihood = self._likelihood(solved)
        std = float(np.sqrt(variance))
        if unknown.kind == "late" and likelihood > 0.0:  # slopes do not show that dry friction changes sign later
            std = min(std, abs(value) / float(np.sqrt(likelihood)))
        return Deviation(unknown, value, std, likelihood, parameters, model, self.columns)

    def throughout(self, one: Deviation) -> bool:
        """Whether a deviation explains the recording without the block that it explains most, too: no single event."""
        moved = self.shifted(one.unknown, one.value)[1] if one.unknown.kind in ("zero", "late") else self.instants
        regressor = moved.filtered_regressor(RegressorKernel(one.model, one.columns))
        predicted = np.einsum("nbN,b->nN", regressor, one.parameters)
        for joint, value in one.gains.items():
            predicted[joint] *= 1.0 + value
        believed = np.einsum("nbN,b->nN", self.regressor, self._all(self._file_fit.parameters))
        membership = self.instants.block == np.arange(BLOCKS)[:, None]
        before, after = (
            np.where(self.instants.counted, self.instants.torque - torque, 0.0)[self.used] ** 2 @ membership.T
            for torque in (believed, predicted)
        )
        whole = float(self.rows[self.used] @ np.log(before.sum(axis=1) / np.maximum(after.sum(axis=1), TINY)))
        before, after = (np.maximum(sums.sum(axis=1, keepdims=True) - sums, TINY) for sums in (before, after))
        without = self.rows[self.used] @ np.log(before / after)
        return bool(without.min() > THROUGHOUT * whole)

    def _likelihood(self, solved: _Solved) -> float:
        """Doubled log-likelihood ratio against the file's values."""
        used = self.rows > 0
        left = np.maximum(solved.sums[used], TINY)
        return float(np.sum(self.rows[used] * np.log(self._file_fit.sums[used] / left)))

    def _all(self, active: FloatArray) -> FloatArray:
        parameters = np.zeros(len(self.columns))
        parameters[self.active] = active
        return parameters

    def _solved(self, regressor: FloatArray, active: Sequence[int], slopes: FloatArray | None = None) -> _Solved:
        """Least squares over some columns of a regressor (n, b, N), with the slopes (k, n, N) of further unknowns."""
        slopes = np.empty((0, *self.instants.torque.shape)) if slopes is None else slopes
        return _settled(self._blocks(regressor, active, slopes), self.rows, len(slopes))

    def _blocks(self, regressor: FloatArray, active: Sequence[int], slopes: FloatArray) -> dict[int, FloatArray]:
        """Each used joint's triangular factor of [W slopes τ]."""
        blocks = {}
        for n in self.used:
            rows = np.vstack([regressor[n][list(active)], slopes[:, n], self.instants.torque[None, n]])
            blocks[n] = triangular(rows[:, self.instants.counted[n]].T)
        return blocks


def _most_seen_first(directions: FloatArray, pulls: FloatArray) -> FloatArray:
    """Directions (2, 3) turned about the normal of their plane, the one that the torques (3, n, N) show most first."""
    seen = np.tensordot(directions, pulls, 1).reshape(len(directions), -1)
    return np.asarray(np.linalg.svd(seen, full_matrices=False)[0].T @ directions)


@dataclass(frozen=True, eq=False)
class _Solved:
    """Parameters (a,), sums of squares (n,), and the unknowns (k,) with their covariance (None where not seen)."""

    parameters: FloatArray
    sums: FloatArray
    unknown: FloatArray | None
    covariance: FloatArray | None


def _settled(
    blocks: dict[int, FloatArray], rows: FloatArray, unknowns: int, gains: Mapping[int, float] | None = None
) -> _Solved:
    """Least squares with the joints' weights settled.

    Args:
        blocks: each joint's factor of [W slopes τ].
        rows: (n,) equations of each joint.
        unknowns: how many slopes there are.
        gains: joints, and factors on their model torques from which on these are estimated, too.
    """
    width = next(iter(blocks.values())).shape[1] - 1 - unknowns
    factor, scaled_joints = np.ones(len(rows)), list(gains or {})
    factor[scaled_joints] = list((gains or {}).values())
    sums = np.zeros(len(rows))
    for n, block in blocks.items():
        sums[n] = block[:, -1] @ block[:, -1]
    floor = 1e-14 * float(np.max(sums)) + np.finfo(float).tiny
    parameters = np.zeros(width)
    unknown: FloatArray | None = None
    covariance: FloatArray | None = None
    for iteration in range(STATIONARY_ITERATIONS):
        system = []
        with_gains = bool(scaled_joints) and iteration > 0
        for n, block in blocks.items():
            parts = [factor[n] * block[:, :width], block[:, width:-1]]
            if with_gains:
                parts.append((block[:, :width] @ parameters)[:, None] * (np.array(scaled_joints) == n))
            system.append(np.sqrt(rows[n] / max(sums[n], floor)) * np.hstack([*parts, block[:, -1:]]))
        stacked = triangular(np.vstack(system))
        left, right = stacked[:, :-1], stacked[:, -1]
        scale = np.linalg.norm(left, axis=0)
        scale[scale == 0.0] = 1.0
        estimate = solved_factor(left / scale, right, DEPENDENT) / scale
        parameters = estimate[:width]
        if len(estimate) > width:
            # The last rows of the triangular factor are what the parameters' columns leave of the unknowns'.
            rest = left[width : len(estimate), width:]
            if np.any(np.abs(np.diag(rest)) < SEEN_SHARE * scale[width:]):
                return _Solved(parameters, sums, None, None)
            unknown = estimate[width:]
            covariance = np.asarray(np.linalg.inv(rest.T @ rest), dtype=np.float64)
        if with_gains and unknown is not None:
            factor[scaled_joints] = np.clip(factor[scaled_joints] + unknown[unknowns:], *GAINS)
        before = sums.copy()
        for n, block in blocks.items():
            rest_torque = block[:, -1] - factor[n] * (block[:, :width] @ parameters)
            if unknowns and unknown is not None:
                rest_torque = rest_torque - block[:, width:-1] @ unknown
            sums[n] = rest_torque @ rest_torque
        if iteration > 1 and np.all(np.abs(sums - before) <= WEIGHTS_SETTLED * before):
            break
    if scaled_joints:
        unknown = factor[scaled_joints] - 1.0
    return _Solved(parameters, sums, unknown, covariance)
