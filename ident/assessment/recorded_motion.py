"""A recording's motion prepared once, for `dynid info`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from daq.recording.recording import Recording
from daq.robot.loader import RobotFile
from drivers.core.errors import DataError, DynidError, RobotFileError, UsageError
from ident.model.base_parameters import BaseParameters, base_parameters
from ident.model.dynamic_model import DynamicModel, build_model
from ident.model.regressor import RegressorKernel
from ident.regression.observation_matrix import Reduction, reduce_segments
from ident.signals.joint_signals import JointPositions, JointSignals, joint_positions, read_joint_signals
from ident.signals.options import PreprocessChoices
from ident.signals.pipeline import prepare
from ident.signals.prepared import Prepared
from ident.signals.segments import played_window


@dataclass(frozen=True)
class RecordedMotion:
    """A recorded motion beside the model of its arm.

    Attributes:
        robot_file: of the arm.
        model: of the arm.
        base: its base parameters.
        kernel: of their columns.
        positions: as recorded.
        measured: positions and torques as recorded; None where no torque is known.
        prepared: the played motion by the default choices, torque not shifted; the torque is 0 where none is known.
    """

    robot_file: RobotFile
    model: DynamicModel
    base: BaseParameters
    kernel: RegressorKernel
    positions: JointPositions
    measured: JointSignals | None
    prepared: Prepared

    @cached_property
    def reduction(self) -> Reduction:
        """Reduction of the prepared segments."""
        return reduce_segments(self.kernel, self.prepared.segments, self.prepared.parallel_filter)


def recorded_motion(recording: Recording, robot_file: RobotFile) -> RecordedMotion | None:
    """The motion of a recording; None where it holds none that could be analysed.

    Raises:
        IdentificationError: the number of the arm's base parameters cannot be decided.
    """
    try:
        positions = joint_positions(recording, robot_file.robot)
        measured = _measured(recording, robot_file)
        start, stop = played_window(recording)
        signals = _without_torque(positions) if measured is None else measured
        prepared = prepare(signals, PreprocessChoices(start=start, stop=stop))
        model = build_model(robot_file)
    except (DataError, UsageError, RobotFileError):
        return None
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
