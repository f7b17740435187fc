"""Torques and inertias of a servo arm's links along a motion; masses are those of the robot file or its URDF."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from daq.robot.loader import RobotFile
from drivers.core.arrays import FloatArray, IntArray
from drivers.core.errors import RobotFileError
from ident.model.dynamic_model import DynamicModel, build_model
from ident.model.dynamics.energy import EnergyKernel
from ident.model.kinematics.urdf import urdf_inertias
from ident.model.parameters import INERTIAL, LINK_SIZE, link_parameters
from ident.model.regressor import model_torque

DIFFERENCE = 1e-4
"""[rad or m] Half of the difference that gives gravity's slope."""

GRAVITY_FLOOR = 0.02
"""Share of the arm's largest gravity torque below which a joint counts as one without gravity."""


@dataclass(frozen=True, eq=False)
class ServoLinks:
    """Links of an arm whose masses are known."""

    model: DynamicModel  # kinematics and gravity
    inertial: FloatArray  # (10·links,) standard parameters
    origin: str  # where the masses are from, in words

    def torque(self, position: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
        """Torques (n, N) that the links need for a motion (n, N) [N·m or N]."""
        columns = range(len(self.inertial))
        return model_torque(self.model, columns, self.inertial, position, velocity, acceleration)

    def gravity(self, position: FloatArray) -> FloatArray:
        """Torques (n, N) that hold the links at positions (n, N) [N·m or N]."""
        still = np.zeros_like(position)
        return self.torque(position, still, still)

    def along(self, position: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Gravity and its slope by each joint's own position, (n, N) each, and the matrix of inertia (n, n, N)."""
        gravity, still = self.gravity(position), np.zeros_like(position)
        slope, inertia = np.empty_like(gravity), np.empty((len(gravity), *gravity.shape))
        for joint in range(len(position)):
            moved = np.zeros_like(position)
            moved[joint] = DIFFERENCE
            there, back = self.gravity(position + moved)[joint], self.gravity(position - moved)[joint]
            slope[joint] = (there - back) / (2 * DIFFERENCE)
            moved[joint] = 1.0
            inertia[:, joint] = self.torque(position, still, moved) - gravity
        return gravity, slope, inertia

    def heights(self, link: int, position: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Heights (4, N) [m] of a link's origin and of its axes' unit vectors at positions (n, N), levers (4, n, N).

        A point p of the link is at `heights[0] + p @ heights[1:]`, against gravity from the base frame's origin. Levers
        are derivatives by the joints. Both are the energy and the torques of a unit mass.
        """
        strength = float(np.linalg.norm(self.model.gravity))
        columns = [LINK_SIZE * link + INERTIAL.index(name) for name in ("M", "MX", "MY", "MZ")]
        still = np.zeros_like(position)
        height = EnergyKernel(self.model, columns).energy(position, still) / strength
        levers = [model_torque(self.model, columns, unit, position, still, still) for unit in np.eye(len(columns))]
        return height, np.array(levers) / strength

    def weighted(self, position: FloatArray) -> IntArray:
        """Indices of the joints that gravity loads somewhere along positions (n, N)."""
        largest = np.abs(self.gravity(position)).max(axis=1, initial=0.0)
        return np.flatnonzero(largest > GRAVITY_FLOOR * max(float(largest.max(initial=0.0)), 1e-12))


def servo_links(robot_file: RobotFile) -> ServoLinks:
    """The links of an arm, from `prior.links` of its file, else its URDF, else its `truth`.

    Raises:
        RobotFileError: a link has no mass there.
    """
    robot, model = robot_file.robot, build_model(robot_file)
    bodies: list[FloatArray | None] = [None] * len(model.joints)
    origins = set()
    for index, body in enumerate(urdf_inertias(robot_file, model.link_names)):
        if body is not None:
            xx, xy, xz, yy, yz, zz = body[2][np.triu_indices(3)]
            bodies[index] = link_parameters(body[0], tuple(body[1]), (xx, xy, xz, yy, yz, zz))
            origins.add("the URDF")
    for index, name in enumerate(model.link_names):
        prior = robot.prior.links.get(name)
        if prior is not None and prior.mass is not None and prior.com is not None and prior.inertia is not None:
            bodies[index] = link_parameters(prior.mass, prior.com, prior.inertia)
            origins.add("prior.links of the robot file")
        elif bodies[index] is None and name in robot.truth.links:
            link = robot.truth.links[name]
            bodies[index] = link_parameters(link.mass, link.com, link.inertia)
            origins.add("truth.links of the robot file")
    without = [name for name, body in zip(model.link_names, bodies, strict=True) if body is None]
    if without:
        raise RobotFileError(
            f"no mass is stated for {', '.join(without)}",
            where=f"{robot_file.where}: prior.links",
            hint="a servo model needs the links' masses: give a URDF with inertias, or prior.links",
        )
    inertial = np.array(bodies, dtype=np.float64).ravel()
    assert len(inertial) == len(INERTIAL) * len(model.joints)
    return ServoLinks(model, inertial, " and ".join(sorted(origins)))
