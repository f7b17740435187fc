"""Random arms."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from daq.robot import JointLimits, RobotFile, parse_robot
from ident.kinematics import Joint
from ident.model import DynamicModel

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
            smoothing=float(generator.choice([0.0, 0.05])),
        )

    return make
