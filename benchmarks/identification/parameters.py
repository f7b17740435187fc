"""From q, q̇, q̈, τ to base parameters: streamed reduction against a stored observation matrix."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.agreement import check
from benchmarks.arm import Data, arm, data, pinocchio_columns
from benchmarks.peers import Motion, PinocchioLoop, figaroh_regressor, figaroh_robot
from benchmarks.timing import medians
from drivers.core.arrays import FloatArray
from ident.model import base_parameters as base_module
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import DynamicModel
from ident.model.regressor import RegressorKernel, model_torque
from ident.regression.least_squares import ordinary_least_squares
from ident.regression.observation_matrix import Reduction, reduce_segments
from ident.signals.filters import no_filter

COMPARED = """\
parameters_vs_pin_lstsq_200k: 200,000 samples to 54 base parameters with their covariance. The choice of the base
  columns is an arm's, not a recording's: made once, outside, for both. Peer: loop over Pinocchio, base and friction
  columns stored in a matrix that is there already, numpy.linalg.lstsq.
parameters_vs_figaroh_20k: 20,000 samples. figaroh finds the base parameters in the data, by its double QR; ours
  includes their search from the model."""


def reduced(model: DynamicModel, columns: tuple[int, ...], samples: Data) -> Reduction:
    """The reduction, as `identify` calls it, without a filter."""
    return reduce_segments(RegressorKernel(model, columns), [samples.segment()], no_filter())


def ours(model: DynamicModel, columns: tuple[int, ...], samples: Data) -> FloatArray:
    """Base parameters (b,) by our way."""
    return ordinary_least_squares(reduced(model, columns, samples), range(len(columns))).parameters


def ours_with_search(model: DynamicModel, samples: Data) -> FloatArray:
    """The same with the search for the base columns, which is cached otherwise."""
    base_module._cached.cache_clear()
    return ours(model, base_parameters(model).columns, samples)


def pinocchio_and_lstsq(
    model: DynamicModel, columns: tuple[int, ...], motion: Motion, torque: FloatArray, stacked: FloatArray
) -> FloatArray:
    """Base parameters (b,) from W (N, n, b), which is written to `stacked`, and τ (N, n)."""
    inertial = 10 * model.dof
    order = pinocchio_columns(model)
    chosen = [order[column] for column in columns if column < inertial]
    PinocchioLoop(model).fill_columns(motion, chosen, stacked[:, :, : len(chosen)])
    _, velocity, _ = motion
    for position, column in enumerate(columns[len(chosen) :], start=len(chosen)):
        parameter = model.parameters[column]
        joint = parameter.joint
        if parameter.kind == "viscous":
            stacked[:, joint, position] = velocity[:, joint]
        elif parameter.kind == "coulomb":
            stacked[:, joint, position] = np.sign(velocity[:, joint])
        else:
            stacked[:, joint, position] = 1.0
    return np.asarray(np.linalg.lstsq(stacked.reshape(-1, len(columns)), torque.ravel(), rcond=None)[0])


def figaroh(model: DynamicModel, motion: Motion, torque: FloatArray) -> tuple[FloatArray, FloatArray]:
    """figaroh's way: builder, removal of columns without effect, double QR.

    Returns:
        Its base parameters (b,), and the torque (n·N,) that they predict, all samples of the first joint first.
    """
    from figaroh.tools.qrdecomposition import QRDecomposer
    from figaroh.tools.regressor import build_regressor_reduced, get_index_eliminate

    full = figaroh_regressor(figaroh_robot(model), motion)
    names = {f"p{number:02d}": 0.0 for number in range(full.shape[1])}
    without_effect, kept = get_index_eliminate(full, names, tol_e=0.001)
    active = build_regressor_reduced(full, without_effect)
    base_regressor, _, _, parameters = QRDecomposer().double_decomposition(torque, active, kept)
    return parameters, base_regressor @ parameters


def run_pinocchio(count: int = 200_000, rounds: int = 3) -> dict[str, float]:
    """Against the loop over Pinocchio and lstsq.

    Raises:
        DisagreementError: the two parameter vectors differ.
    """
    model = arm()
    columns = base_parameters(model).columns
    samples = data(model, count)
    motion, torque = samples.by_sample(), np.ascontiguousarray(samples.torque.T)
    stacked = np.zeros((count, model.dof, len(columns)))
    check(
        "parameters against Pinocchio and lstsq",
        ours(model, columns, samples),
        pinocchio_and_lstsq(model, columns, motion, torque, stacked),
        1e-9,
    )
    sides: dict[str, Callable[[], FloatArray]] = {
        "ours": lambda: ours(model, columns, samples),
        "peer": lambda: pinocchio_and_lstsq(model, columns, motion, torque, stacked),
    }
    seconds = medians(sides, rounds, warm_up=False)
    return {
        "parameters_vs_pin_lstsq_200k": seconds["peer"] / seconds["ours"],
        "parameters_200k_seconds": seconds["ours"],
    }


def run_figaroh(count: int = 20_000, rounds: int = 3) -> dict[str, float]:
    """Against figaroh's builder and double QR.

    Raises:
        DisagreementError: the two models predict different torques, or have different numbers of parameters.
    """
    model = arm()
    samples = data(model, count)
    motion, torque = samples.by_sample(), samples.torque.ravel()
    theirs, predicted = figaroh(model, motion, torque)
    mine = ours_with_search(model, samples)
    check("number of base parameters against figaroh", np.array([len(mine)]), np.array([len(theirs)]), 0.0)
    # The two choose different base columns: what must agree is the torque.
    kernel = RegressorKernel(model, base_parameters(model).columns)
    check("torque against figaroh", predicted_torque(kernel, mine, samples), predicted, 1e-9)
    del predicted
    sides: dict[str, Callable[[], object]] = {
        "ours": lambda: ours_with_search(model, samples),
        "figaroh": lambda: figaroh(model, motion, torque),
    }
    seconds = medians(sides, rounds, warm_up=False)
    return {"parameters_vs_figaroh_20k": seconds["figaroh"] / seconds["ours"]}


def predicted_torque(kernel: RegressorKernel, parameters: FloatArray, samples: Data) -> FloatArray:
    """Torque (n·N,) of base parameters, all samples of the first joint first."""
    states = samples.position, samples.velocity, samples.acceleration
    return model_torque(kernel.model, kernel.columns, parameters, *states).ravel()
