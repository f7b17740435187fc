"""Design, show and save a motion that excites an arm, or a sweep for friction, in one call each."""

from __future__ import annotations

from functools import cached_property
from os import PathLike
from pathlib import Path

import numpy as np
import numpy.typing as npt

from daq.motion.trajectories import Motion
from daq.motion.trajectory_file import CSV_RATE, SamplesTrajectory, Trajectory, dump_trajectory, parse_trajectory
from daq.motion.trajectory_file import load_trajectory as read_trajectory
from daq.robot.assumptions import assumed_limits
from daq.robot.loader import RobotFile, fingerprint, load_robot, parse_robot
from drivers.core.arrays import FloatArray
from drivers.core.errors import IdentificationError, UsageError
from drivers.core.files import path_of
from drivers.core.options import keywords_of, same_named
from drivers.core.text import percent_text, percentage_text
from ident.excite.choices import DEFAULT_SECONDS, DesignChoices
from ident.excite.constraints.workspace import surroundings_warning
from ident.excite.design import Design, design
from ident.excite.forecast import ExcitationFigures, excitation_figures
from ident.excite.gravity_poses import GravityMotion, gravity_motion
from ident.excite.motion_check import ArmMotionCheck
from ident.excite.page.page import excitation_page
from ident.excite.path import trajectory_of
from ident.excite.prior import PriorKnowledge, find_prior
from ident.excite.search.search import SearchChoices, SearchResult
from ident.excite.servo_motion import ServoExcitation, servo_excitation
from ident.excite.servo_segments import PERIOD
from ident.excite.velocity_sweep import JointSweep, velocity_sweep
from ident.model.another_arm import another_arm
from ident.result.models.model import result_path
from ident.result.tables import Table, table_of_rows
from ident.servo.result import read_servo_result
from ident.tasks.arguments import PagedResult, write_text
from ident.tasks.options import ExciteOptions, GravityMotionOptions, ServoMotionOptions, SweepOptions


class ExcitationTrajectory(PagedResult):
    """A motion that excites an arm: designed by `design_excitation`, or read by `load_trajectory`.

    Attributes:
        robot_file: the arm.
        text: of the trajectory file.
        motion: what is played.
        prior: what is known of the arm beforehand: parameters and torque noise.
        design: its options and figures; None of a trajectory that was read.

    Example:
        >>> import dynid
        >>> motion = dynid.design_excitation("up6", starts=1, workers=1, harmonics=2, period=6.0)
        >>> q, dq, ddq = motion.evaluate([0.0, motion.duration / 2])
        >>> q.shape, bool(abs(dq[0]).max() < 1e-9)
        ((2, 3), True)
    """

    def __init__(
        self, robot_file: RobotFile, text: str, motion: Motion, prior: PriorKnowledge, design: Design | None = None
    ) -> None:
        """Hold a checked trajectory."""
        self.robot_file, self.text, self.motion, self.design = robot_file, text, motion, design
        self.prior = prior

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names (n,) of the joints, in the order of every array's columns."""
        return self.robot_file.robot.joint_names

    @property
    def duration(self) -> float:
        """Duration from rest to rest [s]."""
        return self.motion.duration

    def evaluate(self, time: npt.ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Positions [rad], velocities [rad/s] and accelerations [rad/s²], each (N, n).

        Args:
            time: (N,) from the start [s].
        """
        stamps = np.atleast_1d(np.asarray(time, dtype=np.float64))
        position, velocity, acceleration = (np.ascontiguousarray(signal.T) for signal in self.motion.evaluate(stamps))
        return position, velocity, acceleration

    @cached_property
    def figures(self) -> ExcitationFigures:
        """Condition number, predicted error bars, and limit utilisation."""
        return excitation_figures(self.robot_file, self.motion, self.prior)

    @property
    def summary(self) -> str:
        """Options and figures of the design in one line; empty of a trajectory that was read."""
        return "" if self.design is None else design_summary(self.design, self.figures)

    @property
    def limits(self) -> Table:
        """Limit utilisation of each joint [%]."""
        headings = [("joint", ""), *((name, "%") for name in ("position", "velocity", "acceleration", "torque"))]
        rows = [
            (
                joint.joint,
                100.0 * joint.position_use,
                100.0 * joint.velocity_use,
                100.0 * joint.acceleration_use,
                None if joint.torque_use is None else 100.0 * joint.torque_use,
            )
            for joint in self.figures.joints
        ]
        return table_of_rows(f"Limit utilisation of {self.robot_file.robot.name}", headings, rows)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Missing information, such as the height of the floor, or limits that were assumed."""
        warning = surroundings_warning(self.robot_file, self.motion)
        assumed = tuple(f"assumed: {limit}" for limit in assumed_limits(self.robot_file))
        return assumed if warning is None else (warning, *assumed)

    def save(self, path: str | PathLike[str], *, overwrite: bool = False) -> None:
        """Write the trajectory file (YAML) that `dynid record --trajectory` plays.

        Args:
            path: of the file.
            overwrite: replace a file that exists.

        Raises:
            UsageError, DiskError: it exists already, or cannot be written.
        """
        write_text(path, lambda: self.text, overwrite=overwrite)

    def save_csv(self, path: str | PathLike[str], *, rate: float = CSV_RATE, overwrite: bool = False) -> None:
        """Write the motion as a table of positions, for a player of your own: `time` [s] and a column per joint.

        Args:
            path: of the file (.csv).
            rate: of its rows [Hz].
            overwrite: replace a file that exists.

        Raises:
            UsageError, DiskError: it exists already, or cannot be written.
        """
        write_text(path, lambda: self._csv(rate), overwrite=overwrite)

    def _csv(self, rate: float) -> str:
        time = np.arange(int(np.ceil(self.duration * rate)) + 1) / rate
        position, _, _ = self.evaluate(np.minimum(time, self.duration))
        rows = np.column_stack([time, position])
        lines = [",".join(["time", *self.joint_names]), *(",".join(f"{value:.6f}" for value in row) for row in rows)]
        return "\n".join(lines) + "\n"

    def _page(self) -> str:
        notes = [] if self.design is None else design_notes(self.design)
        return excitation_page(self.robot_file, self.motion, self.prior, self.figures, notes)

    def __repr__(self) -> str:
        return f"<dynid.ExcitationTrajectory of {self.robot_file.robot.name}, {self.duration:.4g} s>"

    def _parts(self) -> tuple[object, ...]:
        return self.limits, self.summary


@keywords_of(ExciteOptions)
def design_excitation(options: ExciteOptions) -> ExcitationTrajectory:
    """Design an excitation trajectory within the arm's limits; Ctrl-C ends the search with the best so far.

    With several processes a script needs `if __name__ == "__main__":` around the call.

    Raises:
        UsageError: an option is not possible, or no pose keeps all limits; names the limit.
        IdentificationError: a search process crashed, with `starts`.
        KeyboardInterrupt: Ctrl-C before there was a feasible motion.

    Example:
        >>> import dynid
        >>> motion = dynid.design_excitation("up6", starts=1, workers=1, harmonics=2, period=6.0)
        >>> motion.limits.columns[1].heading, motion.figures.worst_use <= 1.0
        ('position [%]', True)
    """
    robot_file = load_robot(options.robot)
    prior = find_prior(robot_file, options.prior)
    joints = None if options.joints is None else tuple(options.joints)
    choices = same_named(options, DesignChoices, joints=joints)
    time = DEFAULT_SECONDS if options.time is None and options.starts is None else options.time
    search = same_named(options, SearchChoices, time=time)
    earlier = options.earlier
    if earlier is not None and not isinstance(earlier, ExcitationTrajectory):
        earlier = load_trajectory(earlier, robot_file)
    designed = design(robot_file, prior, choices, search, None if earlier is None else earlier.motion, options.progress)
    figures = excitation_figures(robot_file, designed.motion, prior)
    text = trajectory_text(robot_file, designed, figures)
    trajectory = ExcitationTrajectory(robot_file, text, designed.motion, prior, designed)
    trajectory.__dict__["figures"] = figures  # known already; the property would compute them again
    return trajectory


def load_trajectory(path: str | PathLike[str], robot: str | Path | RobotFile) -> ExcitationTrajectory:
    """Read a trajectory file and check it against its robot: joints, limits, rest at both ends.

    Args:
        path: of the file (YAML; rad, s).
        robot: built-in name, robot file, URDF, or the result of `load_robot`.

    Raises:
        UsageError: names file and key, the value and what is allowed.

    Example:
        >>> import dynid, tempfile, pathlib
        >>> motion = dynid.design_excitation("up6", starts=1, workers=1, harmonics=2, period=6.0)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder, "motion.yaml")
        ...     motion.save(path)
        ...     abs(dynid.load_trajectory(path, "up6").duration - motion.duration) < 1e-9
        True
    """
    if not isinstance(path, (str, PathLike)):
        raise UsageError(f"a {type(path).__name__} is not a path of a trajectory", hint='give "traj.yaml"')
    robot_file = load_robot(robot)
    read = read_trajectory(path_of(path), robot_file.robot)
    return ExcitationTrajectory(robot_file, read.text, read.motion, find_prior(robot_file))


def design_summary(designed: Design, figures: ExcitationFigures) -> str:
    """The figures of a design in one line."""
    choices, forecast = designed.choices, figures.forecast
    use, limit = max(
        [(figures.worst_use, figures.worst_limit), *zip(designed.use.tolist(), designed.limits, strict=True)]
    )
    return (
        f"{choices.kind} of {figures.duration:.4g} s, {choices.criterion}; as played: condition number "
        f"{forecast.scaled_condition:.4g} (below 50 is good; {forecast.condition:.4g} in the parameters' units), "
        f"largest limit utilisation {percent_text(use)} ({limit})"
    )


def trajectory_text(robot_file: RobotFile, designed: Design, figures: ExcitationFigures) -> str:
    """The file's text, read back and checked as `dynid record` will do it.

    Raises:
        IdentificationError: it would be refused.
    """
    comment = f"designed by dynid excite: {design_summary(designed, figures)}"
    robot = robot_file.robot
    trajectory = trajectory_of(designed.motion, robot.name, comment)
    text = dump_trajectory(trajectory.model_copy(update={"designed_for": fingerprint(robot, robot_file.urdf_text)}))
    try:
        parse_trajectory(text, robot, where="the designed trajectory", folder=None)
    except UsageError as error:
        raise IdentificationError(error.message, where=error.where, hint="give a larger --margin") from error
    return text


def search_words(designed: Design) -> str:
    """The outcome of the search in one line."""
    state = designed.search
    ended = ", ended by Ctrl-C" if state.interrupted else ""
    died = f", {state.died} search processes died" if state.died else ""
    finished = f"{state.finished} of its starts finished" if state.finished else "no start finished"
    return f"search of {state.seconds:.1f} s, {finished}{ended}{died}"


def search_state(result: SearchResult) -> str:
    """State of a search in one line: time, and the worst error bar to expect of the best motion so far."""
    if result.limit is None:
        begin = f"{result.seconds:.0f} s of search, {result.finished} starts finished"
    else:
        begin = f"{percent_text(min(result.seconds / result.limit, 1.0))} of {result.limit:.0f} s of search"
    best = result.best
    if best is None:
        return f"{begin}: no motion within all limits yet"
    worst = (
        ""
        if best.worst is None
        else f", its worst error bar expected to be ±{percentage_text(best.worst.percent)} % ({best.worst.name})"
    )
    return f"{begin}: a motion within all limits is found{worst}"


def design_notes(designed: Design) -> list[tuple[str, str]]:
    """Options and outcome of the design, for the page."""
    choices = designed.choices
    return [
        ("Kind", choices.kind),
        ("Criterion", f"{choices.criterion}: {designed.cost:.4g} along one repetition at full speed"),
        ("Designed for", "the last link, which a payload changes" if choices.loaded else "all base parameters"),
        ("Joints that move", ", ".join(choices.joints) if choices.joints else "all"),
        ("Margin", f"{percent_text(choices.margin)} of every limit"),
        ("Self-collision", "checked" if choices.self_collision else "not checked"),
        ("Search", search_words(designed)),
    ]


@keywords_of(GravityMotionOptions)
def design_gravity_motion(options: GravityMotionOptions) -> tuple[ExcitationTrajectory, GravityMotion]:
    """Design a motion for gravity: poses, each passed slowly upwards and downwards (`dynid excite --for gravity`).

    Returns:
        The motion, and what it is expected to tell.

    Raises:
        UsageError: an option is not possible for this arm, or no pose is clear of everything.
        MotionRefusedError: no free way leads from pose to pose.

    Example:
        >>> import dynid
        >>> motion, expected = dynid.design_gravity_motion("up6", poses=8)
        >>> motion.duration < 300.0, expected.silent
        (True, ('S',))
    """
    robot_file = load_robot(options.robot)
    prior = find_prior(robot_file, options.prior)
    designed = gravity_motion(robot_file, ArmMotionCheck(robot_file, options.prior), prior, options)
    comment = (
        f"designed by dynid excite --for gravity: {len(designed.poses)} poses, each passed slowly in both directions"
    )
    return _as_played(robot_file, trajectory_of(designed.motion, robot_file.robot.name, comment), prior), designed


@keywords_of(ServoMotionOptions)
def design_servo_motion(options: ServoMotionOptions) -> tuple[ExcitationTrajectory | None, ServoExcitation]:
    """Design a motion for a servo model: ramps, steps and chirps (`dynid excite --for servo`).

    Returns:
        The motion, None where the model `after` is good enough; and what it is expected to tell.

    Raises:
        UsageError: an option is not possible for this arm, or no pose is clear of everything.
        ResultFileError: `after` is no servo model.
        MotionRefusedError: no motion within the limits narrows what is still wide.

    Example:
        >>> import dynid
        >>> motion, expected = dynid.design_servo_motion("so101", length=20.0)
        >>> motion.duration <= 20.0, {piece.kind for piece in expected.segments} == {"ramp", "steps", "chirp"}
        (True, True)
    """
    robot_file = load_robot(options.robot)
    result = None if options.after is None else read_servo_result(result_path(options.after))
    if result is not None:
        own = parse_robot(result.robot_file, where=result.robot, folder=None, urdf_text=result.urdf or None)
        if difference := another_arm(robot_file, own):
            raise UsageError(difference, where=str(options.after))
    designed = servo_excitation(robot_file, ArmMotionCheck(robot_file), result, options)
    if designed.motion is None:
        return None, designed
    content = SamplesTrajectory(
        robot=robot_file.robot.name,
        comment=f"designed by dynid excite --for servo: {designed.counts}",
        kind="samples",
        time=tuple((np.arange(len(designed.position)) * PERIOD).round(9).tolist()),
        position=tuple(map(tuple, designed.position.round(9).tolist())),
    )
    return _as_played(robot_file, content, find_prior(robot_file)), designed


@keywords_of(SweepOptions)
def design_sweep(options: SweepOptions) -> tuple[ExcitationTrajectory, tuple[JointSweep, ...]]:
    """Design a motion for friction: one joint at a time, forth and back, its speed rising and falling again.

    Returns:
        The motion, and what each joint does in it.

    Raises:
        UsageError: an option is not possible for this arm.
        MotionRefusedError: no joint can move.
    """
    robot_file = load_robot(options.robot)
    sweep = velocity_sweep(robot_file, ArmMotionCheck(robot_file, options.prior), options)
    comment = "designed by dynid sweep: one joint at a time, back and forth, for friction"
    content = trajectory_of(sweep.motion, robot_file.robot.name, comment)
    return _as_played(robot_file, content, find_prior(robot_file, options.prior)), sweep.joints


def _as_played(robot_file: RobotFile, content: Trajectory, prior: PriorKnowledge) -> ExcitationTrajectory:
    """The motion as it is read back from the text of its file."""
    text = dump_trajectory(content)
    read = parse_trajectory(text, robot_file.robot, where="the designed motion", folder=None)
    return ExcitationTrajectory(robot_file, text, read.motion, prior)
