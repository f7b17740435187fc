"""How well a recorded motion excites an arm's base parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from daq.recording import Recording
from daq.robot import RobotFile
from drivers.errors import DataError, RobotFileError, UsageError
from ident.base_parameters import BaseParameters, base_parameters
from ident.joint_columns import combined
from ident.least_squares import excited_columns
from ident.measured import joint_positions
from ident.model import build_model
from ident.observation import Reduction, reduce_segments
from ident.preprocess import Prepared, PreprocessChoices, prepare
from ident.regressor import RegressorKernel
from ident.triangular import scaled_condition


@dataclass(frozen=True)
class ExcitationReached:
    """Figures of a recorded motion; lists have one entry a joint.

    Attributes:
        condition: of the filtered regressor, columns as they are.
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


def excitation_reached(recording: Recording, robot_file: RobotFile) -> ExcitationReached | None:
    """Figures of the recorded motion; None where the recording holds no motion that could be analysed."""
    try:
        motion = joint_positions(recording, robot_file.robot)
        prepared = prepare(motion.time, motion.position, np.zeros_like(motion.position), PreprocessChoices())
        model = build_model(robot_file)
    except (DataError, UsageError, RobotFileError):
        return None
    base = base_parameters(model)
    kernel = RegressorKernel(model, base.columns)
    reduction = reduce_segments(kernel, prepared.segments, prepared.parallel_filter)
    active = list(excited_base_columns(reduction, base, [prepared]))
    factor = reduction.stacked()[:, active]
    singular = np.linalg.svd(factor, compute_uv=False)
    speed = np.max([np.max(np.abs(segment.velocity), axis=1) for segment in prepared.segments], axis=0)
    limits = np.array([joint.velocity for joint in robot_file.robot.joints])
    return ExcitationReached(
        condition=float(singular[0] / singular[-1]) if len(active) else float("inf"),
        scaled_condition=scaled_condition(factor) if len(active) else float("inf"),
        unexcited=[base.names[i] for i in range(base.count) if i not in active],
        position_range=np.ptp(motion.position, axis=0).tolist(),
        velocity_reached=speed.tolist(),
        velocity_share_percent=(100.0 * speed / limits).tolist(),
    )


def excited_base_columns(reduction: Reduction, base: BaseParameters, parts: Sequence[Prepared]) -> tuple[int, ...]:
    """Base columns that the data can tell apart, without the friction of joints that stay at rest throughout.

    There sign(q̇) is the noise of the encoder: independent of everything, and no sign of friction.
    """

    def moves(column: int) -> bool:
        return any(
            bool(
                np.any(np.abs(combined(base.motions[column], segment.velocity)) >= (part.choices.rest_velocity or 0.0))
            )
            for part in parts
            for segment in part.segments
        )

    rubbing = ("viscous", "coulomb", "coupling")
    return tuple(column for column in excited_columns(reduction) if base.kinds[column] not in rubbing or moves(column))
