"""The trajectory file (YAML): which robot, which kind of motion, its coefficients.

    robot: ur5e
    kind: fourier              # or fourier-quintic, sines, points, samples
    period: 10                 # [s]
    offset: [0, -1.2, …]       # [rad or m], one per joint
    sine: [[…], …]             # a row a joint, a column a harmonic
    cosine: [[…], …]
    amplitudes: velocity       # ROCR6 eq. 21, divided by ω; position: AUBO eq. 20
    periods: 3                 # how often it is repeated
    ramp: 2                    # [s] from rest and back to rest

`fourier-quintic` has `period`, `offset`, `sine`, `cosine` (velocity amplitudes) and `periods`: a polynomial of fifth
order, which follows from them, brings every period to rest at its ends. `sines` has `duration`, `offset`, `amplitude`,
`frequency` (rows of [rad] and [rad/s], UP6 eq. 8) and `ramp`; `points` has `points` (a row per point), `durations` and
`dwell` (SR400); `samples` has `time` and `position` (a row per sample) or `csv`, a file with a column `time` and one a
joint. A robot's name or path may stand under `robot`.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
import yaml
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from daq.motion.fourier_quintic import FourierQuintic
from daq.motion.limits import check_limits, check_rest
from daq.motion.trajectories import (
    SHORTEST_RAMP,
    FourierSeries,
    Motion,
    PointToPoint,
    RestToRest,
    SampledMotion,
    SumOfSines,
)
from daq.output_files import GENERATION_KEY, hashes_of, warn_of_strange_files
from daq.robot.loader import changed_since
from daq.robot.schema import Robot
from daq.robot.section import Finite, NonNegative, NotTruthValue, within
from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError
from drivers.core.files import TRAJECTORY_FILE, TRAJECTORY_SAMPLES, read_text
from drivers.core.ranges import COEFFICIENTS, PIECE, SAMPLE_STEP
from drivers.core.validation import describe, read_mapping, validated

_LARGEST = 1e9
"""No arm gets near it, whatever the unit."""
_LOOKS = 997

Row = Annotated[tuple[Finite, ...], Field(min_length=1, max_length=int(COEFFICIENTS.most))]
Rows = Annotated[tuple[Row, ...], Field(min_length=1)]
CSV_RATE = 50.0
"""[Hz] of rows of a motion as a table: what serial servos are commanded at."""

Duration = Annotated[float, Field(gt=0, allow_inf_nan=False), AfterValidator(within(PIECE)), NotTruthValue]
Ramp = Annotated[Finite, Field(ge=SHORTEST_RAMP, description="[s] from rest to full speed, and back")]


def _same_shape(*named: tuple[str, Rows]) -> None:
    shapes = {name: sorted({len(row) for row in rows}) for name, rows in named}
    for name, widths in shapes.items():
        if len(widths) > 1:
            raise ValueError(f"'{name}' has rows of different length: {', '.join(map(str, widths))}")
    first, first_rows = named[0]
    for name, rows in named[1:]:
        if (len(rows), shapes[name]) != (len(first_rows), shapes[first]):
            raise ValueError(
                f"'{name}' is {len(rows)} × {shapes[name][0]}, but '{first}' is {len(first_rows)} × {shapes[first][0]}"
            )


class _Trajectory(BaseModel):
    model_config = ConfigDict(defer_build=True, extra="forbid", frozen=True)

    robot: str = Field(min_length=1)
    comment: str = ""
    designed_for: dict[str, str] = Field(default_factory=dict, description="fingerprint of the robot file's sections")
    files: dict[str, str] = Field(default_factory=dict, description="SHA-256 of the files written with it")


class _SeriesTrajectory(_Trajectory):
    kind: str
    period: Duration = Field(description="[s]")
    offset: Row
    sine: Rows
    cosine: Rows
    periods: int = Field(default=1, ge=1, le=10_000)

    @model_validator(mode="after")
    def _check(self) -> Self:
        _same_shape(("sine", self.sine), ("cosine", self.cosine))
        if len(self.offset) != len(self.sine):
            raise ValueError(f"'offset' has {len(self.offset)} joints, but 'sine' {len(self.sine)} rows")
        return self


class FourierTrajectory(_SeriesTrajectory):
    """A Fourier series (ROCR6 eq. 21; AUBO eq. 20 with amplitudes: position)."""

    kind: Literal["fourier"]
    amplitudes: Literal["velocity", "position"] = "velocity"
    ramp: Ramp = 2.0

    def motion(self) -> Motion:
        """The motion from rest to rest."""
        build = FourierSeries if self.amplitudes == "velocity" else FourierSeries.from_position_amplitudes
        series = build(self.period, np.array(self.offset), np.array(self.sine), np.array(self.cosine))
        return RestToRest(series, self.periods, self.ramp)


class FourierQuinticTrajectory(_SeriesTrajectory):
    """A Fourier series that a fifth-order polynomial brings to rest at the ends of every period."""

    kind: Literal["fourier-quintic"]

    def motion(self) -> Motion:
        """The motion from rest to rest, as every period is."""
        coefficients = np.array(self.offset), np.array(self.sine), np.array(self.cosine)
        return FourierQuintic(self.period, *coefficients, self.periods)


class SinesTrajectory(_Trajectory):
    """A sum of sines (UP6 eq. 8)."""

    kind: Literal["sines"]
    duration: Duration = Field(description="[s]")
    offset: Row
    amplitude: Rows
    frequency: Rows = Field(description="[rad/s]")
    ramp: Ramp = 2.0

    @model_validator(mode="after")
    def _check(self) -> Self:
        _same_shape(("amplitude", self.amplitude), ("frequency", self.frequency))
        if len(self.offset) != len(self.amplitude):
            raise ValueError(f"'offset' has {len(self.offset)} joints, but 'amplitude' {len(self.amplitude)} rows")
        return self

    def motion(self) -> Motion:
        """The motion from rest to rest."""
        sines = SumOfSines(self.duration, np.array(self.offset), np.array(self.amplitude), np.array(self.frequency))
        return RestToRest(sines, 1, self.ramp)


class PointsTrajectory(_Trajectory):
    """Fifth-order moves between points (SR400)."""

    kind: Literal["points"]
    points: Rows
    durations: Annotated[tuple[Duration, ...], Field(min_length=1)] = Field(description="[s]")
    dwell: NonNegative = Field(default=0.0, description="[s]")

    @model_validator(mode="after")
    def _check(self) -> Self:
        _same_shape(("points", self.points))
        if len(self.points) != len(self.durations) + 1:
            raise ValueError(
                f"{len(self.points)} points need {len(self.points) - 1} durations, not {len(self.durations)}"
            )
        return self

    def motion(self) -> Motion:
        """The motion from rest to rest, as every move is."""
        return PointToPoint(np.array(self.points), np.array(self.durations), self.dwell)


class SamplesTrajectory(_Trajectory):
    """Samples, joined by a cubic spline."""

    kind: Literal["samples"]
    time: Annotated[tuple[Finite, ...], Field(min_length=4)]
    position: Annotated[tuple[Row, ...], Field(min_length=4)]

    @model_validator(mode="after")
    def _check(self) -> Self:
        _same_shape(("position", self.position))
        if len(self.time) != len(self.position):
            raise ValueError(f"{len(self.time)} times, but {len(self.position)} positions")
        if np.any(np.diff(self.time) <= 0):
            row = int(np.argmax(np.diff(self.time) <= 0)) + 1
            raise ValueError(f"'time' does not increase at sample {row}: {self.time[row - 1]:g}, {self.time[row]:g}")
        steps = np.diff(np.array(self.time) - self.time[0])
        if not SAMPLE_STEP.holds(float(steps.min())):
            row = int(np.argmin(steps)) + 1
            raise ValueError(f"samples {row - 1} and {row} are {steps.min():.3g} s apart; allowed: {SAMPLE_STEP}")
        return self

    def motion(self) -> Motion:
        """The motion from rest to rest, since the spline's ends are at rest."""
        return SampledMotion(np.array(self.time) - self.time[0], np.array(self.position).T)


Trajectory = FourierTrajectory | FourierQuinticTrajectory | SinesTrajectory | PointsTrajectory | SamplesTrajectory
_KINDS: dict[str, type[Trajectory]] = {
    "fourier": FourierTrajectory,
    "fourier-quintic": FourierQuinticTrajectory,
    "sines": SinesTrajectory,
    "points": PointsTrajectory,
    "samples": SamplesTrajectory,
}


@dataclass(frozen=True)
class TrajectoryFile:
    """A trajectory with the text that a recording keeps; samples of a CSV file, `samples`, stand in the text."""

    trajectory: Trajectory
    motion: Motion
    text: str
    samples: Path | None = None


def load_trajectory(path: Path, robot: Robot) -> TrajectoryFile:
    """Read a trajectory file and check it against its robot: joints, limits, rest at both ends.

    Raises:
        UsageError: names file and key, what was found and what is allowed.
    """
    text = read_text(path, TRAJECTORY_FILE, UsageError)
    read = parse_trajectory(text, robot, where=str(path), folder=path.parent)
    warn_of_strange_files(path, {GENERATION_KEY: read.trajectory.files})
    return read


def parse_trajectory(text: str, robot: Robot, *, where: str, folder: Path | None) -> TrajectoryFile:
    """Validate a trajectory's text; as `load_trajectory`."""
    content = read_mapping(text, kind="a trajectory", where=where, refusal=UsageError)
    kind = content.get("kind")
    schema = _KINDS.get(kind) if isinstance(kind, str) else None
    if schema is None:
        problem = f"found {describe(kind)}" if "kind" in content else "this key is missing"
        raise UsageError(f"{problem}; allowed: {', '.join(_KINDS)}", where=f"{where}: kind")
    samples = None
    if kind == "samples" and "csv" in content:
        samples = (folder or Path()) / str(content["csv"])
        content = _with_samples(content, robot, where, folder)
        text = yaml.safe_dump(content, allow_unicode=True, sort_keys=False)
    trajectory = validated(content, schema, where=where, refusal=UsageError)
    if Path(trajectory.robot).stem != robot.name and trajectory.robot != robot.name:
        raise UsageError(
            f"was made for '{trajectory.robot}', not for '{robot.name}'",
            where=f"{where}: robot",
            hint="limits and joints differ from arm to arm",
        )
    motion = _plausible(trajectory, where)
    with np.errstate(all="ignore"):  # a move of almost no duration has an infinite velocity, which is refused
        try:
            check_limits(motion, robot.joints, where)
        except UsageError as error:
            error.hint = changed_since(trajectory.designed_for, robot) or error.hint
            raise
        check_rest(motion, robot.joints, where)
    return TrajectoryFile(trajectory, motion, text, samples)


def _plausible(trajectory: Trajectory, where: str) -> Motion:
    """The motion, unless it would overflow in the check of the limits; else a UsageError."""
    refusal = UsageError(
        f"has a position, velocity or acceleration that is not below {_LARGEST:g}",
        where=where,
        hint="check its times and its largest and smallest numbers",
    )
    with np.errstate(all="ignore"):
        try:
            motion = trajectory.motion()
        except ValueError as error:  # of a spline whose system of equations overflows; also numpy's LinAlgError
            raise refusal from error
        duration = motion.duration
        if not 0.0 < duration <= 86_400.0:
            raise UsageError(f"lasts {duration:g} s; at most a day is allowed", where=where)
        values = np.array(motion.evaluate(np.linspace(0.0, duration, _LOOKS)))
    if not np.all(np.abs(values) < _LARGEST):
        raise refusal
    return motion


def _with_samples(content: dict[str, object], robot: Robot, where: str, folder: Path | None) -> dict[str, object]:
    name = content["csv"]
    if not isinstance(name, str) or "time" in content or "position" in content:
        raise UsageError("give 'csv', the name of a file, or 'time' and 'position'", where=f"{where}: csv")
    path = (folder or Path()) / name
    time, position = _read_csv(path, robot.joint_names)
    rest = {key: value for key, value in content.items() if key != "csv"}
    return {**rest, "time": time.tolist(), "position": position.tolist()}


def _read_csv(path: Path, joints: tuple[str, ...]) -> tuple[FloatArray, FloatArray]:
    try:
        rows = list(csv.reader(io.StringIO(read_text(path, TRAJECTORY_SAMPLES, UsageError))))
    except csv.Error as error:  # a field of more than 128 KiB
        raise UsageError(f"is not a CSV file: {error}", where=str(path)) from error
    header = [name.strip() for name in rows[0]] if rows else []
    missing = [name for name in ("time", *joints) if name not in header]
    if missing:
        raise UsageError(
            f"has no column {', '.join(missing)}", where=str(path), hint=f"found: {', '.join(header) or 'nothing'}"
        )
    columns = [header.index(name) for name in ("time", *joints)]
    values = []
    for line, row in enumerate(rows[1:], start=2):
        if not row:
            continue
        try:
            values.append([float(row[column]) for column in columns])
        except (ValueError, IndexError) as error:
            raise UsageError("a number is missing or not readable", where=f"{path}, line {line}") from error
    if not values:
        raise UsageError("has no samples", where=str(path))
    table = np.array(values)
    return table[:, 0], table[:, 1:]


def dump_trajectory(trajectory: Trajectory) -> str:
    """A trajectory as the text of its file."""
    content = trajectory.model_dump(mode="json")
    for key in ("designed_for", GENERATION_KEY):
        if not content[key]:
            del content[key]
    return yaml.safe_dump(content, allow_unicode=True, sort_keys=False)


def with_files(text: str, others: Mapping[str, str]) -> str:
    """A trajectory file's text with the SHA-256 of the files that are written with it; name → their text."""
    return text + yaml.safe_dump({GENERATION_KEY: hashes_of(others)})
