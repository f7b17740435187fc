"""How far can a load's error bars and tests be trusted? Simulated UR10e, 2.8 kg load, many seeds; about a minute.

Prints, for each load parameter, its true value, its median standard deviation and how often 95 % intervals hold the
truth; the same of the load as a body that can exist, nothing known of it, beside the unconstrained estimate of the same
figures; then how often the right load is accepted and wrong ones are rejected.
"""

from __future__ import annotations

import os
import sys
from functools import lru_cache

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from daq.recording.recording import Recording
from daq.robot.loader import load_robot
from ident.estimators.feasible.pseudo_inertia import body_of, pseudo_inertia
from ident.experiments.load.payload import Payload, identify_payload
from ident.model.dynamic_model import build_model
from ident.model.load import KnownLoad, moved_origin
from ident.model.parameters import MASS
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from sim_drivers.plant.altered_arm import with_load
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording

FIGURES = ("mass", "x", "y", "z", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")
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
    return identify_payload(*recordings(seed), known)


@lru_cache
def recordings(seed: int) -> tuple[Recording, Recording]:
    """Free and loaded."""
    robot_file = load_robot("ur10e")
    motion = random_fourier_motion(build_model(robot_file), DURATION, seed=seed, candidates=5)
    free = simulate_recording(robot_file, motion, DURATION, seed=2 * seed, rate=RATE)
    loaded = with_load(robot_file, LOAD.mass, COM, INERTIA)
    return free, simulate_recording(loaded, motion, DURATION, seed=2 * seed + 1, rate=RATE)


def bodies(seeds: int) -> list[str]:
    """Centre of mass and inertia about it, of the unconstrained load and of the one that can exist; noise alone."""
    true = np.array([LOAD.mass, *COM, *INERTIA])
    values: dict[str, list[np.ndarray]] = {"unconstrained": [], "can exist": []}
    deviations: dict[str, list[np.ndarray]] = {"unconstrained": [], "can exist": []}
    impossible, boundary, costs = 0, 0, []
    for seed in range(seeds):
        file = load_robot("ur10e")
        drives = tuple(drive.model_copy(update={"gain_std": None}) for drive in file.robot.drives)
        certain = file.model_copy(update={"robot": file.robot.model_copy(update={"drives": drives})})
        payload = identify_payload(*recordings(seed), None, certain)
        load, body = payload.consistent, body_of(payload.load.standard)
        if load is None:
            raise RuntimeError(f"no consistent load, seed {seed}")
        impossible += int(np.linalg.eigvalsh(pseudo_inertia(payload.load.standard))[0] <= 0)
        boundary += load.on_boundary
        costs.append(load.consistent_errors[1] / load.errors[1] - 1)
        to_centre = moved_origin(-body.com)
        spread = payload.load.standard_deviations(to_centre)
        for kind, one, std in (
            ("unconstrained", body, [spread[9], *spread[6:9] / body.mass, *spread[:6]]),
            ("can exist", load.body, [load.mass_std, *load.com_std, *load.inertia_std]),
        ):
            values[kind].append(np.array([one.mass, *one.com, *one.inertia[np.triu_indices(3)]]))
            deviations[kind].append(np.array(std))
    lines = [f"\nunconstrained loads that cannot exist: {impossible} of {seeds}; at the boundary: {boundary}"]
    lines.append(f"error of the loaded run's torque: {np.median(costs):+.2%} median, {max(costs):+.2%} at most")
    for kind, found in values.items():
        error = np.array(found) - true
        held = np.abs(error) <= WITHIN_95_PERCENT * np.array(deviations[kind])
        lines.append(f"{kind}: RMS error, share of 95 % intervals that hold the truth (all {held.mean():.1%})")
        for name, rms, share in zip(FIGURES, np.sqrt(np.mean(error**2, axis=0)), held.mean(axis=0), strict=True):
            lines.append(f"  {name:5} {rms:9.5f} {share:6.0%}")
    return lines


def gain_errors(seeds: int) -> list[str]:
    """The mass by robot files whose gains are wrong as their `gain_std` says, one draw a seed."""
    file, generator, lines = load_robot("ur10e"), np.random.default_rng(0), []
    relative = np.array([drive.gain_std / abs(drive.gain) for drive in file.robot.drives])
    for kind, count in (("of each joint by itself", len(relative)), ("common to all joints", 1)):
        errors, deviations = [], []
        for seed in range(seeds):
            shares = relative * generator.standard_normal(count)
            drives = tuple(
                drive.model_copy(update={"gain": drive.gain * (1 + share)})
                for drive, share in zip(file.robot.drives, shares, strict=True)
            )
            wrong = file.model_copy(update={"robot": file.robot.model_copy(update={"drives": drives})})
            load = identify_payload(*recordings(seed), None, wrong).load
            errors.append(load.standard[MASS] - LOAD.mass)
            deviations.append(load.standard_deviations(np.eye(10))[MASS])
        held = np.mean(np.abs(errors) <= WITHIN_95_PERCENT * np.array(deviations))
        lines.append(
            f"errors of the gains {kind}: mass off by {np.sqrt(np.mean(np.square(errors))):.3f} kg (RMS), σ "
            f"{np.median(deviations):.3f} kg, 95 % intervals hold the truth {held:.0%}"
        )
    return lines


def main(seeds: int = 40) -> None:
    """Print the tables."""
    results = [identified(seed, LOAD) for seed in range(seeds)]
    values = np.array([each.load.values for each in results])
    std = np.array([np.sqrt(np.diag(each.load.covariance)) for each in results])
    held = np.abs(values - LOAD.values) <= WITHIN_95_PERCENT * std
    columns = results[0].load.columns
    print(f"{'':6} {'true':>9} {'mean':>9} {'σ':>9} {'held':>6}   ({seeds} seeds; noise alone, gains as in the file)")
    for i, name in enumerate(columns.names):
        print(
            f"{name:6} {LOAD.values[i]:9.4f} {values[:, i].mean():9.4f} {np.median(std[:, i]):9.4f} "
            f"{held[:, i].mean():6.0%}   {columns.units[i]}"
        )
    print(f"all    {held.mean():36.1%}")
    print("\n".join(bodies(seeds)))
    print("\n".join(gain_errors(seeds)))
    tests = {
        "mass": [each.tests.mass for each in results],
        "known values": [each.tests.values for each in results],
        "some load": [each.tests.load for each in results],
        "the known load": [each.tests.known_load for each in results],
        "the rest unchanged": [each.tests.unchanged for each in results],
    }
    for name, of_seeds in tests.items():
        accepted = [test.passed for test in of_seeds if test is not None]
        print(f"right load, test of {name}: accepted in {sum(accepted)} of {len(accepted)}")
    for name, wrong in WRONG.items():
        refused = [identified(seed, wrong) for seed in range(seeds)]
        for test_name, of_seeds in (
            ("known values", [each.tests.values for each in refused]),
            ("the known load", [each.tests.known_load for each in refused]),
        ):
            tests = [test for test in of_seeds if test is not None]
            rejected = sum(not test.passed for test in tests)
            print(f"wrong load, {name}, test of {test_name}: rejected in {rejected} of {len(tests)}")


if __name__ == "__main__":
    main(seeds=int(sys.argv[1]) if len(sys.argv) > 1 else 40)
