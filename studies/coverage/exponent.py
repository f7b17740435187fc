"""Friction |q̇|^α within its 95 % intervals on two arms: a table of docs/measurements/error-bars.md.

    python -m studies.coverage.exponent [seeds [arms, as ur5e,rocr6]]

Built-in arms under their controllers, with exponents of 0.65 to 0.8 in place of 1; another motion of 24 s and other
noise for each seed, recorded at 200 Hz and identified with `coulomb-viscous+power`. Another motion validates.
"""

from __future__ import annotations

import os
import sys

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import yaml

from daq.motion.trajectories import RestToRest
from daq.recording.recording import Recording
from daq.robot.loader import RobotFile, load_robot, parse_robot
from ident.identify.identification import IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from ident.model.dynamic_model import build_model
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from sim_drivers.plant.plant import Plant
from sim_drivers.synthetic.measurement import random_fourier_motion
from studies.papers.aubo_coverage import Errors, found_errors
from studies.synthetic.controlled_run import record_plant

ALPHA = (0.8, 0.7, 0.75, 0.65, 0.75, 0.7)
KINDS = ("coulomb", "viscous", "exponent", "bodies")
PERIOD, RAMP, RATE = 20.0, 2.0, 200.0
"""[s], [s], [Hz]."""


def arm(name: str) -> RobotFile:
    """A built-in arm with friction that is not linear in the velocity."""
    robot = yaml.safe_load(load_robot(name).text)
    for joint, alpha in zip(robot["truth"]["joints"].values(), ALPHA, strict=True):
        joint["alpha"] = alpha
    return parse_robot(yaml.safe_dump(robot), where=name, folder=None)


def recorded(robot_file: RobotFile, seed: int) -> Recording:
    """What the arm's sensors say of a motion."""
    motion = RestToRest(random_fourier_motion(build_model(robot_file), PERIOD, 500 + seed, 10), 1, RAMP)
    plant = Plant(robot_file, seed=seed, position=motion.evaluate(np.zeros(1))[0][:, 0])
    return record_plant(robot_file, plant, motion, RATE)


def main(seeds: int = 8, arms: str = "ur5e,rocr6") -> None:
    """Print a row for each arm."""
    print(f"| arm | {' | '.join(KINDS)} |\n|---|{'---|' * len(KINDS)}")
    choices = IdentifyChoices(model=ModelChoices(friction="coulomb-viscous+power"), search_delay=False)
    for name in arms.split(","):
        robot_file, errors = arm(name), list[Errors]()
        held_out = recorded(robot_file, 99)
        for seed in range(seeds):
            errors.append(found_errors(identify([recorded(robot_file, seed)], [held_out], choices)))
        shares = []
        for kind in KINDS:
            values = np.array([value for one in errors for (of, _), value in one.items() if of == kind])
            shares.append(100.0 * np.mean(np.abs(values[:, 0]) <= WITHIN_95_PERCENT * values[:, 1]))
        print(f"| {name} | {' | '.join(f'{share:.0f} %' for share in shares)} |", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 8, *sys.argv[2:3])
