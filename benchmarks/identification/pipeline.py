"""The whole identification of a simulated minute, as a user waits for it."""

from __future__ import annotations

from benchmarks.timing import medians
from daq.robot.loader import load_robot
from ident.identify.identification import IdentifyChoices
from ident.identify.identify import identify
from ident.model.dynamic_model import build_model
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording

COMPARED = """\
full_pipeline_ur5e_seconds: identify() with its default choices on 60 s of the simulated UR5e at its own rate, the last
  30 % held out: preprocessing, delay, estimation, error bars, validation."""

PERIOD = 15.0


def run(duration: float = 60.0, rounds: int = 3) -> dict[str, float]:
    """Seconds of one identification."""
    robot_file = load_robot("ur5e")
    motion = random_fourier_motion(build_model(robot_file), PERIOD, seed=1)
    recording = simulate_recording(robot_file, motion, duration, seed=1)
    seconds = medians({"identify": lambda: identify([recording], [], IdentifyChoices())}, rounds, warm_up=False)
    return {"full_pipeline_ur5e_seconds": seconds["identify"]}
