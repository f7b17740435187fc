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
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from html import escape
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np
import numpy.typing as npt

from daq.plotting import Backend, LinePanel, line_figure
from daq.recording.array_choices import ArrayChoices
from daq.recording.joint_arrays import JointArrays, command_arrays, joint_arrays
from daq.robot.loader import RobotFile, load_robot, parse_robot
from daq.robot.schema import Robot
from drivers.core.arrays import FloatArray
from drivers.core.errors import DataError, DynidError, RecordingError, RobotFileError, UsageError
from drivers.core.files import path_of
from drivers.core.options import argument, keywords_of, option
from drivers.core.software import software_versions
from drivers.streams import UNITS

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset

SCHEMA_VERSION = 1
STOPPED = "stopped: "
"""How the event begins that says what stopped a session before its end."""
HAND_GUIDED = "hand guiding begins"
"""How the event begins from which on a hand led the arm: no torque after it is the arm's alone."""
JOINTS_STREAM = "joints"
COMMANDS_STREAM = "commands"
"""Stream of the commands where their stamps are not those of the joints."""
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

    def __repr__(self) -> str:
        return f"<Channel {self.quantity} [{self.unit}] of {', '.join(self.columns)}, {len(self.values)} samples>"


@dataclass(frozen=True)
class Stream:
    """Samples of one source."""

    name: str  # of the stream
    time: FloatArray  # (N,) the source's own clock [s]
    host_time: FloatArray  # (N,) the host's monotonic clock [s]; equal to `time` where the source was imported
    channels: Mapping[str, Channel]  # quantity → channel

    def __repr__(self) -> str:
        return f"<Stream {self.name}: {_pace(self)}, {', '.join(self.channels)}>"


@dataclass(frozen=True)
class Event:
    """Something that happened: a gap, a limit hit, a repair, the reason of a stop; `time` in the source's clock [s]."""

    time: float
    level: Level
    source: str
    message: str


_ROBOT = argument("robot", "Built-in name, robot file, URDF, or the result of `load_robot`.")


@dataclass(frozen=True, kw_only=True)
class NamedArrayOptions(ArrayChoices):
    """Arguments of what makes a recording of arrays with names."""

    units: Mapping[str, str] = option(
        {},
        "Unit of each column or array, or of all of a quantity, such as {'position': 'deg', 'torque': 'Nm'}; "
        "a name may state its own, `q1 [deg]`. SI where neither does.",
    )
    comment: str = option("", "Your own words.")


@dataclass(frozen=True)
class FrameOptions(NamedArrayOptions):
    """Arguments of `from_dataframe`."""

    robot: str | Path | RobotFile = field(metadata=_ROBOT)
    frame: DataFrame = field(metadata=argument("frame", "The data: one row per sample."))


@dataclass(frozen=True)
class DictOptions(NamedArrayOptions):
    """Arguments of `from_dict`."""

    robot: str | Path | RobotFile = field(metadata=_ROBOT)
    arrays: Mapping[str, npt.ArrayLike] = field(metadata=argument("arrays", "Name → array, list or tensor."))


@dataclass(frozen=True, repr=False)
class Recording:
    """A recording: an arm's measured signals, with its robot file.

    Made by `from_arrays`, `from_dataframe`, `from_dict`, `read_recording`, `import_recording` or `simulate`; `save`
    keeps it. Signals of the joints are `time` (N,) and `position`, `velocity`, `current`, `torque`, `temperature`
    (N, n); what was not recorded is a `DataError` that says what was.

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
        part: from and until [s] after the file's first stamp, where only so much of it was read; None for all of it.

    Example:
        >>> import dynid
        >>> run = dynid.simulate("ur5e", duration=2.0, seed=1)
        >>> run
        <dynid.Recording of ur5e: 2 s at 500 Hz, position, current>
        >>> run.time.shape, run.position.shape
        ((1000,), (1000, 6))
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
    part: tuple[float, float] | None = None

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

    @staticmethod
    @keywords_of(FrameOptions)
    def from_dataframe(options: FrameOptions) -> Recording:
        """A recording from a pandas (or polars) data frame: one row per sample.

        Columns are recognised by their names: a time `t` (or an index of times), positions `q1`, `q2`, … or
        `position_elbow`, and likewise `qd`, `torque`, `current`, `temperature`.

        Raises:
            ImportFileError: columns that are wrong, incomplete or ambiguous; names the column and what to do.
            UsageError: it is not a data frame, or options that do not apply.
            RobotFileError: no such robot.

        Example:
            >>> import dynid, numpy as np
            >>> pandas = __import__("pytest").importorskip("pandas")
            >>> time = np.arange(0, 4, 0.01)
            >>> frame = pandas.DataFrame({"time": time})
            >>> for joint in range(1, 7):
            ...     frame[f"q{joint} [deg]"] = 30 * np.sin(time)
            ...     frame[f"torque{joint}"] = np.cos(time)
            >>> dynid.Recording.from_dataframe("ur5e", frame)
            <dynid.Recording of ur5e: 4 s at 100 Hz, position, torque>
        """
        from daq.importers.arrays import arrays_of_frame, recording_of_arrays

        return recording_of_arrays(arrays_of_frame(options.frame), options)

    @staticmethod
    @keywords_of(DictOptions)
    def from_dict(options: DictOptions) -> Recording:
        """A recording from named arrays: `t` (N,), `q`, `qd`, `torque`, `current`, … (N, n), or one (N,) per joint.

        Raises:
            ImportFileError: arrays that are wrong, incomplete or ambiguous; names the array and what to do.
            UsageError: it is not a dictionary, or options that do not apply.
            RobotFileError: no such robot.

        Example:
            >>> import dynid, numpy as np
            >>> time = np.arange(0, 4, 0.01)
            >>> q = 30 * np.sin(time)[:, None] * np.ones(6)
            >>> dynid.Recording.from_dict("ur5e", {"t": time, "q": q, "tau": 0.1 * q}, units={"q": "deg"})
            <dynid.Recording of ur5e: 4 s at 100 Hz, position, torque>
        """
        from daq.importers.arrays import arrays_of_dict, recording_of_arrays

        return recording_of_arrays(arrays_of_dict(options.arrays), options)

    @property
    def time(self) -> FloatArray:
        """Stamps of the joints' samples (N,) [s]."""
        return self._joints().time

    @property
    def position(self) -> FloatArray:
        """Positions of the joints (N, n) [rad or m]."""
        return self._signal("position")

    @property
    def velocity(self) -> FloatArray:
        """Velocities of the joints (N, n) [rad/s or m/s], where they were recorded."""
        return self._signal("velocity")

    @property
    def current(self) -> FloatArray:
        """Currents of the motors (N, n) [A], where they were recorded."""
        return self._signal("current")

    @property
    def torque(self) -> FloatArray:
        """Torques of the joints (N, n) [N·m or N], where they were recorded."""
        return self._signal("torque")

    @property
    def temperature(self) -> FloatArray:
        """Temperatures of the joints (N, n) [°C], where they were recorded with the positions."""
        return self._signal("temperature")

    def _joints(self) -> Stream:
        if JOINTS_STREAM not in self.streams:
            raise DataError(
                "has no stream of the joints",
                where=self.label,
                hint=f"its streams: {', '.join(self.streams) or 'none'}",
            )
        return self.streams[JOINTS_STREAM]

    def _signal(self, quantity: str) -> FloatArray:
        channels = self._joints().channels
        if quantity in channels:
            return channels[quantity].values
        hints = [f"recorded: {', '.join(channels)}"]
        hints += [f'run.streams["{name}"]' for name, stream in self.streams.items() if quantity in stream.channels]
        if quantity == "velocity":
            hints.append("numpy.gradient(run.position, run.time, axis=0) differentiates")
        if quantity == "torque" and "current" in channels:
            hints.append("dynid.identify turns currents into torques, by the gains of the robot file")
        raise DataError(f"{quantity} was not recorded", where=self.label, hint="; ".join(hints))

    def save(self, path: str | PathLike[str], *, overwrite: bool = False) -> None:
        """Write the recording (HDF5, .h5), as `write_recording` does; `read_recording` reads it.

        Args:
            path: of the file.
            overwrite: replace a file that exists.

        Raises:
            UsageError: the file exists already, is no regular file, or its folder cannot be written.
            DiskError: the disk is full or fails; a file that existed is as it was.
        """
        from daq.recording.writer import write_recording

        write_recording(path_of(path), self, overwrite=overwrite)

    def plot(self, *quantities: str, backend: Backend = "plotly") -> Any:
        """Signals of the joints over time, a panel per quantity and a line per joint.

        Args:
            quantities: such as "position"; all that were recorded where none is named.
            backend: "plotly" gives a `plotly.graph_objects.Figure`, "matplotlib" a `matplotlib.figure.Figure`.

        Raises:
            DataError: a quantity was not recorded.
            UsageError: the backend does not exist or is not installed.

        Example:
            >>> import dynid
            >>> figure = dynid.simulate("ur5e", duration=2.0, seed=1).plot("position")
            >>> len(figure.data)
            6
        """
        stream = self._joints()
        for quantity in quantities:
            self._signal(quantity)
        shown = [stream.channels[quantity] for quantity in quantities or _ordered(stream)]
        panels = [
            LinePanel(
                channel.quantity,
                stream.time,
                dict(zip(channel.columns, channel.values.T, strict=True)),
                "time [s]",
                channel.unit,
            )
            for channel in shown
        ]
        return line_figure(panels, 1, backend, linked=True)

    def to_frame(self) -> DataFrame:
        """Signals of the joints as a pandas data frame, indexed by time [s]; `from_dataframe` reads it back.

        Columns are `position_<joint>` and so on; their units are in `frame.attrs["units"]`.

        Raises:
            UsageError: pandas is not installed.
        """
        try:
            import pandas
        except ImportError as error:
            raise UsageError("a data frame needs pandas", hint="pip install 'dynid[frames]'") from error
        stream, robot = self._joints(), self.robot().robot
        columns, units = {}, {}
        for quantity in _ordered(stream):
            channel = stream.channels[quantity]
            for joint, values in zip(channel.columns, channel.values.T, strict=True):
                columns[f"{quantity}_{joint}"] = values
                units[f"{quantity}_{joint}"] = robot.column_unit(UNITS.get(quantity, channel.unit), (joint,))
        frame = pandas.DataFrame(columns, index=pandas.Index(stream.time, name="time"))
        frame.attrs["units"] = units
        return frame

    def __repr__(self) -> str:
        return f"<dynid.Recording of {self._arm}: {self._what}>"

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><td>{escape(name)}</td><td>{len(stream.time)}</td><td>{_pace(stream)}</td>"
            f"<td>{escape(', '.join(f'{each.quantity} [{each.unit}]' for each in stream.channels.values()))}</td></tr>"
            for name, stream in self.streams.items()
        )
        head = "".join(f"<th>{heading}</th>" for heading in ("stream", "samples", "duration and rate", "signals"))
        note = f"<p>{escape(self.comment)}</p>" if self.comment else ""
        caption = f"<caption>Recording of {escape(self._arm)}: {escape(self.label)}</caption>"
        return f"<table>{caption}<thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>{note}"

    @property
    def _arm(self) -> str:
        with suppress(DynidError):
            return self.robot().robot.name
        return "an unknown arm"

    @property
    def _what(self) -> str:
        if JOINTS_STREAM not in self.streams:
            return f"streams {', '.join(self.streams) or 'none'}"
        stream = self.streams[JOINTS_STREAM]
        others = "".join(f", stream {name}" for name in self.streams if name != JOINTS_STREAM)
        return f"{_pace(stream)}, {', '.join(_ordered(stream))}{others}{'' if self.complete else ', incomplete'}"

    def to_xarray(self, stream: str = JOINTS_STREAM) -> Dataset:
        """One stream as an xarray dataset: a variable a quantity (time, joint), with its unit; `host_time` [s] beside.

        Quantities of other columns than the first one's have their own dimension, `<quantity>_column`.

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
        name = str(self.path) if self.path is not None else "recording in memory"
        return name if self.part is None else f"{name}, {self.part[0]:g} to {self.part[1]:g} s"

    @property
    def stopped_by(self) -> str:
        """Return what stopped `dynid record` before the motion's end, in words; empty where nothing did."""
        stops = [event.message for event in self.events if event.message.startswith(STOPPED)]
        return stops[-1].removeprefix(STOPPED) if stops else ""

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


def _ordered(stream: Stream) -> list[str]:
    """Quantities of a stream, motion first."""
    order = list(UNITS)
    return sorted(stream.channels, key=lambda name: (order.index(name) if name in order else len(order), name))


def _pace(stream: Stream) -> str:
    """Duration and rate of a stream, in words."""
    time = stream.time[np.isfinite(stream.time)]
    if len(time) < 2 or not (step := float(np.median(np.diff(time)))) > 0.0:
        return f"{len(time)} samples"
    return f"{time[-1] - time[0] + step:.4g} s at {1.0 / step:.4g} Hz"
