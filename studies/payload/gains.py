"""How well are a UR10e's drive gains found, whose true values are hidden? Simulated, 2.8 kg load, many seeds.

Prints for how many seeds each gain has a value, its errors, how often 95 % intervals hold the true one, the same for
total least squares over all columns; for an exciting motion and for one that goes slowly up and down; then what
`dynid payload` makes of gains that are 10 % wrong. About a minute.
"""

from __future__ import annotations

import os
import sys

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from daq.motion.trajectories import FourierSeries
from daq.recording.recording import Recording
from daq.robot.loader import load_robot
from drivers.core.arrays import FloatArray
from ident.experiments.gains.drive_gains import DriveGains, gain_system, identify_gains
from ident.experiments.load.payload import identify_payload
from ident.experiments.run_pair import LOADED, widened
from ident.linear_algebra.triangular import triangular
from ident.model.dynamic_model import build_model
from ident.model.load import KnownLoad
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from sim_drivers.plant.altered_arm import with_load
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording
from studies.synthetic.altered_arms import with_gains

DURATION = 20.0
RATE = 125.0
SLOW_DURATION = 400.0
SLOW_RATE = 20.0
LOAD = KnownLoad(2.8, (0.03, -0.02, 0.08), (0.01, 0.001, 0.0, 0.012, 0.0, 0.009))
HIDDEN = (1.1, 0.9, 1.05, 0.93, 1.1, 0.9)


def record(factors: tuple[float, ...], seed: int) -> tuple[Recording, Recording]:
    """A free and a loaded run of an arm whose gains are `factors` times those of its file."""
    motion = random_fourier_motion(build_model(load_robot("ur10e")), DURATION, seed=seed, candidates=10)
    return runs(factors, motion, DURATION, RATE, seed)


def runs(
    factors: tuple[float, ...], motion: FourierSeries, duration: float, rate: float, seed: int
) -> tuple[Recording, Recording]:
    """A free and a loaded run along the same motion."""
    robot_file = load_robot("ur10e")
    arm = with_gains(robot_file, dict(zip(robot_file.robot.joint_names, factors, strict=True)))
    loaded = with_load(arm, LOAD.mass, LOAD.com or (), LOAD.inertia or ())
    free = simulate_recording(arm, motion, duration, seed=2 * seed, rate=rate)
    return free, simulate_recording(loaded, motion, duration, seed=2 * seed + 1, rate=rate)


def slow_motion(seed: int) -> FourierSeries:
    """Every joint goes up and down by about a radian, slower than 0.15 rad/s, around a stretched pose."""
    generator = np.random.default_rng(seed)
    sine, cosine = np.zeros((2, 6, 5))
    for joint, (first, second) in enumerate(((0, 2), (1, 3), (2, 4), (4, 1), (3, 0), (4, 1))):
        phase, size = generator.uniform(0.0, 2.0 * np.pi), 0.3 if joint == 0 else 1.0
        sine[joint, first], cosine[joint, first] = size * np.sin(phase), size * np.cos(phase)
        sine[joint, second], cosine[joint, second] = 0.4 * generator.standard_normal(2)
    middle = np.array([0.0, -1.2, 0.8, -0.5, 0.7, 0.3])
    return FourierSeries.from_position_amplitudes(SLOW_DURATION, middle, sine, cosine)


def columns_alike(free: Recording, loaded: Recording) -> FloatArray:
    """Gains (n,) by the smallest singular vector of the whole matrix, columns scaled to unit length."""
    system, by_first_pass = gain_system(free, loaded, KnownLoad(LOAD.mass), None, None)
    pair, effects = system.pair, system.parts
    dof, count = pair.model.dof, pair.base.count
    if len(system.used) < dof:
        return np.full(dof, np.nan)
    columns = list(system.layout)
    blocks = []
    for joint in range(dof):
        for run_index, run in enumerate(pair.runs):
            of_run = run.reduction.joints[joint]
            wide = widened(of_run.columns, count, effects if run_index == LOADED else 0.0 * effects, np.zeros(count))
            rows = of_run.factor @ wide / system.noise[joint] / system.relative_gains[joint]
            block = np.zeros((len(rows), len(columns) + dof))
            block[:, : len(columns)] = -rows[:, columns]
            block[:, len(columns) + joint] = rows[:, -1]
            blocks.append(block)
    factor = triangular(np.vstack(blocks))
    lengths = np.linalg.norm(factor, axis=0)
    vector = np.linalg.svd(factor / lengths)[2][-1] / lengths
    return np.asarray(by_first_pass * vector[len(columns) :] / vector[len(columns) - 1])


def main(seeds: int = 20) -> None:
    """Print both tables."""
    names = load_robot("ur10e").robot.joint_names
    true = np.array([load_robot("ur10e").robot.drive(name).gain for name in names]) * np.array(HIDDEN)
    print(f"the file's gains off by up to 10 %; load {LOAD.mass:g} kg; {seeds} seeds; errors in per cent")
    print(f"\nexciting motion, two runs of {DURATION:g} s")
    print_errors(names, true, [both_ways(*record(HIDDEN, seed)) for seed in range(seeds)])
    print(f"\nslowly up and down, two runs of {SLOW_DURATION:g} s")
    slow = [runs(HIDDEN, slow_motion(seed), SLOW_DURATION, SLOW_RATE, seed) for seed in range(seeds)]
    print_errors(names, true, [both_ways(*pair) for pair in slow])
    wrong = identify_payload(*record((1 / 1.1,) * 6, 0), KnownLoad(LOAD.mass))
    print("\nall gains of the file 10 % too high:")
    for line in (*wrong.sentences, *(f"warning: {warning}" for warning in wrong.warnings)):
        print(f"  {line}")


def both_ways(free: Recording, loaded: Recording) -> tuple[DriveGains, FloatArray]:
    """The gains, and those by total least squares over all columns."""
    return identify_gains(free, loaded, KnownLoad(LOAD.mass)), columns_alike(free, loaded)


def print_errors(names: tuple[str, ...], true: FloatArray, found: list[tuple[DriveGains, FloatArray]]) -> None:
    """A line for each joint; seeds in which its gain got no value are left out (all columns: any gain)."""
    results = [gains for gains, _ in found]
    error = np.array([100.0 * (each.values / true - 1.0) for each in results])
    held = np.array([np.abs(each.values - true) <= WITHIN_95_PERCENT * each.std for each in results])
    std = np.array([100.0 * each.std / np.abs(each.values) for each in results])
    alike = np.array([100.0 * (others / true - 1.0) for _, others in found])
    print(f"{'joint':20} told   mean    RMS  worst  σ told   held   columns alike: mean, RMS")
    for i, name in enumerate(names):
        known = np.isfinite(error[:, i])
        if not known.any():
            print(f"{name:20} {0:4}")
            continue
        own, others = error[known, i], alike[np.isfinite(alike[:, i]), i]
        print(
            f"{name:20} {known.sum():4} {own.mean():6.2f} {np.sqrt(np.mean(own**2)):6.2f} {np.abs(own).max():6.2f} "
            f"{np.median(std[known, i]):7.2f} {held[known, i].mean():6.0%}   "
            + (f"{others.mean():15.2f} {np.sqrt(np.mean(others**2)):5.2f}" if len(others) else "")
        )


if __name__ == "__main__":
    main(seeds=int(sys.argv[1]) if len(sys.argv) > 1 else 20)
