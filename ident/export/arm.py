"""The arm that is exported: bodies of the links, their simple shapes, and what turns and rubs at joints and motors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from daq.robot.loader import BASE, RobotFile
from drivers.core.arrays import FloatArray
from drivers.core.errors import ModelError
from ident.estimators.feasible.pseudo_inertia import Body, body_of
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import DynamicModel
from ident.model.dynamics.inverse_dynamics import InverseDynamics
from ident.model.dynamics.pinocchio_model import pinocchio_model
from ident.model.kinematics.joints import BASE_INDEX
from ident.model.parameters import LINK_SIZE

SHORTEST_LINK = 1e-3
"""[m] below which two joints count as lying on each other."""

Segment = tuple[FloatArray, FloatArray, float]
"""Start and end (3,) [m] in the link's frame, and radius [m]."""


@dataclass(frozen=True)
class JointTerms:
    """What acts along joints or motors beside the links; arrays (a,)."""

    inertia: FloatArray  # of the motor or of what turns with the joint [kg·m²]
    viscous: FloatArray  # [N·m·s/rad], positive where it brakes
    coulomb: FloatArray  # [N·m], positive where it brakes
    offset: FloatArray  # constant torque [N·m]


@dataclass(frozen=True)
class ExportedArm:
    """An arm with the standard parameters of bodies that can exist."""

    robot_file: RobotFile  # its limits, shapes and URDF
    model: DynamicModel  # its tree and transmission
    values: FloatArray  # (p,) standard parameters in the order of `model.parameters`
    dynamics: InverseDynamics  # torques of the same parameters, which every file that is read again is compared with
    # friction of the identified model that none of the formats has, in sentences
    further_friction: tuple[str, ...] = ()

    @cached_property
    def bodies(self) -> tuple[Body, ...]:
        """The links' bodies, each in the frame of its joint, in the order of the tree."""
        links = self.values[: LINK_SIZE * len(self.model.joints)].reshape(-1, LINK_SIZE)
        return tuple(body_of(link) for link in links)

    @property
    def coupling(self) -> FloatArray:
        """(a, a) R of q_motor = R·q_joint."""
        return self.dynamics.coupling

    @property
    def coupled(self) -> tuple[bool, ...]:
        """(a,) whether several joints move a motor."""
        return self.model.transmission.coupled

    @property
    def closed(self) -> bool:
        """Return whether some joints have no motor and follow the others."""
        return self.model.transmission.closed

    @cached_property
    def motors(self) -> JointTerms:
        """Friction of the motors, on their own motion."""
        return self._terms(of_pairs=False)

    @cached_property
    def at_joints(self) -> JointTerms:
        """Friction of the joints: motors that move one joint alone, and what turns with a coupled joint itself."""
        pairs, motors = self._terms(of_pairs=True), self.motors
        single = self.coupling[[not several for several in self.coupled]]
        own = JointTerms(*(values[[not several for several in self.coupled]] for values in vars(motors).values()))
        return JointTerms(
            inertia=pairs.inertia + own.inertia @ single**2,
            # Friction of a coupled joint itself brakes where it is negative (SR400 eq. 8).
            viscous=-pairs.viscous + own.viscous @ single**2,
            coulomb=-pairs.coulomb + own.coulomb @ np.abs(single),
            offset=own.offset @ single,
        )

    def _terms(self, *, of_pairs: bool) -> JointTerms:
        kinds: dict[str, str] = {"Iac": "motor_inertia", "Fv": "viscous", "Fs": "coulomb"}
        terms = {name: np.zeros(self.model.dof) for name in ("motor_inertia", "viscous", "coulomb", "offset")}
        for parameter, value in zip(self.model.parameters, self.values, strict=True):
            if parameter.kind == "inertial" or (parameter.kind == "coupling") != of_pairs:
                continue
            kind = kinds[parameter.symbol] if parameter.kind == "coupling" else parameter.kind
            terms[kind][self.model.active.index(parameter.joint)] = value
        return JointTerms(terms["motor_inertia"], terms["viscous"], terms["coulomb"], terms["offset"])

    @cached_property
    def home(self) -> FloatArray:
        """(a,) a position within the limits of the joints with a motor: 0 where it is allowed, else the middle."""
        return np.array(
            [
                0.0 if low <= 0.0 <= high else 0.5 * (low + high)
                for low, high in (limits.position for limits in self.model.limits)
            ]
        )


def with_armature(arm: ExportedArm, armature: FloatArray) -> ExportedArm:
    """The arm with inertias (a,) [kg·m²] of motors that the measured torque does not carry, as simulators move them."""
    if not np.any(armature):
        return arm
    model = replace(
        arm.model,
        motor_inertia=tuple(bool(own or added) for own, added in zip(arm.model.motor_inertia, armature, strict=True)),
    )
    values = dict(zip((parameter.name for parameter in arm.model.parameters), arm.values.tolist(), strict=True))
    standard = np.array([values.get(parameter.name, 0.0) for parameter in model.parameters])
    for index, parameter in enumerate(model.parameters):
        if parameter.kind == "motor_inertia":
            standard[index] += armature[model.active.index(parameter.joint)]
    base = base_parameters(model)
    dynamics = InverseDynamics(model, base, base.projection @ standard, standard)
    return replace(arm, model=model, values=standard, dynamics=dynamics)


def refuse_unidentified_friction(names: Sequence[str], where: str) -> None:
    """Refuse friction that no recording determined: an export would pass a guess off as identified.

    Raises:
        ModelError: there is some.
    """
    if names:
        raise ModelError(
            f"the recording did not identify {', '.join(names)}, and an export would contain a guess instead",
            where=where,
            hint="record a motion that moves these joints, or give the value under 'known' in the robot file",
        )


def link_segments(arm: ExportedArm) -> dict[int, list[Segment]]:
    """Segments of every link by its number, the base's by `BASE_INDEX`; a sphere has one point twice.

    From the link's origin to those of the joints that hang on it, and of the last link to the tool.
    """
    model, workspace = arm.model, arm.robot_file.robot.workspace
    ends: dict[int, list[FloatArray]] = {index: [] for index in range(BASE_INDEX, len(model.joints))}
    for joint in model.joints:
        ends[joint.parent].append(joint.translation)
    ends[model.tool_link].append(np.array(workspace.tool, dtype=np.float64))
    origin, shapes = np.zeros(3), {}
    for link, points in ends.items():
        radius = workspace.radius_of(BASE if link == BASE_INDEX else model.link_names[link])
        long = [point for point in points if float(np.linalg.norm(point)) > SHORTEST_LINK]
        shapes[link] = [(origin, point, radius) for point in long] or [(origin, origin, radius)]
    return shapes


def pinocchio_arm(arm: ExportedArm) -> Any:
    """A `pinocchio.Model` of the tree: bodies, armature, damping, dry friction, limits, gravity; joints in our order.

    `pin.rnea` gives the torques of the links and of the armature. Pinocchio leaves friction to its user, and holds no
    offsets, no loops and no coupled motors.
    """
    model = arm.model
    result = pinocchio_model(model, arm.values[: LINK_SIZE * len(model.joints)])
    active, terms = list(model.active), arm.at_joints
    armature, damping, friction = (np.zeros(result.nv) for _ in range(3))
    velocity, effort = np.full(result.nv, np.inf), np.full(result.nv, np.inf)
    armature[active], damping[active], friction[active] = terms.inertia, terms.viscous, terms.coulomb
    velocity[active] = [limits.velocity for limits in model.limits]
    effort[active] = [np.inf if limits.torque is None else limits.torque for limits in model.limits]
    result.armature, result.damping, result.friction = armature, damping, friction
    result.velocityLimit, result.effortLimit = velocity, effort
    if hasattr(result, "lowerDryFrictionLimit"):  # since Pinocchio 4; the limits above are the upper ones
        result.lowerDryFrictionLimit = -friction
        result.lowerVelocityLimit, result.lowerEffortLimit = -velocity, -effort
    return result
