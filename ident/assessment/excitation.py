"""A recorded motion prepared once, and how well it excites an arm's base parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from daq.recording.recording import Recording
from daq.robot.loader import RobotFile
from drivers.core.errors import DynidError
from ident.friction.table import FRICTION_KINDS
from ident.linear_algebra.triangular import scaled_condition
from ident.model.base_parameters import BaseParameters, base_parameters
from ident.model.dynamic_model import DynamicModel, build_model
from ident.model.joint_columns import combined
from ident.model.regressor import RegressorKernel
from ident.regression.least_squares import excited_columns
from ident.regression.observation_matrix import Reduction, reduce_segments
from ident.signals.joint_signals import JointPositions, JointSignals, joint_positions, read_joint_signals
from ident.signals.options import PreprocessChoices
from ident.signals.pipeline import prepare
from ident.signals.prepared import Prepared
from ident.signals.segments import played_window


@dataclass(frozen=True)
class RecordedMotion:
    """A recorded motion beside the model of its arm."""

    robot_file: RobotFile  # robot file of the arm
    model: DynamicModel  # dynamic model of the arm
    base: BaseParameters  # base parameters of the model
    kernel: RegressorKernel  # regressor of the base parameters' columns
    positions: JointPositions  # positions as recorded
    measured: JointSignals | None  # positions and torques as recorded; None where no torque is known
    # the played motion by the default choices, torque not shifted; the torque is 0 where none is known
    prepared: Prepared

    @cached_property
    def reduction(self) -> Reduction:
        """Reduction of the prepared segments."""
        return reduce_segments(self.kernel, self.prepared.segments, self.prepared.parallel_filter)


def recorded_motion(recording: Recording, robot_file: RobotFile) -> RecordedMotion:
    """The motion of a recording, prepared as `dynid identify` would.

    Raises:
        DataError, UsageError, RobotFileError: it holds none that can be analysed.
        IdentificationError: the number of the arm's base parameters cannot be decided.
    """
    positions = joint_positions(recording, robot_file.robot)
    measured = _measured(recording, robot_file)
    start, stop = played_window(recording)
    signals = _without_torque(positions) if measured is None else measured
    prepared = prepare(signals, PreprocessChoices(start=start, stop=stop))
    model = build_model(robot_file)
    base = base_parameters(model)
    kernel = RegressorKernel(model, base.columns)
    return RecordedMotion(robot_file, model, base, kernel, positions, measured, prepared)


def _without_torque(positions: JointPositions) -> JointSignals:
    torque = np.zeros_like(positions.position)
    return JointSignals(
        positions.label, positions.joint_names, positions.time, positions.position, torque, "no torque recorded"
    )


def _measured(recording: Recording, robot_file: RobotFile) -> JointSignals | None:
    try:
        return read_joint_signals(recording, robot_file.robot)
    except DynidError:  # no torque, or no gain that makes one of the motors' signals
        return None


@dataclass(frozen=True)
class ExcitationReached:
    """Figures of a recorded motion; lists have one entry per joint."""

    condition: float  # of the filtered regressor, columns not normalised
    scaled_condition: float  # the same with columns of unit length
    unexcited: list[str]  # names of the base parameters that the motion does not excite
    position_range: list[float]  # largest minus smallest position [rad or m]
    velocity_reached: list[float]  # largest speed [rad/s or m/s]
    velocity_share_percent: list[float]  # the same, of the joint's limit [%]


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
