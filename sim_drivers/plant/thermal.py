"""Heat of simulated joints: copper loss warms the winding, friction the housing, and the air cools the housing.

Cw·Ṫw = P_copper − Gwh·(Tw − Th)
Ch·Ṫh = P_friction + Gwh·(Tw − Th) − Gha·(Th − T_ambient)
"""

from __future__ import annotations

import numpy as np

from daq.robot.schema import Robot, TruthThermal
from drivers.core.arrays import FloatArray

LOSS_AT_TORQUE_LIMIT = 80.0
"""Copper loss [W] at the torque limit of a joint whose truth gives none: a size, not a measurement."""

UNKNOWN_TORQUE_LIMIT = 100.0
"""Torque limit [N·m] assumed for the copper loss of a joint without one."""


def copper_losses(robot: Robot) -> FloatArray:
    """Copper loss over the square of the drive torque, R/K² (n,) [W/(N·m)²]."""
    given = robot.truth.thermal.copper_loss
    limits = [joint.torque or UNKNOWN_TORQUE_LIMIT for joint in robot.joints]
    return np.array(
        [
            given.get(name, LOSS_AT_TORQUE_LIMIT / limit**2)
            for name, limit in zip(robot.joint_names, limits, strict=True)
        ]
    )


def _heat_matrix(thermal: TruthThermal) -> FloatArray:
    across, out = thermal.winding_to_housing, thermal.housing_to_ambient
    return np.array(
        [
            [-across / thermal.winding_capacity, across / thermal.winding_capacity],
            [across / thermal.housing_capacity, -(across + out) / thermal.housing_capacity],
        ]
    )


class JointHeat:
    """Temperatures of n joints, exact for heat that is constant within a step.

    Args:
        thermal: the constants.
        dof: number of joints.
        step: [s] between two calls of `advance`.

    Attributes:
        winding: (n,) [°C].
        housing: (n,) [°C], where the temperature sensor sits.
        ambient: [°C].
    """

    def __init__(self, thermal: TruthThermal, dof: int, step: float) -> None:
        from scipy.linalg import expm

        self.ambient = thermal.ambient
        self.winding = np.full(dof, thermal.ambient)
        self.housing = np.full(dof, thermal.ambient)
        matrix = _heat_matrix(thermal)
        self._decay: FloatArray = expm(matrix * step)
        capacities = np.array([thermal.winding_capacity, thermal.housing_capacity])
        self._gain: FloatArray = np.linalg.solve(matrix, self._decay - np.eye(2)) / capacities

    def advance(self, copper: FloatArray, friction: FloatArray) -> None:
        """One step on with copper and friction losses (n,) [W]."""
        above = np.stack([self.winding, self.housing]) - self.ambient
        above = self._decay @ above + self._gain @ np.stack([copper, friction])
        self.winding, self.housing = above + self.ambient
