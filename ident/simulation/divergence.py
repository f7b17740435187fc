"""Why a simulated motion diverges, in words: the joint, what it has to move, and what moved it."""

from __future__ import annotations

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import ModelError
from drivers.core.units import joint_unit
from ident.simulation.forward_arm import ForwardArm

FASTEST = 1e4
"""[rad/s or m/s] A velocity beyond which a simulation has diverged."""

ALTERNATIONS = 4
"""Successive changes of a torque's sign, step by step, that mark a controller as unstable with this step."""


def diverged(velocity: FloatArray) -> bool:
    """Whether a velocity (n,) is beyond all bounds, or no number."""
    return not bool(np.all(np.abs(velocity) < FASTEST))


def divergence(
    arm: ForwardArm, time: float, position: FloatArray, velocities: FloatArray, torques: FloatArray
) -> ModelError:
    """The error of a motion that has diverged.

    Args:
        arm: that was simulated.
        time: of the last velocity [s].
        position: (n,) before it.
        velocities: (N + 1, n) up to it, the last one beyond all bounds.
        torques: (N, n) of the steps.
    """
    inertia = arm.inertia(position)
    if not (np.isfinite(inertia).all() and np.isfinite(arm.bias(position, velocities[-2])).all()):
        return ModelError(
            f"the model gives no finite inertia or gravity at {time:.4g} s, whatever the torque",
            hint="look for lengths, masses or parameters of the result that are out of proportion",
        )
    joint = int(np.argmax(np.where(np.isfinite(velocities[-1]), np.abs(velocities[-1]), np.inf)))
    name = arm.joint_names[joint]
    speed, torque, mass = (joint_unit(unit, sliding=arm.sliding[joint]) for unit in ("rad/s", "N·m", "kg·m²"))
    moved = 1.0 / float(np.linalg.inv(inertia)[joint, joint])
    return ModelError(
        f"the simulated motion diverges at {time:.4g} s: {name} passes {FASTEST:g} {speed}, its inertia {moved:.2g} "
        f"{mass} there, the other joints free, its torque {torques[-1, joint]:.3g} {torque}",
        hint=_hint(arm, name, torques[-1 - ALTERNATIONS :, joint]),
    )


def _hint(arm: ForwardArm, name: str, torque: FloatArray) -> str:
    """What to do, from the last torques of the joint."""
    if name in arm.accelerated:
        return (
            "its viscous friction is negative and accelerates it: simulate the physically consistent model "
            '(parameters="consistent", the default)'
        )
    if len(torque) > ALTERNATIONS and np.all(torque[1:] * torque[:-1] < 0.0):
        return "the torque changes sign at every step: a shorter step, or softer gains for so little inertia"
    return "give a smaller torque, softer controller gains or a shorter step"
