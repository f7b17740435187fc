"""What presliding is worth near velocity reversals (docs/measurements/friction.md).

    python -m studies.friction.presliding [NAME…]

Held-out error [%] below 0.1 rad/s and of all samples, without and with presliding, and the travels found: public
recordings (their folder in DYNID_DATA), and `plant`, a simulated UR5e on the bristles of its plant, which break away
after a known travel. A few minutes.
"""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import yaml

from daq.recording.recording import Recording
from daq.robot.loader import RobotFile, load_robot, parse_robot
from ident.identify.identification import Identification, IdentifyChoices
from ident.identify.identify import identify
from ident.identify.preparation import compare_run
from ident.model.dynamic_model import build_model
from ident.model.regressor import RegressorKernel
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from sim_drivers.plant.plant import Plant
from sim_drivers.synthetic.measurement import random_fourier_motion
from studies.friction.friction_models import choices_of, errors
from studies.models.consistency import public
from studies.synthetic.controlled_run import record_plant

FRICTION = ("coulomb-viscous", "coulomb-viscous+power", "coulomb-viscous+power+stribeck+load", "auto")
PLANT_TRAVELS = (5e-5, 5e-4, 2e-3, 5e-3)
"""Travels of the simulated bristles [rad]; the first is that of the robot file."""
RATE = 500.0
PERIOD = 20.0


def line(name: str, found: Identification) -> str:
    """The table's row."""
    presliding = found.presliding
    assert presliding is not None
    static = RegressorKernel(replace(found.model, presliding=()), found.base.columns)
    series = [part for run in found.validation_runs for part in compare_run(static, found.solution.parameters, run)]
    (whole, _, slow), (whole_with, _, slow_with) = (
        errors(replace(found, validation_series=tuple(series))),
        errors(found),
    )
    texts = [
        f"{one.parameter} {1e3 * one.travel:.3g} ± {1e3 * WITHIN_95_PERCENT * one.std:.1g}"
        for one in presliding.travels
    ]
    return f"| {name} | {slow:.2f} → {slow_with:.2f} | {whole:.2f} → {whole_with:.2f} | {', '.join(texts)} |"


def arm_on_bristles(travel: float) -> RobotFile:
    """A UR5e whose bristles break away after this travel [rad]."""
    robot = yaml.safe_load(load_robot("ur5e").text)
    for joint in robot["truth"]["joints"].values():
        joint["pre_sliding"] = travel
    return parse_robot(yaml.safe_dump(robot), where="ur5e", folder=None)


def controlled(robot_file: RobotFile, seed: int) -> tuple[Recording, Plant]:
    """A motion of the arm under its controller."""
    motion = random_fourier_motion(build_model(robot_file), PERIOD, seed)
    plant = Plant(robot_file, seed=seed, position=motion.evaluate(np.zeros(1))[0][:, 0])
    return record_plant(robot_file, plant, motion, RATE), plant


def main(names: list[str]) -> None:
    """Print the table."""
    print("| | below 0.1 rad/s | all | travels [10⁻³ rad] |\n|---|---|---|---|")
    notes: list[str] = []
    folder = Path(os.environ.get("DYNID_DATA", "../shared/data"))
    for name in names or ["ur10", "panda", "tx40", "plant"]:
        if name == "plant":
            for travel in PLANT_TRAVELS:
                robot_file = arm_on_bristles(travel)
                (run, plant), (other, _) = (controlled(robot_file, seed) for seed in (1, 2))
                joints = robot_file.robot.truth.joints.values()
                actual = np.array([joint.coulomb + joint.stribeck for joint in joints]) / plant._friction._stiffness
                name_of = f"UR5e, bristle of {1e3 * travel:g} mrad"
                print(line(name_of, identify([run], [other], IdentifyChoices())), flush=True)
                notes.append(f"{name_of}: breaks away after {np.array2string(1e3 * actual, precision=3)} mrad")
            continue
        recording, choices = public(folder, name)
        for friction in FRICTION:
            found = identify([recording], [], choices_of(choices, friction))
            print(line(f"{name}, `{friction}`", found), flush=True)
    print("", *notes, sep="\n")


if __name__ == "__main__":
    main(sys.argv[1:])
