"""Less data and more noise never improve a grade."""

from __future__ import annotations

import numpy as np
import pytest
from check_bench import changed

import dynid
from daq.recording.recording import Recording
from daq.robot.loader import RobotFile
from ident.model.dynamic_model import build_model
from ident.verdict.verdict import GRADES
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording

pytestmark = pytest.mark.usefixtures("not_simulated", "stated_friction")

PERIOD = 10.0


def badness(recording: Recording, held_out: Recording, seconds: float) -> list[int]:
    """How bad the grade of every purpose is that does not ask for a simulation, from the first seconds."""
    purposes = dynid.identify(recording, validation=held_out, stop=seconds).verdict.purposes
    return [GRADES.index(one.grade) for name, one in purposes.items() if name != "simulation"]


def test_less_data_and_more_noise_never_improve_a_grade(three_joint: RobotFile) -> None:
    motions = [random_fourier_motion(build_model(three_joint), PERIOD, seed, candidates=2) for seed in (1, 2)]
    recordings = [simulate_recording(three_joint, motion, 2 * PERIOD, 1, rate=100.0) for motion in motions]

    def graded(seconds: float, share: float) -> list[int]:
        generator = np.random.default_rng(0)
        run, other = (
            changed(one, lambda i: i + share * i.std(axis=0) * generator.standard_normal(i.shape)) for one in recordings
        )
        return badness(run, other, seconds)

    grades = np.array([graded(*one) for one in ((20.0, 0.0), (10.0, 0.1), (10.0, 3.0))])
    assert np.all(np.diff(grades, axis=0) >= 0), grades
    assert np.all(grades[-1] > grades[0]), grades
