"""Arms with bodies, friction and motor inertia of known values, ready to be exported."""

from __future__ import annotations

import numpy as np

from daq.robot.loader import RobotFile
from drivers.core.arrays import FloatArray
from ident.export.arm import ExportedArm
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import DynamicModel, build_model
from ident.model.dynamics.inverse_dynamics import InverseDynamics
from ident.model.parameters import link_parameters


def exported_arm(robot_file: RobotFile, values: FloatArray | None = None, seed: int = 1) -> ExportedArm:
    """The arm with these standard parameters (p,), random ones of possible bodies where there are none."""
    model = build_model(robot_file)
    values = random_parameters(model, seed) if values is None else values
    base = base_parameters(model)
    return ExportedArm(robot_file, model, values, InverseDynamics(model, base, base.projection @ values))


def random_parameters(model: DynamicModel, seed: int = 1) -> FloatArray:
    """Standard parameters (p,) of solid bodies and friction that brakes."""
    generator = np.random.default_rng(seed)
    values = []
    for parameter in model.parameters[10 * len(model.joints) :]:
        size = float(generator.uniform(0.1, 1.0))
        if parameter.kind == "offset":
            size *= float(generator.choice([-1.0, 1.0]))
        if parameter.kind == "coupling" and parameter.symbol != "Iac":
            size = -0.3 * size  # brakes where it is negative (SR400 eq. 8)
        values.append(size)
    links = []
    for _ in model.joints:
        mass = float(generator.uniform(1.0, 6.0))
        points = generator.normal(scale=0.08, size=(12, 3))
        points -= points.mean(axis=0)
        inertia = mass * (np.mean(np.sum(points**2, axis=1)) * np.eye(3) - points.T @ points / len(points))
        links.append(
            link_parameters(mass, generator.uniform(-0.2, 0.2, 3).tolist(), inertia[np.triu_indices(3)].tolist())
        )
    return np.concatenate([*links, values])
