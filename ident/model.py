"""The dynamic model of an arm: its joints, gravity, and which parameters it has.

Column order, everywhere: ten inertial parameters a link, links in the order of the robot file's joints,

    XX1 XY1 XZ1 YY1 YZ1 ZZ1 MX1 MY1 MZ1 M1  XX2 … M2  …

then motor inertias `Ia`, viscous `Fv`, Coulomb `Fs` and offset `Fo`, each for those joints that have it. Inertias are
about the origin of the joint's frame and in its axes, MX MY MZ are the first moments there (SR400 §3.1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from daq.robot import JointLimits, Robot, RobotFile
from drivers.errors import RobotFileError
from ident.kinematics import FloatArray, Joint
from ident.mdh import mdh_joints
from ident.urdf import urdf_joints

INERTIAL = ("XX", "XY", "XZ", "YY", "YZ", "ZZ", "MX", "MY", "MZ", "M")
"""The ten standard inertial parameters of a link, in column order [kg·m², kg·m, kg] (SR400 §3.1)."""

Kind = Literal["inertial", "motor_inertia", "viscous", "coulomb", "offset"]
KIND_SYMBOLS: dict[Kind, str] = {"motor_inertia": "Ia", "viscous": "Fv", "coulomb": "Fs", "offset": "Fo"}
"""Symbols of the joint parameters, in column order (SR400 eq. 6-7; Fo as f_o in AUBO eq. 6)."""


@dataclass(frozen=True)
class StandardParameter:
    """One column of the standard regressor.

    Attributes:
        name: as in the papers (`XX2`, `Fv1`); numbered from 1 in the robot file's order.
        kind: what it is.
        joint: number of its joint, from 0.
        symbol: the name without the number.
    """

    name: str
    kind: Kind
    joint: int
    symbol: str


@dataclass(frozen=True)
class DynamicModel:
    """An arm whose torque is linear in its standard parameters.

    Attributes:
        name: of the robot.
        joints: the tree.
        limits: of each joint.
        gravity: (3,) [m/s²] in the base frame.
        motor_inertia, viscous, coulomb, offset: whether each joint has that column.
        smoothing: ε [rad/s] of tanh(q̇/ε) in the Coulomb column (ROCR6 eq. 4); 0 for sign(q̇) (SR400 eq. 7).
    """

    name: str
    joints: tuple[Joint, ...]
    limits: tuple[JointLimits, ...]
    gravity: FloatArray
    motor_inertia: tuple[bool, ...]
    viscous: tuple[bool, ...]
    coulomb: tuple[bool, ...]
    offset: tuple[bool, ...]
    smoothing: float = 0.0

    @property
    def dof(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints, in order."""
        return tuple(joint.name for joint in self.joints)

    @property
    def parameters(self) -> tuple[StandardParameter, ...]:
        """The standard parameters in column order."""
        inertial = [
            StandardParameter(f"{symbol}{number + 1}", "inertial", number, symbol)
            for number in range(self.dof)
            for symbol in INERTIAL
        ]
        of_joints = [
            StandardParameter(f"{symbol}{number + 1}", kind, number, symbol)
            for kind, symbol in KIND_SYMBOLS.items()
            for number, present in enumerate(self.has(kind))
            if present
        ]
        return tuple(inertial + of_joints)

    def has(self, kind: Kind) -> tuple[bool, ...]:
        """Whether each joint has a column of this kind."""
        if kind == "inertial":
            return (True,) * self.dof
        present: tuple[bool, ...] = getattr(self, kind)
        return present

    def coulomb_direction(self, velocity: FloatArray) -> FloatArray:
        """The Coulomb column: sign(q̇), or tanh(q̇/ε) where smoothing is set; same shape as `velocity`."""
        return np.tanh(velocity / self.smoothing) if self.smoothing > 0 else np.sign(velocity)


def build_model(robot_file: RobotFile) -> DynamicModel:
    """The dynamic model that a robot file describes.

    Raises:
        RobotFileError: the URDF and the file's joints do not fit together.
    """
    robot = robot_file.robot
    if robot.model.mdh is not None:
        joints = mdh_joints(robot.model.mdh)
    else:
        where = f"{robot.name}: {robot.model.urdf}"
        joints = urdf_joints(robot_file.urdf_text or "", robot.joint_names, robot.model.locked, where)
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
    )


def _friction(robot: Robot, column: Literal["viscous", "coulomb", "offset"]) -> tuple[bool, ...]:
    friction = robot.friction
    of_arm = friction.offset if column == "offset" else column in friction.model.split("-")
    present = []
    for name in robot.joint_names:
        exception = getattr(friction.joints[name], column) if name in friction.joints else None
        present.append(of_arm if exception is None else exception)
    return tuple(present)


def truth_vector(robot_file: RobotFile) -> FloatArray:
    """True standard parameters (p,) of a simulated arm, in column order.

    Raises:
        RobotFileError: the file's truth names no link for some joint.
    """
    robot = robot_file.robot
    model = build_model(robot_file)
    missing = [name for name in robot.joint_names if name not in robot.truth.links]
    if missing:
        raise RobotFileError(f"no true link for joint(s) {', '.join(missing)}", where=f"{robot.name}: truth.links")
    values = {}
    for number, name in enumerate(robot.joint_names):
        link = robot.truth.links[name]
        for symbol, value in zip(INERTIAL, link_parameters(link.mass, link.com, link.inertia), strict=True):
            values[f"{symbol}{number + 1}"] = value
        joint = robot.truth.joints.get(name)
        for kind, symbol in KIND_SYMBOLS.items():
            values[f"{symbol}{number + 1}"] = getattr(joint, kind) if joint is not None else 0.0
    return np.array([values[parameter.name] for parameter in model.parameters])


def link_parameters(mass: float, com: Sequence[float], inertia: Sequence[float]) -> FloatArray:
    """Ten standard parameters (10,) of a link from its mass [kg], centre of mass (3,) [m] and the inertia there.

    `inertia` is xx, xy, xz, yy, yz, zz about the centre of mass [kg·m²]; the parallel-axis theorem moves it to the
    joint frame's origin.
    """
    x, y, z = com
    xx, xy, xz, yy, yz, zz = inertia
    about_origin = [
        xx + mass * (y * y + z * z),
        xy - mass * x * y,
        xz - mass * x * z,
        yy + mass * (x * x + z * z),
        yz - mass * y * z,
        zz + mass * (x * x + y * y),
    ]
    return np.array([*about_origin, mass * x, mass * y, mass * z, mass])
