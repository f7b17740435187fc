"""Forces on links from torques at joints: the smallest that is noticed, and the wrench at the tool."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import FloatArray
from ident.model.dynamic_model import DynamicModel
from ident.model.dynamics.link_jacobian import LinkJacobians, link_end
from ident.monitor.thresholds import FAST, REST, SLOW, Thresholds

RESPONSE = 1000
"""Samples in which every observer has settled."""
NOTICEABLE = 0.02
"""A lever [m] below which a force does not act on a joint."""
WELL_CONDITIONED = 1e6
"""Largest ratio of the variances of a wrench that is given; beyond it joint torques say nothing of some direction."""


@dataclass(frozen=True)
class SmallestForce:
    """The smallest force on the far end of a link that is noticed, lasting `CONTACT`, in 95 % of the cases."""

    link: str  # by the joint that moves it
    # moving, resting: (3,) [N] along x, y and z of the base frame, either sign, all joints in motion, or all near rest
    # or a reversal; inf where no joint feels it. The median of the poses.
    moving: FloatArray
    resting: FloatArray
    worst: FloatArray  # (3,) the largest of the poses, in motion


def smallest_forces(
    model: DynamicModel, thresholds: Thresholds, tool: FloatArray, poses: FloatArray
) -> tuple[SmallestForce, ...]:
    """The smallest forces on every link at poses (K, n) [rad or m]."""
    places = LinkJacobians(model)
    moving, resting = np.max(thresholds.noticed[[SLOW, FAST]], axis=0), thresholds.noticed[REST]
    forces = np.empty((2, len(model.joints), len(poses), 3))
    for number, pose in enumerate(poses):
        places.move(pose)
        for link in range(len(model.joints)):
            lever = np.abs(places.jacobian(link, link_end(model, link, tool))[:3])
            for row, needed in enumerate((moving, resting)):
                forces[row, link, number] = force_noticed(lever, needed)
    with np.errstate(invalid="ignore"):
        middle = np.median(forces, axis=2)
    return tuple(
        SmallestForce(name, middle[0, link], middle[1, link], forces[0, link].max(axis=0))
        for link, name in enumerate(model.link_names)
    )


def force_noticed(lever: FloatArray, needed: FloatArray) -> FloatArray:
    """(3,) [N] the smallest force along each axis that gives some joint the torque (n,) it needs [N·m or N].

    Args:
        lever: (3, n) |∂point/∂joint| [m or 1].
        needed: (n,) of each joint.
    """
    with np.errstate(divide="ignore"):
        return np.asarray(np.min(np.where(lever > NOTICEABLE, needed / lever, np.inf), axis=1))


def expected_delay(thresholds: Thresholds, lag: float) -> float:
    """Time [s] from the begin of a force of twice the smallest until it is noticed.

    The observer needs it to reach half of a constant torque; half a sample period and the model's delay come on top.
    """
    response = thresholds.observer().apply(
        np.ones((RESPONSE, thresholds.spread.shape[1])), np.zeros(RESPONSE, dtype=bool)
    )
    samples = 1 + np.argmax(response > 0.5, axis=0).max()
    return float(samples * thresholds.period + lag - 0.5 * thresholds.period)


@dataclass(frozen=True)
class Wrench:
    """Force and moment that act on the tool, in the base frame."""

    force: FloatArray  # (3,) [N]
    moment: FloatArray  # (3,) about the tool point [N·m]
    covariance: FloatArray  # (6, 6) of both


def tool_wrench(jacobian: FloatArray, torque: FloatArray, spread: FloatArray) -> Wrench | None:
    """The wrench at the tool that explains external torques best, each weighted by its σ.

    Args:
        jacobian: (6, n) of the tool point.
        torque: (n,) external [N·m or N].
        spread: (n,) its σ.

    Returns:
        None where joint torques do not determine all six parts: fewer than six joints, or near a singular pose.
    """
    weighted = jacobian / spread
    information = weighted @ weighted.T
    values = np.linalg.eigvalsh(information)
    if values[0] <= 0.0 or values[-1] > WELL_CONDITIONED * values[0]:
        return None
    covariance = np.linalg.inv(information)
    wrench = covariance @ (weighted @ (torque / spread))
    return Wrench(wrench[:3], wrench[3:], np.asarray(covariance, dtype=np.float64))
