"""What outliers do to an identification, and what is left of it where they are replaced (docs/measurements/signals.md).

    python -m studies.signals.outliers 5

Simulated arms, 30 s each; encoder glitches of one to three samples, and spikes of the motor's signal. Takes about a
minute with 5 seeds.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from contextlib import nullcontext
from unittest.mock import patch

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from daq.recording.quality.outliers import CleanSignal, without_outliers
from daq.recording.recording import JOINTS_STREAM, Recording
from daq.robot.loader import load_robot
from drivers.core.arrays import FloatArray
from ident.identify.identification import Identification, IdentifyChoices
from ident.identify.identify import identify
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.true_parameters import truth_vector
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording
from studies.synthetic.data_mistakes import with_values

ROBOTS = ("ur5e", "rocr6", "panda")
DURATION = 30.0
MOTOR_SIGNALS = ("current", "voltage", "torque")
Change = Callable[[FloatArray, np.random.Generator], FloatArray]


def glitches(share: float, size: float, longest: int = 1) -> Change:
    """Errors of `size` [the signal's unit] in a share of the samples, alone or in runs."""

    def change(values: FloatArray, generator: np.random.Generator) -> FloatArray:
        begin = generator.random(values.shape) < share
        wrong = begin.copy()
        length = generator.integers(1, longest + 1, values.shape)
        for later in range(1, longest):
            wrong[later:] |= (begin & (length > later))[:-later]
        return values + size * wrong

    return change


def spikes(share: float, size: float) -> Change:
    """Errors of either sign and of `size` times the signal's root mean square in a share of the samples."""

    def change(values: FloatArray, generator: np.random.Generator) -> FloatArray:
        sign = generator.choice([-1.0, 1.0], values.shape) * (generator.random(values.shape) < share)
        return np.asarray(values + size * np.sqrt(np.mean(values**2, axis=0)) * sign)

    return change


CASES: dict[str, tuple[tuple[str, ...], Change]] = {
    "none": ((), glitches(0.0, 0.0)),
    "0.1 % of positions by 0.05 rad": (("position",), glitches(1e-3, 0.05)),
    "1 % of positions by 0.05 rad": (("position",), glitches(1e-2, 0.05)),
    "0.1 % by 0.05 rad, 1 to 3 samples": (("position",), glitches(1e-3, 0.05, 3)),
    "0.1 % of positions by 0.002 rad": (("position",), glitches(1e-3, 0.002)),
    "0.1 % of torques by 3 RMS": (MOTOR_SIGNALS, spikes(1e-3, 3.0)),
}


def spoilt(recording: Recording, quantities: tuple[str, ...], change: Change, seed: int) -> Recording:
    """The recording with outliers in some quantities."""
    generator = np.random.default_rng(seed)
    channels = recording.streams[JOINTS_STREAM].channels
    changed = {name: change(channels[name].values, generator) for name in channels if name in quantities}
    return with_values(recording, **changed)


def as_recorded(_: FloatArray, values: FloatArray) -> CleanSignal:
    """Replace nothing, in place of `without_outliers`."""
    none = np.zeros(values.shape[1], dtype=np.int64)
    return CleanSignal(values, none, none)


def found(recording: Recording, *, replaced: bool) -> Identification:
    """An identification with or without outliers replaced."""
    with nullcontext() if replaced else patch("ident.signals.joint_signals.without_outliers", as_recorded):
        return identify([recording], [], IdentifyChoices())


def main(seeds: int) -> None:
    """Print the table."""
    print("| arm | outliers | found [%] | held out [%] | its 95 % intervals hold the truth [%] | largest error [σ] |")
    print("|---|---|---|---|---|---|")
    for robot in ROBOTS:
        robot_file = load_robot(robot)
        model = build_model(robot_file)
        truth = base_parameters(model).projection @ truth_vector(robot_file)
        for case, (quantities, change) in CASES.items():
            figures: dict[bool, list[tuple[float, float, float]]] = {True: [], False: []}
            wrong = named = 0
            for seed in range(seeds):
                motion = random_fourier_motion(model, DURATION, seed=seed, candidates=5)
                clean = simulate_recording(robot_file, motion, DURATION, seed=seed)
                recording = spoilt(clean, quantities, change, seed)
                for name, channel in recording.streams[JOINTS_STREAM].channels.items():
                    different = channel.values != clean.streams[JOINTS_STREAM].channels[name].values
                    wrong += int(different.sum())
                    there = without_outliers(recording.streams[JOINTS_STREAM].time, channel.values).values
                    named += int(np.sum(different & (there != channel.values)))
                for replaced, rows in figures.items():
                    result = found(recording, replaced=replaced)
                    error = np.abs(result.solution.parameters - truth) / result.std
                    rows.append(
                        (result.validation.relative_error, float(np.mean(error < WITHIN_95_PERCENT)), error.max())
                    )
            share = f"{100 * named / wrong:.1f}" if wrong else "–"
            after, before = (np.mean(figures[replaced], axis=0) for replaced in (True, False))
            print(
                f"| {robot} | {case} | {share} | {100 * after[0]:.2f} ({100 * before[0]:.2f}) | "
                f"{100 * after[1]:.0f} ({100 * before[1]:.0f}) | {after[2]:.1f} ({before[2]:.1f}) |",
                flush=True,
            )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 5)
