"""Why a controlled arm's intervals hold the truth too seldom, and what helps: reversals of the joints.

A UR5e under its own controller, with friction before sliding, noise and ripple, plays a d-optimal excitation: two
periods of 15 s. Prints, over all base parameters and seeds, the share of 95 % intervals that hold the truth, the root
mean square of error over standard deviation, and the parameters that are off the most on average: with equations left
out (`--leave-out-reversals`) and kept, and for an arm that follows the motion exactly. `python studies/reversals.py
12` takes some minutes.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from daq.motion.trajectories import Motion
from daq.recording.recording import JOINTS_STREAM, Channel, Recording, Stream
from daq.robot.loader import RobotFile, load_robot
from ident.excite.choices import DesignChoices
from ident.excite.design import design
from ident.excite.prior import find_prior
from ident.excite.search.search import SearchChoices
from ident.identify.identification import IdentifyChoices
from ident.identify.identify import identify
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.true_parameters import truth_vector
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from sim_drivers.plant.plant import Plant
from sim_drivers.synthetic.measurement import simulate_recording

ROBOT = "ur5e"
RATE = 500.0
SHARES = (0.0, 0.05, 0.1, 0.2)
SHOWN = 4


def controlled(robot_file: RobotFile, motion: Motion, seed: int) -> Recording:
    """What the sensors of an arm say that a controller moves."""
    count = round(motion.duration * RATE)
    position, velocity, acceleration = motion.evaluate(np.arange(count) / RATE)
    plant = Plant(robot_file, seed=seed, position=position[:, 0])
    samples = []
    for q, v, a in zip(position.T, velocity.T, acceleration.T, strict=True):
        plant.set_target(q, v, a)
        plant.advance(1.0 / RATE)
        samples.append(plant.measure())
    stamps = np.array([sample.time for sample in samples])
    names = robot_file.robot.joint_names
    channels = {
        "position": Channel("position", np.array([sample.position for sample in samples]), "rad", names),
        "current": Channel("current", np.array([sample.current for sample in samples]), "A", names),
    }
    return Recording(robot_file.text, {JOINTS_STREAM: Stream(JOINTS_STREAM, stamps, stamps, channels)})


def line(robot_file: RobotFile, recordings: Sequence[Recording], share: float) -> str:
    """Identify each recording; the figures over all of them."""
    base = base_parameters(build_model(robot_file))
    truth = base.projection @ truth_vector(robot_file)
    off, deviations = [], []
    for recording in recordings:
        found = identify([recording], [], IdentifyChoices(reversals=share))
        off.append((found.solution.parameters - truth) / found.std)
        deviations.append(found.std)
    ratio, mean = np.array(off), np.mean(off, axis=0)
    worst = ", ".join(f"{base.names[i]} {mean[i]:+.1f}" for i in np.argsort(-np.abs(mean))[:SHOWN])
    inside = np.mean(np.abs(ratio) <= WITHIN_95_PERCENT)
    rms = np.sqrt(np.mean(ratio**2))
    return f"{inside:8.1%} {rms:12.2f} {np.median(deviations):14.3g}   {worst}"


def main(seeds: int = 12) -> None:
    """Print a line for each case."""
    robot_file = load_robot(ROBOT)
    choices = DesignChoices(period=15.0, periods=2, ramp=2.0, margin=0.2)
    found = design(robot_file, find_prior(robot_file), choices, SearchChoices(seed=1, starts=1, workers=1))
    motion = found.family.trajectory(found.variables, robot_file.robot.name, "").motion()
    print(f"{'left out below':28} {'inside':>8} {'rms error/σ':>12} {'median σ':>14}   mean error/σ, the largest")
    recordings = [controlled(robot_file, motion, seed) for seed in range(seeds)]
    for share in SHARES:
        print(f"{f'{share:g} of the rms velocity':28} {line(robot_file, recordings, share)}", flush=True)
    exact = [simulate_recording(robot_file, motion, motion.duration, seed) for seed in range(seeds)]
    print(f"{'nothing, motion exact':28} {line(robot_file, exact, 0.0)}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 12)
