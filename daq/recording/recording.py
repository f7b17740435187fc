"""A recording in memory: streams of channels, and events (HDF5 schema version 1, DESIGN.md "The recording").

    /            attrs: dynid_schema, robot, urdf, created, versions, trajectory, speed_scale, host, comment, complete
    /streams/<name>/time, host_time      (N,) float64 [s]
    /streams/<name>/<quantity>           (N, n), attrs unit, description, joints; magnitude (where the sign is lost)
    /events      compound (N,): time, level, source, message

Everything is created before the first append and nothing is resized but along N, as HDF5's single-writer
multiple-reader mode demands; a writer only appends and flips `complete` at the end.
"""

from __future__ import annotations

import platform
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Self

import numpy.typing as npt

from daq.recording.joint_arrays import JointArrays, command_arrays, joint_arrays
from daq.robot.loader import RobotFile, load_robot, parse_robot
from daq.robot.schema import Robot
from drivers.core.arrays import FloatArray
from drivers.core.errors import DataError, RecordingError, RobotFileError, UsageError
from drivers.streams import UNITS

if TYPE_CHECKING:
    from xarray import Dataset

SCHEMA_VERSION = 1
JOINTS_STREAM = "joints"
COMMANDS_STREAM = "commands"
"""Of the commands where their stamps are not those of the joints."""
MOTOR_SIGNALS = ("torque", "current", "voltage")
"""Quantities of a stream that are or become the joints' torques."""

Level = Literal["info", "warning", "error"]


@dataclass(frozen=True)
class Channel:
    """One dataset of a stream: `values` (N, n) in `unit`, a column for each name in `columns`.

    `magnitude` says whether they have lost their sign.
    """

    quantity: str
    values: FloatArray
    unit: str
    columns: tuple[str, ...]
    description: str = ""
    magnitude: bool = False


@dataclass(frozen=True)
class Stream:
    """Samples of one source.

    Attributes:
        name: of the stream.
        time: (N,) the source's own clock [s].
        host_time: (N,) the host's monotonic clock [s]; equal to `time` where the source was imported.
        channels: quantity → channel.
    """

    name: str
    time: FloatArray
    host_time: FloatArray
    channels: Mapping[str, Channel]


@dataclass(frozen=True)
class Event:
    """Something that happened: a gap, a limit hit, a repair, the reason of a stop; `time` in the source's clock [s]."""

    time: float
    level: Level
    source: str
    message: str


@dataclass(frozen=True)
class Recording:
    """A recording: an arm's measured signals, with its robot file.

    Made by `from_arrays`, `read_recording`, `import_recording` or `simulate`; `write_recording` keeps it.

    Attributes:
        path: file it came from; None for one that was built in memory.
        robot_text: the whole robot file.
        urdf_text: the URDF that the robot file names; empty where it names none.
        complete: whether the writer closed it in order.
        streams: name → stream.
        events: in order of writing.
        created: ISO 8601, UTC.
        versions: package → version at the time of writing.
        trajectory: text of the trajectory file that was played; empty where none was.
        speed_scale: share of its speed at which it was played: all of its times are divided by it.
        host: name of the recording computer.
        comment: the user's own words.

    Example:
        >>> import dynid
        >>> run = dynid.simulate("ur5e", duration=2.0, seed=1)
        >>> sorted(run.streams["joints"].channels)
        ['current', 'position']
    """

    robot_text: str
    streams: Mapping[str, Stream]
    events: tuple[Event, ...] = ()
    complete: bool = True
    path: Path | None = None
    urdf_text: str = ""
    created: str = ""
    versions: Mapping[str, str] = field(default_factory=dict)
    trajectory: str = ""
    speed_scale: float = 1.0
    host: str = ""
    comment: str = ""

    @classmethod
    def from_arrays(
        cls,
        robot: str | Path | RobotFile,
        *,
        time: npt.ArrayLike,
        position: npt.ArrayLike,
        current: npt.ArrayLike | None = None,
        torque: npt.ArrayLike | None = None,
        voltage: npt.ArrayLike | None = None,
        velocity: npt.ArrayLike | None = None,
        temperature: npt.ArrayLike | None = None,
        target_position: npt.ArrayLike | None = None,
        target_time: npt.ArrayLike | None = None,
        comment: str = "",
    ) -> Self:
        """A recording from arrays (N, n): one row per sample, one column per joint in the robot's order.

        Nothing is filtered.

        Args:
            robot: built-in name, robot file, URDF, or the result of `load_robot`.
            time: (N,) strictly rising stamps [s]; gaps are recognised.
            position: (N, n) [rad, or m of prismatic joints].
            current: (N, n) of the motors [A]; the robot file's gains turn it into torque.
            torque: (N, n) at the joints [N·m or N].
            voltage: (N, n) of the motors' references [V], in place of the current.
            velocity: (N, n) [rad/s or m/s]; differentiated from the position where absent.
            temperature: (N, n) of the joints [°C].
            target_position: (N, n) commanded, or (M, n) at stamps of their own [rad or m].
            target_time: (M,) these stamps, of the same clock [s].
            comment: your own words.

        Raises:
            DataError: a wrong shape, missing joints, NaN, unsorted stamps, degrees; names array, sample and joint.
            RobotFileError: no such robot.

        Example:
            >>> import dynid, numpy as np
            >>> time = np.arange(0, 4, 0.01)
            >>> position = 0.5 * np.sin(time)[:, None] * np.ones(6)
            >>> run = dynid.Recording.from_arrays("ur5e", time=time, position=position, current=0 * position)
            >>> run.streams["joints"].channels["current"].unit
            'A'
        """
        robot_file = load_robot(robot)
        if all(given is None for given in (current, torque, voltage, target_position)):
            raise DataError(
                "neither current, voltage nor torque is given, and no target_position", where="Recording.from_arrays"
            )
        given = {
            "position": position,
            "velocity": velocity,
            "current": current,
            "voltage": voltage,
            "torque": torque,
            "temperature": temperature,
        }
        commands = {"target_position": target_position}
        if target_time is None:
            checked, commanded = joint_arrays(robot_file, time, given | commands), None
        else:
            checked, commanded = (
                joint_arrays(robot_file, time, given),
                command_arrays(robot_file, target_time, commands),
            )
        streams = {JOINTS_STREAM: _stream_of_arrays(JOINTS_STREAM, checked, robot_file.robot)}
        if commanded is not None:
            streams[COMMANDS_STREAM] = _stream_of_arrays(COMMANDS_STREAM, commanded, robot_file.robot)
        return cls(
            robot_text=robot_file.text,
            urdf_text=robot_file.urdf_text or "",
            streams=streams,
            created=datetime.now(UTC).isoformat(timespec="seconds"),
            versions=software_versions(),
            host=platform.node(),
            comment=comment,
        )

    def to_xarray(self, stream: str = JOINTS_STREAM) -> Dataset:
        """One stream as an xarray dataset: a variable a quantity (time, joint), with its unit; `host_time` [s] beside.

        Quantities of other columns than the first one's have their own dimension, `<quantity>_column`.

        Args:
            stream: name of the stream.

        Raises:
            UsageError: xarray is not installed, or there is no such stream.

        Example:
            >>> import dynid
            >>> run = dynid.simulate("ur5e", duration=2.0, seed=1)
            >>> run.to_xarray()["position"].dims  # doctest: +SKIP
            ('time', 'joint')
        """
        try:
            import xarray
        except ImportError as error:
            raise UsageError("a dataset needs xarray", hint="pip install 'dynid[frames]'") from error
        if stream not in self.streams:
            raise UsageError(
                f"there is no stream '{stream}'", where=self.label, hint=f"streams: {', '.join(self.streams)}"
            )
        data = self.streams[stream]
        joints = next((channel.columns for channel in data.channels.values()), ())
        coordinates: dict[str, object] = {
            "time": ("time", data.time, {"units": "s"}),
            "host_time": ("time", data.host_time, {"units": "s"}),
            "joint": list(joints),
        }
        variables = {}
        for quantity, channel in data.channels.items():
            dimension = "joint" if channel.columns == joints else f"{quantity}_column"
            coordinates.setdefault(dimension, list(channel.columns))
            attributes = {"units": channel.unit, "long_name": channel.description}
            variables[quantity] = (("time", dimension), channel.values, attributes)
        return xarray.Dataset(variables, coordinates, {"comment": self.comment, "created": self.created})

    @property
    def label(self) -> str:
        """Name of this recording in messages."""
        return str(self.path) if self.path is not None else "recording in memory"

    def robot(self) -> RobotFile:
        """The robot file that the recording carries.

        Raises:
            RecordingError: the recording carries none, or one that this version does not accept.
        """
        if not self.robot_text:
            raise RecordingError("carries no robot file", where=self.label, hint="name one: --robot, in Python robot=")
        try:
            return parse_robot(
                self.robot_text,
                where="its robot file",
                folder=self.path.parent if self.path is not None else None,
                urdf_text=self.urdf_text or None,
            )
        except RobotFileError as error:
            raise RecordingError(
                str(error), where=self.label, hint="name another robot file: --robot, in Python robot="
            ) from error


def _stream_of_arrays(name: str, arrays: JointArrays, arm: Robot) -> Stream:
    names = arm.joint_names
    unsigned = any(arm.drive(joint).signal == "magnitude" for joint in names)
    channels = {}
    for quantity, values in arrays.values.items():
        unit, magnitude = arm.column_unit(UNITS[quantity], names), unsigned and quantity in MOTOR_SIGNALS
        channels[quantity] = Channel(quantity, values, unit, names, "from an array", magnitude)
    return Stream(name, arrays.time, arrays.time, channels)


def software_versions() -> dict[str, str]:
    """Versions of Python, dynid and its numerical libraries; 'unknown' for one that is not installed as a package."""
    return dict(_versions())


@cache
def _versions() -> tuple[tuple[str, str], ...]:
    versions = [("python", platform.python_version())]
    for package in ("dynid", "numpy", "scipy", "h5py", "pin"):
        try:
            versions.append((package, version(package)))
        except PackageNotFoundError:
            versions.append((package, "unknown"))
    return tuple(versions)
