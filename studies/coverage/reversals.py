"""How much of each velocity reversal to leave out: coverage and held-out error, on simulated and on recorded arms.

Simulated arms under their own controllers, with friction before sliding, noise and ripple, once with the friction of
their files and once with a Stribeck term of 0.3 of Coulomb friction, play d-optimal excitations (15 s, two periods) and
are judged on a motion of another criterion and seed. Prints, for each share of `--reversals`, the part of the
95 % intervals that contain the true value, over all base parameters and over those without friction, the RMS of error
over σ, the median σ, and the held-out error (root mean square over the recordings), of all samples and of those above
0.1 rad/s. Then the held-out errors of the public recordings in the folder `DYNID_DATA`: first 70 % identified, last
30 % compared. `python -m studies.coverage.reversals 12`: 12 recordings per arm and friction, some minutes.
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
FRICTION = ("viscous", "coulomb", "offset", "coupling")

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


def line(robot_file: RobotFile, pairs: Sequence[tuple[Recording, Recording]], share: float) -> str:
    """Identify each recording and validate it with its partner; the figures over all of them."""
    base = base_parameters(build_model(robot_file))
    truth = base.projection @ truth_vector(robot_file)
    off, deviations, errors = [], [], []
    for recording, other in pairs:
        identification = identify([recording], [other], replace(PLAIN, reversals=share))
        off.append((identification.solution.parameters - truth) / identification.std)
        deviations.append(identification.std)
        errors.append(held_out_errors(identification))
    ratio, mean = np.array(off), np.mean(off, axis=0)
    inside = np.abs(ratio) <= WITHIN_95_PERCENT
    rigid = [i for i in range(base.count) if base.kinds[i] not in FRICTION]
    worst = ", ".join(f"{base.names[i]} {mean[i]:+.1f}" for i in np.argsort(-np.abs(mean))[:2])
    return (
        f"{inside.mean():8.1%} {inside[:, rigid].mean():8.1%} {np.sqrt(np.mean(ratio**2)):8.2f} "
        f"{np.median(deviations):9.3g} {percent(np.sqrt(np.mean(np.square(errors), axis=0)))}   {worst}"
    )


def percent(errors: Sequence[float]) -> str:
    """Held-out errors of all and of fast samples."""
    return " ".join(f"{error:8.2%}" for error in errors)


def held_out_errors(identification: Identification) -> tuple[float, float]:
    """Relative error of the held-out torques, and of those of joints above `LOW_SPEED`."""
    series = identification.validation_series
    measured = np.concatenate([segment.measured for segment in series], axis=1)
    residual = np.concatenate([segment.residual for segment in series], axis=1)
    counted = np.concatenate([segment.counted for segment in series], axis=1)
    fast = counted & (np.abs(np.concatenate([segment.velocity for segment in series], axis=1)) >= LOW_SPEED)
    return tuple(float(np.linalg.norm(residual[mask]) / np.linalg.norm(measured[mask])) for mask in (counted, fast))


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


def main(seeds: int = 12) -> None:
    """Print a line for each case."""
    head = f"{'left out':>9} {'held':>8} {'rigid':>8} {'rms e/σ':>8} {'median σ':>9} {'held out':>8} {'fast':>8}"
    for robot in ROBOTS:
        plain = load_robot(robot)
        excitations, validation = motions(plain)
        for name, arm in (("friction of the file", plain), ("with Stribeck friction", with_stribeck(plain))):
            print(f"\n{robot}, {name}, {seeds} recordings\n{head}   mean error/σ, the largest", flush=True)
            pairs = [
                (controlled(arm, excitations[seed % MOTIONS], seed), controlled(arm, validation, seeds + seed))
                for seed in range(seeds)
            ]
            for share in SHARES:
                print(f"{share:9g} {line(plain, pairs, share)}", flush=True)
    folder = Path(os.environ.get("DYNID_DATA", "../shared/data"))
    if not folder.is_dir():
        print(f"\nno public recordings: {folder} is no folder")
        return
    for name, (recording, preprocess) in public_recordings(folder).items():
        print(f"\n{name}\n{'left out':>9} {'held out':>8} {'fast':>8}")
        for share in SHARES:
            identification = identify([recording], [], replace(PLAIN, preprocess=preprocess, reversals=share))
            print(f"{share:9g} {percent(held_out_errors(identification))}", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 12)
