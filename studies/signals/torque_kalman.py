"""What ROCR6's Kalman filter of the torques buys (docs/measurements/signals.md).

    python -m studies.signals.torque_kalman [SEEDS]

The model's change of torque is the filter's input (`--method kalman-wls`); friction is coulomb-viscous without
presliding. Public recordings (their folder in DYNID_DATA): relative error of the held-out torques [%]. Simulated ROCR6,
20 s: median error of the base parameters in σ of `wls`, share of 95 % intervals that hold the truth, and error on
another motion without noise [%]; five seeds.
"""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from daq.robot.loader import load_robot
from ident.identify.identification import IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from ident.model.dynamic_model import build_model
from ident.model.true_parameters import true_model, truth_vector
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording
from studies.friction.friction_models import choices_of
from studies.models.consistency import public

RATIOS = (1.0, 0.1, 0.01, 0.001)
PLAIN = IdentifyChoices(model=ModelChoices(friction="coulomb-viscous"), presliding=False)
METHODS = ("wls", *(f"kalman-wls:ratio={ratio:g}" for ratio in RATIOS), "kalman-wls:ratio=0.01:rounds=5")


def main(seeds: int = 5) -> None:
    """Print both tables."""
    folder = Path(os.environ.get("DYNID_DATA", "../shared/data"))
    arms = {name: public(folder, name) for name in ("ur10", "tx40", "panda")}
    print(f"| method | {' | '.join(arms)} |\n|---|{'---|' * len(arms)}")
    for method in METHODS:
        errors = []
        for recording, choices in arms.values():
            found = identify(
                [recording], [], replace(choices_of(choices, "coulomb-viscous"), method=method, presliding=False)
            )
            errors.append(100.0 * found.validation.relative_error)
        print(f"| `{method}` | {' | '.join(f'{error:.2f}' for error in errors)} |", flush=True)
    robot_file = load_robot("rocr6")
    truth = truth_vector(robot_file, true_model(robot_file))
    runs = []
    for seed in range(seeds):
        motions = [random_fourier_motion(build_model(robot_file), 10.0, seed=seed + part) for part in (0, 100)]
        runs.append([simulate_recording(robot_file, motion, 20.0, seed=seed) for motion in motions])
    print("\n| method | error [σ of wls] | intervals with the truth [%] | held out [%] |\n|---|---|---|---|")
    deviations: list[np.ndarray] = []
    for method in METHODS:
        errors, held, held_out = [], [], []
        for seed, (run, other) in enumerate(runs):
            found = identify([run], [other], replace(PLAIN, method=method))
            if method == "wls":
                deviations.append(found.std)
            error = np.abs(found.solution.parameters - found.base.projection @ truth)
            errors.append(np.median(error / deviations[seed]))
            held.append(np.mean(error <= 1.96 * found.std))
            held_out.append(found.validation.relative_error)
        print(
            f"| `{method}` | {np.mean(errors):.2f} | {100 * np.mean(held):.0f} | {100 * np.mean(held_out):.2f} |",
            flush=True,
        )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
