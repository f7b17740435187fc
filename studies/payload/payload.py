"""How far can a load's error bars and tests be trusted? Simulated UR10e, 2.8 kg load, many seeds; about a minute.

Prints, for each load parameter, its true value, its median standard deviation and how often 95 % intervals hold the
truth; the same of the load as a body that can exist, nothing known of it, beside the unconstrained estimate of the same
figures; the mass by drive gains that are off as their `gain_std` says, each by itself or all alike; then how often the
right load is accepted and wrong ones are rejected.
"""

from __future__ import annotations

import os
import sys
from functools import cache

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from daq.recording.recording import Recording
from daq.robot.loader import load_robot
from ident.estimators.feasible.pseudo_inertia import body_of, pseudo_inertia
from ident.experiments.load.load_estimate import LoadEstimate, estimate_load, identify_separately
from ident.experiments.load.payload import Payload, identify_payload
from ident.experiments.run_pair import RunPair, prepare_pair
from ident.model.dynamic_model import build_model
from ident.model.load import KnownLoad, load_effect, moved_origin
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT, SignificanceTest
from ident.regression.systematic_errors import relative_gain_std
from ident.signals.joint_signals import read_joint_signals
from sim_drivers.plant.altered_arm import with_load
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording
from studies.synthetic.altered_arms import with_gains

FIGURES = {
    "mass [kg]": [0],
    "centre of mass, worst axis [m]": [1, 2, 3],
    "Ixx, Iyy, Izz, largest [kg·m²]": [4, 7, 9],
    "Ixy, Ixz, Iyz, largest [kg·m²]": [5, 6, 8],
}
"""Rows of the table of bodies, and their places in mass, centre and inertia."""
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


@cache
def recordings(seed: int) -> tuple[Recording, Recording]:
    """Free and loaded."""
    robot_file = load_robot("ur10e")
    motion = random_fourier_motion(build_model(robot_file), DURATION, seed=seed, candidates=5)
    free = simulate_recording(robot_file, motion, DURATION, seed=2 * seed, rate=RATE)
    loaded = with_load(robot_file, LOAD.mass, COM, INERTIA)
    return free, simulate_recording(loaded, motion, DURATION, seed=2 * seed + 1, rate=RATE)


def unconstrained_load(pair: RunPair) -> LoadEstimate:
    """The load with its covariances, nothing known of it."""
    separate, grams = identify_separately(pair)
    effect = load_effect(pair.model, pair.base, pair.robot_file.robot)
    return estimate_load(pair, grams, effect, separate.weights, None)


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
        unconstrained = unconstrained_load(prepare_pair(*recordings(seed), read_joint_signals, certain))
        load, body = payload.consistent_load, body_of(unconstrained.standard)
        if load is None:
            raise RuntimeError(f"no consistent load, seed {seed}")
        impossible += int(np.linalg.eigvalsh(pseudo_inertia(unconstrained.standard))[0] <= 0)
        boundary += load.on_boundary
        costs.append(load.errors[1].consistent / load.errors[1].unconstrained - 1)
        spread = unconstrained.standard_deviations(moved_origin(-np.array(body.com)))
        for kind, of, std in (
            ("unconstrained", body, [spread[9], *spread[6:9] / body.mass, *spread[:6]]),
            ("can exist", load, [load.mass_std, *load.com_std, *load.inertia_std.values()]),
        ):
            values[kind].append(np.array([of.mass, *of.com, *of.inertia.values()]))
            deviations[kind].append(np.array(std))
    lines = [f"\nunconstrained loads that cannot exist: {impossible} of {seeds}; at the boundary: {boundary}"]
    lines.append(f"error of the loaded run's torque: {np.median(costs):+.2%} median, {max(costs):+.2%} at most")
    errors = {kind: np.array(found) - true for kind, found in values.items()}
    rms = [np.sqrt(np.mean(error**2, axis=0)) for error in errors.values()]
    held = [np.abs(error) <= WITHIN_95_PERCENT * np.array(deviations[kind]) for kind, error in errors.items()]
    lines.append(
        "\n| | RMS error, unconstrained | consistent | 95 % intervals that hold the truth, unconstrained | consistent |"
        "\n|---|---|---|---|---|"
    )
    for name, places in FIGURES.items():
        shares = [np.unique([f"{100 * part.mean():.0f}" for part in each[:, places].T]) for each in held]
        texts = [" to ".join(sorted({min(one, key=int), max(one, key=int)}, key=int)) + " %" for one in shares]
        lines.append(f"| {name} | {' | '.join([*(f'{each[places].max():.2g}' for each in rms), *texts])} |")
    lines.append(f"| all ten | | | {' | '.join(f'{100 * each.mean():.1f} %' for each in held)} |")
    return lines


def gain_errors(seeds: int) -> list[str]:
    """The mass by robot files whose gains are wrong as their `gain_std` says, one draw a seed."""
    file, generator = load_robot("ur10e"), np.random.default_rng(0)
    names = file.robot.joint_names
    relative = relative_gain_std(file.robot, names)
    lines = [
        "\n| errors of the gains | load | mass off by, RMS [kg] | its σ, median [kg] | 95 % intervals that hold it |"
    ]
    lines.append("|---|---|---|---|---|")
    for kind, count in (("of each joint by itself", len(relative)), ("common to all joints", 1)):
        found: dict[str, list[tuple[float, float]]] = {"unconstrained": [], "consistent": []}
        for seed in range(seeds):
            factors = 1.0 + relative * generator.standard_normal(count)
            wrong = with_gains(file, dict(zip(names, factors.tolist(), strict=True)))
            payload = identify_payload(*recordings(seed), None, wrong)
            body = payload.consistent_load
            if body is None or payload.mass is None:
                raise RuntimeError(f"no load, seed {seed}")
            found["unconstrained"].append((payload.mass.value, payload.mass.std))
            found["consistent"].append((body.mass, body.mass_std))
        for load_kind, values in found.items():
            error, sigma = np.array(values).T - [[LOAD.mass], [0.0]]
            held = np.mean(np.abs(error) <= WITHIN_95_PERCENT * sigma)
            figures = f"{np.sqrt(np.mean(error**2)):.3f} | {np.median(sigma):.3f} | {100 * held:.0f} %"
            lines.append(f"| {kind} | {load_kind} | {figures} |")
    return lines


def main(seeds: int = 40) -> None:
    """Print the tables."""
    results = [identified(seed, LOAD) for seed in range(seeds)]
    values, std = (
        np.array([[getattr(row, field) for row in each.load] for each in results]) for field in ("value", "noise_std")
    )
    held = np.abs(values - LOAD.values) <= WITHIN_95_PERCENT * std
    print(f"{'':6} {'true':>9} {'mean':>9} {'σ':>9} {'held':>6}   ({seeds} seeds; noise alone, gains as in the file)")
    for i, row in enumerate(results[0].load):
        print(
            f"{row.name:6} {LOAD.values[i]:9.4f} {values[:, i].mean():9.4f} {np.median(std[:, i]):9.4f} "
            f"{held[:, i].mean():6.0%}   {row.unit}"
        )
    print(f"all    {held.mean():36.1%}")
    print("\n".join(bodies(seeds)))
    print("\n".join(gain_errors(seeds)))
    tests: dict[str, list[SignificanceTest | None]] = {
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
            made = [test for test in of_seeds if test is not None]
            rejected = sum(not test.passed for test in made)
            print(f"wrong load, {name}, test of {test_name}: rejected in {rejected} of {len(made)}")


if __name__ == "__main__":
    main(seeds=int(sys.argv[1]) if len(sys.argv) > 1 else 40)
