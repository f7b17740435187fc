"""What friction or torque that depends on the position would gain on public recordings: docs/measurements/friction.md.

    python -m studies.friction.ripple [NAME…]
    python -m studies.friction.ripple several

`several`: a simulated UR10e without and with a torque and a friction of one period per turn, each of a tenth of the
joint's Coulomb friction, recorded once and three times; another motion is held out.

Beside the default model, each joint gets cos nq, sin nq and the same times sign(q̇), for the harmonic n of a turn that
predicts blocks of the identification data best, if it predicts them better than none; fitted to its residuals, judged
on the held-out 30 %.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from daq.recording.recording import JOINTS_STREAM, Recording
from drivers.core.arrays import FloatArray, IntArray
from dynid import simulate
from ident.identify.data_split import PreparedRun
from ident.identify.friction.candidates import FOLDS
from ident.identify.identification import Identification, IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from ident.regression.comparison import TorqueSeries
from studies.models.consistency import public
from studies.synthetic.data_mistakes import with_values

HARMONICS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 24, 30, 40, 50, 60, 80, 100, 101, 120, 121, 160, 200, 202, 240, 242)


Systems = tuple[FloatArray, FloatArray, IntArray]
"""Columns (4, M) of a harmonic, residuals (M,) of a joint, and the block (M,) that each belongs to."""


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


def systems(runs: Sequence[PreparedRun], parts: Sequence[TorqueSeries], joint: int, harmonic: int) -> Systems:
    """Those of all runs; of several, each is a block."""
    found = [system(run, part, joint, harmonic) for run, part in zip(runs, parts, strict=True)]
    counts = [len(residual) for _, residual in found]
    block = np.repeat(np.arange(len(runs)), counts) if len(runs) > 1 else np.arange(counts[0]) * FOLDS // counts[0]
    return np.hstack([columns for columns, _ in found]), np.concatenate([one for _, one in found]), block


def block_error(columns: FloatArray, residual: FloatArray, block: IntArray) -> float:
    """Squared error on each block of what fits the others."""
    error = 0.0
    for number in np.unique(block):
        own = block == number
        values = fitted(columns[:, ~own], residual[~own])
        error += float(np.sum((residual[own] - values @ columns[:, own]) ** 2))
    return error


def line(name: str, found: Identification) -> str:
    """Held-out error before and after, and the harmonic of each joint with its gain held out."""
    (held_out,), (validation,) = found.validation_runs, found.validation_series
    before = after = 0.0
    gains = []
    for joint, joint_name in enumerate(found.model.joint_names):
        tried = {harmonic: systems(found.runs, found.fit_series, joint, harmonic) for harmonic in HARMONICS}
        best = min(HARMONICS, key=lambda harmonic: block_error(*tried[harmonic]))
        columns, residual = system(held_out, validation, joint, best)
        left = residual
        if block_error(*tried[best]) < float(np.sum(tried[best][1] ** 2)):
            left = residual - fitted(*tried[best][:2]) @ columns
            gain = 100.0 * (np.linalg.norm(left) / np.linalg.norm(residual) - 1.0)
            turns = np.ptp(found.runs[0].prepared.segments[0].position[joint]) / (2.0 * np.pi)
            gains.append(f"{joint_name} n = {best} over {turns:.1f} turns {gain:+.0f} %")
        before, after = before + float(np.sum(residual**2)), after + float(np.sum(left**2))
    size = np.linalg.norm(validation.measured[validation.counted & np.isfinite(validation.residual)])
    errors = " → ".join(f"{100.0 * np.sqrt(value) / size:.2f}" for value in (before, after))
    return f"| {name} | {errors} | {', '.join(gains) or 'none'} |"


def rippled(run: Recording, share: float) -> Recording:
    """A recording of simulated torques with a torque and a friction of one period per turn, the same in all runs."""
    stream = run.streams[JOINTS_STREAM]
    position = stream.channels["position"].values
    robot = run.robot().robot
    size = share * np.array([robot.truth.joints[name].coulomb for name in robot.joint_names])
    name = next(name for name in ("torque", "current") if name in stream.channels)
    gains = np.array([robot.drive(joint).gain or 1.0 for joint in robot.joint_names]) if name == "current" else 1.0
    added = size * (np.sin(position + 1.0) + np.sign(np.gradient(position, axis=0)) * np.cos(position))
    return with_values(run, **{name: stream.channels[name].values + added / gains})


def several() -> None:
    """Print what one and three runs of a simulated arm gain on another motion."""
    clean = [simulate("ur10e", duration=15.0, seed=seed, rate=100.0) for seed in (11, 12, 13, 14)]
    choices = IdentifyChoices(model=ModelChoices(friction="coulomb-viscous"), search_delay=False, presliding=False)
    for share in (0.0, 0.1):
        *runs, other = [rippled(run, share) for run in clean]
        for count in (1, 3):
            name = f"ur10e, n = 1 of {100 * share:.0f} %, {count} run{'s' if count > 1 else ''}"
            print(line(name, identify(runs[:count], [other], choices)), flush=True)


def main(names: list[str]) -> None:
    """Print a row for each recording."""
    folder = Path(os.environ.get("DYNID_DATA", "../shared/data"))
    print("| | held-out error [%] | harmonics that blocks call for, and what they do to the joint's held-out error |")
    print("|---|---|---|")
    if names == ["several"]:
        several()
        return
    for name in names or ["ur10", "panda", "tx40"]:
        recording, choices = public(folder, name)
        inertia = False if name == "panda" else None
        model = ModelChoices(friction="auto", motor_inertia=inertia)
        print(line(name, identify([recording], [], replace(choices, model=model))), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
