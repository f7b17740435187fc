"""How exact the reduction is on badly conditioned data, against lstsq of the stored matrix."""

from __future__ import annotations

import math
import statistics
from dataclasses import dataclass

import numpy as np

from benchmarks.arm import PERIOD, arm, true_parameters
from drivers.core.arrays import FloatArray
from ident.linear_algebra.triangular import GRAM_CONDITION_LIMIT, GramAccumulator
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import DynamicModel
from ident.model.regressor import RegressorKernel, evaluate_in_chunks, regressor
from ident.regression.least_squares import ordinary_least_squares
from ident.regression.observation_matrix import JointFactor, Reduction, estimate_condition, reduce_segments
from ident.signals.filters import no_filter
from ident.signals.prepared import Segment
from sim_drivers.synthetic.measurement import random_fourier_motion

CONDITION = 1e6

COMPARED = """\
error_vs_lstsq_cond_1e6: all joints but the first move too little (by the factor that gives a scaled condition of 1e6),
  exact torques of known parameters; our relative error over that of numpy.linalg.lstsq on the stored matrix, median of
  several motions. error_gram_vs_lstsq_cond_1e6: the same with the Gram matrix, which the estimated condition keeps
  the reduction from."""


@dataclass(frozen=True, eq=False)
class Problem:
    """A least-squares problem with a known answer.

    Attributes:
        kernel: its base columns.
        segment: motion and torque.
        matrix: W (n·N, b), all rows of the first joint first.
        truth: (b,) base parameters.
    """

    kernel: RegressorKernel
    segment: Segment
    matrix: FloatArray
    truth: FloatArray


def problem(model: DynamicModel, seed: int, samples: int, condition: float = CONDITION) -> Problem:
    """A motion whose scaled condition is `condition`, and its torque, summed in extended precision."""
    base = base_parameters(model)
    kernel = RegressorKernel(model, base.columns)
    motion = random_fourier_motion(model, PERIOD, seed)
    time = np.asarray(np.arange(samples) * (PERIOD / samples), dtype=np.float64)
    states = motion.evaluate(time)
    middle = motion.offset[:, None]

    def segment(amplitude: float, torque: FloatArray) -> Segment:
        factor = np.full((model.dof, 1), amplitude)
        factor[0] = 1.0
        position = middle + factor * (states[0] - middle)
        used = np.ones(samples, dtype=np.bool_)
        return Segment(time, position, factor * states[1], factor * states[2], torque, samples / PERIOD, used)

    low, high = 1e-6, 1.0
    for _ in range(30):
        amplitude = math.sqrt(low * high)
        if estimate_condition(kernel, [segment(amplitude, states[0])]) > condition:
            low = amplitude
        else:
            high = amplitude
    without = segment(high, states[0])
    dense = regressor(model, without.position, without.velocity, without.acceleration, base.columns)
    matrix = np.ascontiguousarray(dense.transpose(0, 2, 1)).reshape(-1, base.count)
    truth = base.projection @ true_parameters(model)
    torque = (matrix.astype(np.longdouble) @ truth.astype(np.longdouble)).astype(np.float64)
    return Problem(kernel, segment(high, torque.reshape(model.dof, samples)), matrix, truth)


def gram_reduction(kernel: RegressorKernel, segment: Segment) -> Reduction:
    """The reduction by Gram matrices whatever the condition."""
    sums = [GramAccumulator(len(joint.columns) + 1) for joint in kernel.joint_rows]
    for part, packed in evaluate_in_chunks(kernel, segment.position, segment.velocity, segment.acceleration):
        for joint, (rows, gram) in enumerate(zip(kernel.joint_rows, sums, strict=True)):
            gram.add(np.vstack([packed[rows.rows], segment.torque[joint, part]]))
    factors = [
        JointFactor(rows.columns, gram.factor(), gram.rows) for rows, gram in zip(kernel.joint_rows, sums, strict=True)
    ]
    return Reduction(tuple(factors), len(kernel.columns), 1, segment.position.shape[1], "Gram matrix, forced")


def run(samples: int = 10_000, seeds: range = range(1, 8)) -> dict[str, float]:
    """Median error ratios, the reduction choosing its own way as in every identification.

    Raises:
        RuntimeError: the condition stayed where the plain Gram matrix is exact enough: not what this is about.
    """
    model = arm()
    exact, gram = [], []
    for seed in seeds:
        given = problem(model, seed, samples)
        everything = range(len(given.truth))
        if estimate_condition(given.kernel, [given.segment]) <= GRAM_CONDITION_LIMIT:
            raise RuntimeError(f"motion {seed}: the condition does not reach the limit of the Gram matrix")
        found = ordinary_least_squares(reduce_segments(given.kernel, [given.segment], no_filter()), everything)
        forced = ordinary_least_squares(gram_reduction(given.kernel, given.segment), everything)
        reference = np.asarray(
            np.linalg.lstsq(given.matrix, given.segment.torque.ravel(), rcond=None)[0], dtype=np.float64
        )
        yardstick = _error(reference, given.truth)
        exact.append(_error(found.parameters, given.truth) / yardstick)
        gram.append(_error(forced.parameters, given.truth) / yardstick)
    return {
        "error_vs_lstsq_cond_1e6": statistics.median(exact),
        "error_gram_vs_lstsq_cond_1e6": statistics.median(gram),
    }


def _error(parameters: FloatArray, truth: FloatArray) -> float:
    return float(np.linalg.norm(parameters - truth) / np.linalg.norm(truth))
