"""Arms, motions and systems that several tests share."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from daq.robot.loader import RobotFile, parse_robot
from daq.robot.schema import JointLimits
from drivers.core.arrays import FloatArray
from ident.linear_algebra.triangular import triangular
from ident.model.dynamic_model import DynamicModel
from ident.model.kinematics.joints import Joint
from ident.model.kinematics.transmission import direct_transmission
from ident.model.regressor import model_torque
from ident.regression.observation_matrix import JointFactor, Reduction
from ident.signals.pipeline import Segment

UR_LIKE = """
name: ur_like
model:
  mdh:
    - {joint: j1, alpha: 0, d: 0, r: 0.16}
    - {joint: j2, antecedent: j1, alpha: pi/2, d: 0, r: 0}
    - {joint: j3, antecedent: j2, alpha: 0, d: -0.42, r: 0}
    - {joint: j4, antecedent: j3, alpha: 0, d: -0.39, r: 0.13}
    - {joint: j5, antecedent: j4, alpha: pi/2, d: 0, r: 0.1}
    - {joint: j6, antecedent: j5, alpha: -pi/2, d: 0, r: 0.1}
joints:
""" + "".join(f"  - {{name: j{i}, position: [-3, 3], velocity: 3, torque: 100}}\n" for i in range(1, 7))

THREE_JOINT = """
name: three_joint
model:
  mounting: free
  mdh:
    - {joint: j1, alpha: 0, d: 0, r: 0.3}
    - {joint: j2, antecedent: j1, alpha: pi/2, d: 0, r: 0}
    - {joint: j3, antecedent: j2, alpha: 0, d: 0.4, r: 0.1}
joints:
  - {name: j1, position: [-3, 3], velocity: 3, acceleration: 10, torque: 100}
  - {name: j2, position: [-3, 3], velocity: 3, acceleration: 10, torque: 100}
  - {name: j3, position: [-3, 3], velocity: 3, acceleration: 10, torque: 50}
drives:
  - {joint: j1, gain: 10, gain_std: 0.5}
  - {joint: j2, gain: -8, gain_std: 0.5}
  - {joint: j3, gain: 4, gain_std: 0.2}
truth:
  links:
    j1: {mass: 4, com: [0.01, -0.02, -0.05], inertia: [0.02, 0.001, 0, 0.02, 0, 0.03]}
    j2: {mass: 5, com: [0.2, 0.01, 0.05], inertia: [0.01, 0, 0.002, 0.09, 0, 0.09]}
    j3: {mass: 2, com: [0.15, 0.02, 0.03], inertia: [0.004, 0.001, 0, 0.03, 0.001, 0.03]}
  joints:
    j1: {viscous: 3, coulomb: 6, offset: 0.5, motor_inertia: 1.0}
    j2: {viscous: 4, coulomb: 7, offset: -0.4, motor_inertia: 0.8}
    j3: {viscous: 1, coulomb: 2, offset: 0.2, motor_inertia: 0.3}
  noise:
    rate: 200
    encoder_resolution: 1.0e-5
    torque_std: {j1: 0.8, j2: 0.8, j3: 0.1}
"""


@pytest.fixture(scope="session")
def three_joint() -> RobotFile:
    """A simulated 3-joint arm with drive gains, one of them negative, and noise."""
    return parse_robot(THREE_JOINT, where="three_joint", folder=None)


@pytest.fixture(scope="session")
def noise_free() -> RobotFile:
    """That arm with perfect sensors."""
    return parse_robot(THREE_JOINT[: THREE_JOINT.index("  noise:")], where="noise-free", folder=None)


@pytest.fixture(scope="session")
def smooth_segment() -> Callable[..., Segment]:
    """Makes segments of a motion that never repeats, known exactly, with the torque of given parameters.

    The torque (n, N) is that of standard parameters (p,), `delay` seconds late; zero where none are given.
    """

    def make(
        model: DynamicModel,
        samples: int,
        *,
        parameters: FloatArray | None = None,
        rate: float = 100.0,
        seed: int = 0,
        delay: float = 0.0,
    ) -> Segment:
        generator = np.random.default_rng(seed)
        amplitude = generator.uniform(0.2, 0.5, (model.dof, 4, 1))
        pulsation = 2.0 * np.pi * generator.uniform(0.1, 0.8, (model.dof, 4, 1))
        phase = generator.uniform(0.0, 2.0 * np.pi, (model.dof, 4, 1))

        def motion(time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
            angle = pulsation * time + phase
            swing = amplitude * np.sin(angle)
            return (
                swing.sum(axis=1),
                (amplitude * pulsation * np.cos(angle)).sum(axis=1),
                (-(pulsation**2) * swing).sum(axis=1),
            )

        time = np.arange(samples) / rate
        position, velocity, acceleration = motion(time)
        torque = np.zeros_like(position)
        if parameters is not None:
            torque = model_torque(model, None, parameters, *motion(time - delay))
        return Segment(time, position, velocity, acceleration, torque, rate, np.ones(samples, dtype=np.bool_))

    return make


@pytest.fixture(scope="session")
def dense_reduction() -> Callable[..., Reduction]:
    """Reduces systems that are given in full: for each joint its rows W (N, b) and torques (N,)."""

    def reduce(joints: Sequence[tuple[FloatArray, FloatArray]]) -> Reduction:
        count = joints[0][0].shape[1]
        return Reduction(
            joints=tuple(
                JointFactor(tuple(range(count)), triangular(np.column_stack([W, torque])), len(W))
                for W, torque in joints
            ),
            column_count=count,
            torque_count=1,
            samples=len(joints[0][0]),
            method="dense",
        )

    return reduce


@pytest.fixture(scope="session")
def ur_like() -> RobotFile:
    """A 6-joint arm with a UR's geometry."""
    return parse_robot(UR_LIKE, where="ur_like", folder=None)


@pytest.fixture(scope="session")
def random_tree() -> Callable[..., DynamicModel]:
    """Makes arms with random branches, axes, prismatic joints and columns."""

    def make(seed: int, dof: int = 6, *, aligned: bool = False) -> DynamicModel:
        generator = np.random.default_rng(seed)
        joints = []
        for number in range(dof):
            axis = generator.standard_normal(3)
            rotation = np.linalg.qr(generator.standard_normal((3, 3)))[0]
            rotation *= np.linalg.det(rotation)
            if aligned:  # right angles and coordinate axes, as URDFs have them
                axis = np.eye(3)[generator.integers(3)] * generator.choice([-1.0, 1.0])
                rotation = np.eye(3)[generator.permutation(3)]
                rotation *= np.linalg.det(rotation)
            joints.append(
                Joint(
                    name=f"j{number + 1}",
                    parent=int(generator.integers(-1, number)) if number else -1,
                    prismatic=bool(generator.random() < 0.3),
                    rotation=rotation,
                    translation=generator.uniform(-0.5, 0.5, 3) * generator.integers(0, 2, 3),
                    axis=axis / np.linalg.norm(axis),
                )
            )

        def flags() -> tuple[bool, ...]:
            return tuple(bool(flag) for flag in generator.integers(0, 2, dof))

        return DynamicModel(
            name=f"tree {seed}",
            joints=tuple(joints),
            limits=tuple(JointLimits(name=j.name, position=(-3.0, 3.0), velocity=3.0) for j in joints),
            gravity=generator.uniform(-10, 10, 3),
            motor_inertia=flags(),
            viscous=flags(),
            coulomb=flags(),
            offset=flags(),
            transmission=direct_transmission(dof),
            smoothing=float(generator.choice([0.0, 0.05])),
        )

    return make
