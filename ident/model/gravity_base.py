"""Gravity parameters: the fewest combinations of standard parameters that fix the torque of an arm at rest.

An arm at rest shows first moments and masses only, and of those fewer combinations than an arm in motion: nothing of
what turns about a vertical axis. They are found as base parameters are, from random poses within the limits, beside one
constant offset for each motor.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from daq.robot.loader import RobotFile
from drivers.core.arrays import FloatArray
from ident.friction.terms import NO_TERMS
from ident.model.base_parameters import STATES_PER_PARAMETER, BaseParameters, base_parameters_of, random_states
from ident.model.dynamic_model import DynamicModel, build_model
from ident.model.regressor import RegressorKernel, motion_factor, regressor


def resting_model(robot_file: RobotFile) -> DynamicModel:
    """The model of an arm whose motors have an offset and nothing that a motion shows.

    Raises:
        RobotFileError: the geometry cannot be used.
    """
    model = build_model(robot_file)
    none, every = (False,) * model.dof, (True,) * model.dof
    return replace(model, motor_inertia=none, viscous=none, coulomb=none, offset=every, terms=NO_TERMS, presliding=())


def gravity_base(model: DynamicModel) -> BaseParameters:
    """Base parameters of a `resting_model`, offsets among them.

    A joint that slides along gravity has its weight and its offset in one parameter.

    Raises:
        IdentificationError: their number cannot be decided.
    """
    kernel = RegressorKernel(model)
    position, _, _ = random_states(model, max(100, STATES_PER_PARAMETER * len(kernel.columns)))
    still = np.zeros_like(position)
    return base_parameters_of(model, motion_factor(kernel, position, still, still))


def gravity_rows(model: DynamicModel, base: BaseParameters, position: FloatArray) -> FloatArray:
    """Rows (N, n, b) of the motors' torques in poses (N, n) by the gravity parameters, offsets among them."""
    still = np.zeros_like(position.T)
    rows = regressor(model, np.ascontiguousarray(position.T), still, still, base.columns)
    return np.ascontiguousarray(np.moveaxis(rows, -1, 0))


def gravity_columns(base: BaseParameters) -> list[int]:
    """Indices of the parameters other than offsets, which thus weigh."""
    return [index for index, kind in enumerate(base.kinds) if kind == "inertial"]
