"""Servo models of simulated arms: how many true parameters lie in their 95 % intervals, and what is refused.

Three arms, each as it is, with play in its gears that the robot file declares, and with breakaway friction beside play
that it declares or does not. No robot file says what profile the servos are set to. Parameters
that are marked unidentifiable or assumed are not counted, nor torques of a joint whose stiffness is assumed, which hold
in its scale only: neither gravity nor the inertia of its links ties them to N·m. The last column counts joints without
gravity whose stiffness is refused, or right.

`python -m studies.servo.coverage SEEDS` takes about 200 s of CPU time a seed, half of them for the OpenArm with
declared play; `python -m studies.servo.coverage 4-7 koch` takes seeds 4 to 7 of one arm.
"""

from __future__ import annotations

import os
import sys

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import dynid
from daq.robot.loader import load_robot
from ident.servo.fit import TORQUES
from ident.servo.links import servo_links
from sim_drivers.synthetic.servo import simulate_servo
from studies.coverage.seeds import of_cases
from studies.synthetic.altered_arms import true_values, with_servos

ARMS = ("so101", "koch", "openarm")
COUNTED = ("stiffness", "damping", "armature", "coulomb", "bias", "delay", "acceleration_limit", "load_friction")
SIGNED = ("bias", "delay")

PLAY = 0.003
"""[rad] in the gears."""

BREAKAWAY = {"stribeck": 0.03, "stribeck_velocity": 0.05}
"""[N·m], [rad/s]"""

KINDS = ("", "play declared", "play and breakaway", "play declared, breakaway")

GEAR = {"openarm": 6800.0}
"""[N·m/rad] of gears with play in place of 500: 6 mrad at the torque limit, as in the SO-101, where 500 gives 80."""


def of_seed(name: str, kind: str, seed: int) -> tuple[dict[str, list[bool]], list[bool]]:
    """Which counted parameters are inside, and which torque scales without gravity are refused or right."""
    file = load_robot(name)
    file = file.model_copy(update={"robot": file.robot.model_copy(update={"connections": {}})})
    if kind:
        joint = BREAKAWAY if "breakaway" in kind else None
        file = with_servos(file, joint=joint, backlash=PLAY, gear_stiffness=GEAR.get(name, 500.0))
    truth, names = true_values(file), file.robot.joint_names
    servo = {each: {"backlash": PLAY} for each in names} if "declared" in kind else {}
    known = file.model_copy(update={"robot": file.robot.model_copy(update={"servo": servo})})
    inside: dict[str, list[bool]] = {term: [] for term in COUNTED}
    refused: list[bool] = []
    run, other = (simulate_servo(file, duration=seconds, seed=seed) for seconds in (30.0, 6.0))
    model = dynid.identify_servo(run, validation=other, robot=known)
    weighted = {names[row] for row in servo_links(file).weighted(run.position.T)}
    for fit in model.result.servo:
        stiffness = fit.parameters["stiffness"]
        if fit.joint not in weighted:
            low, high = stiffness.interval or (0.0, np.inf)
            right = low <= truth[fit.joint]["stiffness"] <= high
            refused.append(stiffness.unidentifiable or right)
        for term, estimate in fit.parameters.items():
            true = truth[fit.joint].get(term, 0.0)
            scaled = term in TORQUES and stiffness.origin == "assumed"
            counted = term in inside and (true > 0 or term in SIGNED) and not scaled
            if counted and estimate.interval is not None and not estimate.unidentifiable:
                inside[term].append(estimate.interval[0] <= true <= estimate.interval[1])
    return inside, refused


def main() -> None:
    """Print a row per arm."""
    first, _, last = (sys.argv[1] if len(sys.argv) > 1 else "20").partition("-")
    seeds = range(int(first), int(last) + 1) if last else range(int(first))
    arms = sys.argv[2:] or ARMS
    print("| arm | " + " | ".join(COUNTED) + " | all | no gravity: torque scale refused, or right |")
    print("|---|" + "---|" * (len(COUNTED) + 2))
    for name in arms:
        for kind in KINDS:
            outcomes = list(of_cases(of_seed, [(name, kind, seed) for seed in seeds]))
            columns = {term: [value for inside, _ in outcomes for value in inside[term]] for term in COUNTED}
            refused = [value for _, of_joints in outcomes for value in of_joints]
            every = [value for column in columns.values() for value in column]
            cells = [f"{100 * np.mean(column):.0f} %" if column else "–" for column in columns.values()]
            scale = f"{sum(refused)} of {len(refused)}" if refused else "–"
            label = ", ".join(filter(None, (name, kind)))
            print(f"| {label} | {' | '.join(cells)} | {100 * np.mean(every):.0f} % | {scale} |", flush=True)


if __name__ == "__main__":
    main()
