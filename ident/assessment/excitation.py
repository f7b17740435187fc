"""How well a recorded motion excites an arm's base parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.assessment.recorded_motion import RecordedMotion
from ident.friction.table import FRICTION_KINDS
from ident.linear_algebra.triangular import scaled_condition
from ident.model.base_parameters import BaseParameters
from ident.model.joint_columns import combined
from ident.regression.least_squares import excited_columns
from ident.regression.observation_matrix import Reduction
from ident.signals.prepared import Prepared


@dataclass(frozen=True)
class ExcitationReached:
    """Figures of a recorded motion; lists have one entry per joint.

    Attributes:
        condition: of the filtered regressor, columns not normalised.
        scaled_condition: the same with columns of unit length.
        unexcited: names of the base parameters that the motion does not excite.
        position_range: largest minus smallest position [rad or m].
        velocity_reached: largest speed [rad/s or m/s].
        velocity_share_percent: the same, of the joint's limit [%].
    """

    condition: float
    scaled_condition: float
    unexcited: list[str]
    position_range: list[float]
    velocity_reached: list[float]
    velocity_share_percent: list[float]


def excitation_reached(motion: RecordedMotion) -> ExcitationReached:
    """Figures of a recorded motion."""
    base = motion.base
    active = list(excited_base_columns(motion.reduction, base, [motion.prepared]))
    factor = motion.reduction.stacked()[:, active]
    singular = np.linalg.svd(factor, compute_uv=False)
    speed = np.max([np.max(np.abs(segment.velocity), axis=1) for segment in motion.prepared.segments], axis=0)
    position = np.concatenate([segment.position for segment in motion.prepared.segments], axis=1)
    limits = np.array([joint.velocity for joint in motion.robot_file.robot.joints])
    return ExcitationReached(
        condition=float(singular[0] / singular[-1]) if len(active) else float("inf"),
        scaled_condition=scaled_condition(factor) if len(active) else float("inf"),
        unexcited=[base.names[i] for i in range(base.count) if i not in active],
        position_range=np.ptp(position, axis=1).tolist(),
        velocity_reached=speed.tolist(),
        velocity_share_percent=(100.0 * speed / limits).tolist(),
    )


def excited_base_columns(reduction: Reduction, base: BaseParameters, runs: Sequence[Prepared]) -> tuple[int, ...]:
    """Base columns that the data identify, without the friction of joints that rest throughout.

    There sign(q̇) is encoder noise: independent of everything, and unrelated to friction.
    """

    def moves(column: int) -> bool:
        return any(
            bool(np.any(np.abs(combined(base.motions[column], segment.velocity)) >= run.rest_velocity))
            for run in runs
            for segment in run.segments
        )

    rubbing = (*(kind for kind in FRICTION_KINDS if kind != "offset"), "coupling")
    return tuple(column for column in excited_columns(reduction) if base.kinds[column] not in rubbing or moves(column))
