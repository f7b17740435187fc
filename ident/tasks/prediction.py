"""Predict the torques of a recording with an identified model in one call; the prediction saves and shows itself."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import cached_property
from os import PathLike
from typing import Any

import numpy as np

from daq.motion.trajectories import sampled
from daq.motion.trajectory_file import load_trajectory
from daq.plotting import Backend
from daq.recording.recording import JOINTS_STREAM, Channel, Event, Recording, Stream
from daq.recording.writer import write_recording
from daq.robot.loader import RobotFile
from drivers.core.arrays import FloatArray
from drivers.core.files import path_of
from drivers.core.options import keywords_of
from drivers.core.software import software_versions
from drivers.core.units import common_unit
from drivers.streams import UNITS
from ident.identify.data_split import labelled
from ident.identify.predict import PARTS, RecordingPrediction, predict_recording
from ident.report.prediction_page import prediction_figure, prediction_page
from ident.result.delivered import Parameters
from ident.result.models.gravity_model import refuse_gravity_alone
from ident.result.models.load_model import load_model
from ident.result.models.model import Model
from ident.result.result_file import stored_model
from ident.result.tables import Table, table_of_rows
from ident.tasks.arguments import PagedResult, is_trajectory, recording_of
from ident.tasks.identification import IdentificationResult
from ident.tasks.options import PredictOptions

PREDICTION_STREAM = "prediction"

PLANNED_RATE = 500.0
"""Samples per second [Hz] of a motion that was not recorded."""

DESCRIPTIONS = {
    "predicted_torque": "of the model: inertial, Coriolis, gravity and friction torque together",
    "inertial_torque": "M(q)*ddq, motor inertia included",
    "coriolis_torque": "C(q, dq)*dq, centrifugal torque included",
    "gravity_torque": "g(q)",
    "friction_torque": "viscous and Coulomb friction, constant offsets included",
    "predicted_torque_std": "standard deviation of predicted_torque from that of the parameters",
    "residual_torque": "measured minus predicted, low-passed: what the arm exerts on its surroundings; an external "
    "torque that acts on the arm has the opposite sign",
    "residual_torque_std": "standard deviation of residual_torque without contact: that of the prediction and of the "
    "residuals of the identification",
}
"""Quantity → description of the stream `prediction`; torques at the joints."""


@dataclass(frozen=True, eq=False)
class Prediction(PagedResult):
    """The torques that a model predicts for a recording: N samples of n joints, gap-free segments one after another.

    The motion is low-passed and the measured torque shifted by the delay as at the identification; ends of segments,
    where filters are not valid, are left out.

    Attributes:
        robot_file: of the model.
        label: what messages call the recording.
        joint_names: (n,).
        time: (N,) the recording's clock [s].
        position, velocity, acceleration: (N, n) [rad, rad/s, rad/s² or m…].
        torque: (N, n) predicted joint torque [N·m or N], the sum of the next four.
        inertial: (N, n) M(q)·q̈, motor inertia included.
        coriolis: (N, n) C(q, q̇)·q̇.
        gravity: (N, n) g(q).
        friction: (N, n) viscous and Coulomb friction and offsets.
        std: (N, n) standard deviation σ of `torque` from that of the parameters.
        measured: (N, n) recorded joint torque, not filtered; None where none was recorded.
        residual: (N, n) measured minus predicted, both low-passed: what the arm exerts on its surroundings (an external
            torque that acts on the arm has the opposite sign); None likewise.
        residual_std: (N, n) σ of `residual` without contact, from `std` and the residuals of the identification; None
            where they are not known.
        origin: which model predicts what, in words.
        segments: the same segment by segment.
        comment: of the recording.

    Example:
        >>> import dynid
        >>> run, other = (dynid.simulate("ur5e", duration=10.0, seed=seed) for seed in (1, 2))
        >>> prediction = dynid.predict(dynid.identify(run), other)
        >>> prediction.gravity.shape == prediction.torque.shape == prediction.residual.shape
        True
        >>> sorted(prediction.recording.streams)
        ['joints', 'prediction']
    """

    robot_file: RobotFile = field(repr=False)
    label: str
    joint_names: tuple[str, ...]
    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    torque: FloatArray
    inertial: FloatArray
    coriolis: FloatArray
    gravity: FloatArray
    friction: FloatArray
    std: FloatArray
    measured: FloatArray | None
    residual: FloatArray | None
    residual_std: FloatArray | None
    origin: str
    segments: RecordingPrediction = field(repr=False)
    comment: str = ""

    @cached_property
    def recording(self) -> Recording:
        """All of it as a recording: stream `joints` (processed motion, measured torque) and stream `prediction`."""
        joints = {
            "position": self.position,
            "velocity": self.velocity,
            "acceleration": self.acceleration,
            "torque": self.measured,
        }
        torque = f"{self.segments.torque_origin}, at the joints, shifted by the delay, not filtered"
        motion = dict.fromkeys(("position", "velocity", "acceleration"), "low-passed as at the identification")
        of_model = {
            "predicted_torque": self.torque,
            **{f"{part}_torque": getattr(self, part) for part in PARTS},
            "predicted_torque_std": self.std,
            "residual_torque": self.residual,
            "residual_torque_std": self.residual_std,
        }
        start = float(self.time[0])
        return Recording(
            robot_text=self.robot_file.text,
            urdf_text=self.robot_file.urdf_text or "",
            streams={
                JOINTS_STREAM: self._stream(JOINTS_STREAM, joints, {**motion, "torque": torque}),
                PREDICTION_STREAM: self._stream(PREDICTION_STREAM, of_model, DESCRIPTIONS),
            },
            events=tuple(Event(start, "info", "predict", text) for text in (self.origin, *self.segments.steps)),
            created=datetime.now(UTC).isoformat(timespec="seconds"),
            versions=software_versions(),
            host=platform.node(),
            comment=self.comment,
        )

    def _stream(self, name: str, signals: Mapping[str, FloatArray | None], said: Mapping[str, str]) -> Stream:
        names, robot = self.joint_names, self.robot_file.robot
        channels = {}
        for quantity, values in signals.items():
            if values is not None:
                unit = robot.column_unit(UNITS.get(quantity, UNITS["torque"]), names)
                channels[quantity] = Channel(quantity, values, unit, names, said[quantity])
        return Stream(name, self.time, self.time, channels)

    @property
    def summary(self) -> Table:
        """Root mean square of each joint's torques [N·m]; the largest residual, and the mean σ of prediction and it."""
        headings = ("measured", "predicted", *PARTS, "residual")
        signals = (self.measured, self.torque, *(getattr(self, part) for part in PARTS), self.residual)
        columns = [_rms(signal, len(self.joint_names)) for signal in signals]
        largest = _each(None if self.residual is None else np.abs(self.residual).max(axis=0), len(self.joint_names))
        deviations = [_rms(self.std, len(self.joint_names)), _rms(self.residual_std, len(self.joint_names))]
        rows = list(zip(self.joint_names, *columns, largest, *deviations, strict=True))
        names = (*headings, "largest_residual", "std", "residual_std")
        unit = common_unit("N·m", self.robot_file.robot.sliding)
        return table_of_rows(
            f"Torques of {self.label}, root mean squares", [("joint", ""), *((name, unit) for name in names)], rows
        )

    def save(self, path: str | PathLike[str], *, overwrite: bool = False) -> None:
        """Write `recording` (.h5), as `dynid predict -o` does.

        Args:
            path: of the file.
            overwrite: replace a file that exists.

        Raises:
            RecordingError: the file exists, or cannot be written.
        """
        write_recording(path_of(path), self.recording, overwrite=overwrite)

    def _page(self) -> str:
        return prediction_page(self.robot_file.robot, self.label, self.summary, self.segments)

    def plot(self, *, backend: Backend = "plotly") -> Any:
        """Measured and predicted torque of each joint over time, as a figure.

        Args:
            backend: "plotly" gives a `plotly.graph_objects.Figure`, "matplotlib" a `matplotlib.figure.Figure`.

        Raises:
            UsageError: the backend does not exist or is not installed.
        """
        return prediction_figure(self.robot_file.robot.joints, self.segments).drawn(backend)

    def __repr__(self) -> str:
        return f"<dynid.Prediction of {self.label}: {len(self.time)} samples of {len(self.joint_names)} joints>"

    def _parts(self) -> tuple[object, ...]:
        return (self.summary,)


@keywords_of(PredictOptions)
def predict(options: PredictOptions) -> Prediction:
    """Predict the joint torques [N·m] of a motion, part by part, with standard deviations and what remains.

    Raises:
        DataError: the recording lacks positions, a joint or a gain, or is too short.
        ModelError: the model is not that of the whole arm, or a parameter without a value acts on the motion.
        ResultFileError: no result, or it holds no covariance.
        UsageError: there are no such parameters.

    Example:
        >>> import dynid
        >>> run, other = (dynid.simulate("ur5e", duration=10.0, seed=seed) for seed in (1, 2))
        >>> prediction = dynid.predict(dynid.identify(run), other)
        >>> prediction.summary.columns[1].heading
        'measured [N·m]'
    """
    model = model_of(options.identified, options.parameters, "the torque of a motion")
    robot_file = stored_model(model.result).robot_file
    recording = _planned(options.run, robot_file) if is_trajectory(options.run) else recording_of(options.run)
    predicted = predict_recording(model, robot_file, recording)
    segments = predicted.segments

    def joined(name: str) -> FloatArray:
        return np.concatenate([getattr(segment, name) for segment in segments])

    std = joined("std")
    measured = [segment.measured for segment in segments if segment.measured is not None]
    residual = [segment.residual for segment in segments if segment.residual is not None]
    return Prediction(
        robot_file=robot_file,
        label=labelled(recording.label, predicted.overlap),
        joint_names=model.joint_names,
        **{name: joined(name) for name in ("time", "position", "velocity", "acceleration", "torque")},
        **{part: np.concatenate([segment.parts[part] for segment in segments]) for part in PARTS},
        std=std,
        measured=np.concatenate(measured) if measured else None,
        residual=np.concatenate(residual) if residual else None,
        residual_std=np.sqrt(std**2 + predicted.noise**2) if residual and predicted.noise is not None else None,
        origin=f"{model.kind} parameters of {model.name}, identified {model.result.created}, along {recording.label}",
        segments=predicted,
        comment=recording.comment,
    )


def _planned(trajectory: str | PathLike[str], robot_file: RobotFile) -> Recording:
    """The motion of a trajectory file as if an arm had followed it exactly: positions and velocities, no torque."""
    path = path_of(trajectory)
    time, position, velocity = sampled(load_trajectory(path, robot_file.robot).motion, PLANNED_RATE)
    return replace(Recording.from_dict(robot_file, {"t": time, "q": position, "dq": velocity}), path=path)


def model_of(
    identified: IdentificationResult | Model | str | PathLike[str], parameters: Parameters | None, what: str
) -> Model:
    """The model of a result, a model, or a path; `what` it is needed for.

    Raises:
        ModelError: it knows gravity alone.
        ResultFileError, UsageError: as `load_model`.
    """
    if isinstance(identified, IdentificationResult):
        return Model(identified.result, parameters)
    model = identified if isinstance(identified, Model) else load_model(identified, parameters)
    refuse_gravity_alone(model, what)
    return model


def _rms(signal: FloatArray | None, count: int) -> list[float | None]:
    return _each(None if signal is None else np.sqrt(np.mean(signal**2, axis=0)), count)


def _each(values: FloatArray | None, count: int) -> list[float | None]:
    return [None] * count if values is None else [float(value) for value in values]
