"""The regressor of 20,000 samples: our kernel, a loop over Pinocchio, figaroh's builder."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.agreement import check
from benchmarks.arm import Data, arm, data, pinocchio_columns
from benchmarks.peers import PinocchioLoop, figaroh_regressor, figaroh_robot
from benchmarks.timing import medians
from drivers.core.arrays import FloatArray
from ident.model.regressor import RegressorKernel

COMPARED = """\
regressor_vs_pin_loop: the 60 inertial columns of 20,000 samples into memory that is there already. Pinocchio: a loop
  over computeJointTorqueRegressor, 6 × 60 entries a sample, zeros included. Ours: chunk by chunk, the entries that are
  not structurally zero, all samples kept. regressor_streamed_vs_pin_loop: the same into one reused chunk, as
  identification does it.
regressor_vs_figaroh_builder: all 78 columns, friction included; figaroh allocates its result itself."""


def fill_rows(kernel: RegressorKernel, samples: Data, out: FloatArray) -> None:
    """Fill `out` (kernel.row_count, N) chunk by chunk."""
    for start in range(0, samples.samples, kernel.chunk):
        part = slice(start, min(start + kernel.chunk, samples.samples))
        kernel.evaluate(
            samples.position[:, part], samples.velocity[:, part], samples.acceleration[:, part], out[:, part]
        )


def stream_rows(kernel: RegressorKernel, samples: Data, buffer: FloatArray) -> None:
    """Evaluate every chunk into the same `buffer` (kernel.row_count, chunk)."""
    for start in range(0, samples.samples, kernel.chunk):
        part = slice(start, min(start + kernel.chunk, samples.samples))
        states = samples.position[:, part], samples.velocity[:, part], samples.acceleration[:, part]
        kernel.evaluate(*states, buffer[:, : part.stop - part.start])


def unpacked(kernel: RegressorKernel, packed: FloatArray) -> FloatArray:
    """(N, n, columns) from packed rows (kernel.row_count, N)."""
    dense = np.zeros((packed.shape[1], len(kernel.joint_rows), len(kernel.columns)))
    for joint, rows in enumerate(kernel.joint_rows):
        dense[:, joint, list(rows.columns)] = packed[rows.rows].T
    return dense


def run_pinocchio(count: int = 20_000, rounds: int = 15) -> dict[str, float]:
    """Against the loop over Pinocchio.

    Raises:
        DisagreementError: the two regressors differ.
    """
    model = arm()
    samples = data(model, count)
    motion = samples.by_sample()
    kernel = RegressorKernel(model, range(10 * model.dof))
    loop = PinocchioLoop(model)
    theirs = np.empty((count, model.dof, 10 * model.dof))
    ours = np.empty((kernel.row_count, count))
    buffer = np.empty((kernel.row_count, kernel.chunk))
    sides: dict[str, Callable[[], None]] = {
        "ours": lambda: fill_rows(kernel, samples, ours),
        "streamed": lambda: stream_rows(kernel, samples, buffer),
        "pinocchio": lambda: loop.fill(motion, theirs),
    }
    seconds = medians(sides, rounds)
    check("regressor against Pinocchio", unpacked(kernel, ours), theirs[:, :, pinocchio_columns(model)], 1e-12)
    return {
        "regressor_vs_pin_loop": seconds["pinocchio"] / seconds["ours"],
        "regressor_streamed_vs_pin_loop": seconds["pinocchio"] / seconds["streamed"],
        "regressor_us_per_sample": 1e6 * seconds["ours"] / count,
    }


def run_figaroh(count: int = 20_000, rounds: int = 5) -> dict[str, float]:
    """Against figaroh's builder.

    Raises:
        DisagreementError: the two regressors differ.
    """
    model = arm()
    samples = data(model, count)
    motion = samples.by_sample()
    kernel = RegressorKernel(model)
    robot = figaroh_robot(model)
    ours = np.empty((kernel.row_count, count))
    fill_rows(kernel, samples, ours)
    theirs = figaroh_regressor(robot, motion).reshape(model.dof, count, -1).transpose(1, 0, 2)
    order = pinocchio_columns(model)
    order += range(len(order), theirs.shape[2])
    check("regressor against figaroh", unpacked(kernel, ours), theirs[:, :, order], 1e-12)
    sides: dict[str, Callable[[], object]] = {
        "ours": lambda: fill_rows(kernel, samples, ours),
        "figaroh": lambda: figaroh_regressor(robot, motion),
    }
    seconds = medians(sides, rounds)
    return {"regressor_vs_figaroh_builder": seconds["figaroh"] / seconds["ours"]}
