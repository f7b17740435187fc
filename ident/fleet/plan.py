"""The fleet file: which arms, recordings and methods; and the jobs that follow from it."""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from glob import glob, has_magic
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, model_validator

from daq.recording.reader import recording_seconds
from drivers.core.errors import DynidError, RecordingError, UsageError
from drivers.core.files import FLEET_FILE, check_utf8, read_text
from drivers.core.ranges import RECORDING_TIME
from drivers.core.text import did_you_mean
from drivers.core.validation import read_mapping, validated
from ident.tasks.options import IdentifyOptions

PARTS_FRICTION = "coulomb-viscous"
"""Friction terms of parts where the file names none."""
FAN_IN = 32
"""Results that one job merges."""
EXAMPLE = "arms: [{name: cell-1, recordings: [cell-1/*.h5]}]"

_FolderName = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._ -]{0,99}$")]
_OF_A_JOB = frozenset({"runs", "validation", "robot", "method", "progress"})
_FILES = ("accept", "friction_from")
"""Options that name a file."""


class FleetArm(BaseModel):
    """One arm and what was recorded of it."""

    model_config = ConfigDict(defer_build=True, extra="forbid", frozen=True)

    name: _FolderName = Field(description="its folder of results")
    recordings: list[str] = Field(min_length=1, description="paths, patterns (*.h5) or URLs; one result of each")
    together: bool = Field(default=False, description="whether the recordings are stacked into one result")
    validation: list[str] = Field(default=[], description="held-out recordings; the last 30 % without any")
    robot: str | None = Field(default=None, description="robot file in place of the recordings' own")
    parts: float | None = Field(
        default=None,
        ge=10.0,
        le=RECORDING_TIME.most,
        description="seconds of a job: long recordings, merged in the end",
    )

    @model_validator(mode="after")
    def _parts_alone(self) -> FleetArm:
        if self.parts is not None and self.together:
            raise ValueError("parts are merged, not stacked: omit 'together'")
        return self


class FleetFile(BaseModel):
    """A fleet: each recording of each arm is identified with each method."""

    model_config = ConfigDict(defer_build=True, extra="forbid", frozen=True)

    arms: list[FleetArm] = Field(min_length=1, description="the arms")
    methods: list[str] = Field(default=["wls"], min_length=1, description="as identify takes them")
    options: dict[str, Any] = Field(default={}, description="further options of identify, by their Python names")


@dataclass(frozen=True)
class Job:
    """One identification."""

    name: str  # arm, recording and method, its folder below the fleet's
    arm: str  # its name
    # recordings, validation: paths or URLs
    recordings: tuple[str, ...]
    validation: tuple[str, ...]
    robot: str | None  # path or built-in name; None for the recordings' own
    method: str  # as identify takes it
    options: tuple[tuple[str, Any], ...]  # further options of identify, as pairs
    part: tuple[float, float] | None = None  # from and until [s], of the one recording; None for all of it
    merged: tuple[str, ...] | None = None  # names of the jobs whose results are merged; None where it identifies

    def key(self) -> str:
        """What its result depends on, as hexadecimal digits: files by path, size and time, options, dynid's version."""
        named = [value for name, value in self.options if name in _FILES and isinstance(value, str)]
        content = [
            [_state(path) for path in (*self.recordings, *self.validation, self.robot or "", *named)],
            [self.method, self.options, self.part, self.merged, version("dynid")],
        ]
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def read_fleet(path: Path) -> list[Job]:
    """The jobs of a fleet file, in its order; relative paths are taken from its folder.

    Raises:
        UsageError: it cannot be read, a key or an option is wrong, a pattern finds nothing, or two jobs share a folder.
    """
    where = str(path)
    text = read_text(path, FLEET_FILE, UsageError)
    content = read_mapping(text, kind="a fleet file", where=where, refusal=UsageError, hint=EXAMPLE)
    fleet = validated(content, FleetFile, where=where, refusal=UsageError)
    _check_options(fleet, where)
    for name in _FILES:
        if isinstance(value := fleet.options.get(name), str):
            fleet.options[name] = str((path.parent / value).resolve())
    jobs = [job for arm in fleet.arms for job in _jobs(fleet, arm, path.parent, where)]
    name, count = Counter(job.name for job in jobs).most_common(1)[0]
    if count > 1:
        raise UsageError(f"two results would be written to {name}", where=where, hint="give the arms other names")
    return jobs


def is_url(place: str) -> bool:
    """Return whether a recording is named by a URL (s3://…, https://…), which fsspec opens."""
    return "://" in place


def _check_options(fleet: FleetFile, where: str) -> None:
    allowed = sorted({field.name for field in fields(IdentifyOptions)} - _OF_A_JOB)
    for name in fleet.options:
        if name not in allowed:
            hint = did_you_mean(name, allowed) or f"there are {', '.join(allowed)}"
            raise UsageError(f"options: '{name}' is not an option of identify", where=where, hint=hint)
    for method in fleet.methods:
        try:
            IdentifyOptions(runs=(), method=method, **fleet.options)
        except DynidError as error:
            raise UsageError(error.message, where=where, hint=error.hint) from error


def _jobs(fleet: FleetFile, arm: FleetArm, folder: Path, where: str) -> Iterator[Job]:
    recordings = [path for place in arm.recordings for path in _found(place, folder, arm, where)]
    validation = tuple(path for place in arm.validation for path in _found(place, folder, arm, where))
    robot = arm.robot
    if robot is not None and (folder / robot).is_file():
        robot = str((folder / robot).resolve())
    if arm.parts is not None:
        yield from _parts(fleet, arm, recordings, validation, robot, where)
        return
    groups = [tuple(recordings)] if arm.together else [(recording,) for recording in recordings]
    for group in groups:
        stem = Path(group[0]).stem if len(group) == 1 else "all"
        for method in fleet.methods:
            name = f"{arm.name}/{stem}/{_folder(method)}"
            yield Job(name, arm.name, group, validation, robot, method, tuple(sorted(fleet.options.items())))


def _parts(
    fleet: FleetFile,
    arm: FleetArm,
    recordings: Sequence[str],
    validation: tuple[str, ...],
    robot: str | None,
    where: str,
) -> Iterator[Job]:
    """Jobs of the parts of long recordings; terms that each would choose for itself could not be merged."""
    options = tuple(sorted({"friction": PARTS_FRICTION, **fleet.options}.items()))
    for place in recordings:
        if is_url(place):
            raise UsageError(f"arm {arm.name}: parts need files, not {place}", where=where, hint="fetch it first")
        try:
            seconds = recording_seconds(Path(place))
        except RecordingError:  # its job fails for the same reason, and the others go on
            for method in fleet.methods:
                name = f"{arm.name}/{Path(place).stem}/{_folder(method)}"
                yield Job(name, arm.name, (place,), validation, robot, method, options)
            continue
        count = max(1, round(seconds / arm.parts))  # type: ignore[operator]  # not None here
        borders = [*(seconds * number / count for number in range(count)), math.floor(seconds) + 1.0]
        for number, part in enumerate(pairwise(borders), start=1):
            for method in fleet.methods:
                name = f"{arm.name}/{Path(place).stem}-part-{number:04d}/{_folder(method)}"
                yield Job(name, arm.name, (place,), validation, robot, method, options, part=part)


def merges(fleet_jobs: Sequence[Job]) -> Iterator[list[Job]]:
    """Jobs that merge the results of parts, a level of the tree at a time; `ARM/merged/METHOD` is the last."""
    groups: dict[tuple[str, str], list[Job]] = {}
    for job in fleet_jobs:
        if job.part is not None:
            groups.setdefault((job.arm, job.method), []).append(job)
    level = 0
    while groups := {key: jobs for key, jobs in groups.items() if len(jobs) > 1}:
        level += 1
        for key, jobs in groups.items():
            batches = [jobs[first : first + FAN_IN] for first in range(0, len(jobs), FAN_IN)]
            if len(batches) > 1 and len(batches[-1]) == 1:
                batches[-2:] = [batches[-2][:-1], batches[-2][-1:] + batches[-1]]
            groups[key] = [
                replace(
                    jobs[0],
                    name=f"{jobs[0].arm}/{'merged' if len(batches) == 1 else f'merged-{level}-{number:04d}'}/"
                    f"{_folder(jobs[0].method)}",
                    recordings=tuple(dict.fromkeys(place for job in batch for place in job.recordings)),
                    part=None,
                    merged=tuple(job.name for job in batch),
                )
                for number, batch in enumerate(batches, start=1)
            ]
        yield [job for jobs in groups.values() for job in jobs]


def _folder(method: str) -> str:
    return re.sub(r"[^A-Za-z0-9.]+", "-", method).strip("-")


def _found(place: str, folder: Path, arm: FleetArm, where: str) -> list[str]:
    if is_url(place):
        return [place]
    if not has_magic(place):
        return [str((folder / place).resolve())]  # where it is missing, that is its job's failure
    files = sorted(glob(str(folder.resolve() / place), recursive=True))
    if not files:
        raise UsageError(f"arm {arm.name}: no file is named like {place}", where=where)
    for file in files:
        check_utf8(Path(file).name, UsageError)
    return files


def _state(place: str) -> list[Any]:
    path = Path(place)
    if not place or is_url(place) or not path.is_file():
        return [place]
    stat = path.stat()
    return [place, stat.st_size, stat.st_mtime_ns]
