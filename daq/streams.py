"""What a recording consists of: streams of channels, and events."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Literal

from daq.robot import RobotFile, parse_robot
from drivers.errors import RecordingError, RobotFileError
from drivers.streams import FloatArray

SCHEMA_VERSION = 1
JOINTS_STREAM = "joints"

Level = Literal["info", "warning", "error"]


@dataclass(frozen=True)
class Channel:
    """One dataset of a stream: `values` (N, n) in `unit`, a column for each name in `columns`."""

    quantity: str
    values: FloatArray
    unit: str
    columns: tuple[str, ...]
    description: str = ""


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
    """A recording as it was read.

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
        host: name of the recording computer.
        comment: the user's own words.
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
    host: str = ""
    comment: str = ""

    @property
    def label(self) -> str:
        """What a message calls this recording."""
        return str(self.path) if self.path is not None else "recording in memory"

    def robot(self) -> RobotFile:
        """The robot file that the recording carries.

        Raises:
            RecordingError: the recording carries none, or one that this version does not accept.
        """
        if not self.robot_text:
            raise RecordingError("carries no robot file", where=self.label, hint="name one with --robot")
        try:
            return parse_robot(
                self.robot_text,
                where="its robot file",
                folder=self.path.parent if self.path is not None else None,
                urdf_text=self.urdf_text or None,
            )
        except RobotFileError as error:
            raise RecordingError(str(error), where=self.label, hint="name another robot file with --robot") from error


def software_versions() -> dict[str, str]:
    """Versions of Python, dynid and what it computes with; 'unknown' for what is not installed as a package."""
    versions = {"python": platform.python_version()}
    for package in ("dynid", "numpy", "scipy", "h5py", "pin"):
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            versions[package] = "unknown"
    return versions
