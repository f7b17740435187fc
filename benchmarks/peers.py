"""The peers' ways to a regressor: a loop over Pinocchio, and figaroh's builder."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin

from drivers.core.arrays import FloatArray
from ident.model.dynamic_model import DynamicModel
from ident.model.dynamics.pinocchio_model import pinocchio_model

Motion = tuple[FloatArray, FloatArray, FloatArray]
"""Position, velocity, acceleration (N, n): a row a sample, as the peers take them."""


class PinocchioLoop:
    """Pinocchio called sample by sample."""

    def __init__(self, model: DynamicModel) -> None:
        self._model = pinocchio_model(model)
        self._working = self._model.createData()

    def fill(self, motion: Motion, out: FloatArray) -> None:
        """Write the inertial columns, in Pinocchio's order, into `out` (N, n, 10·n)."""
        compute, model, working = pin.computeJointTorqueRegressor, self._model, self._working
        position, velocity, acceleration = motion
        for i in range(len(position)):
            out[i] = compute(model, working, position[i], velocity[i], acceleration[i])

    def fill_columns(self, motion: Motion, columns: list[int], out: FloatArray) -> None:
        """Write chosen inertial columns into `out` (N, n, k)."""
        compute, model, working = pin.computeJointTorqueRegressor, self._model, self._working
        position, velocity, acceleration = motion
        for i in range(len(position)):
            out[i] = compute(model, working, position[i], velocity[i], acceleration[i])[:, columns]


FIGAROH_COLUMNS = {"has_friction": True, "has_joint_offset": True, "has_actuator_inertia": False}
"""figaroh's names for the arm's friction columns; it orders them Fv, Fs, Fo behind the inertial ones, as we do."""


def figaroh_robot(model: DynamicModel) -> Any:
    """What figaroh's builder needs of a robot, without the layer that its own robot class adds to every call."""
    arm_model = pinocchio_model(model)
    return SimpleNamespace(model=arm_model, data=arm_model.createData())


def figaroh_regressor(robot: Any, motion: Motion) -> FloatArray:
    """figaroh's regressor (n·N, p), all rows of the first joint first."""
    from figaroh.tools.regressor import build_regressor_basic

    choices = FIGAROH_COLUMNS | {"act_idxv": list(range(robot.model.nv))}
    return np.asarray(build_regressor_basic(robot, *motion, choices))
