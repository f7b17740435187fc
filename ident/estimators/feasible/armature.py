"""Motor inertia that the measured torque does not carry: of the robot file, else assumed.

A torque sensor behind the gear shows the link alone. A simulated wrist joint then has so little inertia that the
sensor's own error throws it off in a fraction of a second, while the real one moves its motor, too, whose inertia
counts the square of the gear ratio.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from daq.robot.schema import Robot
from drivers.core.arrays import FloatArray
from ident.estimators.feasible.problem import friction_rates
from ident.model.dynamic_model import DynamicModel

ASSUMED_COASTING = 1.0
"""[s] in which the friction that the sensor sees would stop the motor: a Panda then gets 0.06 to 0.12 kg·m² per joint,
where MuJoCo Menagerie assumes 0.1. Its gear's own friction, which no sensor behind it sees, stops it much sooner."""

GIVEN, ASSUMED = "robot file", "assumed"


@dataclass(frozen=True)
class Armature:
    """Inertia of a motor, on the side of its joint, that is in no measured torque."""

    joint: str  # its name
    value: float  # [kg·m² or kg]
    source: str  # "robot file" or "assumed"


def armatures(model: DynamicModel, robot: Robot, columns: Sequence[int], values: FloatArray) -> tuple[Armature, ...]:
    """Indices of the joints whose drive says `inertia: false`.

    Args:
        model: the arm.
        robot: its file.
        columns: (c,) of standard parameters, friction among them.
        values: (c,) theirs.
    """
    behind = np.array([not robot.drive(name).inertia for name in model.joint_names])
    rates = _falling(np.where(behind, friction_rates(model, columns, values), 0.0), model.sliding)
    joints = []
    for name, rate in zip(model.joint_names, rates.tolist(), strict=True):
        drive = robot.drive(name)
        if drive.armature is not None:
            joints.append(Armature(name, drive.armature, GIVEN))
        elif not drive.inertia and rate > 0.0:
            joints.append(Armature(name, ASSUMED_COASTING * rate, ASSUMED))
    return tuple(joints)


def _falling(rates: FloatArray, sliding: Sequence[bool]) -> FloatArray:
    """Friction (n,) that does not grow towards the tool: no motor is smaller than one that it carries.

    A single joint whose sensor sees little friction would else have hardly any motor.
    """
    falling = rates.copy()
    for kind in set(sliding):
        own = np.flatnonzero(np.array(sliding) == kind)
        falling[own] = np.maximum.accumulate(rates[own][::-1])[::-1]
    return falling


class _OfJoint(Protocol):
    """What is known of one motor, here or in a result."""

    @property
    def joint(self) -> str: ...

    @property
    def value(self) -> float: ...


def armature_vector(model: DynamicModel, found: Sequence[_OfJoint]) -> FloatArray:
    """(n,) [kg·m² or kg], 0 of the others."""
    values = {of_joint.joint: of_joint.value for of_joint in found}
    return np.array([values.get(name, 0.0) for name in model.joint_names])
