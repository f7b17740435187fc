"""True values within their 95 % intervals, over simulated demonstrations: `dynid demo` without real time.

A UR5e under its controller (`Plant`: bristle friction, heat, noise and encoder of the robot file), each seed with
another motion and other noise, identified with the defaults and with `--friction coulomb-viscous`, which the arm has.
Shares are of all seeds' values; in brackets is the mean number inside of the arm's base parameters.

    python -m studies.coverage.demo_coverage [seeds [first]]
"""

from __future__ import annotations

import os
import sys

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from daq.motion.trajectories import RestToRest
from daq.recording.recording import Recording
from daq.robot.loader import RobotFile, load_robot
from ident.identify.identification import IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from ident.model.dynamic_model import build_model
from ident.model.true_parameters import truth_vector
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from sim_drivers.plant.plant import Plant
from sim_drivers.synthetic.measurement import random_fourier_motion
from studies.synthetic.controlled_run import record_plant

PERIODS = {"identification": (15.0, 2), "validation": (10.0, 1)}
"""Length of a period [s], and how many."""

RATE, RAMP = 500.0, 2.0
CANDIDATES = 20
"""Random motions of which the best conditioned one is played: the demonstration designs its own."""

CASES = {
    "default": IdentifyChoices(),
    "coulomb-viscous": IdentifyChoices(model=ModelChoices(friction="coulomb-viscous")),
}
KINDS = ("viscous", "coulomb", "offset", "bodies and motors")


def played(arm: RobotFile, part: str, seed: int) -> Recording:
    """The arm's recording of a motion from rest to rest."""
    period, periods = PERIODS[part]
    number = 2 * seed + (part == "validation")
    motion = RestToRest(random_fourier_motion(build_model(arm), period, number, CANDIDATES), periods, RAMP)
    plant = Plant(arm, seed=number, position=motion.evaluate(np.zeros(1))[0][:, 0])
    return record_plant(arm, plant, motion, RATE)


def main(seeds: int = 20, first: int = 0) -> None:
    """Print a line per case."""
    arm = load_robot("ur5e")
    names = [parameter.name for parameter in build_model(arm).parameters]
    truth = dict(zip(names, truth_vector(arm).tolist(), strict=True))
    ratios: dict[str, dict[str, list[float]]] = {case: {kind: [] for kind in KINDS} for case in CASES}
    further = dict.fromkeys(CASES, 0)
    for seed in range(first, first + seeds):
        recordings = [played(arm, part, seed) for part in PERIODS]
        for case, choices in CASES.items():
            found = identify(recordings[:1], recordings[1:], choices)
            columns = [truth.get(parameter.name, 0.0) for parameter in found.model.parameters]
            true = found.base.projection @ np.array(columns)
            plain = not (found.model.terms.shaped or found.model.terms.loaded)
            further[case] += not plain
            for place in found.solution.active:
                kind = found.base.kinds[place] if found.base.kinds[place] in KINDS else KINDS[-1]
                error = abs(float(found.solution.parameters[place] - true[place])) / float(found.std[place])
                ratios[case][kind].append(error)
        print(f"# seed {seed}", file=sys.stderr, flush=True)
    print("| | " + " | ".join(KINDS) + " | all | seeds with further friction terms |")
    print("|---" * (len(KINDS) + 3) + "|")
    for case, of_case in ratios.items():
        every = np.concatenate(list(of_case.values())) < WITHIN_95_PERCENT
        shares = [100.0 * np.mean(np.array(values) < WITHIN_95_PERCENT) for values in of_case.values()]
        cells = " | ".join(f"{share:.0f} %" for share in shares)
        print(f"| {case} | {cells} | {100 * every.mean():.1f} % ({every.sum() / seeds:.1f}) | {further[case]} |")


if __name__ == "__main__":
    main(*(int(argument) for argument in sys.argv[1:3]))
