"""Steps of a servo roll-out: how far positions are from those with steps of 0.1 ms.

Joints of three simulated arms with their true parameters, alone (gravity along the commands, no coupling), on 12 s of
the commands of `simulate_servo`; means and maxima of the absolute difference over all joints [mrad].

`python -m studies.servo.steps` takes five seconds.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from daq.recording.commanded_motion import TARGET, CommandedMotion
from daq.robot.loader import load_robot
from drivers.core.arrays import FloatArray
from ident.servo import motion as pieces
from ident.servo.links import servo_links
from ident.servo.rollout.lanes import at_samples
from ident.servo.rollout.rollout import roll_out
from ident.servo.terms import INDEX, start_values
from sim_drivers.synthetic.servo import servo_commands
from studies.synthetic.altered_arms import true_values

STEPS = (0.001, 0.0025, 0.005, 0.01)
"""[s]"""

REFERENCE = 1e-4
"""[s]"""


def main() -> None:
    """Print a row per arm."""
    print("| arm | " + " | ".join(f"{1e3 * step:g} ms" for step in STEPS) + " |")
    print("|---|" + "---|" * len(STEPS))
    for name in ("so101", "koch", "openarm"):
        exact = positions(name, REFERENCE)
        errors = [1e3 * np.abs(positions(name, step) - exact) for step in STEPS]
        print(f"| {name} | " + " | ".join(f"{error.mean():.2f}, {error.max():.1f}" for error in errors) + " |")


def positions(name: str, step: float) -> FloatArray:
    """(S, n) of an arm's joints with steps of so many seconds, the first half second left out."""
    file = load_robot(name)
    links, rate, names = servo_links(file), file.robot.truth.noise.rate, file.robot.joint_names
    time = np.arange(0.0, 12.0, 1 / rate)
    command, values = servo_commands(file, time, 1), start_values(len(names))
    for row, truth in enumerate(true_values(file).values()):
        for term, value in truth.items():
            values[row, INDEX[term]] = value
    pieces.STEP = step
    motions = pieces.servo_motions(CommandedMotion(names, time, command, time, {TARGET: command}), name)
    loads = [pieces.motion_load(links, motion, time, motion.position, np.zeros(len(names))) for motion in motions]
    lanes = pieces.lanes_of(motions, loads, None)
    return at_samples(lanes, roll_out(lanes, values.T[:, lanes.joint])[0])[round(0.5 * rate) :]


if __name__ == "__main__":
    main()
