"""Arms with a model that is true, and exact samples of their motion."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from true_results import true_result

from daq.robot.loader import RobotFile, load_robot
from ident.model.dynamic_model import build_model
from ident.monitor.interval_torque import JointSamples
from ident.result.models.model import Model
from sim_drivers.synthetic.measurement import random_fourier_motion

PERIOD = 0.002


@lru_cache
def known_model(robot: str) -> tuple[Model, RobotFile]:
    file = load_robot(robot)
    count = sum(parameter is not None for parameter in true_result(file).base_parameters)
    return Model(true_result(file, covariance=1e-8 * np.eye(count)), "full"), file


@lru_cache
def exact_samples(robot: str, count: int = 400) -> JointSamples:
    """A motion and the torques that the model needs for it, without noise."""
    model, file = known_model(robot)
    motion = random_fourier_motion(build_model(file), 5.0, seed=1, candidates=1)
    time = 1.0 + PERIOD * np.arange(count)
    position, velocity, acceleration = (rows.T for rows in motion.evaluate(time))
    return JointSamples(time, position, model.torque(position, velocity, acceleration))
