"""Rigid-body dynamics of an arm at its motors, one sample at a time: for simulation.

An arm without loops and coupling is Pinocchio's. With them, the tree follows the motors by q_tree = T·q_m + b with
T = G·R⁻¹, so that the motors' power equals that of the tree's joints (SR400 eq. 4 and 6):

    Γ_m = Tᵀ·Γ_tree(q_tree, T·q̇_m, T·q̈_m) + (Ia + I_pair)·q̈_m        M_m = Tᵀ·M_tree·T + Ia + I_pair

With general loops q_tree and T are functions of q_m, and the tree's accelerations are T·q̈_m + Ṫ·q̇_m.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.core.arrays import FloatArray
from ident.model.dynamic_model import DynamicModel
from ident.model.dynamics.pinocchio_model import pinocchio_model
from ident.model.kinematics.transmission import LinearTransmission, Transmission

if TYPE_CHECKING:
    from ident.model.kinematics.linkages.closed_loops import ClosedLoops, ClosedPose


class RigidArm(Protocol):
    """Links and motor inertias; arrays (n,), in the motors' coordinates, joint side.

    Attributes:
        armature: (n,) motor inertias [kg·m²]; may be changed.
    """

    armature: FloatArray

    def forward(self, position: FloatArray, velocity: FloatArray, torque: FloatArray) -> FloatArray:
        """Accelerations that torques [N·m] cause."""

    def inverse(self, position: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
        """Torques [N·m] that a motion needs."""

    def bias(self, position: FloatArray, velocity: FloatArray) -> FloatArray:
        """Torques [N·m] of a motion without acceleration: gravity, Coriolis and centrifugal."""

    def gravity(self, position: FloatArray) -> FloatArray:
        """Torques [N·m] that hold the arm."""

    def inertia(self, position: FloatArray) -> FloatArray:
        """Inertia matrix (n, n) with the motors' inertias [kg·m²]."""


def rigid_arm(
    model: DynamicModel, inertial: FloatArray, armature: FloatArray, pair_inertia: FloatArray | None = None
) -> RigidArm:
    """The arm of a model.

    Args:
        model: kinematics and gravity.
        inertial: (10·links,) parameters of its links.
        armature: (n,) motor inertias [kg·m²].
        pair_inertia: (n,) inertias that turn with a coupled joint, beside the motor's [kg·m²].
    """
    transmission = model.transmission
    if transmission.direct:
        return _Tree(model, inertial, armature)
    if isinstance(transmission, LinearTransmission):
        return _Linear(model, transmission, inertial, armature, pair_inertia)
    from ident.model.kinematics.linkages.closed_loops import ClosedLoops  # only arms that have such loops pay for it

    if isinstance(transmission, ClosedLoops):
        return _Closed(model, transmission, inertial, armature, pair_inertia)
    raise TypeError(f"no dynamics for {type(transmission).__name__}")


class _Tree:
    """Every joint of the tree has its own motor."""

    def __init__(self, model: DynamicModel, inertial: FloatArray, armature: FloatArray) -> None:
        import pinocchio as pin

        self._arm: Any = pinocchio_model(model, inertial)
        self._arm.armature = armature
        self._data = self._arm.createData()
        self._aba, self._rnea, self._crba = pin.aba, pin.rnea, pin.crba
        self._gravity, self._bias = pin.computeGeneralizedGravity, pin.nonLinearEffects
        self._depth_first, order = _numbered_depth_first(self._arm)
        self._depth_first_data = self._depth_first.createData()
        self._order, place = order, np.argsort(order)
        # `crba` writes the upper triangle: where each element of the arm's matrix stands in it.
        self._places = (np.minimum.outer(place, place), np.maximum.outer(place, place))

    @property
    def armature(self) -> FloatArray:
        return np.array(self._arm.armature)

    @armature.setter
    def armature(self, values: FloatArray) -> None:
        self._arm.armature = values

    def forward(self, position: FloatArray, velocity: FloatArray, torque: FloatArray) -> FloatArray:
        # Pinocchio hands out a view of its own memory.
        acceleration: FloatArray = self._aba(self._arm, self._data, position, velocity, torque).copy()
        return acceleration

    def inverse(self, position: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
        torque: FloatArray = self._rnea(self._arm, self._data, position, velocity, acceleration).copy()
        return torque

    def bias(self, position: FloatArray, velocity: FloatArray) -> FloatArray:
        torque: FloatArray = self._bias(self._arm, self._data, position, velocity).copy()
        return torque

    def gravity(self, position: FloatArray) -> FloatArray:
        return np.array(self._gravity(self._arm, self._data, position))

    def inertia(self, position: FloatArray) -> FloatArray:
        upper = self._crba(self._depth_first, self._depth_first_data, position[self._order])
        matrix: FloatArray = upper[self._places]
        matrix.flat[:: len(matrix) + 1] += self._arm.armature
        return matrix


def _numbered_depth_first(arm: Any) -> tuple[Any, NDArray[np.intp]]:
    """The same links with joints numbered depth first, as Pinocchio's `crba` demands, without motor inertias.

    Returns:
        The model, and the joint (from 0) of `arm` that each of its joints is.
    """
    import pinocchio as pin

    paths: list[tuple[int, ...]] = [()]
    for joint in range(1, arm.njoints):
        paths.append((*paths[arm.parents[joint]], joint))
    order = sorted(range(1, arm.njoints), key=paths.__getitem__)
    index = {0: 0} | {joint: position for position, joint in enumerate(order, start=1)}
    result = pin.Model()
    for joint in order:
        result.addJoint(index[arm.parents[joint]], arm.joints[joint], arm.jointPlacements[joint], arm.names[joint])
        result.inertias[index[joint]] = arm.inertias[joint]
    return result, np.array(order, dtype=np.intp) - 1


class _Constrained(ABC):
    """Joints follow, or motors are coupled."""

    def __init__(
        self,
        model: DynamicModel,
        transmission: Transmission,
        inertial: FloatArray,
        armature: FloatArray,
        pair_inertia: FloatArray | None,
    ) -> None:
        self._tree = _Tree(model, inertial, np.zeros(len(model.joints)))
        self._to_joints = np.linalg.inv(transmission.coupling)
        pair = np.zeros(model.dof) if pair_inertia is None else pair_inertia
        self._pair = self._to_joints.T @ np.diag(pair) @ self._to_joints
        self.armature = np.array(armature)

    @abstractmethod
    def _placed(self, position: FloatArray) -> tuple[FloatArray, FloatArray]:
        """T (n, a) and position (n,) of the tree for that (a,) of the motors."""

    @abstractmethod
    def _motion(
        self, position: FloatArray, velocity: FloatArray, acceleration: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """T (n, a) and position, velocity and acceleration (n,) of the tree for those (a,) of the motors."""

    def forward(self, position: FloatArray, velocity: FloatArray, torque: FloatArray) -> FloatArray:
        follow, *tree = self._motion(position, velocity, np.zeros_like(position))
        bias = follow.T @ self._tree.inverse(*tree)
        return np.asarray(np.linalg.solve(self._inertia(follow, tree[0]), torque - bias))

    def inverse(self, position: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
        follow, *tree = self._motion(position, velocity, acceleration)
        rotors = self.armature * acceleration + self._pair @ acceleration
        return np.asarray(follow.T @ self._tree.inverse(*tree) + rotors)

    def bias(self, position: FloatArray, velocity: FloatArray) -> FloatArray:
        follow, *tree = self._motion(position, velocity, np.zeros_like(position))
        return np.asarray(follow.T @ self._tree.inverse(*tree))

    def gravity(self, position: FloatArray) -> FloatArray:
        follow, tree = self._placed(position)
        return np.asarray(follow.T @ self._tree.gravity(tree))

    def inertia(self, position: FloatArray) -> FloatArray:
        return self._inertia(*self._placed(position))

    def _inertia(self, follow: FloatArray, tree: FloatArray) -> FloatArray:
        return np.asarray(follow.T @ self._tree.inertia(tree) @ follow + self._pair + np.diag(self.armature))


class _Linear(_Constrained):
    """Joints follow linearly, if any does."""

    def __init__(
        self,
        model: DynamicModel,
        transmission: LinearTransmission,
        inertial: FloatArray,
        armature: FloatArray,
        pair_inertia: FloatArray | None,
    ) -> None:
        super().__init__(model, transmission, inertial, armature, pair_inertia)
        self._follow = transmission.follow @ self._to_joints
        self._offset = transmission.offset

    def _placed(self, position: FloatArray) -> tuple[FloatArray, FloatArray]:
        return self._follow, self._follow @ position + self._offset

    def _motion(
        self, position: FloatArray, velocity: FloatArray, acceleration: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        follow = self._follow
        return follow, follow @ position + self._offset, follow @ velocity, follow @ acceleration


class _Closed(_Constrained):
    """Joints follow by closing equations, solved from where the arm was last."""

    def __init__(
        self,
        model: DynamicModel,
        transmission: ClosedLoops,
        inertial: FloatArray,
        armature: FloatArray,
        pair_inertia: FloatArray | None,
    ) -> None:
        super().__init__(model, transmission, inertial, armature, pair_inertia)
        self._loops = transmission
        self._pose: ClosedPose | None = None
        self._position = np.full(model.dof, np.nan)

    def _pose_at(self, position: FloatArray) -> ClosedPose:
        # A step of a simulation asks for the inertia and for several biases at one position.
        if self._pose is None or not np.array_equal(position, self._position):
            self._pose = self._loops.pose((self._to_joints @ position)[:, None], self._pose)
            self._position = position.copy()
        return self._pose

    def _placed(self, position: FloatArray) -> tuple[FloatArray, FloatArray]:
        pose = self._pose_at(position)
        return np.asarray(pose.follow[..., 0] @ self._to_joints), pose.tree[:, 0]

    def _motion(
        self, position: FloatArray, velocity: FloatArray, acceleration: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        follow, tree = self._placed(position)
        joints = [(self._to_joints @ values)[:, None] for values in (velocity, acceleration)]
        motion = self._loops.motion_at(self._pose_at(position), *joints)
        return follow, tree, motion.velocity[:, 0], motion.acceleration[:, 0]
