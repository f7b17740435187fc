"""What an identified model says of a recording: torque, its parts, their standard deviation, and what remains."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import get_args

import numpy as np

from daq.recording.recording import JOINTS_STREAM, Recording
from daq.robot.loader import RobotFile
from drivers.core.arrays import FloatArray
from drivers.core.units import ZERO_CELSIUS
from ident.identify.data_split import RunWindow
from ident.identify.revalidate import stored_choices, used_share
from ident.model.another_arm import check_arm
from ident.result.graded import robots_of
from ident.result.models.model import Model, TorquePart
from ident.signals.joint_signals import JointSignals, joint_positions, joint_temperature, read_joint_signals
from ident.signals.pipeline import prepare
from ident.signals.prepared import Prepared, Segment

PARTS: tuple[TorquePart, ...] = get_args(TorquePart)
"""M(q)·q̈ with motor inertia; C(q, q̇)·q̇; g(q); friction with offsets. Together they are the predicted torque."""


@dataclass(frozen=True, eq=False)
class SegmentPrediction:
    """The torques of one gap-free segment, N samples of n joints, at the joints."""

    time: FloatArray  # (N,) the recording's clock [s]
    rate: float  # [Hz]
    # position, velocity, acceleration: (N, n) low-passed as at the identification [rad, rad/s, rad/s² or m…]
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    parts: dict[TorquePart, FloatArray]  # (N, n) of each part [N·m or N]; their sum is the prediction
    std: FloatArray  # (N, n) standard deviation σ of the prediction from that of the parameters [N·m or N]
    # (N, n) recorded torque, shifted by the delay, not filtered; None where none was recorded [N·m or N]
    measured: FloatArray | None
    # (N, n) measured minus predicted, both through the torque filter of the identification; None likewise
    residual: FloatArray | None

    @property
    def torque(self) -> FloatArray:
        """Predicted torque (N, n) [N·m or N]."""
        return np.asarray(sum(self.parts.values()))


@dataclass(frozen=True, eq=False)
class RecordingPrediction:
    """All segments of a recording."""

    segments: tuple[SegmentPrediction, ...]  # in order of time
    # (n,) standard deviation of the filtered torque's residual at the identification [N·m or N]; None where the result
    # does not know it of every joint
    noise: FloatArray | None
    torque_origin: str  # where the recorded torque comes from; empty where none was recorded
    steps: tuple[str, ...]  # how the recording was processed, a sentence per step
    presliding: bool  # whether dry friction follows Dahl's model near velocity reversals
    overlap: float  # share of the recorded samples that the model was identified from; 0 where no torque is recorded


def predict_recording(model: Model, robot_file: RobotFile, recording: Recording) -> RecordingPrediction:
    """Predict the torques of a recording, filters and delay as at the identification, samples at rest included.

    Args:
        model: what predicts.
        robot_file: of its result; its drive gains turn a recorded signal into torque.
        recording: of the same arm.

    Raises:
        DataError: the recording lacks positions, a joint, or a gain, or is of another arm.
        ModelError: a parameter without a value acts on the motion.
        ResultFileError: the result holds no covariance.
    """
    check_arm([recording], robot_file, robots_of(model.result.recordings))
    signals = _signals(recording, robot_file)
    model.require_temperature(signals.temperature, signals.label)
    choices = replace(stored_choices(model.result), keep_rest=True)
    prepared = prepare(signals, choices)
    segments = tuple(_predicted(model, prepared, segment, signals) for segment in prepared.segments)
    deviations = model.result.residuals.joint_std
    complete = len(deviations) == model.dof and all(value is not None for value in deviations)
    noise = model.coupling.T**2 @ np.square(np.array(deviations, dtype=np.float64)) if complete else None
    return RecordingPrediction(
        segments=segments,
        noise=None if noise is None else np.sqrt(noise),
        torque_origin=signals.torque_origin,
        steps=(
            *(f"{step.name}: {step.text}" for step in prepared.steps if step.name != "parallel filter"),
            *(
                [
                    f"friction: holds the weight of {', '.join(model.confounded)}, which no motion separates from "
                    "the offset"
                ]
                if model.confounded
                else []
            ),
            *(["presliding: dry friction by Dahl's model near velocity reversals"] if model.slides_gradually else []),
            f"residual: measured and predicted torque, zero-phase low-pass of {prepared.cutoffs.torque:.4g} Hz, "
            "all samples kept",
        ),
        presliding=model.slides_gradually,
        overlap=used_share(model.result, recording, RunWindow(signals, None, None)) if signals.torque_origin else 0.0,
    )


def _signals(recording: Recording, robot_file: RobotFile) -> JointSignals:
    """Positions and torques; torques of 0 and an empty origin where none was recorded."""
    robot = robot_file.robot
    stream = recording.streams.get(JOINTS_STREAM)
    signals = {"torque", "current", *(robot.drive(name).signal for name in robot.joint_names)}
    if stream is None or any(name in signals and not channel.magnitude for name, channel in stream.channels.items()):
        return read_joint_signals(recording, robot)
    positions = joint_positions(recording, robot)
    nothing = np.zeros_like(positions.position)
    return JointSignals(
        positions.label,
        positions.joint_names,
        positions.time,
        positions.position,
        nothing,
        "",
        temperature=joint_temperature(recording, robot.joint_names),
    )


def _predicted(model: Model, prepared: Prepared, segment: Segment, signals: JointSignals) -> SegmentPrediction:
    """The segment without its ends, where the filters are not valid."""
    used = segment.used

    def rows(values: FloatArray) -> FloatArray:
        return np.ascontiguousarray(values[:, used].T)

    q, dq, ddq = rows(segment.position), rows(segment.velocity), rows(segment.acceleration)
    celsius = None if segment.temperature is None else rows(segment.temperature) - ZERO_CELSIUS
    parts = model.torque_parts(q, dq, ddq, celsius)
    change = model.presliding_torque(segment.position.T, segment.velocity.T, segment.rate).T
    parts["friction"] = parts["friction"] + rows(change)
    measured = residual = None
    if signals.torque_origin:
        at_joints = model.coupling.T @ segment.torque
        measured = rows(at_joints)
        every_sample = replace(prepared.parallel_filter, factor=1)
        heat = None if segment.temperature is None else segment.temperature.T - ZERO_CELSIUS
        residual = rows(
            every_sample.apply(
                at_joints
                - change
                - model.torque(segment.position.T, segment.velocity.T, segment.acceleration.T, heat).T
            )
        )
    return SegmentPrediction(
        time=segment.time[used],
        rate=segment.rate,
        position=q,
        velocity=dq,
        acceleration=ddq,
        parts=parts,
        std=model.torque_std(q, dq, ddq, celsius),
        measured=measured,
        residual=residual,
    )
