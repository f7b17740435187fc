"""Friction experiments on a simulated AUBO i5: is the true friction within the intervals?

Friction of AUBO eq. 3-6 on three joints (values of the paper's size, invented), 121 ripple periods per revolution,
encoder and torque noise. Each seed records the sweep of `dynid sweep` in two poses, cold and warm (25.5 to 40.6 °C, an
exponential), and asks how often the true value lies within the 95 % interval: with the terms given, and with those that
`auto` chose.

    python -m studies.friction.friction_experiment [SEEDS [auto]]   coverage over seeds, 20 by default
    python -m studies.friction.friction_experiment plant            one arm with bristle friction that heats itself
"""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Iterable

import numpy as np
import yaml

import dynid
from daq.motion.trajectories import PointToPoint
from daq.recording.recording import Recording
from daq.robot.loader import RobotFile, load_robot, parse_robot
from drivers.core.arrays import FloatArray
from drivers.core.units import ZERO_CELSIUS
from ident.excite.choices import SweepChoices
from ident.excite.motion_check import ArmMotionCheck
from ident.excite.velocity_sweep import velocity_sweep
from ident.experiments.friction.joint_data import friction_torque
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.result.friction_experiment import JointFrictionExperiment
from sim_drivers.plant.plant import Plant
from sim_drivers.synthetic.measurement import simulate_recording
from studies.synthetic.controlled_run import record_plant

JOINTS = ("upperArm_joint", "foreArm_joint", "wrist1_joint")
TRUTH = {
    "upperArm_joint": {"alpha": 1.25, "load": 0.0012, "temperature": [30.0, -0.08, 0.0]},
    "foreArm_joint": {"alpha": 1.35, "load": 0.004, "temperature": [26.0, -0.07, 0.0]},
    "wrist1_joint": {"alpha": 1.3, "load": 0.06, "temperature": [8.0, -0.022, 0.0]},
}
POSES = {"stretched": [0.0, -0.3, 0.4, 0.3, 0.0, 0.0], "bent": [0.0, 0.6, 1.4, 0.9, 0.6, 0.0]}
GIVEN = "coulomb-viscous+power+load+temperature-linear"
COLD, WARM = 25.5, 40.6
RATE = 200.0
REPEATS = 4


def arm(*, plain: bool = False) -> RobotFile:
    """The built-in arm with the paper's friction; plain, its section `friction` does not tell the terms."""
    content = yaml.safe_load(load_robot("aubo_i5").text)
    for name, friction in TRUTH.items():
        content["truth"]["joints"][name] |= friction
    if not plain:
        content["friction"] = {
            "load": "quadratic",
            "temperature": "linear",
            "joints": {name: {"exponent": friction["alpha"]} for name, friction in TRUTH.items()},
        }
    content["poses"] = POSES
    return parse_robot(yaml.safe_dump(content), where="aubo_i5", folder=None)


def sweeps(robot_file: RobotFile) -> list[PointToPoint]:
    """The motion in each pose."""
    check = ArmMotionCheck(robot_file)
    return [
        velocity_sweep(robot_file, check, SweepChoices(joints=JOINTS, pose=pose, slowest=0.2, speeds=5)).motion
        for pose in POSES
    ]


def warming(robot_file: RobotFile, motions: list[PointToPoint], seed: int) -> list[Recording]:
    """Both poses in turn, the arm warming up from one sweep to the next."""
    whole = sum(motion.duration for motion in motions) * REPEATS
    begin, recordings = 0.0, []
    for repeat in range(REPEATS):
        for index, motion in enumerate(motions):
            stamps = begin + np.arange(round(motion.duration * RATE)) / RATE
            celsius = COLD + (WARM - COLD) * (1.0 - np.exp(-3.0 * stamps / whole)) / (1.0 - np.exp(-3.0))
            heat = np.repeat(celsius[:, None], 6, axis=1)
            own = 1000 * seed + 10 * repeat + index
            recordings.append(simulate_recording(robot_file, motion, motion.duration, own, RATE, celsius=heat))
            begin += motion.duration
    return recordings


def true_values(robot_file: RobotFile, name: str) -> dict[str, float]:
    """True values of a joint, by the names of the result."""
    joint = robot_file.robot.truth.joints[name]
    return {
        "coulomb": joint.coulomb,
        "viscous": joint.viscous,
        "exponent": joint.alpha,
        "offset": joint.offset,
        "load": joint.load,
        "beta1": joint.temperature[0],
        "beta2": joint.temperature[1],
        "beta3": joint.temperature[2],
    }


def estimates(joint: JointFrictionExperiment) -> Iterable[tuple[str, float, float]]:
    """Name, value and σ of what was estimated."""
    for name in ("coulomb", "viscous", "exponent", "offset", "load"):
        value, std = getattr(joint, name), getattr(joint, f"{name}_std")
        if value is not None and std is not None:
            yield name, value, std
    for index, (value, std) in enumerate(zip(joint.temperature or [], joint.temperature_std or [], strict=True), 1):
        if std:
            yield f"beta{index}", value, std


def coverage(seeds: int, text: str) -> None:
    """Share of true values within the 95 % intervals, with these terms."""
    robot_file = arm()
    motions = sweeps(robot_file)
    deviations: dict[str, list[float]] = defaultdict(list)
    relative: dict[str, list[float]] = defaultdict(list)
    chosen: dict[str, int] = defaultdict(int)
    for seed in range(seeds):
        result = dynid.friction(
            warming(robot_file, motions, seed), friction=text, robot=arm(plain=True), delay=0.0
        ).result
        for joint in result.joints:
            truth = true_values(robot_file, joint.joint)
            power = "" if joint.load_power is None else f" load^{joint.load_power:g}"
            alpha = "" if joint.exponent is None else " power"
            extra = "" if joint.stribeck is None else " stribeck"
            chosen[f"{alpha}{extra}{power} temperature:{joint.temperature_term}".strip()] += 1
            if joint.load_power != 2.0 or joint.exponent is None:
                continue  # other terms, other meanings
            for name, value, std in estimates(joint):
                deviations[name].append((value - truth[name]) / std)
                relative[name].append(WITHIN_95_PERCENT * std / abs(truth[name]) if truth[name] else np.nan)
    print("| parameter | joints | ± (median) | true value within the 95 % interval | RMS error | mean error |")
    print("|---|---|---|---|---|---|")
    for name, values in deviations.items():
        inside = np.mean(np.abs(values) < WITHIN_95_PERCENT)
        print(
            f"| {name} | {len(values)} | {np.median(relative[name]):.2%} | {inside:.1%} | {np.std(values):.2f} σ | "
            f"{np.mean(values):+.2f} σ |"
        )
    print("\n| terms | joints |\n|---|---|")
    for terms, count in chosen.items():
        print(f"| {terms} | {count} |")


def plant_run() -> None:
    """An arm with a controller and bristle friction that warms up by its own losses."""
    robot_file = arm()
    motions = sweeps(robot_file)
    plant = Plant(robot_file, seed=1, position=np.array(POSES["stretched"]))
    recordings = []
    for _ in range(2):
        for motion in motions:
            recordings.append(record_plant(robot_file, plant, _approach(motion, plant.measure().position), RATE))
    found = dynid.friction(recordings, friction=GIVEN, robot=arm(plain=True))
    print(found.result.delay_note, found.warnings)
    for joint, fitted in zip(found.result.joints, found.experiment.joints, strict=True):
        truth, heat = true_values(robot_file, joint.joint), joint.temperature_range
        assert heat is not None
        kelvin = 0.5 * (heat.least + heat.greatest) + ZERO_CELSIUS
        speed = np.linspace(0.1, 1.0, 10) * joint.speed_range.greatest
        level = np.full_like(speed, joint.load_range.greatest / 2.0)
        even = truth["offset"] if joint.offset is None else joint.offset
        model, warmth = found.experiment.periods.model, np.full_like(speed, kelvin)
        curve = friction_torque(model, fitted, speed, warmth, level) - even
        true = truth["coulomb"] + truth["viscous"] * speed ** truth["exponent"] + truth["load"] * level**2
        true += np.sqrt(speed) * (truth["beta1"] + truth["beta2"] * kelvin)
        worst = np.max(np.abs(curve / true - 1.0))
        print(f"{joint.joint}: {heat.least:.1f} to {heat.greatest:.1f} °C, residual RMS {joint.rmse:.3g} N·m")
        print(f"  friction at half the load off by at most {worst:.1%}, 10 to 100 % of {speed[-1]:.2f} rad/s")


def _approach(motion: PointToPoint, position: FloatArray) -> PointToPoint:
    """The motion with a slow way to its start before it."""
    return PointToPoint(np.vstack([position, motion.points]), np.concatenate([[4.0], motion.durations]))


if __name__ == "__main__":
    argument = sys.argv[1] if len(sys.argv) > 1 else "20"
    if argument == "plant":
        plant_run()
    else:
        coverage(int(argument), sys.argv[2] if len(sys.argv) > 2 else GIVEN)
