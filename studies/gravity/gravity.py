"""How good is gravity from `dynid excite --for gravity`? Simulated arms, many seeds; CPU minutes.

Prints for each arm the time of the motion, how often the 95 % intervals of parameters and of torques in random poses
hold the truth, the largest error in those poses over the root mean square of the largest joint's gravity, and the same
figure of the true masses and first moments, each wrong by up to 30 %.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "support"))

import numpy as np
from random_arms import random_arm

import dynid
from daq.recording.recording import JOINTS_STREAM, Recording
from daq.robot.loader import RobotFile, load_robot
from drivers.core.errors import DynidError
from ident.experiments.gravity.suspicions import file_parameters
from ident.model.base_parameters import gravity_base, gravity_rows, random_states, resting_model
from ident.model.parameters import INERTIAL
from ident.model.true_parameters import truth_vector
from sim_drivers.synthetic.measurement import simulate_recording
from studies.synthetic.data_mistakes import with_values

RATE = 25.0
POSES = 200
NOISE = 0.02
"""Noise of arms that state none, over the root mean square of a joint's torque."""


def main(seeds: int, random_seeds: int) -> None:
    """Print the table."""
    print(
        "| arm | motion [s] | parameters inside [%] | torques inside [%] | largest error [%] | 30 % wrong masses [%] |"
    )
    print("| --- | ---: | ---: | ---: | ---: | ---: |")
    arms = [(name, load_robot(name), seeds) for name in ("ur5e", "panda", "sr400")]
    arms += [(f"random {seed}", random_arm(seed, trees=seed % 3 == 0), random_seeds) for seed in range(10)]
    for name, robot_file, count in arms:
        try:
            print(row(name, robot_file, count), flush=True)
        except DynidError as error:
            print(f"| {name} | {error} |", flush=True)


def row(name: str, robot_file: RobotFile, seeds: int) -> str:
    """One arm's row."""
    trajectory, _ = dynid.design_gravity_motion(robot_file)
    model = resting_model(robot_file)
    base = gravity_base(model)
    truth = file_parameters(robot_file, model, base)
    assert truth is not None
    poses = random_states(model, POSES, seed=1)[0].T
    rows = gravity_rows(model, base, poses)
    weighing = [
        i
        for i in range(base.count)
        if base.kinds[i] == "inertial" or np.any(base.projection[i, : 10 * len(model.joints)])
    ]
    gravity = rows[:, :, weighing] @ truth[weighing]
    size = float(np.sqrt(np.mean(gravity**2, axis=0)).max())
    inside, within, worst = [], [], 0.0
    for seed in range(seeds):
        run = _noisy(
            simulate_recording(robot_file, trajectory.motion, trajectory.duration, seed, RATE), robot_file, seed
        )
        found = dynid.identify_gravity(run)
        for one, true in zip(found.result.gravity_parameters, truth, strict=True):
            if one.value is not None:
                inside.append(one.low <= true <= one.high)
        values = np.array([one.value or 0.0 for one in found.result.gravity_parameters])
        error = rows @ (values - truth)
        std = np.sqrt(np.einsum("knb,bc,knc->kn", rows, np.array(found.result.covariance), rows))
        acting = std > 1e-9
        within.append(np.mean(np.abs(error[acting]) <= 2.05 * std[acting]))
        worst = max(worst, float(np.abs(rows[:, :, weighing] @ (values - truth)[weighing]).max()))
    wrong = _wrong_masses(robot_file, model, base, rows, weighing, truth)
    return (
        f"| {name} | {trajectory.duration:.0f} | {100 * np.mean(inside):.0f} | {100 * np.mean(within):.0f} "
        f"| {100 * worst / size:.2g} | {100 * wrong / size:.2g} |"
    )


def _noisy(run: Recording, robot_file: RobotFile, seed: int) -> Recording:
    """The recording with noise, where the robot file states none."""
    if any(robot_file.robot.truth.noise.torque_std.values()):
        return run
    torque = run.streams[JOINTS_STREAM].channels["torque"].values
    scale = NOISE * np.sqrt(np.mean(torque**2, axis=0))
    return with_values(run, torque=torque + scale * np.random.default_rng(seed).standard_normal(torque.shape))


def _wrong_masses(robot_file: RobotFile, model, base, rows, weighing, truth) -> float:  # type: ignore[no-untyped-def]
    """Largest error of gravity by bodies of which each is lighter or heavier by up to 30 %."""
    standard = truth_vector(robot_file, model)
    generator = np.random.default_rng(0)
    worst = []
    for _ in range(20):
        factors = np.ones(len(standard))
        for link in range(len(model.joints)):
            factors[len(INERTIAL) * link : len(INERTIAL) * (link + 1)] = generator.uniform(0.7, 1.3)
        error = rows[:, :, weighing] @ (base.projection @ (factors * standard) - truth)[weighing]
        worst.append(float(np.abs(error).max()))
    return float(np.median(worst))


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
