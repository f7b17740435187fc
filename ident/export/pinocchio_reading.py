"""An exported URDF read again by Pinocchio, compared and simulated."""

from __future__ import annotations

from typing import Any
from xml.etree import ElementTree

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import ModelError
from ident.export.arm import ExportedArm
from ident.export.reading import (
    DURATION,
    STATES,
    ReadBack,
    Simulation,
    energy_gain,
    random_states,
    released,
    tracked_motion,
    tracking_error,
    tracking_gains,
    tree_torque_error,
)

SIMULATION_STEP = 0.001
"""[s]"""

LONGEST_TRAVEL = 2e-3
"""Travel [rad or m] in a step from which on it is cut into parts, `MOST_PARTS` at most."""

MOST_PARTS = 20

VISCOUS_SPEED = 1e-3
"""[rad/s or m/s] below which Coulomb friction is taken as viscous."""


def read_urdf(arm: ExportedArm, text: str) -> ReadBack:
    """Read a URDF's text, compare its torques with the model's, and simulate it as it is, with gravity as identified.

    Raises:
        ModelError: Pinocchio cannot read it.
    """
    import pinocchio as pin

    tree = _read(arm, text)
    error = _torque_error(tree, STATES)
    remark = "closed loops opened, joints without a motor driven too" if arm.closed else ""
    return ReadBack(f"Pinocchio {pin.__version__}", error, STATES, (_fall(tree), _track(tree)), remark)


def torque_error(arm: ExportedArm, text: str, states: int) -> float:
    """Largest difference of a URDF's torques from the model's at random states, over the largest torque.

    Compared is its `rnea` with its damping and friction, and with what it cannot hold added: motor inertia, offsets,
    coupled motors, and Gᵀ of closed loops.

    Raises:
        ModelError: Pinocchio cannot read it.
    """
    return _torque_error(_read(arm, text), states)


def _read(arm: ExportedArm, text: str) -> _Tree:
    import pinocchio as pin

    try:
        model = pin.buildModelFromXML(text)
    except Exception as error:  # Pinocchio raises several kinds, none of them public
        raise ModelError(f"Pinocchio does not read the URDF: {error}", where=arm.model.name) from error
    model.gravity.linear = arm.model.gravity
    return _Tree(arm, model, *_stated_friction(text, arm))


class _Tree:
    """The URDF's model with its friction, joints in the arm's order."""

    def __init__(self, arm: ExportedArm, model: Any, damping: FloatArray, friction: FloatArray) -> None:
        self.arm, self.model, self.data = arm, model, model.createData()
        self._braked = model.copy()
        self._braked_data = self._braked.createData()
        self.joints = [model.joints[model.getJointId(name)] for name in arm.model.link_names]
        self.place = [joint.idx_v for joint in self.joints]
        self.damping, self.friction = np.zeros(model.nv), np.zeros(model.nv)
        self.damping[self.place], self.friction[self.place] = damping, friction
        index = np.arange(model.nv)
        self._upper = (np.minimum.outer(index, index), np.maximum.outer(index, index))  # of what `crba` writes

    def configuration(self, position: FloatArray) -> FloatArray:
        """Pinocchio's (nq,) of positions (n,): a continuous joint is a cosine and a sine."""
        values = np.zeros(self.model.nq)
        for joint, value in zip(self.joints, position, strict=True):
            values[joint.idx_q : joint.idx_q + joint.nq] = (np.cos(value), np.sin(value)) if joint.nq == 2 else (value,)
        return values

    def vector(self, values: FloatArray) -> FloatArray:
        """Pinocchio's (nv,) of velocities or accelerations (n,)."""
        ordered = np.zeros(self.model.nv)
        ordered[self.place] = values
        return ordered

    def inertia(self, q: FloatArray) -> FloatArray:
        """Inertia matrix (nv, nv)."""
        import pinocchio as pin

        return np.asarray(pin.crba(self.model, self.data, q)[self._upper])

    def step(
        self, q: FloatArray, v: FloatArray, torque: FloatArray, duration: float = SIMULATION_STEP
    ) -> tuple[FloatArray, FloatArray]:
        """One step of the semi-implicit Euler method, implicit in friction, which stiff joints need."""
        import pinocchio as pin

        # (M + h·B)·v⁺ = M·v + h·(τ − bias), solved as the forward dynamics of an arm with h·B more armature.
        braking = self.damping + self.friction / np.maximum(np.abs(v), VISCOUS_SPEED)
        self._braked.armature = self.model.armature + duration * braking
        moved = v + duration * pin.aba(self._braked, self._braked_data, q, v, torque - braking * v)
        return pin.integrate(self.model, q, duration * moved), moved


def _torque_error(tree: _Tree, states: int) -> float:
    import pinocchio as pin

    arm = tree.arm
    active = random_states(arm, states)
    motion = arm.model.tree_motion(*active)
    torque = np.array(
        [
            pin.rnea(tree.model, tree.data, tree.configuration(a), tree.vector(b), tree.vector(c))[tree.place]
            for a, b, c in zip(motion.position.T, motion.velocity.T, motion.acceleration.T, strict=True)
        ]
    ).T
    torque += tree.damping[tree.place][:, None] * motion.velocity
    torque += tree.friction[tree.place][:, None] * arm.model.coulomb_direction(motion.velocity)
    return tree_torque_error(arm, torque, active)


def _stated_friction(text: str, arm: ExportedArm) -> tuple[FloatArray, FloatArray]:
    """Damping and friction (n,) as the URDF's text states them."""
    # Of the robot's own joints: those of a transmission or a ros2_control section are elements `joint` too.
    stated = {joint.get("name", ""): joint.find("dynamics") for joint in ElementTree.fromstring(text).findall("joint")}
    values = np.zeros((2, len(arm.model.joints)))
    for index, name in enumerate(arm.model.link_names):
        element = stated.get(name)
        if element is not None:
            values[:, index] = float(element.get("damping", "0")), float(element.get("friction", "0"))
    return values[0], values[1]


def _fall(tree: _Tree) -> Simulation:
    """Unpowered."""
    import pinocchio as pin

    arm = tree.arm
    q, v = tree.configuration(arm.model.tree_position(released(arm)[:, None])[:, 0]), np.zeros(tree.model.nv)
    energies, nothing = [], np.zeros(tree.model.nv)
    for _ in range(round(DURATION / SIMULATION_STEP)):
        kinetic = pin.computeKineticEnergy(tree.model, tree.data, q, v)
        energies.append((kinetic, pin.computePotentialEnergy(tree.model, tree.data, q)))
        # Without friction a light wrist turns so fast that a whole step would gain energy.
        parts = int(np.clip(np.ceil(np.abs(v).max() * SIMULATION_STEP / LONGEST_TRAVEL), 1, MOST_PARTS))
        for _ in range(parts):
            q, v = tree.step(q, v, nothing, SIMULATION_STEP / parts)
        if not (np.all(np.isfinite(q)) and np.all(np.isfinite(v))):
            return Simulation("unpowered", finite=False)
    kinetic, potential = np.array(energies).T
    return Simulation("unpowered", finite=True, energy_gain=energy_gain(kinetic + potential, kinetic))


def _track(tree: _Tree) -> Simulation:
    """Track the motion with its torque, friction included, and a controller."""
    import pinocchio as pin

    arm = tree.arm
    time = np.asarray(SIMULATION_STEP * np.arange(round(DURATION / SIMULATION_STEP)), dtype=np.float64)
    active = tracked_motion(arm, time)
    motion = arm.model.tree_motion(*active)
    q, v = tree.configuration(motion.position[:, 0]), tree.vector(motion.velocity[:, 0])
    amplitude = tree.vector(np.ptp(motion.position, axis=1))
    stiffness, damping = tracking_gains(tree.inertia(q), tree.friction, amplitude)
    positions = np.empty_like(motion.position)
    for sample in range(len(time)):
        wanted = tree.configuration(motion.position[:, sample])
        rate, change = tree.vector(motion.velocity[:, sample]), tree.vector(motion.acceleration[:, sample])
        away = pin.difference(tree.model, q, wanted)
        positions[:, sample] = motion.position[:, sample] - away[tree.place]
        torque = pin.rnea(tree.model, tree.data, wanted, rate, change)
        torque += tree.damping * rate + tree.friction * np.sign(rate)
        torque += stiffness @ away + damping @ (rate - v)
        q, v = tree.step(q, v, torque)
        if not (np.all(np.isfinite(q)) and np.all(np.isfinite(v))):
            return Simulation("tracking", finite=False)
    moving = list(arm.model.active)
    return Simulation(
        "tracking", finite=True, tracking_error=tracking_error(positions[moving], motion.position[moving])
    )
