"""What a format cannot hold of an arm, in sentences for its comment and for the command."""

from __future__ import annotations

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.units import joint_unit
from ident.export.arm import ExportedArm

STANDARD_GRAVITY = (0.0, 0.0, -9.81)
"""[m/s²] what simulators take where a file does not say it."""


def left_out_of_urdf(arm: ExportedArm) -> tuple[str, ...]:
    """Return what a URDF lacks; friction and limits of joints, and the bodies of links, are in it."""
    joints = arm.at_joints
    coupled = np.array(arm.coupled)
    sentences = []
    if np.any(joints.inertia):
        sentences.append(f"motor inertia, to be added to the diagonal of M(q): {_listed(arm, joints.inertia, 'kg·m²')}")
    if np.any(joints.offset):
        sentences.append(f"constant offsets of the torque: {_listed(arm, joints.offset, 'N·m')}")
    if np.any(coupled):
        sentences.append(f"coupled motors: {'; '.join(_motor(arm, int(motor)) for motor in np.flatnonzero(coupled))}")
    if arm.closed:
        passive = [name for name in arm.model.link_names if name not in arm.model.joint_names]
        sentences.append(f"closed loops: {', '.join(passive)} have no motor and follow the others; here they are free")
    if not np.allclose(arm.model.gravity, STANDARD_GRAVITY, atol=0.01):
        gravity = " ".join(f"{value:g}" for value in arm.model.gravity)
        sentences.append(f"gravity, which is {gravity} m/s² in the base frame")
    unlimited = _without_torque_limit(arm)
    if unlimited:
        sentences.append(f"torque limits of {unlimited}, which are not known")
    return (*sentences, *_unusual_friction(arm))


def left_out_of_mjcf(arm: ExportedArm) -> tuple[str, ...]:
    """Return what an MJCF lacks."""
    unlimited = _without_torque_limit(arm)
    limits = [f"control limits of {unlimited}, whose torque limit is not known"] if unlimited else []
    return (
        "velocity and acceleration limits",
        "collision shapes: its capsules are visual only",
        *limits,
        *_unusual_friction(arm),
    )


def left_out_of_ros2_inertial(arm: ExportedArm) -> tuple[str, ...]:
    """Return what the inertial parameters alone lack."""
    rest = [name for name, closed in (("loops", arm.closed), ("coupled motors", any(arm.coupled))) if closed]
    return (f"everything but the links' bodies: {', '.join(['friction', 'motor inertia', 'offsets', *rest])}",)


def _without_torque_limit(arm: ExportedArm) -> str:
    return ", ".join(limits.name for limits in arm.model.limits if limits.torque is None)


def _unusual_friction(arm: ExportedArm) -> tuple[str, ...]:
    if not arm.model.smoothing:
        return arm.further_friction
    smoothing = f"the smoothing of Coulomb friction, tanh(q̇/ε) with ε = {arm.model.smoothing:g} rad/s"
    return (smoothing, *arm.further_friction)


def _motor(arm: ExportedArm, motor: int) -> str:
    """`the motor of j6 (1·j5 + 1·j6: inertia 0.3 kg·m², …)`."""
    names, terms, row = arm.model.joint_names, arm.motors, arm.coupling[motor]
    motion = " + ".join(f"{row[joint]:g}·{names[joint]}" for joint in np.flatnonzero(row))
    mass, rate, torque = (joint_unit(unit, sliding=arm.model.sliding[motor]) for unit in ("kg·m²", "N·m·s/rad", "N·m"))
    return (
        f"the motor of {names[motor]} ({motion}: inertia {terms.inertia[motor]:.6g} {mass}, viscous friction "
        f"{terms.viscous[motor]:.6g} {rate}, Coulomb friction {terms.coulomb[motor]:.6g} {torque}, offset "
        f"{terms.offset[motor]:.6g} {torque})"
    )


def _listed(arm: ExportedArm, values: FloatArray, unit: str) -> str:
    """`j1 0.3 kg·m², j2 0.12 kg` of the joints whose value is not 0; the unit is that of a turning joint."""
    joints = zip(arm.model.joint_names, arm.model.sliding, values, strict=True)
    return ", ".join(
        f"{name} {value:.6g} {joint_unit(unit, sliding=slides)}" for name, slides, value in joints if value
    )
