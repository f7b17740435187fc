"""Decimation by 10 of every column of W: packed rows in one go against scipy.signal.decimate column by column."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benchmarks.agreement import check
from benchmarks.arm import arm, data
from benchmarks.identification.regressor import fill_rows, unpacked
from benchmarks.timing import medians
from drivers.core.arrays import FloatArray
from ident.model.regressor import RegressorKernel
from ident.signals.filters import chebyshev_decimation

FACTOR = 10

COMPARED = """\
decimation_vs_column_loop: W of 6 joints, 20,000 samples and 72 columns (60 inertial, 12 of friction), every tenth
  sample kept. Peer: scipy.signal.decimate for every joint and column of W (n·N, p), into memory that is there already.
  Ours: the rows that are not structurally zero."""


def column_loop(matrix: FloatArray, joints: int, out: FloatArray) -> None:
    """Decimate W (n·N, p), all rows of the first joint first, into `out` (n·M, p)."""
    from scipy.signal import decimate

    samples, kept = len(matrix) // joints, len(out) // joints
    for joint in range(joints):
        for column in range(matrix.shape[1]):
            signal = matrix[joint * samples : (joint + 1) * samples, column]
            out[joint * kept : (joint + 1) * kept, column] = decimate(signal, FACTOR)


def run(count: int = 20_000, rounds: int = 7) -> dict[str, float]:
    """Against the loop.

    Raises:
        DisagreementError: the decimated matrices differ.
    """
    model = replace(arm(), offset=(False,) * 6)
    kernel = RegressorKernel(model)
    rows = np.empty((kernel.row_count, count))
    fill_rows(kernel, data(model, count), rows)
    matrix = np.ascontiguousarray(unpacked(kernel, rows).transpose(1, 0, 2)).reshape(model.dof * count, -1)
    kept = -(-count // FACTOR)
    theirs = np.empty((model.dof * kept, matrix.shape[1]))
    chosen = chebyshev_decimation(FACTOR)
    sides: dict[str, Callable[[], object]] = {
        "ours": lambda: chosen.apply(rows),
        "loop": lambda: column_loop(matrix, model.dof, theirs),
    }
    seconds = medians(sides, rounds)
    mine = unpacked(kernel, chosen.apply(rows)).transpose(1, 0, 2).reshape(theirs.shape)
    check("decimation against scipy.signal.decimate", mine, theirs, 1e-9)
    return {
        "decimation_vs_column_loop": seconds["loop"] / seconds["ours"],
        "decimation_nonzero_share": kernel.row_count / (model.dof * matrix.shape[1]),
    }
