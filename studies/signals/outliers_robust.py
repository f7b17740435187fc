"""Faults in recorded signals: least squares against robust least squares; the table of docs/measurements/signals.md.

    python -m studies.signals.outliers_robust 5

Simulated arms, 40 s of a periodic motion, judged on 20 s of another one without faults. Either contacts: bursts of 20
to 100 ms that fill 5 % of the time, in which a torque of up to its own root mean square is added to one joint. Or
single samples, 5 % of each motor signal, off by 3 RMS. Or a joint whose encoder holds its value for a second while the
arm moves on. Prints, over the seeds, the median error of the base parameters in standard deviations of weighted least
squares on the data without faults, the share of true values inside the 95 % intervals, and the held-out error. Takes
about two minutes per arm with 5 seeds.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from daq.recording.recording import JOINTS_STREAM, Recording, Stream
from daq.robot.loader import load_robot
from drivers.core.arrays import FloatArray
from ident.identify.identification import Identification, IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from ident.model.dynamic_model import build_model
from ident.model.true_parameters import truth_vector
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording
from studies.synthetic.data_mistakes import with_values

ROBOTS = ("ur5e", "rocr6", "panda")
METHODS = ("ols", "wls", "irls", "irls:weights=huber", "irls:weights=tukey")
PERIOD, DURATION, HELD_OUT = 20.0, 40.0, 20.0
SHARE = 0.05
MOTOR_SIGNALS = ("current", "voltage", "torque")

Fault = Callable[[Stream, np.random.Generator], dict[str, FloatArray]]


def no_fault(stream: Stream, generator: np.random.Generator) -> dict[str, FloatArray]:
    """The recording as it is."""
    return {}


def contacts(stream: Stream, generator: np.random.Generator) -> dict[str, FloatArray]:
    """Bursts in the motors' signals, one joint at a time, until they fill `SHARE` of the time."""
    rate = (len(stream.time) - 1) / (stream.time[-1] - stream.time[0])
    changed = {}
    for name in MOTOR_SIGNALS:
        if name not in stream.channels:
            continue
        values = stream.channels[name].values.copy()
        size = np.sqrt(np.mean(values**2, axis=0))
        filled = 0
        while filled < SHARE * len(values):
            length = int(generator.uniform(0.02, 0.1) * rate)
            start = int(generator.integers(0, len(values) - length))
            joint = int(generator.integers(0, values.shape[1]))
            values[start : start + length, joint] += generator.uniform(-1.0, 1.0) * size[joint]
            filled += length
        changed[name] = values
    return changed


def single_samples(stream: Stream, generator: np.random.Generator) -> dict[str, FloatArray]:
    """`SHARE` of each motor's samples off by 3 RMS."""
    changed = {}
    for name in MOTOR_SIGNALS:
        if name in stream.channels:
            values = stream.channels[name].values
            sign = generator.choice([-1.0, 1.0], values.shape) * (generator.random(values.shape) < SHARE)
            changed[name] = values + 3.0 * np.sqrt(np.mean(values**2, axis=0)) * sign
    return changed


def stuck(stream: Stream, generator: np.random.Generator) -> dict[str, FloatArray]:
    """The second joint's encoder holds its value for a second."""
    rate = (len(stream.time) - 1) / (stream.time[-1] - stream.time[0])
    position = stream.channels["position"].values.copy()
    start = int(generator.uniform(0.2, 0.8) * len(position))
    position[start : start + int(rate), 1] = position[start, 1]
    return {"position": position}


FAULTS: dict[str, Fault] = {
    "none": no_fault,
    "contacts, 5 % of the time": contacts,
    "5 % of samples by 3 RMS": single_samples,
    "encoder stuck for 1 s": stuck,
}


def spoilt(recording: Recording, fault: Fault, seed: int) -> Recording:
    """The recording with a fault; the recorded velocity, which does not have it, left out."""
    return with_values(recording, **fault(recording.streams[JOINTS_STREAM], np.random.default_rng(seed)))


def recordings(robot: str, seed: int) -> tuple[Recording, Recording]:
    """Recordings to identify from, and held out."""
    arm = load_robot(robot)
    model = build_model(arm)
    first, other = (random_fourier_motion(model, PERIOD, seed=seed + extra, candidates=10) for extra in (0, 500))
    return simulate_recording(arm, first, DURATION, seed=seed), simulate_recording(arm, other, HELD_OUT, seed=seed + 1)


def identified(recording: Recording, held_out: Recording, method: str) -> Identification:
    """Identify with a known delay of 0 and the arm's own friction, so that only the estimators differ."""
    choices = IdentifyChoices(method, model=ModelChoices(friction="coulomb-viscous"), search_delay=False)
    return identify([recording], [held_out], choices)


def line(robot: str, seeds: int, name: str) -> str:
    """A fault's figures for each method."""
    arm = load_robot(robot)
    figures = np.empty((seeds, len(METHODS), 3))
    for seed in range(seeds):
        clean, held_out = recordings(robot, seed)
        reference = identified(clean, held_out, "wls")
        truth = reference.base.projection @ truth_vector(arm)
        recording = spoilt(clean, FAULTS[name], seed)
        for row, method in enumerate(METHODS):
            found = identified(recording, held_out, method)
            error = np.abs(found.solution.parameters - truth)
            inside = np.mean(error <= WITHIN_95_PERCENT * found.std)
            figures[seed, row] = np.median(error / reference.std), inside, found.validation.relative_error
    cells = (f"{error:.2f} | {100 * inside:.0f} % | {100 * held:.2f} %" for error, inside, held in figures.mean(axis=0))
    return f"| {name}, {robot} | {' | '.join(cells)} |"


def main(seeds: int = 5, robots: Sequence[str] = ROBOTS) -> None:
    """Print the table."""
    heads = [head for method in METHODS for head in (f"`{method}` error", "inside", "held out")]
    print(f"| fault | {' | '.join(heads)} |\n|{'---|' * (1 + len(heads))}")
    for name in FAULTS:
        for robot in robots:
            print(line(robot, seeds, name), flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 5, sys.argv[2].split(",") if len(sys.argv) > 2 else ROBOTS)
