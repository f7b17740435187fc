"""How much of each velocity reversal to leave out: coverage and held-out error, on simulated and on recorded arms.

Simulated arms under their own controllers, with friction before sliding, noise and ripple, once with the friction of
their files and once with a Stribeck term of 0.3 of Coulomb friction, play d-optimal excitations (15 s, two periods) and
are judged on a motion of another criterion and seed. Prints, for each share of `--reversals`, the part of the
95 % intervals that contain the true value, and the held-out error (root mean square over the recordings). Then the
held-out errors of the public recordings in the folder `DYNID_DATA`, of all samples and of those above 0.1 rad/s: first
70 % identified, last 30 % compared. `python -m studies.coverage.reversals 12`: 12 recordings per arm and friction.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import yaml

from daq.importers.choices import ImportChoices
from daq.importers.import_file import import_file
from daq.motion.trajectories import Motion
from daq.recording.recording import Recording
from daq.robot.loader import RobotFile, load_robot, parse_robot
from ident.assessment.validation import LOW_SPEED
from ident.excite.choices import DesignChoices
from ident.excite.design import design
from ident.excite.prior import find_prior
from ident.excite.search.search import SearchChoices
from ident.identify.identification import Identification, IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.true_parameters import truth_vector
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.signals.options import PreprocessChoices
from sim_drivers.plant.plant import Plant
from studies.synthetic.controlled_run import record_plant

ROBOTS = ("ur5e", "panda")
MOTIONS = 3
RATE = 500.0
SHARES = (0.0, 0.02, 0.05, 0.1, 0.2)
STRIBECK = 0.3
STRIBECK_VELOCITY = 0.1

PUBLIC = {
    "ur10": ("ur10_unisa1.npz", "shoulder_pan shoulder_lift elbow wrist_1 wrist_2 wrist_3", "{}_joint", True),
    "panda": ("panda_gaz1.npz", "1 2 3 4 5 6 7", "joint_{}", False),
}
"""Recording, joints, and whether the torque is that of motors, whose inertia it shows."""
TX40_MOVES = 7.45
"""The TX40 rests after this time [s]."""


def with_stribeck(robot_file: RobotFile) -> RobotFile:
    """The arm with more friction at low speed."""
    robot = yaml.safe_load(robot_file.text)
    for joint in robot["truth"]["joints"].values():
        joint |= {"stribeck": STRIBECK * joint["coulomb"], "stribeck_velocity": STRIBECK_VELOCITY}
    return parse_robot(yaml.safe_dump(robot), where=robot["name"], folder=None)


def controlled(robot_file: RobotFile, motion: Motion, seed: int) -> Recording:
    """Sensor values of an arm that a controller moves."""
    start = motion.evaluate(np.zeros(1))[0][:, 0]
    return record_plant(robot_file, Plant(robot_file, seed=seed, position=start), motion, RATE)


def motions(robot_file: RobotFile) -> tuple[list[Motion], Motion]:
    """Excitations, and one by another criterion to validate with."""
    prior = find_prior(robot_file)
    excitation = DesignChoices(period=15.0, periods=2, ramp=2.0, margin=0.2)
    other = replace(excitation, criterion="condition", periods=1)
    designs = [
        design(robot_file, prior, choices, SearchChoices(seed=seed, starts=1, workers=1)).motion
        for seed, choices in enumerate([excitation] * MOTIONS + [other], start=1)
    ]
    return designs[:-1], designs[-1]


PLAIN = IdentifyChoices(model=ModelChoices(friction="coulomb-viscous"), presliding=False)


def cells(robot_file: RobotFile, pairs: Sequence[tuple[Recording, Recording]], share: float) -> list[str]:
    """Identify each recording and validate it with its partner: share of intervals that hold, and held-out error."""
    base = base_parameters(build_model(robot_file))
    truth = base.projection @ truth_vector(robot_file)
    inside, errors = [], []
    for recording, other in pairs:
        found = identify([recording], [other], replace(PLAIN, reversals=share))
        inside.append(np.abs(found.solution.parameters - truth) <= WITHIN_95_PERCENT * found.std)
        errors.append(held_out_errors(found)[0])
    return [f"{100.0 * np.mean(inside):.1f} %", f"{100.0 * np.sqrt(np.mean(np.square(errors))):.2f} %"]


def held_out_errors(identification: Identification) -> tuple[float, float]:
    """Relative error of the held-out torques, and of those of joints above `LOW_SPEED`."""
    series = identification.validation_series
    measured = np.concatenate([segment.measured for segment in series], axis=1)
    residual = np.concatenate([segment.residual for segment in series], axis=1)
    counted = np.concatenate([segment.counted for segment in series], axis=1)
    fast = counted & (np.abs(np.concatenate([segment.velocity for segment in series], axis=1)) >= LOW_SPEED)
    every, of_fast = (float(np.linalg.norm(residual[m]) / np.linalg.norm(measured[m])) for m in (counted, fast))
    return every, of_fast


def public_recordings(folder: Path) -> dict[str, tuple[Recording, PreprocessChoices]]:
    """The recordings of `shared/data`, with the window in which the arm moves."""
    recordings = {}
    for name, (file, joints, pattern, motors) in PUBLIC.items():
        names = [pattern.format(joint) for joint in joints.split()]
        limits = "\n".join(f"  - {{name: {joint}, position: [-6.2832, 6.2832], velocity: 6}}" for joint in names)
        drives = "\n".join(f"  - {{joint: {joint}, signal: torque, inertia: {str(motors).lower()}}}" for joint in names)
        text = f"name: {name}\nmodel: {{urdf: {name}.urdf}}\njoints:\n{limits}\ndrives:\n{drives}\n"
        robot_file = parse_robot(text, where=name, folder=folder)
        recordings[name] = import_file(folder / file, robot_file, ImportChoices()), PreprocessChoices()
    text = (Path(__file__).parents[2] / "examples" / "tx40.yaml").read_text(encoding="utf-8")
    tx40 = import_file(folder / "tx40_t1.npz", parse_robot(text, where="tx40", folder=folder), ImportChoices())
    recordings["tx40"] = tx40, PreprocessChoices(stop=TX40_MOVES)
    return recordings


def print_table(heads: Sequence[str], columns: Sequence[Sequence[Sequence[str]]]) -> None:
    """A row per share; columns hold two cells for each of them."""
    print(f"\n| left out below | {' | '.join(heads)} |\n|{'---|' * (1 + len(heads))}")
    for row, share in enumerate(SHARES):
        print(f"| {share:g} | {' | '.join(cell for column in columns for cell in column[row])} |", flush=True)


def main(seeds: int = 12) -> None:
    """Print a table of simulated arms and one of recordings."""
    heads, columns = [], []
    for robot in ROBOTS:
        plain = load_robot(robot)
        excitations, validation = motions(plain)
        for name, arm in ((robot, plain), (f"{robot}, Stribeck", with_stribeck(plain))):
            pairs = [
                (controlled(arm, excitations[seed % MOTIONS], seed), controlled(arm, validation, seeds + seed))
                for seed in range(seeds)
            ]
            heads += [f"{name}: intervals", "error"]
            columns.append([cells(plain, pairs, share) for share in SHARES])
    print_table(heads, columns)
    folder = Path(os.environ.get("DYNID_DATA", "../shared/data"))
    if not folder.is_dir():
        print(f"\nno public recordings: {folder} is no folder")
        return
    heads, columns = [], []
    for name, (recording, preprocess) in public_recordings(folder).items():
        heads += [name, "fast"]
        choices = [replace(PLAIN, preprocess=preprocess, reversals=share) for share in SHARES]
        found = [held_out_errors(identify([recording], [], choice)) for choice in choices]
        columns.append([[f"{error:.2%}".replace("%", " %") for error in errors] for errors in found])
    print_table(heads, columns)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 12)
