"""An arm with a four-bar linkage, from its robot file to its parameters: `python -m studies.models.four_bar 30`.

Prints how exactly the loop closes over the whole range of the crank, what that costs, and what identifications find on
30 s of a motion designed for this arm, against the truth: followed exactly, torques with white noise, four times; and
once played by the simulated arm under its own controller, with its sensors.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from daq.motion.trajectories import Motion, RestToRest
from daq.recording.recording import JOINTS_STREAM, Channel, Recording, Stream
from daq.robot.loader import RobotFile, load_robot
from ident.excite.choices import DesignChoices
from ident.excite.design import design
from ident.excite.prior import find_prior
from ident.excite.search.search import SearchChoices
from ident.identify.identification import Identification, IdentifyChoices
from ident.identify.identify import identify
from ident.model.base_parameters import base_parameters, random_states
from ident.model.dynamic_model import build_model
from ident.model.kinematics.loops import loop_ends, place_tree
from ident.model.regressor import RegressorKernel
from ident.model.true_parameters import truth_vector
from sim_drivers.plant.plant import Plant
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording

ARM = Path(__file__).parents[2] / "examples" / "four_bar.yaml"
RATE = 500.0
SAMPLES = 4096


def closing_error(robot_file: RobotFile) -> float:
    """Largest distance [m] between the closing frames over the limits, placed by the tree's kinematics."""
    model = build_model(robot_file)
    joint_index = {name: joint for joint, name in enumerate(model.link_names)}
    largest = 0.0
    for tree in model.tree_position(random_states(model, 1000, seed=1)[0]).T:
        frames = place_tree(model.joints, tree)
        one, other = (
            frames[joint][1] + frames[joint][0] @ end[1]
            for joint, end in loop_ends(robot_file.robot.model.loops[0], joint_index)
        )
        largest = max(largest, float(np.linalg.norm(one - other)))
    return largest


def print_costs(robot_file: RobotFile) -> None:
    """Processor time of the tree's motion and of the base regressor a sample, and of the simulation a second."""
    model = build_model(robot_file)
    motion = random_states(model, SAMPLES, seed=2)
    kernel = RegressorKernel(model, base_parameters(model).columns)
    packed = np.empty((kernel.row_count, SAMPLES))

    def least(work: Callable[[], object], repeat: int = 5) -> float:
        spans = []
        for _ in range(repeat):
            begun = time.process_time()
            work()
            spans.append(time.process_time() - begun)
        return min(spans)

    solving = least(lambda: model.tree_motion(*motion))
    whole = least(lambda: kernel.evaluate(*motion, packed))
    print(f"base regressor: {1e6 * whole / SAMPLES:.1f} µs a sample, {1e6 * solving / SAMPLES:.1f} of it for the loop")
    plant = Plant(robot_file)
    print(f"simulation: {least(lambda: plant.advance(1.0), 2):.2f} s of processor time a second")


def played(robot_file: RobotFile, motion: Motion, seed: int) -> Recording:
    """The simulated arm's sensor values while its controller follows a motion that begins at rest."""
    stamps = np.arange(round(motion.duration * RATE)) / RATE
    targets = [values.T for values in motion.evaluate(stamps)]
    plant = Plant(robot_file, seed=seed, position=targets[0][0])
    measured = []
    for position, velocity, acceleration in zip(*targets, strict=True):
        plant.set_target(position, velocity, acceleration)
        plant.advance(1.0 / RATE)
        measured.append(plant.measure())
    names = robot_file.robot.joint_names
    channels = {
        "position": Channel("position", np.array([sample.position for sample in measured]), "rad", names),
        "current": Channel("current", np.array([sample.current for sample in measured]), "A", names),
    }
    at = np.array([sample.time for sample in measured])
    return Recording(robot_text=robot_file.text, streams={JOINTS_STREAM: Stream(JOINTS_STREAM, at, at, channels)})


def compare(robot_file: RobotFile, label: str, run: Recording, validation: Recording) -> tuple[Identification, int]:
    """Identify and print how many true base parameters lie within 1.96 deviations."""
    result = identify([run], [validation], IdentifyChoices())
    truth = base_parameters(build_model(robot_file)).projection @ truth_vector(robot_file)
    inside = int(np.count_nonzero(np.abs(result.solution.parameters - truth) <= 1.96 * result.std))
    print(
        f"{label:12} {inside} of {len(truth)} true values within 1.96 deviations; relative error of the torque on "
        f"another motion {100 * result.validation.relative_error:.2f} %",
        flush=True,
    )
    return result, inside


def main(seconds: float = 30.0, seeds: int = 4) -> int:
    """Print all of it; gives how many true values of all lay within their intervals, motions followed exactly."""
    robot_file = load_robot(ARM)
    print(f"closing frames at most {closing_error(robot_file):.1e} m apart at 1000 random positions")
    print_costs(robot_file)
    repeats = max(1, round(seconds / 10.0))
    search = SearchChoices(seed=1, starts=1, workers=1)
    designed = design(robot_file, find_prior(robot_file), DesignChoices(periods=repeats), search)
    print(f"designed: condition {designed.condition:.0f}, columns scaled; {100 * designed.use.max():.1f} % of a limit")
    motion = designed.motion
    other = RestToRest(random_fourier_motion(build_model(robot_file), 10.0, seed=3, candidates=10), 1, 2.0)
    total = 0
    for seed in range(seeds):
        runs = (simulate_recording(robot_file, each, each.duration, seed=seed) for each in (motion, other))
        total += compare(robot_file, f"exact, {seed}", *runs)[1]
    played_runs = (played(robot_file, each, seed) for seed, each in ((1, motion), (2, other)))
    result, _ = compare(robot_file, "played", *played_runs)
    truth = base_parameters(build_model(robot_file)).projection @ truth_vector(robot_file)
    print(f"\nas played:\n{'parameter':10} {'truth':>9} {'estimate':>9} {'deviation':>10}")
    for name, true, value, std in zip(result.base.names, truth, result.solution.parameters, result.std, strict=True):
        print(f"{name:10} {true:9.4f} {value:9.4f} {std:10.4f}")
    return total


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 30.0)
