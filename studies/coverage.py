"""How often do 95 % intervals hold the truth? Simulated arms, 20 s each, many seeds; takes about a minute.

Prints, for each arm, the share of true base parameters within ±1.96 standard deviations over all parameters and seeds,
with corrected (delete-block jackknife) and with classical standard deviations. Arguments: seeds, and the method
where it is not wls.
"""

from __future__ import annotations

import os
import sys

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from daq.robot.loader import load_robot
from ident.identify.identification import IdentifyChoices
from ident.identify.identify import identify
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.true_parameters import truth_vector
from ident.regression.least_squares import Method
from sim_drivers.synthetic.measurement import simulate_recording
from sim_drivers.synthetic.motion import random_fourier_motion

INTERVAL = 1.96
DURATION = 20.0
HELD_OUT = 8.6


def coverage(robot: str, seeds: int, method: Method = "wls") -> tuple[float, float, float]:
    """Shares of true values inside: corrected, classical, and of the parameter that was missed most (corrected)."""
    robot_file = load_robot(robot)
    model = build_model(robot_file)
    base = base_parameters(model)
    truth = base.projection @ truth_vector(robot_file)
    corrected, classical = [], []
    for seed in range(seeds):
        motion = random_fourier_motion(model, DURATION, seed=seed, candidates=10)
        recording = simulate_recording(robot_file, motion, DURATION + HELD_OUT, seed=seed)
        result = identify([recording], [], IdentifyChoices(method, split=DURATION))
        error = np.abs(result.solution.parameters - truth)
        corrected.append(error <= INTERVAL * result.std)
        classical.append(error <= INTERVAL * result.solution.std)
    return float(np.mean(corrected)), float(np.mean(classical)), float(np.mean(corrected, axis=0).min())


def main(
    robots: tuple[str, ...] = ("ur5e", "rocr6", "aubo_i5", "panda"), seeds: int = 20, method: Method = "wls"
) -> None:
    """Print a line for each arm."""
    print(f"{'arm':10} {'corrected':>10} {'classical':>10} {'worst parameter':>16}   ({method}, {seeds} seeds)")
    for robot in robots:
        corrected, classical, worst = coverage(robot, seeds, method)
        print(f"{robot:10} {corrected:10.1%} {classical:10.1%} {worst:16.0%}")


if __name__ == "__main__":
    main(
        seeds=int(sys.argv[1]) if len(sys.argv) > 1 else 20,
        method=sys.argv[2] if len(sys.argv) > 2 else "wls",  # type: ignore[arg-type]
    )
