"""The arm and the data of all benchmarks: a UR5e's geometry with viscous and Coulomb friction and an offset a joint.

60 inertial and 18 friction columns, of which 36 + 18 = 54 are base columns.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from daq.robot.loader import load_robot
from drivers.core.arrays import FloatArray
from ident.model.dynamic_model import DynamicModel, build_model
from ident.model.dynamics.pinocchio_model import PINOCCHIO_ORDER
from ident.model.parameters import INERTIAL
from ident.model.regressor import model_torque
from ident.model.true_parameters import truth_vector
from ident.signals.prepared import Segment
from sim_drivers.synthetic.measurement import random_fourier_motion

PERIOD = 20.0
"""Period of the motion [s]; every data set samples one period evenly, so that no sample is there twice."""

NOISE_STD = 0.5
"""White noise on the torques [N·m]."""

_PIECE = 10_000


@dataclass(frozen=True, eq=False)
class Data:
    """Samples of a motion.

    Attributes:
        position, velocity, acceleration: (n, N) [rad, rad/s, rad/s²].
        torque: (n, N) [N·m], with noise.
        rate: [Hz].
    """

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    torque: FloatArray
    rate: float

    @property
    def samples(self) -> int:
        """Number of samples N."""
        return int(self.position.shape[1])

    def by_sample(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position, velocity, acceleration (N, n), a row a sample, as the peers take them."""
        return (
            np.ascontiguousarray(self.position.T),
            np.ascontiguousarray(self.velocity.T),
            np.ascontiguousarray(self.acceleration.T),
        )

    def segment(self) -> Segment:
        """The same as the segment that preprocessing would hand on."""
        time = np.arange(self.samples) / self.rate
        used = np.ones(self.samples, dtype=np.bool_)
        return Segment(time, self.position, self.velocity, self.acceleration, self.torque, self.rate, used)


def arm() -> DynamicModel:
    """The arm: without motor inertias, which the peers call by other names and which change nothing in the timing."""
    return replace(build_model(load_robot("ur5e")), motor_inertia=(False,) * 6)


def true_parameters(model: DynamicModel) -> FloatArray:
    """Standard parameters (p,) of the built-in UR5e for this arm's columns."""
    robot_file = load_robot("ur5e")
    names = {parameter.name: i for i, parameter in enumerate(build_model(robot_file).parameters)}
    return truth_vector(robot_file)[[names[parameter.name] for parameter in model.parameters]]


def data(model: DynamicModel, samples: int, seed: int = 1) -> Data:
    """`samples` samples of one period of a random Fourier motion, built piece by piece: little memory beyond them."""
    motion = random_fourier_motion(model, PERIOD, seed)
    truth = true_parameters(model)
    generator = np.random.default_rng(seed)
    position, velocity, acceleration, torque = (np.empty((model.dof, samples)) for _ in range(4))
    for part in _pieces(samples):
        states = motion.evaluate(np.arange(part.start, part.stop, dtype=np.float64) * (PERIOD / samples))
        position[:, part], velocity[:, part], acceleration[:, part] = states
        noise = NOISE_STD * generator.standard_normal(states[0].shape)
        torque[:, part] = model_torque(model, None, truth, *states) + noise
    return Data(position, velocity, acceleration, torque, samples / PERIOD)


def _pieces(samples: int) -> Iterator[slice]:
    for start in range(0, samples, _PIECE):
        yield slice(start, min(start + _PIECE, samples))


def pinocchio_columns(model: DynamicModel) -> list[int]:
    """Number of Pinocchio's column for each of our 10·n inertial columns."""
    return [10 * link + PINOCCHIO_ORDER.index(symbol) for link in range(model.dof) for symbol in INERTIAL]
