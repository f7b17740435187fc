"""Drive gains and lengths estimated together with the parameters, one at a time.

Joints share parameters, and gravity and inertia of one body reach several of them through the lengths between: a gain
or a length of the robot file that is wrong leaves a residual of its own form. Beside the parameters x one further
unknown is estimated by Gauss-Newton: a factor g on the model's torque of a joint, τ_j = g·W_j x, or a shift of a
joint's origin, with τ linear in it about the robot file's value. Weights of the joints are estimated anew with it. The
doubled log-likelihood ratio against the file's value says whether that is more than chance, in independent equations.

All unknowns share one reduction of the data, so that they cost one pass together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers.streams import FloatArray
from ident.linear_algebra.triangular import triangular
from ident.model.dynamic_model import DynamicModel
from ident.model.regressor import RegressorKernel, model_torque
from ident.regression.least_squares import LeastSquares
from ident.regression.observation_matrix import Reduction, only_torques, reduce_segments, stack_reductions
from ident.signals.prepared import Prepared, Segment

STEP = 1e-3
"""[m] by which a joint is shifted for the derivative of the torque."""

ZERO_LENGTH = 1e-4
"""[m]; shorter components of a translation are taken for 0 on purpose."""

SEEN = 1e-6
"""Share of a column's norm that the parameters must leave of it, else the data do not show it."""

ITERATIONS = 8

MOST_SAMPLES = 100_000
"""Samples of a recording that are looked at; the derivatives by all lengths take some 500 bytes each."""

GAINS = (0.05, 20.0)
"""Range of the factor on a gain."""


@dataclass(frozen=True, eq=False)
class Deviation:
    """How far one number of the robot file is from what the data say.

    Attributes:
        joint: its number in the tree for a length, among the motors for a gain.
        axis: of the parent's frame along which the joint's origin shifts; None for a gain.
        value: model torque over recorded torque minus 1, or shift [m].
        std: its standard deviation.
        likelihood: doubled log-likelihood ratio against 0, in independent equations.
        parameters: (b,) base parameters that go with it.
    """

    joint: int
    axis: int | None
    value: float
    std: float
    likelihood: float
    parameters: FloatArray


def deviations(
    kernel: RegressorKernel,
    torques: Sequence[int],
    runs: Sequence[Prepared],
    solution: LeastSquares,
    independent: float,
) -> list[Deviation]:
    """Every gain and length that the data show, each alone beside the parameters; arguments as above."""
    model = kernel.model
    lengths = shifted_origins(model)
    parts = [part for run in runs for part in first_samples(run.segments)]
    if not parts:
        return []
    system = _System(
        only_torques(
            stack_reductions(
                [
                    reduce_segments(
                        kernel,
                        segments := first_samples(run.segments),
                        run.parallel_filter,
                        [_with_derivatives(model, kernel.columns, solution.parameters, s, lengths) for s in segments],
                    )
                    for run in runs
                ]
            ),
            torques,
        ),
        solution,
        independent,
    )
    if system.freedom <= 0 or len(system.used) < 2:
        return []
    found = [system.deviation(joint, axis, 1 + number) for number, (joint, axis) in enumerate(lengths)]
    found += [system.deviation(joint, None, None) for joint in system.used]
    return [one for one in found if one is not None]


def shifted_origins(model: DynamicModel) -> list[tuple[int, int]]:
    """Joints and axes of their parents' frames along which their origins have a length; none where loops close."""
    if model.transmission is not None and model.transmission.closed:
        return []
    return [
        (number, axis)
        for number, joint in enumerate(model.joints)
        for axis in range(3)
        if abs(joint.translation[axis]) > ZERO_LENGTH
    ]


def first_samples(segments: Sequence[Segment]) -> list[Segment]:
    """The segments up to `MOST_SAMPLES`, the last one cut there."""
    kept, left = [], MOST_SAMPLES
    for segment in segments:
        part = slice(0, left)
        if left > 0:
            cut = {name: getattr(segment, name)[..., part] for name in ("time", "position", "velocity", "acceleration")}
            cut |= {name: getattr(segment, name)[..., part] for name in ("torque", "used")}
            cut |= {
                name: None if getattr(segment, name) is None else getattr(segment, name)[:, part]
                for name in ("reversing", "resting")
            }
            kept.append(segment if len(segment.time) <= left else replace(segment, **cut))
        left -= len(segment.time)
    return kept


def _with_derivatives(
    model: DynamicModel,
    columns: Sequence[int],
    parameters: FloatArray,
    segment: Segment,
    lengths: Sequence[tuple[int, int]],
) -> FloatArray:
    """((1 + lengths)·n, N) the torque, and the derivative of the model's by each length."""
    rows = [segment.torque]
    motion = (segment.position, segment.velocity, segment.acceleration, segment.temperature)
    for joint, axis in lengths:
        ahead, behind = (
            model_torque(shifted(model, joint, axis, step), columns, parameters, *motion) for step in (STEP, -STEP)
        )
        rows.append((ahead - behind) / (2.0 * STEP))
    return np.concatenate(rows)


def shifted(model: DynamicModel, joint: int, axis: int, step: float) -> DynamicModel:
    """The arm with a joint's origin shifted in its parent's frame [m]."""
    translation = model.joints[joint].translation.copy()
    translation[axis] += step
    joints = list(model.joints)
    joints[joint] = replace(joints[joint], translation=translation)
    return replace(model, joints=tuple(joints))


class _System:
    """The reduced equations of every joint, with the torques' derivatives beside."""

    def __init__(self, reduction: Reduction, solution: LeastSquares, independent: float) -> None:
        self.active = list(solution.active)
        self.parameters = solution.parameters[self.active]
        self.rows = np.array([joint.rows for joint in reduction.joints], dtype=np.float64)
        self.used = [n for n, rows in enumerate(self.rows) if rows and solution.weights[n] > 0]
        width = len(self.active)
        place = {column: position for position, column in enumerate(self.active)}
        self.blocks = []
        for joint in reduction.joints:
            block = np.zeros((joint.factor.shape[0], width + reduction.torque_count))
            for i, column in enumerate(joint.columns):
                if column in place:
                    block[:, place[column]] = joint.factor[:, i]
            block[:, width:] = joint.factor[:, len(joint.columns) :]
            self.blocks.append(block)
        total = float(self.rows[self.used].sum()) if self.used else 0.0
        # What is looked at may be the beginning of the data that the independent equations were counted in.
        share = min(1.0, total / solution.rows) if solution.rows else 0.0
        self.freedom = independent * share - width
        self.worth = self.freedom / total if total else 0.0
        self.base_count = reduction.column_count
        self.believed, _, _ = self._settled(None, None)

    def deviation(self, joint: int, axis: int | None, derivative: int | None) -> Deviation | None:
        """One unknown beside the parameters: a column of the torques' derivatives, or the gain of a joint.

        None where the parameters take its place.
        """
        sums, solved, parameters = self._settled(None if derivative is not None else joint, derivative)
        if solved is None:
            return None
        value, std = solved
        ratio = sum(self.rows[n] * np.log(self.believed[n] / sums[n]) for n in self.used)
        base = np.zeros(self.base_count)
        base[self.active] = parameters
        return Deviation(joint, axis, value, std / float(np.sqrt(self.worth)), float(self.worth * ratio), base)

    def _settled(
        self, gain_of: int | None, derivative: int | None
    ) -> tuple[FloatArray, tuple[float, float] | None, FloatArray]:
        """Sums of squares (n,) with weights and one unknown (or none) settled.

        Returns:
            The sums; the unknown's value and its σ for white residuals; the parameters (a,).
        """
        width = len(self.active)
        parameters, gain = self.parameters, 1.0
        weights = np.zeros(len(self.blocks))
        sums = self._sums(parameters, 1.0, None, 0.0, None)
        solved = None
        for _ in range(ITERATIONS):
            weights[self.used] = np.sqrt(self.rows[self.used] / np.maximum(sums[self.used], 1e-300))
            system = []
            for n in self.used:
                block = self.blocks[n]
                own = gain if n == gain_of else 1.0
                columns = [own * block[:, :width]]
                if derivative is not None:
                    columns.append(block[:, width + derivative, None])
                elif gain_of is not None:
                    slope = block[:, :width] @ parameters if n == gain_of else np.zeros(len(block))
                    columns.append(slope[:, None])
                system.append(weights[n] * np.hstack([*columns, block[:, width, None]]))
            stacked = triangular(np.vstack(system))
            left, right = stacked[:, :-1], stacked[:, -1]
            scale = np.linalg.norm(left, axis=0)
            scale[scale == 0] = 1.0
            estimate = np.linalg.lstsq(left / scale, right, rcond=1e-12)[0] / scale
            parameters = estimate[:width]
            if derivative is None and gain_of is None:
                sums = self._sums(parameters, 1.0, None, 0.0, None)
                continue
            # R's last diagonal entry is what the other columns leave of the unknown's.
            remaining = abs(left[width, width])
            if remaining < SEEN * scale[width]:
                return sums, None, parameters
            unknown = float(estimate[width])
            if derivative is None:
                gain = float(np.clip(gain + unknown, *GAINS))
            sums = self._sums(parameters, gain, gain_of, unknown, derivative)
            solved = (gain - 1.0 if derivative is None else unknown, 1.0 / remaining)
        return sums, solved, parameters

    def _sums(
        self, parameters: FloatArray, gain: float, gain_of: int | None, shift: float, derivative: int | None
    ) -> FloatArray:
        """(n,) sums of squared residuals."""
        width = len(self.active)
        sums = np.zeros(len(self.blocks))
        for n in self.used:
            block = self.blocks[n]
            rest = (gain if n == gain_of else 1.0) * (block[:, :width] @ parameters) - block[:, width]
            if derivative is not None:
                rest = rest + shift * block[:, width + derivative]
            sums[n] = rest @ rest
        return sums
