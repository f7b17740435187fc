"""What friction or torque that depends on the position would gain on public recordings: docs/measurements/friction.md.

    python -m studies.friction.ripple [NAME…]

Beside the default model, each joint gets cos nq, sin nq and the same times sign(q̇), for the harmonic n of a turn that
predicts blocks of the identification data best, if it predicts them better than none; fitted to its residuals, judged
on the held-out 30 %.
"""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from drivers.core.arrays import FloatArray
from ident.identify.friction.candidates import FOLDS
from ident.identify.identification import Identification, ModelChoices, PreparedRun
from ident.identify.identify import identify
from ident.regression.comparison import TorqueSeries
from studies.models.consistency import public

HARMONICS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 24, 30, 40, 50, 60, 80, 100, 101, 120, 121, 160, 200, 202, 240, 242)


def system(run: PreparedRun, part: TorqueSeries, joint: int, harmonic: int) -> tuple[FloatArray, FloatArray]:
    """Columns (4, M) of a harmonic and residuals (M,) of a joint, of a run of one segment."""
    (segment,) = run.prepared.segments
    angle, direction = harmonic * segment.position[joint], np.sign(segment.velocity[joint])
    columns = np.array([np.cos(angle), np.sin(angle), direction * np.cos(angle), direction * np.sin(angle)])
    counted = part.counted[joint] & np.isfinite(part.residual[joint])
    return run.prepared.parallel_filter.apply(columns)[:, counted], part.residual[joint, counted]


def fitted(columns: FloatArray, residual: FloatArray) -> FloatArray:
    """Coefficients (4,)."""
    return np.asarray(np.linalg.lstsq(columns.T, residual, rcond=1e-6)[0])


def block_error(columns: FloatArray, residual: FloatArray) -> float:
    """Squared error on each block of what fits the others."""
    block, error = np.arange(len(residual)) * FOLDS // len(residual), 0.0
    for number in range(FOLDS):
        own = block == number
        values = fitted(columns[:, ~own], residual[~own])
        error += float(np.sum((residual[own] - values @ columns[:, own]) ** 2))
    return error


def line(name: str, found: Identification) -> str:
    """Held-out error before and after, and the harmonic of each joint with its gain held out."""
    (run,), (held_out,) = found.runs, found.validation_runs
    (fit,), (validation,) = found.fit_series, found.validation_series
    before = after = 0.0
    gains = []
    for joint, joint_name in enumerate(found.model.joint_names):
        systems = {harmonic: system(run, fit, joint, harmonic) for harmonic in HARMONICS}
        best = min(HARMONICS, key=lambda harmonic: block_error(*systems[harmonic]))
        columns, residual = system(held_out, validation, joint, best)
        left = residual
        if block_error(*systems[best]) < float(np.sum(systems[best][1] ** 2)):
            left = residual - fitted(*systems[best]) @ columns
            gain = 100.0 * (np.linalg.norm(left) / np.linalg.norm(residual) - 1.0)
            turns = np.ptp(run.prepared.segments[0].position[joint]) / (2.0 * np.pi)
            gains.append(f"{joint_name} n = {best} over {turns:.1f} turns {gain:+.0f} %")
        before, after = before + float(np.sum(residual**2)), after + float(np.sum(left**2))
    size = np.linalg.norm(validation.measured[validation.counted & np.isfinite(validation.residual)])
    errors = " → ".join(f"{100.0 * np.sqrt(value) / size:.2f}" for value in (before, after))
    return f"| {name} | {errors} | {', '.join(gains)} |"


def main(names: list[str]) -> None:
    """Print a row for each recording."""
    folder = Path(os.environ.get("DYNID_DATA", "../shared/data"))
    print("| | held-out error [%] | harmonics that blocks call for, and what they do to the joint's held-out error |")
    print("|---|---|---|")
    for name in names or ["ur10", "panda", "tx40"]:
        recording, choices = public(folder, name)
        inertia = False if name == "panda" else None
        model = ModelChoices(friction="auto", motor_inertia=inertia)
        print(line(name, identify([recording], [], replace(choices, model=model))), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
