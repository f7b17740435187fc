"""Servo models in one call each: identify from commands and encoders, validate, roll out, export."""

from __future__ import annotations

from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from daq.motion.trajectories import sampled
from daq.motion.trajectory_file import CSV_RATE, load_trajectory
from daq.output_files import check_outputs, replace_files
from daq.plotting import Backend
from daq.recording.commanded_motion import TARGET, CommandedMotion
from daq.recording.recording import JOINTS_STREAM, Channel, Recording, Stream
from daq.robot.loader import RobotFile, load_robot, parse_robot
from drivers.core.arrays import FloatArray
from drivers.core.errors import DataError, RobotFileError, UsageError
from drivers.core.files import path_of
from drivers.core.reading_process import Progress
from drivers.streams import UNITS
from ident.export.mujoco_reading import mujoco_installed
from ident.model.another_arm import check_arm
from ident.ranges import UNIT_SPREAD
from ident.report.servo_page import rollout_figure, servo_page
from ident.result.graded import robots_of
from ident.result.models.model import result_path
from ident.result.result_file import file_sha256
from ident.servo.arm_rollout import roll_out_arm
from ident.servo.identify import ServoIdentification, read_motions, revalidate_servo
from ident.servo.identify import identify_servo as identify_recordings
from ident.servo.links import servo_links
from ident.servo.motion import ServoMotion, servo_motions
from ident.servo.ranges import drawn, servo_ranges
from ident.servo.result import ServoResult, read_servo_result, with_values
from ident.servo.simulators import isaaclab, mjcf, usd
from ident.servo.simulators.actuator_law import ServoReplay, law_paths, left_out, nearest_file
from ident.servo.terms import INDEX, TERMS
from ident.tasks.arguments import GradedResult, Run, Runs, held_out_of, recording_of, recordings_of
from ident.tasks.options import silent


class ServoModel(GradedResult):
    """An arm of position-controlled servos, identified from commanded and measured positions.

    Attributes:
        result: all of it, as `result.json` holds it.
        identification: the held-out motions and their roll-outs; None for a model that was read from a file.

    Example:
        >>> import dynid
        >>> try:
        ...     dynid.load_servo_model("no-such-model")
        ... except dynid.ResultFileError as error:
        ...     print(error.message)
        no such file
    """

    result: ServoResult

    def __init__(self, result: ServoResult, identification: ServoIdentification | None = None) -> None:
        """Hold a result."""
        self.result = result
        self.identification = identification
        self._robot = parse_robot(
            result.robot_file, where=f"{result.robot} in the result", folder=None, urdf_text=result.urdf or None
        )
        self._links = servo_links(self._robot)

    def roll_out(self, run: Run) -> list[tuple[FloatArray, FloatArray]]:
        """Times (N,) [s] and positions (N, n) [rad or m] of each gap-free motion of a recording, on its commands alone.

        Raises:
            DataError: the recording has no commands, or is of another arm.
        """
        motions = self._motions(recording_of(run))
        paths = roll_out_arm(motions, self._links, self.result.values, self.result.contact)
        return [(motion.begin + motion.time, path) for motion, path in zip(motions, paths, strict=True)]

    def predict(self, run: Run) -> Recording:
        """The recording with positions rolled out on its commands; without samples of motions that are too short.

        Raises:
            DataError: the recording has no commands, or is of another arm.
        """
        recording = recording_of(run)
        rolled = self.roll_out(recording)
        stream = recording.streams[JOINTS_STREAM]
        time = np.concatenate([times for times, _ in rolled])
        rows = np.searchsorted(stream.time, time - 1e-9)
        names = tuple(self.result.joints)
        position = Channel(
            "position",
            np.concatenate([path for _, path in rolled]),
            self._robot.robot.column_unit(UNITS["position"], names),
            names,
            "rolled out on the commands alone by a servo model",
        )
        target = stream.channels.get(TARGET)
        kept = {} if target is None else {TARGET: replace(target, values=target.values[rows])}
        played = Stream(JOINTS_STREAM, stream.time[rows], stream.host_time[rows], {"position": position, **kept})
        return replace(recording, path=None, streams={**recording.streams, JOINTS_STREAM: played})

    def simulate(self, time: npt.ArrayLike, command: npt.ArrayLike, *, start: npt.ArrayLike | None = None) -> Recording:
        """What the arm does with commands that were not recorded: a recording of `position` and `target_position`.

        Args:
            time: (N,) [s], increasing; at least 3 s, from 8 Hz up.
            command: (N, n) positions [rad or m], each of which holds until the next.
            start: (n,) position at the beginning [rad or m], at rest; the first command without.

        Raises:
            DataError: other shapes, a value that is not finite, too few samples.

        Example:
            >>> import dynid
            >>> try:
            ...     dynid.load_servo_model("no-such-model").simulate([0.0, 0.1], [[0.0], [0.1]])
            ... except dynid.ResultFileError as error:
            ...     print(error.message)
            no such file
        """
        stamps, commands = np.asarray(time, dtype=np.float64), np.asarray(command, dtype=np.float64)
        begin = commands[0] if start is None and len(commands) else np.asarray(start, dtype=np.float64)
        shape = (len(stamps), len(self.result.joints))
        if stamps.ndim != 1 or commands.shape != shape or begin.shape != shape[1:]:
            raise DataError(f"commands {commands.shape}, start {begin.shape}: expected {shape} and {shape[1:]}")
        if not (np.isfinite(stamps).all() and np.isfinite(commands).all() and np.isfinite(begin).all()):
            raise DataError("a time, command or start is not finite")
        if np.any(np.diff(stamps) <= 0):
            raise DataError("times do not increase")
        positions = np.tile(begin, (len(stamps), 1))
        given = CommandedMotion(tuple(self.result.joints), stamps, positions, stamps, {TARGET: commands})
        motions = servo_motions(given, "commands")
        paths = roll_out_arm(motions, self._links, self.result.values, self.result.contact)
        times = np.concatenate([motion.begin + motion.time for motion in motions])
        kept = np.searchsorted(stamps, times - 1e-9)
        arrays = {"t": times, "q": np.concatenate(paths), TARGET: commands[kept]}
        return Recording.from_dict(self._robot, arrays, comment="rolled out on commands by a servo model")

    def play(self, trajectory: str | PathLike[str]) -> Recording:
        """Return what the arm does with the commands of a trajectory file, sent 50 times a second: as `simulate`.

        Raises:
            UsageError: it cannot be read, or is of another arm.
            DataError: it lasts less than 3 s.
        """
        time, position, _ = sampled(load_trajectory(path_of(trajectory), self._robot.robot).motion, CSV_RATE)
        return self.simulate(time, position)

    def validate(self, runs: Runs, *, model_file: str | PathLike[str] | None = None) -> ServoModel:
        """The same model judged on other recordings.

        Args:
            runs: of the same arm.
            model_file: an MJCF of the arm as it came; its roll-out in MuJoCo stands beside the model's.

        Raises:
            DataError: a recording has no commands, or is of another arm.
            UsageError, ModelError: the MJCF cannot be rolled out.
        """
        file = None if model_file is None else path_of(model_file)
        judged = revalidate_servo(self.result, recordings_of(runs), self._robot, file)
        return ServoModel(judged.result, judged)

    def export_mjcf(self, path: str | PathLike[str], runs: Runs = (), *, overwrite: bool = False) -> ServoReplay | None:
        """Write an MJCF with position actuators, and roll it out on recorded commands where MuJoCo is installed.

        Args:
            path: of the file.
            runs: recordings for the replay; without, the held-out motions of the identification.
            overwrite: whether the file may exist.

        Returns:
            The replay; None without MuJoCo or without motions.

        Raises:
            UsageError: the path cannot be written.
            ModelError: the arm has loops or coupled motors.
        """
        target = path_of(path)
        check_outputs([target], overwrite=overwrite)
        values, contact = self.result.values, self.result.contact
        words = left_out(values, mjcf.MISSING)
        installed = mujoco_installed()
        text, replayed = nearest_file(
            mjcf.FORMAT,
            values,
            self._links,
            contact,
            self._replayed(runs) if installed else [],
            lambda found: mjcf.servo_mjcf(self._robot, self._links, found, words, contact),
            lambda written, motions: mjcf.played_paths(written, self._links, motions),
        )
        replace_files({target: text})
        return replayed

    def export_isaaclab(
        self, path: str | PathLike[str], runs: Runs = (), *, unit_spread: float = 0.0, overwrite: bool = False
    ) -> ServoReplay | None:
        """Write a Python configuration for Isaac Lab: actuators, command profile, terms of domain randomisation.

        The file is read again, and the law of its actuators rolled out on recorded commands; Isaac Lab is not needed.

        Args:
            path: of the file.
            runs: recordings for the replay; without, the held-out motions of the identification.
            unit_spread: σ of the parameters' logarithms from unit to unit, which widens the ranges.
            overwrite: whether the file may exist.

        Returns:
            The replay; None without motions.

        Raises:
            UsageError: the path cannot be written, or a spread that is not within 0 to 2.
            ModelError: the arm has loops or coupled motors.
        """
        target = path_of(path)
        check_outputs([target], overwrite=overwrite)
        speeds, spread = self._speeds(), _spread(unit_spread)
        zero = np.zeros(len(speeds))
        text, replayed = nearest_file(
            isaaclab.FORMAT,
            self.result.values,
            self._links,
            None,
            self._replayed(runs),
            lambda found: isaaclab.isaaclab_configuration(self.result, found, self._links, speeds, spread),
            lambda written, motions: law_paths(
                isaaclab.read_isaaclab(written, str(target)), self._links, zero, motions
            ),
        )
        replace_files({target: text})
        return replayed

    def export_usd(self, path: str | PathLike[str], runs: Runs = (), *, overwrite: bool = False) -> ServoReplay | None:
        """Write a USD stage (text) with bodies and joint drives; it is read again, and its drives rolled out.

        Args:
            path: of the file, `.usda` or `.usd`.
            runs: recordings for the replay; without, the held-out motions of the identification.
            overwrite: whether the file may exist.

        Returns:
            The replay; None without motions.

        Raises:
            UsageError: usd-core is not installed, the path ends otherwise or cannot be written.
            ModelError: the arm has loops or coupled motors.
        """
        target = path_of(path)
        if target.suffix not in {".usda", ".usd"}:
            raise UsageError(f"'{target.name}' does not end in .usda or .usd", hint="name it arm.usda")
        check_outputs([target], overwrite=overwrite)
        values = self.result.values
        words, zero = left_out(values, usd.MISSING), values[:, INDEX["zero"]]
        text, replayed = nearest_file(
            usd.FORMAT,
            values,
            self._links,
            None,
            self._replayed(runs),
            lambda found: usd.servo_usd(self._robot, self._links, found, words),
            lambda written, motions: law_paths(
                usd.read_usd(written, self.result.joints, str(target)), self._links, zero, motions
            ),
        )
        replace_files({target: text})
        return replayed

    def recordings(self) -> tuple[Path, ...]:
        """The recordings of the validation, else of the identification, that are still where they were, unchanged."""
        for role in ("validation", "identification"):
            own = [(Path(use.file), use.sha256) for use in self.result.recordings if use.role == role]
            unchanged = tuple(path for path, sha256 in own if path.is_file() and file_sha256(path) == sha256)
            if unchanged:
                return unchanged
        return ()

    def _motions(self, recording: Recording) -> list[ServoMotion]:
        check_arm([recording], self._robot, robots_of(self.result.recordings))
        return read_motions(recording, self._robot)

    def _speeds(self) -> FloatArray:
        return np.array([joint.velocity for joint in self._robot.robot.joints])

    def _replayed(self, runs: Runs) -> list[ServoMotion]:
        motions = [motion for run in recordings_of(runs) for motion in self._motions(run)]
        if not motions and self.identification is not None:
            motions = self.identification.motions
        return motions

    def ranges(self, unit_spread: float = 0.0) -> dict[str, object]:
        """Ranges for domain randomisation: per joint the 95 % box of each parameter, and their covariance.

        Args:
            unit_spread: σ of the parameters' logarithms from unit to unit, which one arm cannot tell.
        """
        return servo_ranges(self.result, _spread(unit_spread))

    def drawn(self, seed: int, unit_spread: float = 0.0) -> ServoModel:
        """An arm that the recordings allow as well: parameters drawn from their covariance, within their intervals.

        Args:
            seed: of the draw.
            unit_spread: σ of the parameters' logarithms from unit to unit: then another unit of the type.
        """
        return ServoModel(with_values(self.result, drawn(self.result, seed, _spread(unit_spread))))

    def plot(self, *, backend: Backend = "plotly") -> Any:
        """Measured and rolled-out positions of each joint.

        Args:
            backend: "plotly" gives a `plotly.graph_objects.Figure`, "matplotlib" a `matplotlib.figure.Figure`.

        Raises:
            UsageError: the model was read from a file, which holds no positions; or the backend does not exist or
                is not installed.
        """
        if self.identification is None:
            raise UsageError("the model was read from a file, which holds no positions", hint="identify it again")
        figure = rollout_figure(self.result, self.identification)
        return figure.drawn(backend)

    def _page(self) -> str:
        return servo_page(self.result, self.identification)

    def __repr__(self) -> str:
        return f"<dynid.ServoModel {self.result.robot}, {len(self.result.joints)} joints>"


def _spread(value: float) -> float:
    """A spread from unit to unit.

    Raises:
        UsageError: not within 0 to 2.
    """
    if not UNIT_SPREAD.holds(value):
        raise UsageError(f"a spread of {value:g} from unit to unit is not within {UNIT_SPREAD}", where="--unit-spread")
    return value


def identify_servo(
    runs: Runs,
    *,
    validation: Runs = (),
    robot: str | Path | RobotFile | None = None,
    model_file: str | PathLike[str] | None = None,
    progress: Progress = silent,
) -> ServoModel:
    """Identify an arm of servos from commanded and measured positions: `dynid identify --method servo`.

    Args:
        runs: a recording with `target_position`, or several of one arm; read already or paths.
        validation: held-out recordings; the last 30 % of each of the others without any.
        robot: in place of the recordings' own robot file; the links' masses are taken from it.
        model_file: an MJCF of the arm as it came; its roll-out in MuJoCo stands beside the model's.
        progress: called with the name of each step.

    Raises:
        DataError: a recording has no commands, or its positions do not follow them.
        RobotFileError: a link's mass is not known, or `servo` names an unknown joint or parameter.
        IdentificationError: no joint moves.
        UsageError, ModelError: the MJCF cannot be rolled out.

    Example:
        >>> import dynid
        >>> try:
        ...     dynid.identify_servo(dynid.simulate("ur5e", duration=2.0))
        ... except dynid.DataError as error:
        ...     print(error.message.partition(";")[0])
        records no commanded position
    """
    recordings, held_out = recordings_of(runs), held_out_of(validation)
    if not recordings:
        raise UsageError("no recording to identify from")
    robot_file = None if robot is None else load_robot(robot)
    file = robot_file or recordings[0].robot()
    reference = None if model_file is None else path_of(model_file)
    identification = identify_recordings(recordings, held_out, robot_file, _given(file), progress, reference)
    return ServoModel(identification.result, identification)


def load_servo_model(path: str | PathLike[str]) -> ServoModel:
    """Read a servo model back.

    Args:
        path: a folder that `identify_servo(…).save` wrote, or its result.json.

    Raises:
        ResultFileError: no such file, or it holds no servo model.

    Example:
        >>> import dynid
        >>> try:
        ...     dynid.load_servo_model("no-such-model")
        ... except dynid.ResultFileError as error:
        ...     print(error.message)
        no such file
    """
    return ServoModel(read_servo_result(result_path(path)))


def _given(file: RobotFile) -> dict[str, dict[str, float]]:
    """Known parameters of the robot file's `servo`.

    Raises:
        RobotFileError: an unknown parameter, or a value that it cannot have.
    """
    given = file.robot.servo
    for joint, terms in given.items():
        where = f"{file.where}: servo.{joint}"
        for name, value in terms.items():
            if name not in INDEX:
                raise RobotFileError(f"'{name}' is not a servo parameter", where=where, hint=", ".join(INDEX))
            allowed = TERMS[INDEX[name]].allowed
            if not allowed.holds(value):
                raise RobotFileError(f"{value:g} is not within {allowed}", where=f"{where}.{name}")
    return {joint: dict(terms) for joint, terms in given.items()}
