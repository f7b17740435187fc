"""How far can the predictions of `dynid excite` be trusted? `python -m studies.excitation.predicted_errors`: minutes.

A motion of 24 s is predicted, then recorded in simulation and identified many times. Prints the true errors (root mean
square over the recordings) over the predicted standard deviations: median and 10-90 % range over the base parameters.
"""

from __future__ import annotations

import os
import sys
import tempfile

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from pathlib import Path

import numpy as np

from daq.motion.trajectories import RestToRest
from daq.recording.recording import Recording
from daq.robot.loader import RobotFile, load_robot
from ident.assessment.excitation import recorded_motion
from ident.excite.forecast import excitation_figures
from ident.excite.prior import PriorKnowledge, find_prior
from ident.excite.sufficiency import motion_sufficiency
from ident.identify.identification import IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.true_parameters import truth_vector
from ident.result.result_file import result_json
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording

EARLIER_PERIOD, EARLIER_DURATION = 10.0, 30.0
PERIOD, RAMP = 20.0, 2.0
ASKED = 5
"""Recordings for `dynid info`."""
CHOICES = IdentifyChoices(reversals=0.0, model=ModelChoices(friction="coulomb-viscous"))
"""The parameters that are predicted: no further friction terms."""


def without_ripple(robot_file: RobotFile) -> RobotFile:
    """The same arm with white torque noise only."""
    truth = robot_file.robot.truth
    quiet = truth.model_copy(update={"noise": truth.noise.model_copy(update={"ripple_amplitude": {}})})
    return robot_file.model_copy(update={"robot": robot_file.robot.model_copy(update={"truth": quiet})})


def earlier_result(robot_file: RobotFile, recording: Recording) -> PriorKnowledge:
    """Result of an identification of an earlier recording."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "result.json"
        result = identify([recording], [], CHOICES, robot_file=robot_file)
        path.write_text(result_json(result.result))
        return find_prior(robot_file, path)


def compare(label: str, robot_file: RobotFile, count: int) -> None:
    """Print a line for each source of a prediction."""
    model = build_model(robot_file)
    truth = base_parameters(model).projection @ truth_vector(robot_file)
    earlier_motion = random_fourier_motion(model, EARLIER_PERIOD, seed=1)
    earlier = simulate_recording(robot_file, earlier_motion, EARLIER_DURATION, seed=77)
    motion = RestToRest(random_fourier_motion(model, PERIOD, seed=2), 1, RAMP)
    priors = {"truth": find_prior(robot_file), "earlier result": earlier_result(robot_file, earlier)}
    predicted = {}
    for source, prior in priors.items():
        forecast = excitation_figures(robot_file, motion, prior).forecast
        predicted[source] = np.array([parameter.std for parameter in forecast.parameters])
    errors, forecasts = [], []
    for seed in range(count):
        recording = simulate_recording(robot_file, motion, motion.duration, seed=seed)
        # Validated on the other recording, so that all of this one identifies.
        result = identify([recording], [earlier], CHOICES, robot_file=robot_file)
        errors.append(result.solution.parameters - truth)
        if seed < ASKED and (shown := motion_sufficiency(recorded_motion(recording, robot_file))) is not None:
            forecasts.append([parameter.std for parameter in shown.forecast.parameters])
    true = np.sqrt(np.mean(np.square(errors), axis=0))
    for source, deviations in {**predicted, "dynid info": np.median(forecasts, axis=0)}.items():
        low, middle, high = np.quantile(true / deviations, [0.1, 0.5, 0.9])
        print(f"{robot_file.robot.name:6} {label:16} {source:15} {middle:6.2f}  ({low:.2f} to {high:.2f})", flush=True)


def main(robots: tuple[str, ...] = ("ur5e", "panda"), count: int = 20) -> None:
    """Both kinds of noise for each arm."""
    for name in robots:
        robot_file = load_robot(name)
        compare("white", without_ripple(robot_file), count)
        compare("white and ripple", robot_file, count)


if __name__ == "__main__":
    main(count=int(sys.argv[1]) if len(sys.argv) > 1 else 20)
