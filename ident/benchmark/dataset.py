"""Registered public recordings: where they come from, what is known of them, and which of their time is held out."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal
from urllib.error import URLError
from urllib.request import urlopen

import yaml
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from daq.importers.choices import ImportChoices
from daq.importers.import_file import import_file
from daq.recording.reader import read_recording
from daq.recording.recording import Recording, Stream
from daq.robot.loader import RobotFile, load_robot, parse_robot
from daq.robot.section import NonNegative, Positive, within
from drivers.core.errors import DataError, UsageError, WorkError
from drivers.core.files import DATASET_FILE, read_text
from drivers.core.ranges import SAMPLING_RATE
from drivers.core.text import did_you_mean
from drivers.core.validation import read_mapping, validated

Kind = Literal["torque", "servo"]
Text = Annotated[str, Field(min_length=1)]

DOWNLOAD_TIMEOUT = 60.0
"""[s] without an answer."""


class _Section(BaseModel):
    model_config = ConfigDict(defer_build=True, frozen=True, extra="forbid", populate_by_name=True)


class Source(_Section):
    """Origin of recordings."""

    repository: Text = Field(description="of the publication, without https://")
    commit: Text = Field(description="of the repository")
    path: Text = Field(description="of the recordings in it")
    licence: Text = Field(description="as the source states it; nothing of the recordings is part of dynid")
    conversion: str = Field(default="", description="what was done to the source's files; empty where nothing was")


class DataFile(_Section):
    """One file of a mirror folder."""

    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")] = Field(description="of its content")
    url: str = Field(default="", description="from where it is downloaded; empty where it has to be converted")


class Use(_Section):
    """A part of a recording, and what it is for."""

    file: Text
    role: Literal["train", "test"]
    start: NonNegative = Field(default=0.0, description="from the recording's first sample [s]")
    stop: Positive | None = Field(default=None, description="[s]; the end of the recording where null")

    @model_validator(mode="after")
    def _in_order(self) -> Use:
        if self.stop is not None and self.stop <= self.start:
            raise ValueError(f"stop {self.stop:g} s is not after start {self.start:g} s")
        return self


class Dataset(_Section):
    """A registered data set: the content of its YAML file."""

    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9-]*$")]
    title: Text
    kind: Kind = Field(default="torque", description="torques at the joints, or positions that follow commands")
    source: Source
    files: dict[str, DataFile] = Field(min_length=1, description="by their paths in the mirror folder")
    robot: str | dict[str, Any] = Field(description="a built-in robot, or the content of a robot file")
    reading: dict[str, Any] = Field(
        default_factory=dict, alias="import", description="arguments of `dynid.import_recording`"
    )
    units: dict[str, str] = Field(description="quantity → unit in the files")
    traps: list[str] = Field(default_factory=list, description="what goes wrong without notice, a sentence each")
    rate: Annotated[Positive, AfterValidator(within(SAMPLING_RATE))] = Field(
        default=500.0, description="largest rate of the samples that are judged [Hz]"
    )
    states: Positive = Field(default=10.0, description="cut-off of the positions and velocities [Hz]")
    band: Positive = Field(default=5.0, description="cut-off of the torques that are compared [Hz]")
    judged: list[str] | None = Field(default=None, description="joints that are judged; all where null")
    runs: list[Use]

    @model_validator(mode="after")
    def _complete(self) -> Dataset:
        for name, file in self.files.items():
            if name.startswith(("/", "~")) or ".." in Path(name).parts:
                raise ValueError(f"'{name}' leaves the mirror folder")
            if file.url and not file.url.startswith("https://"):
                raise ValueError(f"the address of '{name}' does not begin with https://")
        for use in self.runs:
            if use.file not in self.files:
                raise ValueError(f"the run '{use.file}' is not among the files")
        for role in ("train", "test"):
            if not any(use.role == role for use in self.runs):
                raise ValueError(f"no run has the role {role}")
        parts = {role: [use for use in self.runs if use.role == role] for role in ("train", "test")}
        for train in parts["train"]:
            for test in parts["test"]:
                if train.file == test.file and _overlap(train, test):
                    raise ValueError(f"training and test overlap in '{test.file}'")
        return self


def _overlap(first: Use, second: Use) -> bool:
    infinite = float("inf")
    return max(first.start, second.start) < min(first.stop or infinite, second.stop or infinite)


@dataclass(frozen=True)
class LoadedData:
    """A data set's recordings."""

    dataset: Dataset  # where they are from
    robot: RobotFile  # of the arm
    # train, test: parts of recordings
    train: tuple[Recording, ...]
    test: tuple[Recording, ...]


@cache
def registered() -> dict[str, Dataset]:
    """Data sets that come with dynid, by name."""
    entries = sorted(files("ident.benchmark").joinpath("datasets").iterdir(), key=lambda path: path.name)
    listed = [
        parse_dataset(path.read_text(encoding="utf-8"), path.name) for path in entries if path.name.endswith("yaml")
    ]
    return {dataset.name: dataset for dataset in listed}


def parse_dataset(text: str, where: str) -> Dataset:
    """A data set from its YAML.

    Raises:
        UsageError: names the key and what is allowed.
    """
    hint = "a registered one is printed by: dynid bench --list --json"
    content = read_mapping(text, kind="a data set", where=where, refusal=UsageError, hint=hint)
    return validated(content, Dataset, where=where, refusal=UsageError)


def chosen_datasets(names: Sequence[str]) -> list[Dataset]:
    """Data sets by name or by the path of their YAML file; every registered one where none is named.

    Raises:
        UsageError: there is no such data set, its file is wrong, or two have one name.
    """
    data_sets = registered()
    chosen = []
    for name in names or list(data_sets):
        if name in data_sets:
            chosen.append(data_sets[name])
        elif name.endswith((".yaml", ".yml")):
            chosen.append(parse_dataset(read_text(Path(name), DATASET_FILE, UsageError), name))
        else:
            hint = did_you_mean(name, data_sets) or "the path of a YAML file, too"
            raise UsageError(f"no data set is called '{name}'; there are {', '.join(data_sets)}", hint=hint)
    given = [dataset.name for dataset in chosen]
    if len(set(given)) < len(given):
        raise UsageError(f"a data set is named twice: {', '.join(given)}")
    return chosen


def missing_files(dataset: Dataset, folder: Path) -> list[str]:
    """Files of a data set that a mirror folder has not."""
    return [name for name in dataset.files if not (folder / name).is_file()]


def download(dataset: Dataset, folder: Path) -> None:
    """Fetch what is missing and has an address, and compare its SHA-256 before it is written.

    Raises:
        WorkError: an address does not answer, or answers with another content.
    """
    for name in missing_files(dataset, folder):
        file = dataset.files[name]
        if not file.url:
            continue
        try:
            with urlopen(file.url, timeout=DOWNLOAD_TIMEOUT) as answer:
                content = answer.read()
        except (URLError, OSError, ValueError) as error:
            raise WorkError(f"cannot be downloaded: {error}", where=file.url) from error
        if hashlib.sha256(content).hexdigest() != file.sha256:
            raise WorkError("is not the file that was registered: its SHA-256 differs", where=file.url)
        place = folder / name
        try:
            place.parent.mkdir(parents=True, exist_ok=True)
            unfinished = place.with_name(f"{place.name}.part")
            unfinished.write_bytes(content)
            unfinished.replace(place)
        except OSError as error:
            raise UsageError(f"cannot be written: {error.strerror}", where=str(place)) from error


def load_dataset(dataset: Dataset, folder: Path) -> LoadedData:
    """Read a data set from a mirror folder.

    Raises:
        DataError: a file is missing or is another than the registered one; says where to get it.
        InputError: a file cannot be read.
    """
    if missing := missing_files(dataset, folder):
        source = dataset.source
        origin = f"{source.repository} at {source.commit[:8]}, {source.path}"
        how = "dynid bench --download" if all(dataset.files[name].url for name in missing) else f"get it from {origin}"
        raise DataError(f"{dataset.name}: {', '.join(missing)} is missing", where=str(folder), hint=how)
    for name, file in dataset.files.items():
        if hashlib.sha256((folder / name).read_bytes()).hexdigest() != file.sha256:
            raise DataError("is not the registered file: its SHA-256 differs", where=str(folder / name))
    robot = _robot(dataset, folder)
    options = [of.name for of in fields(ImportChoices)]
    for name in dataset.reading:
        if name not in options:
            hint = did_you_mean(name, options) or f"it has {', '.join(options)}"
            raise UsageError(f"{dataset.name}: import has no option '{name}'", hint=hint)
    choices = ImportChoices(**dataset.reading)
    read = {use.file: _read(folder / use.file, robot, choices) for use in dataset.runs}
    parts = {
        role: tuple(part(read[use.file], use.start, use.stop) for use in dataset.runs if use.role == role)
        for role in ("train", "test")
    }
    return LoadedData(dataset, robot, parts["train"], parts["test"])


def _read(path: Path, robot: RobotFile, choices: ImportChoices) -> Recording:
    return read_recording(path) if path.suffix == ".h5" else import_file(path, robot, choices)


def _robot(dataset: Dataset, folder: Path) -> RobotFile:
    if isinstance(dataset.robot, str):
        return load_robot(dataset.robot)
    text = yaml.safe_dump(dataset.robot, sort_keys=False, allow_unicode=True)
    return parse_robot(text, where=f"robot of {dataset.name}", folder=folder)


def part(recording: Recording, start: float, stop: float | None) -> Recording:
    """The samples of a recording from `start` on and before `stop` [s], counted from its first stamp.

    Raises:
        DataError: there are none.
    """
    begin = min(float(stream.time[0]) for stream in recording.streams.values() if len(stream.time))
    end = float("inf") if stop is None else stop

    def cut(stream: Stream) -> Stream:
        since = stream.time - begin
        inside = (since >= start) & (since < end)
        channels = {name: replace(of, values=of.values[inside]) for name, of in stream.channels.items()}
        return Stream(stream.name, stream.time[inside], stream.host_time[inside], channels)

    streams = {name: cut(stream) for name, stream in recording.streams.items()}
    if not any(len(stream.time) for stream in streams.values()):
        raise DataError(f"there is no sample from {start:g} to {end:g} s", where=recording.label)
    return replace(recording, path=None, streams=streams, events=())
