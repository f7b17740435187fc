"""How far can a load's error bars and tests be trusted? Simulated UR10e, 2.8 kg load, many seeds; about a minute.

Prints, for each load parameter, its true value, its median standard deviation and how often 95 % intervals hold the
truth, then how often the right load is accepted and wrong ones are rejected.
"""

from __future__ import annotations

import os
import sys

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from daq.robot.loader import load_robot
from ident.experiments.payload import Payload, identify_payload
from ident.model.dynamic_model import build_model
from ident.model.load import KnownLoad
from sim_drivers.plant.altered_arm import with_load
from sim_drivers.synthetic.measurement import simulate_recording
from sim_drivers.synthetic.motion import random_fourier_motion

INTERVAL = 1.96
DURATION = 20.0
RATE = 125.0
COM, INERTIA = (0.03, -0.02, 0.08), (0.01, 0.001, 0.0, 0.012, 0.0, 0.009)
LOAD = KnownLoad(2.8, COM, INERTIA)
WRONG = {
    "mass 2 % too large": KnownLoad(2.856, COM, INERTIA),
    "centre of mass 5 mm off": KnownLoad(2.8, (0.03, -0.02, 0.085), INERTIA),
}


def identified(seed: int, known: KnownLoad) -> Payload:
    """The load of a simulated free and loaded run along the same motion."""
    robot_file = load_robot("ur10e")
    motion = random_fourier_motion(build_model(robot_file), DURATION, seed=seed, candidates=5)
    free = simulate_recording(robot_file, motion, DURATION, seed=2 * seed, rate=RATE)
    loaded = with_load(robot_file, LOAD.mass, COM, INERTIA)
    return identify_payload(free, simulate_recording(loaded, motion, DURATION, seed=2 * seed + 1, rate=RATE), known)


def main(seeds: int = 40) -> None:
    """Print the tables."""
    results = [identified(seed, LOAD) for seed in range(seeds)]
    values = np.array([each.load.values for each in results])
    std = np.array([np.sqrt(np.diag(each.load.covariance)) for each in results])
    held = np.abs(values - LOAD.values) <= INTERVAL * std
    columns = results[0].load.columns
    print(f"{'':6} {'true':>9} {'mean':>9} {'σ':>9} {'held':>6}   ({seeds} seeds; noise alone, gains as in the file)")
    for i, name in enumerate(columns.names):
        print(
            f"{name:6} {LOAD.values[i]:9.4f} {values[:, i].mean():9.4f} {np.median(std[:, i]):9.4f} "
            f"{held[:, i].mean():6.0%}   {columns.units[i]}"
        )
    print(f"all    {held.mean():36.1%}")
    tests = {
        "mass": [each.mass_test for each in results],
        "known values": [each.values_test for each in results],
        "some load": [each.load_test for each in results],
        "the known load": [each.known_test for each in results],
        "the rest unchanged": [each.rest.test if each.rest else None for each in results],
    }
    for name, of_seeds in tests.items():
        accepted = [test.passed for test in of_seeds if test is not None]
        print(f"right load, test of {name}: accepted in {sum(accepted)} of {len(accepted)}")
    for name, wrong in WRONG.items():
        refused = [identified(seed, wrong) for seed in range(seeds)]
        for test_name, of_seeds in (
            ("known values", [each.values_test for each in refused]),
            ("the known load", [each.known_test for each in refused]),
        ):
            tests = [test for test in of_seeds if test is not None]
            rejected = sum(not test.passed for test in tests)
            print(f"wrong load, {name}, test of {test_name}: rejected in {rejected} of {len(tests)}")


if __name__ == "__main__":
    main(seeds=int(sys.argv[1]) if len(sys.argv) > 1 else 40)
