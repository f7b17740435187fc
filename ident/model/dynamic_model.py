"""The dynamic model of an arm: joints, gravity, standard parameters and their order.

Column order, everywhere: ten inertial parameters a link, links in the order of the robot file's joints,

    XX1 XY1 XZ1 YY1 YZ1 ZZ1 MX1 MY1 MZ1 M1  XX2 … M2  …

then motor inertias `Ia` and the friction of `ident.friction.table` (viscous `Fv`, Coulomb `Fs`, offset `Fo`, …), each
for those joints that have it. Inertias are about the origin of the joint's frame and in its axes, MX MY MZ are the
first moments there (SR400 .3.1). A motor that several joints move has `Fvm` and `Fsm` in place of `Fv` and `Fs`; the
latter two are then the joint's own friction (SR400 eq. 8) and come last, after the joint's inertia
`Iac` where there is one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from daq.robot.loader import RobotFile
from daq.robot.schema import JointLimits, Robot
from drivers.core.arrays import FloatArray
from drivers.core.errors import DataError
from ident.friction.table import TERMS, Need
from ident.friction.terms import NO_TERMS, FrictionTerms
from ident.model.kinematics.joints import Joint
from ident.model.kinematics.loops import build_transmission, main_chain
from ident.model.kinematics.mdh import mdh_joints
from ident.model.kinematics.transmission import Transmission, TreeMotion
from ident.model.kinematics.urdf import urdf_joints, urdf_order
from ident.model.parameters import INERTIAL, JOINT_SYMBOLS, MOTOR_SYMBOLS, PAIR_SYMBOLS, StandardParameter


@dataclass(frozen=True)
class DynamicModel:
    """An arm whose torque is linear in its standard parameters."""

    name: str  # of the robot
    joints: tuple[Joint, ...]  # the tree
    limits: tuple[JointLimits, ...]  # of each joint with a motor
    gravity: FloatArray  # (3,) [m/s²] in the base frame
    # motor_inertia, viscous, coulomb, offset: whether each motor has that column
    motor_inertia: tuple[bool, ...]
    viscous: tuple[bool, ...]
    coulomb: tuple[bool, ...]
    offset: tuple[bool, ...]
    transmission: Transmission  # between the tree's joints, those with a motor, and the motors
    smoothing: float = 0.0  # ε [rad/s] of tanh(q̇/ε) in the Coulomb column (ROCR6 eq. 4); 0 for sign(q̇) (SR400 eq. 7)
    terms: FrictionTerms = NO_TERMS  # friction beside viscous, Coulomb and offset, and shapes
    # (name of a Coulomb parameter, pre-sliding travel [rad or m]) of each motion that has one: along a motion in time
    # its dry friction follows Dahl's state (`ident.model.presliding`), else sign(q̇)
    presliding: tuple[tuple[str, float], ...] = ()

    @property
    def active(self) -> tuple[int, ...]:
        """Indices of the tree's joints that have a motor, in the order of every array."""
        return self.transmission.active

    @property
    def dof(self) -> int:
        """Number of joints with a motor."""
        return len(self.active)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints with a motor, in order."""
        return tuple(self.joints[index].name for index in self.active)

    @property
    def sliding(self) -> tuple[bool, ...]:
        """Return whether each joint with a motor slides: forces [N] and metres in place of torques and radians."""
        return tuple(self.joints[index].prismatic for index in self.active)

    @property
    def link_names(self) -> tuple[str, ...]:
        """Names of all joints of the tree, in order."""
        return tuple(joint.name for joint in self.joints)

    def tree_position(self, position: FloatArray) -> FloatArray:
        """Positions (n, …) of the tree's joints for positions (dof, …) of those with a motor [rad or m]."""
        return self.transmission.tree_position(position)

    def tree_velocity(self, position: FloatArray, velocity: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Positions and velocities (n, N) of the tree's joints for those (dof, N) of the joints with a motor."""
        return self.transmission.tree_velocity(position, velocity)

    def tree_motion(self, position: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> TreeMotion:
        """The tree's motion for positions, velocities and accelerations (dof, N) of the joints with a motor."""
        return self.transmission.tree_motion(position, velocity, acceleration)

    def active_gradient(self, position: FloatArray, gradient: FloatArray) -> FloatArray:
        """Derivatives (…, dof, N) by the positions of the joints with a motor, from those (…, n, N) by the tree's.

        Args:
            position: (dof, N) of the joints with a motor, where the derivatives are taken.
            gradient: (…, n, N).
        """
        return self.transmission.active_gradient(position, gradient)

    @property
    def tool_link(self) -> int:
        """Index of the link that carries the tool: the last one; behind the longest chain where loops add rods."""
        if not self.transmission.closed:
            return len(self.joints) - 1
        return main_chain(self.joints, self.active)[-1]

    @cached_property
    def parameters(self) -> tuple[StandardParameter, ...]:
        """The standard parameters in column order."""
        inertial = [
            StandardParameter(f"{symbol}{index + 1}", "inertial", index, symbol)
            for index in range(len(self.joints))
            for symbol in INERTIAL
        ]
        coupled = self.transmission.coupled
        of_joints = []
        for kind, plain in JOINT_SYMBOLS.items():
            for index, several, present in zip(self.active, coupled, self.has(kind), strict=True):
                symbol = MOTOR_SYMBOLS.get(plain, plain) if several else plain
                if present:
                    of_joints.append(StandardParameter(f"{symbol}{index + 1}", kind, index, symbol))
        return tuple(inertial + of_joints + self._pair_parameters())

    def _pair_parameters(self) -> list[StandardParameter]:
        """Inertia and friction that turn with a coupled joint, beside its motor's."""
        friction, inertia = self.transmission.pair_friction, self.transmission.pair_inertia
        present = {"motor_inertia": inertia, "viscous": friction, "coulomb": friction}
        return [
            StandardParameter(f"{symbol}{index + 1}", "coupling", index, symbol)
            for symbol, quantity in PAIR_SYMBOLS.items()
            for motor, index in enumerate(self.active)
            if present[quantity][motor] and getattr(self, quantity)[motor]
        ]

    def has(self, kind: str) -> tuple[bool, ...]:
        """Return whether each motor has a column of this kind."""
        if kind == "inertial":
            return (True,) * self.dof
        if kind not in ("motor_inertia", "viscous", "coulomb", "offset"):
            return tuple(kind != "coupling" and self.terms.has(kind, motor) for motor in range(self.dof))
        present: tuple[bool, ...] = getattr(self, kind)
        return present

    def needs(self, condition: Need) -> tuple[bool, ...]:
        """Return whether each motor's friction depends on the load torque, the temperature or the position."""
        kinds = [term.kind for term in TERMS if term.needs == condition]
        return tuple(any(self.terms.has(kind, motor) for kind in kinds) for motor in range(self.dof))

    @cached_property
    def needs_temperature(self) -> bool:
        """Return whether its friction depends on the temperature."""
        return any(self.needs("temperature"))

    @property
    def needs_load_torque(self) -> bool:
        """Return whether its friction depends on the load."""
        return any(self.needs("load"))

    @property
    def needs_position(self) -> bool:
        """Return whether its friction depends on the position, by itself or by the load."""
        return self.needs_load_torque or any(self.needs("position"))

    def require_temperature(self, temperature: FloatArray | None, where: str = "") -> None:
        """Refuse joint temperatures (n, …) [K] that lack those of joints whose friction depends on them.

        Raises:
            DataError: names the joints.
        """
        if not self.needs_temperature:
            return
        lacking = [
            name
            for index, (name, needed) in enumerate(zip(self.joint_names, self.needs("temperature"), strict=True))
            if needed and (temperature is None or not np.all(np.isfinite(temperature[index])))
        ]
        if lacking:
            raise DataError(
                f"the temperature of {', '.join(lacking)} is missing, which the friction depends on",
                where=where,
                hint="record it, or identify without the friction term 'temperature'",
            )

    def coulomb_direction(self, velocity: FloatArray) -> FloatArray:
        """The Coulomb column: sign(q̇), or tanh(q̇/ε) where smoothing is set; same shape as `velocity`."""
        return np.tanh(velocity / self.smoothing) if self.smoothing > 0 else np.sign(velocity)


def build_model(robot_file: RobotFile) -> DynamicModel:
    """The dynamic model that a robot file describes.

    Raises:
        RobotFileError: the URDF and the file's joints do not fit together, or a loop does not close.
    """
    robot = robot_file.robot
    if robot.model.mdh is not None:
        joints = mdh_joints(robot.model.mdh)
    else:
        where = f"{robot_file.where}: {robot.model.urdf}"
        urdf, names = robot_file.urdf_text or "", robot.joint_names
        if robot.passive_names:
            names = urdf_order(urdf, (*names, *robot.passive_names), robot.model.locked, where)
        joints = urdf_joints(urdf, names, robot.model.locked, where)
    return DynamicModel(
        name=robot.name,
        joints=joints,
        limits=robot.joints,
        gravity=np.array(robot.model.gravity),
        motor_inertia=tuple(robot.drive(name).inertia for name in robot.joint_names),
        viscous=_friction(robot, "viscous"),
        coulomb=_friction(robot, "coulomb"),
        offset=_friction(robot, "offset"),
        smoothing=robot.friction.smoothing,
        transmission=build_transmission(robot_file, joints),
    )


def _friction(robot: Robot, column: Literal["viscous", "coulomb", "offset"]) -> tuple[bool, ...]:
    friction = robot.friction
    of_arm = friction.offset if column == "offset" else column in friction.base.split("-")
    present = []
    for name in robot.joint_names:
        exception = getattr(friction.joints[name], column) if name in friction.joints else None
        present.append(of_arm if exception is None else exception)
    return tuple(present)
