"""What does a designed excitation gain? Simulated identifications with motions of equal duration; takes minutes.

The UP6 with the paper's trajectory among them (torque noise added: the paper's simulation has none), and the UR5e. The
error of a base parameter is relative to its true value, or to 2 % of the largest of its kind. Prints, for each motion,
medians over 20 seeds of the root mean square and of the largest of these errors.
"""

from __future__ import annotations

import os
import sys

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import numpy.typing as npt

from daq.motion.trajectories import Motion, RestToRest
from daq.robot.loader import RobotFile, load_robot
from ident.excite.choices import CriterionName, DesignChoices
from ident.excite.design import DEVIATION_FLOOR, design
from ident.excite.prior import find_prior
from ident.excite.search.search import SearchChoices
from ident.identify.identification import IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.true_parameters import truth_vector
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording
from studies.papers.up6_excitation import DURATION, PAPER

RAMP = 2.0
NOISE = 5.0
"""White torque noise of the UP6 [N·m]; its torques reach several hundred."""
RESOLUTION = 1e-5
"""Resolution of its encoders [rad]."""
STARTS = 4
RANDOM_MOTIONS = 5
CRITERIA: tuple[CriterionName, ...] = (
    "d-optimal",
    "e-optimal",
    "deviations",
    "condition",
    "plain-condition",
    "moments",
)


def noisy_up6() -> RobotFile:
    """The built-in UP6 with noise."""
    robot_file = load_robot("up6")
    truth = robot_file.robot.truth
    noise = truth.noise.model_copy(
        update={"torque_std": dict.fromkeys(robot_file.robot.joint_names, NOISE), "encoder_resolution": RESOLUTION}
    )
    noisy = truth.model_copy(update={"noise": noise})
    return robot_file.model_copy(update={"robot": robot_file.robot.model_copy(update={"truth": noisy})})


def errors(robot_file: RobotFile, motion: Motion, seeds: int) -> npt.NDArray[np.float64]:
    """Relative errors (seeds, b) of the base parameters."""
    model = build_model(robot_file)
    base = base_parameters(model)
    truth = base.projection @ truth_vector(robot_file)
    largest = [max(abs(t) for t, k in zip(truth, base.kinds, strict=True) if k == kind) for kind in base.kinds]
    scale = np.maximum(np.abs(truth), DEVIATION_FLOOR * np.array(largest))
    held_out = RestToRest(random_fourier_motion(model, DURATION, seed=99), 1, RAMP)
    validation = simulate_recording(robot_file, held_out, held_out.duration, seed=99)
    results = []
    for seed in range(seeds):
        recording = simulate_recording(robot_file, motion, motion.duration, seed=seed)
        choices = IdentifyChoices(reversals=0.0, model=ModelChoices(friction="coulomb-viscous"))
        result = identify([recording], [validation], choices, robot_file=robot_file)
        results.append(np.abs(result.solution.parameters - truth) / scale)
    return np.array(results)


def print_line(robot: str, name: str, results: npt.NDArray[np.float64]) -> None:
    """Medians over the rows of errors (K, b)."""
    rms, worst = np.sqrt((results**2).mean(axis=1)), results.max(axis=1)
    print(f"{robot:6} {name:24} {np.median(rms):10.2%} {np.median(worst):10.2%}", flush=True)


def main(seeds: int) -> None:
    """Print a line for each arm and motion."""
    print(f"{'arm':6} {'motion':24} {'rms error':>10} {'largest':>10}   (medians over {seeds} seeds)")
    for robot_file in (noisy_up6(), load_robot("ur5e")):
        robot = robot_file.robot.name
        model = build_model(robot_file)
        for criterion in CRITERIA:
            choices = DesignChoices(criterion=criterion, ramp=RAMP)
            made = design(robot_file, find_prior(robot_file), choices, SearchChoices(starts=STARTS))
            print_line(robot, f"designed, {criterion}", errors(robot_file, made.motion, seeds))
        random = [
            RestToRest(random_fourier_motion(model, DURATION, seed=seed, candidates=1), 1, RAMP)
            for seed in range(RANDOM_MOTIONS)
        ]
        results = [errors(robot_file, motion, max(1, seeds // RANDOM_MOTIONS)) for motion in random]
        print_line(robot, f"{RANDOM_MOTIONS} random motions", np.concatenate(results))
        if robot == "up6":
            print_line(robot, "the paper's Table 1", errors(robot_file, RestToRest(PAPER, 1, RAMP), seeds))


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20)
