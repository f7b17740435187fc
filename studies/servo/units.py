"""Ranges for domain randomisation against units of one type: are the others' parameters inside those of one?

A simulated SO-101 is identified from one recording. Twenty other units have gains, inertias and friction that differ
by a factor each (σ of its logarithm 10 %): the share of their true parameters inside the 95 % boxes, for this arm and
with `--unit-spread 0.1`.

`python -m studies.servo.units` takes about two minutes of CPU time.
"""

from __future__ import annotations

import os
import sys

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import dynid
from daq.robot.loader import load_robot
from ident.servo.ranges import unit_ranges
from sim_drivers.synthetic.servo import simulate_servo
from studies.synthetic.altered_arms import another_unit, true_values

UNITS, SPREAD = 20, 0.1
COUNTED = ("stiffness", "damping", "armature", "coulomb", "load_friction")


def main() -> None:
    """Print the table; a folder of a servo model is taken in place of an identification."""
    if len(sys.argv) > 1:
        model = dynid.load_servo_model(sys.argv[1])
    else:
        run, other = (simulate_servo("so101", duration=duration, seed=1) for duration in (30.0, 6.0))
        model = dynid.identify_servo(run, validation=other)
    file = load_robot("so101")
    told = {
        (joint.joint, name)
        for joint in model.result.servo
        for name, one in joint.parameters.items()
        if name in COUNTED and one.origin == "data" and not one.unidentifiable
    }
    # A joint whose torques nothing ties to N·m has them in another scale.
    tied = {joint.joint for joint in model.result.servo if joint.parameters["stiffness"].origin == "data"}
    told = {pair for pair in told if pair[0] in tied}
    print("| ranges | this arm | " + " | ".join(COUNTED) + " | all |")
    print("|---|---|" + "---|" * (len(COUNTED) + 1))
    for label, spread in (("of this arm", 0.0), (f"--unit-spread {SPREAD:g}", SPREAD)):
        boxes = unit_ranges(model.result, spread)
        shares: dict[str, list[bool]] = {name: [] for name in COUNTED}
        own: list[bool] = []
        for unit in range(UNITS + 1):
            truth = true_values(file if unit == 0 else another_unit(file, SPREAD, unit))
            for joint, name in told:
                box = boxes[joint][name]
                inside = box.low <= truth[joint][name] <= box.high
                (own if unit == 0 else shares[name]).append(inside)
        cells = [f"{100 * np.mean(shares[name]):.0f} %" if shares[name] else "–" for name in COUNTED]
        every = 100 * np.mean([value for column in shares.values() for value in column])
        print(f"| {label} | {100 * np.mean(own):.0f} % | " + " | ".join(cells) + f" | {every:.0f} % |")


if __name__ == "__main__":
    main()
