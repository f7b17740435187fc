"""True values within their 95 % intervals, over simulated demonstrations: `dynid demo` without real time.

Arms under their controllers (`Plant`: bristle friction, heat, noise and encoders of the robot file), each seed with
another motion and other noise, identified with the defaults but for the method. Shares are of all seeds' values; in
brackets is the mean number inside and that of the arm's base parameters. About 15 s of CPU per arm and seed.

    python -m studies.coverage.demo_coverage [seeds [arms, as ur5e,panda [methods, as wls,iirls]]]
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from daq.motion.trajectories import RestToRest
from daq.recording.recording import Recording
from daq.robot.loader import RobotFile, load_robot
from ident.identify.identification import Identification, IdentifyChoices
from ident.identify.identify import identify
from ident.model.dynamic_model import build_model
from ident.model.true_parameters import truth_vector
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from sim_drivers.plant.plant import Plant
from sim_drivers.synthetic.measurement import random_fourier_motion
from studies.coverage.seeds import of_cases
from studies.synthetic.controlled_run import record_plant

PERIODS = {"identification": (15.0, 2), "validation": (10.0, 1)}
"""Length of a period [s], and how many."""

RATE, RAMP = 500.0, 2.0
CANDIDATES = 20
"""Random motions of which the best conditioned one is played: the demonstration designs its own."""

KINDS = ("viscous", "coulomb", "offset", "bodies and motors")


def played(arm: RobotFile, part: str, seed: int) -> Recording:
    """The arm's recording of a motion from rest to rest."""
    period, periods = PERIODS[part]
    number = 2 * seed + (part == "validation")
    motion = RestToRest(random_fourier_motion(build_model(arm), period, number, CANDIDATES), periods, RAMP)
    plant = Plant(arm, seed=number, position=motion.evaluate(np.zeros(1))[0][:, 0])
    return record_plant(arm, plant, motion, RATE)


def errors_of(found: Identification) -> list[tuple[str, str, float, float]]:
    """Kind, name, error and σ of each base parameter that was estimated."""
    names = [parameter.name for parameter in build_model(found.robot_file).parameters]
    truth = dict(zip(names, truth_vector(found.robot_file).tolist(), strict=True))
    columns = [truth.get(parameter.name, 0.0) for parameter in found.model.parameters]
    error = found.solution.parameters - found.base.projection @ np.array(columns)
    return [
        (
            found.base.kinds[place] if found.base.kinds[place] in KINDS else KINDS[-1],
            found.base.names[place],
            float(error[place]),
            float(found.std[place]),
        )
        for place in found.solution.active
    ]


def of_seed(name: str, methods: Sequence[str], seed: int) -> dict[str, tuple[bool, list[tuple[str, float]]]]:
    """By method whether there are further friction terms, and kind and |error| over σ of the base parameters."""
    recordings = [played(load_robot(name), part, seed) for part in PERIODS]
    print(f"# {name}, seed {seed}", file=sys.stderr, flush=True)
    models = {method: identify(recordings[:1], recordings[1:], IdentifyChoices(method)) for method in methods}
    return {
        method: (
            bool(found.model.terms.shaped or found.model.terms.loaded),
            [(kind, abs(error) / sigma) for kind, _, error, sigma in errors_of(found)],
        )
        for method, found in models.items()
    }


def main(seeds: int = 20, arms: str = "ur5e,panda,rocr6", methods: str = "wls,iirls") -> None:
    """Print a line per arm and method."""
    print("| arm, method | " + " | ".join(KINDS) + " | all | seeds with further friction terms |")
    print("|---" * (len(KINDS) + 3) + "|")
    for name in arms.split(","):
        ratios: dict[str, list[tuple[str, float]]] = {method: [] for method in methods.split(",")}
        further = dict.fromkeys(ratios, 0)
        for outcome in of_cases(of_seed, [(name, tuple(ratios), seed) for seed in range(seeds)]):
            for method, (more, values) in outcome.items():
                further[method] += more
                ratios[method] += values
        for method, values in ratios.items():
            inside = np.array([ratio < WITHIN_95_PERCENT for _, ratio in values])
            kinds = np.array([kind for kind, _ in values])
            cells = " | ".join(f"{100 * inside[kinds == kind].mean():.0f} %" for kind in KINDS)
            share = f"{100 * inside.mean():.1f} % ({inside.sum() / seeds:.1f} of {len(values) / seeds:.1f})"
            print(f"| {name}, `{method}` | {cells} | {share} | {further[method]} |", flush=True)


if __name__ == "__main__":
    main(*(int(word) if word.isdigit() else word for word in sys.argv[1:]))  # type: ignore[arg-type]
