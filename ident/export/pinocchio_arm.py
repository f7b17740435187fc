"""The exported arm as a `pinocchio.Model`."""

from __future__ import annotations

from typing import Any

import numpy as np

from ident.export.arm import ExportedArm
from ident.model.dynamics.pinocchio_model import pinocchio_model
from ident.model.parameters import LINK_SIZE


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
