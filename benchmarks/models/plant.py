"""How much faster than the real arm the simulated one is."""

from __future__ import annotations

import numpy as np

from benchmarks.agreement import DisagreementError
from benchmarks.timing import medians
from daq.robot.loader import load_robot
from ident.model.dynamic_model import build_model
from sim_drivers.plant.plant import Plant
from sim_drivers.synthetic.measurement import random_fourier_motion

COMPARED = """\
plant_vs_real_time: the simulated UR5e under its PID, steps of 1 ms; every 2 ms a new target and a measurement. Seconds
  of the arm's time in a second of ours, on one core."""

PERIOD = 10.0
CONTROL = 0.002
FOLLOWS = 0.2
"""A target that the arm does not follow this closely [rad] would make an easy benchmark."""


def run(duration: float = 10.0, rounds: int = 3) -> dict[str, float]:
    """Arm's seconds a second.

    Raises:
        DisagreementError: the arm did not follow its targets.
    """
    robot_file = load_robot("ur5e")
    motion = random_fourier_motion(build_model(robot_file), PERIOD, seed=1)
    time = CONTROL * np.arange(round(duration / CONTROL), dtype=np.float64)
    position, velocity, acceleration = (np.ascontiguousarray(rows.T) for rows in motion.evaluate(time))

    def follow() -> None:
        plant = Plant(robot_file, seed=1, position=position[0])
        worst = 0.0
        for target in zip(position, velocity, acceleration, strict=True):
            plant.set_target(*target)
            plant.advance(CONTROL)
            measured = plant.measure()
            worst = max(worst, float(abs(measured.position[0] - target[0][0])))
        if worst > FOLLOWS:
            raise DisagreementError(f"the arm is {worst:.2f} rad away from its target")

    return {"plant_vs_real_time": duration / medians({"plant": follow}, rounds)["plant"]}
