"""Other people's files as recordings: CSV, .npz, .mat, HDF5, ROS 2 bags (sqlite3 and MCAP).

A reader (`csv`, `npz`, `mat`, `rosbag`) gives a `Table`; `assembly` puts it into the robot's joint order and into SI;
`checks` and `plausibility` refuse what is wrong. All assumptions and repairs become events of the recording.
"""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from importlib import import_module
from os import PathLike
from pathlib import Path

import numpy as np

from daq.importers.assembly import ImportedSamples, assemble
from daq.importers.checks import check_samples
from daq.importers.choices import ImportChoices
from daq.importers.formats.csv import read_csv
from daq.importers.formats.lerobot import INFO, is_lerobot, parquet_reader, read_lerobot
from daq.importers.formats.mat import read_hdf5, read_mat
from daq.importers.formats.npz import read_npz
from daq.importers.formats.rosbag import bag_files, read_rosbag
from daq.importers.plausibility import check_units
from daq.importers.table import ForeignTable, parsing, printable
from daq.recording.recording import COMMANDS_STREAM, JOINTS_STREAM, Channel, Event, Recording, Stream
from daq.robot.loader import RobotFile, load_robot
from daq.robot.schema import Robot
from drivers.core.errors import ImportFileError, UsageError
from drivers.core.files import ARRAY_FILE, HDF5_SIGNATURE, open_input, path_of
from drivers.core.options import argument, keywords_of
from drivers.core.reading_process import TIME_LIMIT, Progress, read_apart
from drivers.core.software import software_versions
from drivers.streams import COMMANDS, UNITS

Reader = Callable[[Path, Sequence[str], ImportChoices], ForeignTable]

_READERS: Mapping[str, Reader] = {
    ".csv": read_csv,
    ".tsv": read_csv,
    ".txt": read_csv,
    ".dat": read_csv,
    ".npz": read_npz,
    ".mat": read_mat,
    ".h5": read_hdf5,
    ".hdf5": read_hdf5,
    ".db3": read_rosbag,
    ".mcap": read_rosbag,
}
SUPPORTED = (*_READERS, "a ROS 2 bag's folder", "a LeRobot dataset's folder")
"""Endings that `import_file` reads."""

_OF_BAGS = ("rosbags.rosbag2", "rosbags.typesys.stores.ros2_humble")
_LIBRARIES = {".mat": ("scipy.io",), ".db3": _OF_BAGS, ".mcap": _OF_BAGS}
BAG_SPEED = 2e6
"""Bytes of a bag [B/s] that are surely read in so much processor time: messages are read one by one, 20 µs each."""
DATASET_SPEED = 1e6
"""The same of a dataset's Parquet files, whose episodes are checked one by one."""

_ORDER = ("position", "velocity", "current", "torque", "temperature", *COMMANDS)
_MAGIC = (
    (b"SQLite format 3\0", ".db3"),
    (b"\x89MCAP0\r\n", ".mcap"),
    (b"PK\x03\x04", ".npz"),
    (b"MATLAB ", ".mat"),
    (HDF5_SIGNATURE, ".h5"),
)


_FROM_MEMORY = "dynid.Recording.from_dataframe(robot, frame) and from_dict take data that are already in memory"


def import_file(
    path: Path, robot: RobotFile, choices: ImportChoices, progress: Progress = lambda step: None
) -> Recording:
    """Import a foreign file as a recording in memory: a stream `joints`, and `commands` where they have own stamps.

    Current stays current: it becomes torque at identification, with the drive gains.

    Returns:
        A recording in SI, columns in the robot's order, every assumption and repair as an event.

    Raises:
        ImportFileError: an unknown kind of file, one that is wrong, incomplete or ambiguous, or one that takes too much
            time or memory to read.
        UsageError: choices that don't apply to this kind of file.
    """
    if not path.exists():
        raise ImportFileError("no such file", where=str(path))
    if is_lerobot(path):
        episodes = import_episodes(path, robot, choices, progress)
        if len(episodes) > 1:
            raise UsageError(
                f"holds {len(episodes)} episodes, each a recording of its own",
                where=str(path),
                hint="choose one: episode=0",
            )
        return next(iter(episodes.values()))
    if choices.episode is not None or choices.calibration is not None:
        given = "episode" if choices.episode is not None else "calibration"
        raise UsageError(f"--{given} is for LeRobot datasets", where=str(path), hint=f"there is no {INFO} in it")
    reader = _reader(path)
    for library in _LIBRARIES.get(path.suffix.lower(), ()):  # once, not in every reading process
        import_module(library)
    time_limit = TIME_LIMIT
    if reader is read_rosbag:
        time_limit += sum(file.stat().st_size for file in bag_files(path) if file.is_file()) / BAG_SPEED

    def read(progress: Progress) -> Recording:
        return _import(reader, path, robot, choices, progress)

    return read_apart(read, path, ImportFileError, time_limit=time_limit, progress=progress)


def import_episodes(
    path: Path, robot: RobotFile, choices: ImportChoices, progress: Progress = lambda step: None
) -> dict[int, Recording]:
    """Import the episodes of a LeRobot dataset, or the one that `choices.episode` names, by their numbers.

    Raises:
        ImportFileError: as `import_file`; names the episode.
        UsageError: pyarrow is missing, or choices that don't apply.
    """

    def read(progress: Progress) -> dict[int, Recording]:
        progress(f"reading {printable(path.name)}")
        recordings = {}
        for episode in read_lerobot(path, robot, choices):
            progress(f"checking episode {episode.number}")
            name, where = f"{path.name}, episode {episode.number}", f"{path}: episode {episode.number}"
            origin = _origin(name, episode.table, episode.files)
            recordings[episode.number] = recording_of_table(episode.table, robot, choices, where, origin)
        return recordings

    parquet_reader(path)  # once, not in every reading process
    size = sum(file.stat().st_size for file in path.rglob("*.parquet") if file.is_file())
    time_limit = TIME_LIMIT + size / DATASET_SPEED
    return read_apart(read, path, ImportFileError, time_limit=time_limit, progress=progress)


def _import(reader: Reader, path: Path, robot: RobotFile, choices: ImportChoices, progress: Progress) -> Recording:
    progress(f"reading {printable(path.name)}")
    if reader is read_rosbag:  # the only one that is not done in seconds
        reader = partial(read_rosbag, progress=progress)
    table = reader(path, robot.robot.joint_names, choices)
    progress("checking the samples")
    return recording_of_table(table, robot, choices, str(path), _origin(path.name, table, bag_files(path)))


def _origin(name: str, table: ForeignTable, files: Sequence[Path]) -> str:
    return f"imported from {printable(name)} ({table.source}), SHA-256 {_sha256(files)}"


def recording_of_table(
    table: ForeignTable, robot: RobotFile, choices: ImportChoices, where: str, comment: str
) -> Recording:
    """The recording of a foreign table: in the robot's joint order and in SI, checked.

    Raises:
        ImportFileError: columns that are wrong, incomplete or ambiguous.
    """
    # Absurd values overflow on their way to being refused; the refusal says it, not a warning of NumPy.
    with np.errstate(over="ignore", invalid="ignore"):
        samples = assemble(table, robot, choices, where)
        samples = check_samples(samples, choices, where)
        samples = check_units(samples, robot.robot, robot.prismatic_joints, choices, where)
    return Recording(
        robot_text=robot.text,
        urdf_text=robot.urdf_text or "",
        streams=_streams(samples, table.source, robot.robot),
        events=_events(samples),
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        versions=software_versions(),
        host=platform.node(),
        comment=comment,
    )


def _reader(path: Path) -> Reader:
    if path.is_dir() or path.name == "metadata.yaml":
        return read_rosbag
    suffix = path.suffix.lower()
    if suffix in _READERS:
        return _READERS[suffix]
    if suffix == ".bag":
        raise ImportFileError(
            "is a ROS 1 bag, which is not read",
            where=str(path),
            hint="convert it: rosbags-convert --src FILE --dst FOLDER",
        )
    with open_input(path, ARRAY_FILE, ImportFileError) as file:
        head = file.read(16)
    looks = next((ending for magic, ending in _MAGIC if head.startswith(magic)), None)
    raise ImportFileError(
        f"unknown kind of file '{printable(path.suffix) or path.name}'; supported are: {', '.join(SUPPORTED)}",
        where=str(path),
        hint=f"its content looks like {looks}; rename it" if looks else "",
    )


def _streams(samples: ImportedSamples, source: str, robot: Robot) -> dict[str, Stream]:
    streams = {JOINTS_STREAM: _stream(JOINTS_STREAM, samples, source, robot)}
    if samples.commands is not None:
        streams[COMMANDS_STREAM] = _stream(COMMANDS_STREAM, samples.commands, source, robot)
    return streams


def _stream(name: str, samples: ImportedSamples, source: str, robot: Robot) -> Stream:
    channels = {
        quantity: Channel(
            quantity=quantity,
            values=entry.values,
            unit=robot.column_unit(UNITS[quantity], entry.joints),
            columns=entry.joints,
            description=f"imported ({source}): {', '.join(dict.fromkeys(map(printable, entry.labels)))}",
            magnitude=entry.magnitude,
        )
        for quantity in _ORDER
        if (entry := samples.quantities.get(quantity)) is not None
    }
    return Stream(name=name, time=samples.time, host_time=samples.time, channels=channels)


def _events(samples: ImportedSamples) -> tuple[Event, ...]:
    return tuple(
        Event(float(samples.time[note.sample or 0]), note.level, "import", _one_line(note.message))
        for note in samples.notes
    )


def _one_line(text: str) -> str:
    """A message without characters that HDF5 texts cannot hold."""
    return "".join(character if character.isprintable() else " " for character in text)


def _sha256(files: Sequence[Path]) -> str:
    digest = hashlib.sha256()
    for path in files:
        with parsing(path, "a file"), path.open("rb") as file:
            while chunk := file.read(1 << 20):
                digest.update(chunk)
    return digest.hexdigest()


@dataclass(frozen=True)
class ImportOptions(ImportChoices):
    """Arguments of `import_recording`."""

    path: str | PathLike[str] = field(metadata=argument("file", "Path of the file, or of a bag's or dataset's folder."))
    robot: str | Path | RobotFile = field(
        metadata=argument("robot", "Built-in name, robot file, URDF, or the result of `load_robot`.")
    )


@keywords_of(ImportOptions)
def import_recording(options: ImportOptions) -> Recording:
    """Import a CSV, npz, mat, HDF5, ROS 2 bag or MCAP file, or a LeRobot episode, as a recording in memory, in SI.

    Raises:
        ImportFileError: an unknown kind of file, or one that is wrong, incomplete or ambiguous.
        UsageError: options that do not apply.

    Example:
        >>> import dynid, numpy as np, pathlib, tempfile
        >>> time = np.arange(0, 4, 0.01)
        >>> q = 0.5 * np.sin(time)[:, None] * np.ones(6)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder, "run.npz")
        ...     np.savez(path, t=time, q=q, torque=10 * q)
        ...     run = dynid.import_recording(path, "ur5e")
        >>> run.streams["joints"].channels["torque"].values.shape
        (400, 6)
    """
    return import_file(path_of(options.path, _FROM_MEMORY), load_robot(options.robot), options)
