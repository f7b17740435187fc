"""What a format cannot hold of an arm, in sentences for its comment and for the command."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drivers.streams import FloatArray
from ident.export.arm import ExportedArm

STANDARD_GRAVITY = (0.0, 0.0, -9.81)
"""[m/s²] what simulators take where a file does not say it."""


def left_out_of_urdf(arm: ExportedArm) -> tuple[str, ...]:
    """What a URDF lacks; friction and limits of joints, and the bodies of links, are in it."""
    names, motors, joints = arm.model.joint_names, arm.motors, arm.at_joints
    coupled = np.array(arm.coupled)
    sentences = []
    if np.any(motors.inertia) or np.any(joints.inertia):
        values = np.where(coupled, motors.inertia, joints.inertia)
        sentences.append(f"motor inertia [kg·m²], to be added to the diagonal of M(q): {_listed(names, values)}")
    if np.any(motors.offset):
        sentences.append(f"constant offsets of the torque [N·m]: {_listed(names, motors.offset)}")
    if np.any(coupled):
        rows = "; ".join(
            f"motor of {names[motor]}: " + " + ".join(f"{factor:g}·{names[j]}" for j, factor in _entries(row))
            for motor, row in enumerate(arm.coupling)
            if coupled[motor]
        )
        sentences.append(
            f"coupled motors ({rows}), with their viscous friction [N·m·s/rad] "
            f"{_listed(names, motors.viscous, coupled)} and Coulomb friction [N·m] "
            f"{_listed(names, motors.coulomb, coupled)}"
        )
    if arm.closed:
        passive = [name for name in arm.model.link_names if name not in names]
        sentences.append(f"closed loops: {', '.join(passive)} have no motor and follow the others; here they are free")
    if not np.allclose(arm.model.gravity, STANDARD_GRAVITY, atol=0.01):
        gravity = " ".join(f"{value:g}" for value in arm.model.gravity)
        sentences.append(f"gravity, which is {gravity} m/s² in the base frame")
    unlimited = _without_torque_limit(arm)
    if unlimited:
        sentences.append(f"torque limits of {unlimited}, which are not known")
    return (*sentences, *_smoothing(arm))


def left_out_of_mjcf(arm: ExportedArm) -> tuple[str, ...]:
    """What an MJCF lacks."""
    unlimited = _without_torque_limit(arm)
    limits = [f"control limits of {unlimited}, whose torque limit is not known"] if unlimited else []
    return (
        "velocity and acceleration limits",
        "collision shapes: its capsules are there to be seen and touch nothing",
        *limits,
        *_smoothing(arm),
    )


def left_out_of_ros2_inertial(arm: ExportedArm) -> tuple[str, ...]:
    """What the inertial parameters alone lack."""
    rest = [name for name, closed in (("loops", arm.closed), ("coupled motors", any(arm.coupled))) if closed]
    return (f"everything but the links' bodies: {', '.join(['friction', 'motor inertia', 'offsets', *rest])}",)


def _without_torque_limit(arm: ExportedArm) -> str:
    return ", ".join(limits.name for limits in arm.model.limits if limits.torque is None)


def _smoothing(arm: ExportedArm) -> tuple[str, ...]:
    if not arm.model.smoothing:
        return ()
    return (f"the smoothing of Coulomb friction, tanh(q̇/ε) with ε = {arm.model.smoothing:g} rad/s",)


def _entries(row: FloatArray) -> list[tuple[int, float]]:
    return [(int(joint), float(row[joint])) for joint in np.flatnonzero(row)]


def _listed(names: Sequence[str], values: FloatArray, shown: FloatArray | None = None) -> str:
    """`j1 0.3, j2 0.12` of those that are shown and not 0."""
    kept = np.ones(len(names), dtype=bool) if shown is None else shown
    return ", ".join(f"{n} {v:.6g}" for n, v, keep in zip(names, values, kept, strict=True) if keep and v) or "0"
