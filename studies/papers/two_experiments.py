"""Two experiments against one, on a simulated SR400: python -m studies.papers.two_experiments [seeds [moves]].

SR400 .4.3 point 7. Quintic point-to-point motions, 250 Hz, encoder steps, torque noise and ripple of the built-in robot
file. Three ways to spend the same number of moves on the arm:

- one experiment: every joint moves, every motor's torque is used;
- two experiments: joints 5 and 6 locked, the torques of the other motors; then every joint moves, with the torques of
  motors 5 and 6 only; merged;
- the same recordings, and of the second every motor's torque is used: then both experiments inform on the arm, and the
  chi-square test can decide whether they agree.

The first two with `wls`, which weighs each motor's equations by their noise, and with `ols`, as the paper did.

Printed: how often a 95 % interval holds the truth and how large the errors are, over all seeds; and the test's result
when the arm carries 2 kg in the second experiment only. About 15 s of CPU per seed.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np

from daq.recording.recording import Recording
from daq.robot.loader import RobotFile, load_robot
from drivers.core.arrays import FloatArray
from ident.experiments.merge.merged_result import merge_results
from ident.identify.identification import IdentifyChoices
from ident.identify.identify import identify
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.true_parameters import truth_vector
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.regression.options import ExperimentChoices
from ident.result.schema import Result
from sim_drivers.plant.altered_arm import with_load
from sim_drivers.synthetic.measurement import simulate_recording
from studies.synthetic.random_points import random_points_motion

ROBOT = "sr400"
WRIST = ("j5", "j6")
LOAD = 2.0
"""[kg], 0.1 m in front of the last joint's frame."""

RATE = 250.0
"""[Hz]"""

WAYS = (
    "one experiment, `wls`",
    "one experiment, `ols`",
    "two experiments as above, `wls`",
    "two experiments as above, `ols`",
    "two experiments, all torques of the second, `wls`",
)


@dataclass(frozen=True)
class Comparison:
    """Errors of the merged and the single model.

    Attributes:
        names: of the base parameters.
        truth: (b,).
        values, std: (ways, seeds, b).
        agree: (seeds,) whether the chi-square test of the last way passes.
        loaded_agree: the same where the arm carries a load in the second experiment.
    """

    names: tuple[str, ...]
    truth: FloatArray
    values: FloatArray
    std: FloatArray
    agree: list[bool]
    loaded_agree: list[bool]


def recorded(robot_file: RobotFile, seed: int, moves: int, moving: tuple[str, ...] = ()) -> Recording:
    motion = random_points_motion(robot_file.robot, seed, moves, moving)
    return simulate_recording(robot_file, motion, motion.duration, seed, RATE)


def result_of(recording: Recording, torques_of: tuple[str, ...] = (), method: str = "wls") -> Result:
    experiment = ExperimentChoices(torques_of=torques_of)
    choices = IdentifyChoices(method, experiment=experiment, search_delay=False, reversals=0.0)
    return identify([recording], [], choices).result


def figures(result: Result) -> tuple[list[float], list[float]]:
    """Values and standard deviations; nan where there is none."""
    nothing = float("nan")
    return (
        [nothing if one.value is None else one.value for one in result.base_parameters],
        [nothing if one.std is None else one.std for one in result.base_parameters],
    )


def compare(seeds: int, moves: int) -> Comparison:
    """Identify each way, for each seed."""
    arm = load_robot(ROBOT)
    loaded_arm = with_load(arm, LOAD, (0.0, 0.0, 0.1), (0.0,) * 6)
    model = build_model(arm)
    base = base_parameters(model)
    rest = tuple(name for name in arm.robot.joint_names if name not in WRIST)
    results: list[list[tuple[list[float], list[float]]]] = []
    agree: list[bool] = []
    loaded_agree: list[bool] = []
    for seed in range(seeds):
        locked, free = recorded(arm, 100 + seed, moves, rest), recorded(arm, 200 + seed, moves)
        once = recorded(arm, 400 + seed, 2 * moves)
        first, first_ols = result_of(locked), result_of(locked, method="ols")
        loaded = result_of(recorded(loaded_arm, 300 + seed, moves))
        two, two_ols, all_torques, spoilt = (
            merge_results([("locked", one), ("free", other)])[0]
            for one, other in (
                (first, result_of(free, WRIST)),
                (first_ols, result_of(free, WRIST, "ols")),
                (first, result_of(free)),
                (first, loaded),
            )
        )
        kinds = (result_of(once), result_of(once, method="ols"), two, two_ols, all_torques)
        results.append([figures(fit) for fit in kinds])
        for fit, list_of in ((all_torques, agree), (spoilt, loaded_agree)):
            assert fit.merge is not None
            assert fit.merge.consistency is not None
            list_of.append(fit.merge.consistency.agree)
    table = np.array(results).transpose(1, 2, 0, 3)
    return Comparison(base.names, base.projection @ truth_vector(arm), table[:, 0], table[:, 1], agree, loaded_agree)


def main(seeds: int = 8, moves: int = 24) -> Comparison:
    """Print the table."""
    results = compare(seeds, moves)
    error = results.values - results.truth
    inside = np.abs(error) < WITHIN_95_PERCENT * results.std
    wrist = np.array([name[-1] in "56" for name in results.names])
    rms = np.sqrt(np.mean(error**2, axis=1))
    print("| | links and motors 1 to 4, 7, 8 | 5 and 6 | intervals |\n|---|---|---|---|")
    for kind, label in enumerate(WAYS):
        ratios = rms[kind] / rms[0]
        shares = " | ".join(f"{np.median(ratios[of]):.2f}" for of in (~wrist, wrist))
        print(f"| {label} | {shares} | {100 * np.mean(inside[kind]):.1f} % |")
    print(
        f"\nthe experiments agree, says the chi-square test: the same arm {sum(results.agree)} of {seeds}, "
        f"{LOAD:g} kg in one of them {sum(results.loaded_agree)} of {seeds}"
    )
    return results


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
