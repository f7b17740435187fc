"""An arm that moves under its own controller is identified from what its sensors say, truth inside the error bars."""

from __future__ import annotations

import numpy as np
import pytest

from daq.recording import JOINTS_STREAM, Channel, Recording, Stream
from daq.robot import load_robot
from ident.base_parameters import base_parameters
from ident.identify import IdentifyChoices, identify
from ident.model import build_model, truth_vector
from sim_drivers.motion import random_fourier_motion
from sim_drivers.plant import Plant

RATE = 500.0


def record(robot_file, motion, duration, seed):
    time = np.arange(round(duration * RATE)) / RATE
    position, velocity, acceleration = (values.T for values in motion.evaluate(time))
    # The motion begins at speed: for two seconds its own time speeds up from a standstill, φ = t²/4 − 1.
    up = np.arange(round(2.0 * RATE)) / RATE
    before = [values.T for values in motion.evaluate(up**2 / 4.0 - 1.0)]
    pace = (up / 2.0)[:, None]
    plant = Plant(robot_file, seed=seed, position=before[0][0])
    for q, v, a in zip(before[0], before[1] * pace, before[2] * pace**2 + before[1] * 0.5, strict=True):
        plant.set_target(q, v, a)
        plant.advance(1.0 / RATE)
    samples = []
    for sample in range(len(time)):
        plant.set_target(position[sample], velocity[sample], acceleration[sample])
        plant.advance(1.0 / RATE)
        samples.append(plant.measure())
    names = robot_file.robot.joint_names
    stamps = np.array([sample.time for sample in samples])
    channels = {
        "position": Channel("position", np.array([sample.position for sample in samples]), "rad", names),
        "current": Channel("current", np.array([sample.current for sample in samples]), "A", names),
    }
    return Recording(
        robot_text=robot_file.text, streams={JOINTS_STREAM: Stream(JOINTS_STREAM, stamps, stamps, channels)}
    )


@pytest.mark.slow
def test_the_truth_is_found_from_twenty_seconds():
    robot_file = load_robot("ur5e")
    model = build_model(robot_file)
    base = base_parameters(model)
    truth = base.projection @ truth_vector(robot_file)
    recordings = [[record(robot_file, random_fourier_motion(model, 10.0, seed=seed), 20.0, seed)] for seed in (1, 2)]
    found = identify(recordings[0], recordings[1], IdentifyChoices())
    assert found.validation.relative_error < 0.05
    inside = np.abs(found.solution.parameters - truth) <= 1.96 * found.std
    assert np.mean(inside) >= 0.85, [name for name, good in zip(base.names, inside, strict=True) if not good]
