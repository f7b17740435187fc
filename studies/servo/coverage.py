"""Servo models of simulated arms: how many true parameters lie in their 95 % intervals, and what is refused.

Three arms, each as it is and with play in its gears and breakaway friction, which the model holds in part. Parameters
that are marked unidentifiable or assumed are not counted, nor torques of a joint whose stiffness is assumed, which hold
in its scale only: neither gravity nor the inertia of its links ties them to N·m. The last column counts joints without
gravity whose stiffness is refused, or right.

`python -m studies.servo.coverage SEEDS` takes about half a minute of CPU time for each identification, of which there
are six a seed; `python -m studies.servo.coverage 1 koch` takes one arm only.
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
from studies.synthetic.altered_arms import true_values, with_servos

ARMS = ("so101", "koch", "openarm")
COUNTED = ("stiffness", "damping", "armature", "coulomb", "bias", "delay", "acceleration_limit", "load_friction")
SIGNED = ("bias", "delay")

PLAY = 0.003
"""[rad] in the gears."""

BREAKAWAY = {"stribeck": 0.03, "stribeck_velocity": 0.05}
"""[N·m], [rad/s]"""


def main() -> None:
    """Print a row per arm."""
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    arms = sys.argv[2:] or ARMS
    print("| arm | " + " | ".join(COUNTED) + " | all | no gravity: torque scale refused, or right |")
    print("|---|" + "---|" * (len(COUNTED) + 2))
    for name in arms:
        plain = load_robot(name)
        spoilt = with_servos(plain, joint=BREAKAWAY, backlash=PLAY)
        for file, suffix in ((plain, ""), (spoilt, ", play and breakaway")):
            truth, names = true_values(file), file.robot.joint_names
            inside: dict[str, list[bool]] = {term: [] for term in COUNTED}
            refused: list[bool] = []
            for seed in range(seeds):
                run, other = (simulate_servo(file, duration=seconds, seed=seed) for seconds in (30.0, 6.0))
                model = dynid.identify_servo(run, validation=other)
                weighted = {names[row] for row in servo_links(file).weighted(run.position.T)}
                for joint in model.result.servo:
                    stiffness = joint.parameters["stiffness"]
                    if joint.joint not in weighted:
                        low, high = stiffness.interval or (0.0, np.inf)
                        right = low <= truth[joint.joint]["stiffness"] <= high
                        refused.append(stiffness.unidentifiable or right)
                    for term, found in joint.parameters.items():
                        true = truth[joint.joint].get(term, 0.0)
                        scaled = term in TORQUES and stiffness.origin == "assumed"
                        known = term in inside and (true > 0 or term in SIGNED) and not scaled
                        if known and found.interval is not None and not found.unidentifiable:
                            inside[term].append(found.interval[0] <= true <= found.interval[1])
            every = [value for column in inside.values() for value in column]
            cells = [f"{100 * np.mean(column):.0f} %" if column else "–" for column in inside.values()]
            scale = f"{sum(refused)} of {len(refused)}" if refused else "–"
            print(f"| {name}{suffix} | {' | '.join(cells)} | {100 * np.mean(every):.0f} % | {scale} |", flush=True)


if __name__ == "__main__":
    main()
