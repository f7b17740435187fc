"""Experiments in one call: friction of the joints, gravity of an arm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from daq.motion.trajectory_file import parse_trajectory
from daq.plotting import Backend
from daq.recording.recording import Recording
from daq.robot.loader import RobotFile, load_robot
from drivers.core.errors import UsageError
from drivers.core.options import keywords_of
from drivers.core.reading_process import Progress
from ident.experiments.friction.experiment import FrictionExperiment, analyse_friction
from ident.experiments.gravity.experiment import GravityExperiment, analyse_gravity, revalidated
from ident.report.friction_page import friction_page
from ident.report.gravity_page import gravity_page, poses_figure
from ident.result.friction_experiment import FRICTION_FILE, FrictionExperimentResult
from ident.result.gravity import GravityResult, read_gravity_result
from ident.result.models.gravity_model import GravityModel
from ident.result.models.model import result_path
from ident.result.tables import Table
from ident.tasks.arguments import GradedResult, Runs, SavedResult, held_out_of, recordings_of
from ident.tasks.options import FrictionOptions, silent
from ident.views.friction_tables import friction_table


@dataclass(frozen=True)
class IdentifiedFriction(SavedResult):
    """Friction of an arm's joints by experiment.

    Attributes:
        experiment: all of its figures and data.

    Example:
        >>> import dynid
        >>> dynid.IdentifiedFriction.table.__doc__.split(":")[0]
        'One row per joint'
    """

    FILE = FRICTION_FILE

    experiment: FrictionExperiment

    @property
    def result(self) -> FrictionExperimentResult:
        """Return what `friction.json` holds."""
        return self.experiment.result

    @property
    def table(self) -> Table:
        """One row per joint: coefficients and shapes with their σ, the ranges that they hold for, residual RMS."""
        return friction_table(self.result)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Return what the recordings do not tell."""
        return tuple(self.result.warnings)

    def _page(self) -> str:
        return friction_page(self.experiment)

    def __repr__(self) -> str:
        return f"<dynid.IdentifiedFriction of {', '.join(joint.joint for joint in self.result.joints)}>"

    def _parts(self) -> tuple[object, ...]:
        return self.table, "\n".join(f"warning: {warning}" for warning in self.warnings)


@keywords_of(FrictionOptions)
def friction(options: FrictionOptions) -> IdentifiedFriction:
    """Identify the friction of single joints from recordings in which one joint moves at a time (AUBO §2.2).

    Each movement has its own gravity and inertia, so that poses and weights on the tool may differ.

    Raises:
        InputError: invalid recordings or options; loops or coupled motors; no joint that moves alone.
        IdentificationError: the movements do not tell the terms apart.

    Example:
        >>> import dynid
        >>> dynid.friction("sweep.h5")
        Traceback (most recent call last):
        drivers.core.errors.RecordingError: sweep.h5: no such file
    """
    robot_file = None if options.robot is None else load_robot(options.robot)
    recordings = recordings_of(options.runs)
    return IdentifiedFriction(
        analyse_friction(recordings, options.friction, robot_file, options.delay, options.progress)
    )


class IdentifiedGravity(GradedResult):
    """Gravity of an arm, identified from poses that were passed slowly in both directions.

    Attributes:
        result: all of it, as `result.json` holds it.
        model: to compute with: `model.gravity(q)`.

    Example:
        >>> import dynid
        >>> dynid.IdentifiedGravity.errors.__doc__.split(",")[0]
        'Errors of each joint on held-out data'
    """

    result: GravityResult

    def __init__(self, experiment: GravityExperiment) -> None:
        """Hold an experiment."""
        self._experiment = experiment
        self.result = experiment.result
        self.model = GravityModel(experiment.result)

    def validate(self, runs: Runs) -> IdentifiedGravity:
        """The same model judged on other recordings of poses passed in both directions.

        Raises:
            DataError: a recording is of another arm, or passes no pose in both directions.
        """
        return IdentifiedGravity(revalidated(self._experiment, recordings_of(runs)))

    def plot(self, *, backend: Backend = "plotly") -> Any:
        """Measured and predicted gravity of each joint, pose by pose.

        Args:
            backend: "plotly" gives a `plotly.graph_objects.Figure`, "matplotlib" a `matplotlib.figure.Figure`.

        Raises:
            UsageError: no pose was passed in both directions; or the backend does not exist or is not installed.
        """
        figure = poses_figure(self.result)
        if figure is None:
            raise UsageError("no pose was passed in both directions: there is nothing to plot")
        return figure.drawn(backend)

    def _page(self) -> str:
        return gravity_page(self._experiment)

    def __repr__(self) -> str:
        return f"<dynid.IdentifiedGravity {self.result.robot}, {self.result.verdict.grade} for gravity compensation>"


def identify_gravity(
    runs: Runs, *, validation: Runs = (), robot: str | Path | RobotFile | None = None, progress: Progress = silent
) -> IdentifiedGravity:
    """Identify the gravity of an arm from poses passed slowly in both directions: `dynid identify --gravity`.

    Args:
        runs: a recording of `dynid excite --for gravity`, or several of one arm; read already or paths. Any recording
            will do that passes poses slowly, forth and back.
        validation: held-out recordings; each pose is predicted from the others without any.
        robot: in place of the recordings' own robot file.
        progress: called with the name of each step.

    Raises:
        DataError: no pose is passed in both directions (names joint and pose), or the torques are not those of an arm
            of this size.
        IdentificationError: too few poses.

    Example:
        >>> import dynid
        >>> try:
        ...     dynid.identify_gravity(dynid.simulate("up6", duration=10.0, rate=100.0))
        ... except dynid.DataError as error:
        ...     print(error.message)
        contains no pose that is passed slowly in both directions
    """
    recordings, held_out = recordings_of(runs), held_out_of(validation)
    if not recordings:
        raise UsageError("no recording to identify from")
    robot_file = None if robot is None else load_robot(robot)
    file = robot_file or recordings[0].robot()
    commanded = sorted({name for recording in recordings for name in commanded_joints(recording, file)})
    return IdentifiedGravity(analyse_gravity(recordings, held_out, robot_file, commanded, progress))


def load_gravity(path: str | PathLike[str]) -> IdentifiedGravity:
    """Return what `identify_gravity(…).save` wrote, to be validated.

    Args:
        path: the folder, or its result.json.

    Raises:
        ResultFileError: no such file, or it is another kind of result.
    """
    return IdentifiedGravity(GravityExperiment(read_gravity_result(result_path(path))))


def commanded_joints(recording: Recording, file: RobotFile) -> Sequence[str]:
    """Names of the joints that the trajectory in a recording moves; none where no trajectory was played.

    Raises:
        UsageError: the recording's trajectory cannot be read.
    """
    if not recording.trajectory:
        return ()
    motion = parse_trajectory(recording.trajectory, file.robot, where=recording.label, folder=None).motion
    position, _, _ = motion.evaluate(np.linspace(0.0, motion.duration, 2000))
    return [name for name, path in zip(file.robot.joint_names, position, strict=True) if np.ptp(path) > 1e-6]
