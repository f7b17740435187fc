"""LeRobot datasets, v2.x and v3.x (Parquet and `meta/info.json`), through pyarrow: an episode is a recording.

LeRobot's motors report degrees about the middle of their calibrated range, or that range as -100 to 100; a gripper's
is 0 to 100. A dataset does not say which of them it holds (lerobot/motors/motors_bus.py, `_normalize`).
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from daq.importers.choices import ImportChoices
from daq.importers.table import ForeignTable, Note, QuantityColumns, check_count, listed, parsing, printable
from daq.robot.loader import RobotFile, builtin_robots
from drivers.core.arrays import FloatArray
from drivers.core.errors import ImportFileError, UsageError
from drivers.core.files import ARRAY_FILE, DATASET_META, check_input, read_text
from drivers.core.ranges import SAMPLING_RATE
from drivers.core.text import counted, parsed_json

INFO = Path("meta", "info.json")
STATE, ACTION = "observation.state", "action"
SUFFIXES = {".pos": "position", ".vel": "velocity"}
"""What the names of LeRobot's motors end in."""
GRIPPER = "gripper"
COUNTS = 4095
"""Counts of a motor's turn, less one, as LeRobot has them."""
NOMINAL = 1e-3
"""[s] within which stamps are frame numbers over the rate."""
MOST_FILES = 100_000


@dataclass(frozen=True)
class LeRobotEpisode:
    """One episode, and the files that hold it."""

    number: int  # as the dataset counts
    table: ForeignTable  # its content
    files: tuple[Path, ...]  # that were read for it


@dataclass(frozen=True)
class _Feature:
    """A vector of the dataset: its name, its width, and what its columns are called; empty where nothing says so."""

    key: str
    width: int
    names: tuple[str, ...]


def is_lerobot(path: Path) -> bool:
    """Return whether a folder is a LeRobot dataset."""
    return (path / INFO).is_file()


def parquet_reader(path: Path) -> Any:
    """The module of pyarrow that reads Parquet files.

    Raises:
        UsageError: pyarrow is missing.
    """
    # Arrow's own pool takes 1 GB of address space, all that a reading process has.
    os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")
    try:
        import pyarrow.parquet
    except ImportError as error:
        raise UsageError(
            "a LeRobot dataset needs the package pyarrow", where=str(path), hint="pip install 'dynid[lerobot]'"
        ) from error
    return pyarrow.parquet


def read_lerobot(path: Path, robot: RobotFile, choices: ImportChoices) -> list[LeRobotEpisode]:
    """Read the episodes of a dataset: `observation.state` as what was measured, `action` as what was commanded.

    Args:
        path: the dataset's folder.
        robot: whose joints are meant; its limits are the gripper's range.
        choices: `episode` for one alone; `degrees` or `calibration` where motors are meant.

    Raises:
        UsageError: pyarrow is missing, or options that do not apply.
        ImportFileError: an unknown version, damaged or missing files, no such episode, units that are not stated.
    """
    pq = parquet_reader(path)
    if choices.columns:
        raise UsageError("a LeRobot dataset has no columns to map", where="--column")
    info = _info(path)
    state, action = _feature(info, STATE, path), _feature(info, ACTION, path)
    if state is None:
        raise ImportFileError(f"has no feature '{STATE}'", where=str(path / INFO))
    wanted = [feature for feature in (state, action) if feature is not None]
    files = sorted((path / "data").rglob("*.parquet"))[: MOST_FILES + 1]
    if not files or len(files) > MOST_FILES:
        raise ImportFileError(f"holds {'no' if not files else 'too many'} Parquet files under data/", where=str(path))
    scales = _scales(path, wanted, robot, choices)
    episodes: dict[int, list[tuple[Path, Mapping[str, FloatArray]]]] = {}
    values = 0
    for file in files:
        check_input(file, ARRAY_FILE, ImportFileError)
        with parsing(file, "a Parquet file"):
            columns = [*(feature.key for feature in wanted), "episode_index", "frame_index", "timestamp"]
            content = pq.ParquetFile(file, pre_buffer=False).read(columns=columns, use_threads=False)
            arrays = {name: _array(content.column(name).combine_chunks()) for name in content.column_names}
        missing = [name for name in columns if name not in arrays]
        if missing:
            raise ImportFileError(f"has no column {listed(missing)}", where=str(file))
        values += sum(array.size for array in arrays.values())
        check_count(values, path)
        numbers = arrays["episode_index"].reshape(-1)
        for number in np.unique(numbers[np.isfinite(numbers)]).astype(int).tolist():
            if choices.episode in (None, number):
                rows = numbers == number
                taken = {name: _rows(array, rows, name, file) for name, array in arrays.items()}
                episodes.setdefault(number, []).append((file, taken))
    if not episodes:
        raise ImportFileError(f"has no episode {choices.episode}", where=str(path), hint="they are counted from 0")
    return [_episode(number, parts, info, wanted, scales, path, robot) for number, parts in sorted(episodes.items())]


def _info(path: Path) -> Mapping[str, Any]:
    where = str(path / INFO)
    try:
        info: Any = parsed_json(read_text(path / INFO, DATASET_META, ImportFileError))
    except ValueError as error:
        raise ImportFileError("is not JSON text", where=where) from error
    version = info.get("codebase_version") if isinstance(info, dict) else None
    if not isinstance(version, str) or version.split(".")[0] not in ("v2", "v3"):
        raise ImportFileError(
            f"codebase_version is {printable(version)}; v2.x and v3.x are read",
            where=where,
            hint="convert it with LeRobot's own scripts",
        )
    fps = info.get("fps")
    if isinstance(fps, bool) or not isinstance(fps, int | float) or not SAMPLING_RATE.holds(fps):
        raise ImportFileError(f"fps is {printable(fps)}, which is not within {SAMPLING_RATE}", where=where)
    if not isinstance(info.get("features"), dict):
        raise ImportFileError("has no 'features'", where=where)
    return dict(info)


def _feature(info: Mapping[str, Any], key: str, path: Path) -> _Feature | None:
    """The names and the width of a vector; None where the dataset has none of this name."""
    stated = info["features"].get(key)
    if stated is None:
        return None
    where = f"{path / INFO}: features.{key}"
    shape = stated.get("shape") if isinstance(stated, dict) else None
    if not isinstance(shape, list) or len(shape) != 1 or not isinstance(shape[0], int) or shape[0] < 1:
        raise ImportFileError(f"has shape {printable(shape)}; a vector is needed", where=where)
    names = stated.get("names")
    if isinstance(names, dict):  # {"motors": [...]}, as older versions write it
        names = next(iter(names.values()), None)
    if not isinstance(names, list) or len(names) != shape[0] or not all(isinstance(name, str) for name in names):
        names = ()
    return _Feature(key, shape[0], tuple(names))


def _array(column: Any) -> FloatArray:
    """(N,) or (N, n) numbers of a column; rows without a value make the number of values wrong."""
    flat = column
    while hasattr(flat.type, "value_type"):
        flat = flat.flatten()
    flat = flat.cast("float64")
    # Its own `to_numpy` would import pandas, which takes a second.
    if flat.null_count:
        values = np.array(flat.to_pylist(), dtype=np.float64)
    else:
        values = np.frombuffer(flat.buffers()[1], np.float64, len(flat), 8 * flat.offset)
    return values if flat is column else values.reshape(len(column), -1)


def _rows(array: FloatArray, rows: npt.NDArray[np.bool_], name: str, file: Path) -> FloatArray:
    if len(array) != len(rows):
        raise ImportFileError(
            f"has {counted(len(array), 'value')} in {counted(len(rows), 'row')}", where=f"{file}: {name}"
        )
    return array[rows]


def _motor(name: str) -> tuple[str, str | None]:
    """The motor and the quantity of a column's name; no quantity where the name says none."""
    return next(
        ((name.removesuffix(end), quantity) for end, quantity in SUFFIXES.items() if name.endswith(end)), (name, None)
    )


def _scales(
    path: Path, features: Sequence[_Feature], robot: RobotFile, choices: ImportChoices
) -> dict[str, tuple[float, float, str]]:
    """Motor → factor, offset and unit of what its numbers mean; empty where they are taken as they are."""
    motors = dict.fromkeys(_motor(name)[0] for feature in features for name in feature.names)
    of_motors = any(_motor(name)[1] is not None for feature in features for name in feature.names)
    if choices.calibration is None and not choices.degrees:
        if of_motors:
            raise ImportFileError(
                "holds LeRobot's motor positions: degrees, or -100 to 100 of a calibrated range; it does not say which",
                where=str(path),
                hint="--degrees (use_degrees, LeRobot's default from 0.4.4), or --calibration FILE.json of its arm",
            )
        return {}
    spans = {} if choices.calibration is None else _spans(choices.calibration, list(motors))
    scales = {}
    for motor in motors:
        limits = next((joint for joint in robot.robot.joints if motor.endswith(joint.name)), None)
        if motor.endswith(GRIPPER) and limits is not None:
            low, high = limits.position
            span = spans.get(motor, high - low)
            turn, unit = (math.degrees(1.0), "deg") if choices.degrees else (1.0, "rad")
            scales[motor] = turn * span / 100.0, turn * low, unit
        elif choices.degrees:
            scales[motor] = 1.0, 0.0, "deg"
        else:
            scales[motor] = spans[motor] / 200.0, 0.0, "rad"
    return scales


def _spans(calibration: Path, motors: Sequence[str]) -> dict[str, float]:
    """Motor → calibrated range [rad], from the JSON file that `lerobot-calibrate` writes."""
    where = str(calibration)
    try:
        content = parsed_json(read_text(calibration, DATASET_META, ImportFileError))
    except ValueError as error:
        raise ImportFileError("is not JSON text", where=where) from error
    content = content if isinstance(content, dict) else {}
    spans = {}
    for motor in motors:
        entry = next((entry for name, entry in content.items() if name and motor.endswith(name)), None)
        if entry is None:
            raise ImportFileError(
                f"has no motor '{printable(motor)}'; it has: {listed(content) or 'none'}",
                where=where,
                hint="it is the follower's file under ~/.cache/huggingface/lerobot/calibration/robots",
            )
        least, most = (entry.get(key) if isinstance(entry, dict) else None for key in ("range_min", "range_max"))
        if not isinstance(least, int) or not isinstance(most, int) or not 0 < most - least <= 100 * COUNTS:
            raise ImportFileError(
                f"range_min {printable(least)} and range_max {printable(most)} are not a range of counts",
                where=f"{where}: {printable(motor)}",
            )
        spans[motor] = (most - least) * 2.0 * math.pi / COUNTS
    return spans


def _episode(
    number: int,
    parts: Sequence[tuple[Path, Mapping[str, FloatArray]]],
    info: Mapping[str, Any],
    features: Sequence[_Feature],
    scales: Mapping[str, tuple[float, float, str]],
    path: Path,
    robot: RobotFile,
) -> LeRobotEpisode:
    where = f"{path}: episode {number}"
    version, robot_type = info["codebase_version"], info.get("robot_type")
    arrays = {name: np.concatenate([episode[name] for _, episode in parts]) for name in parts[0][1]}
    notes = [Note("info", f"LeRobot dataset {version}, episode {number}, robot type {printable(robot_type)}")]
    name, builtin = robot.robot.name, builtin_robots()
    known = [other for other in builtin if isinstance(robot_type, str) and other in robot_type]
    if known and name in builtin and name not in known:
        notes.append(Note("warning", f"the dataset's robot type is {printable(robot_type)}, the robot file is {name}"))
    frames, time = arrays["frame_index"].reshape(-1), arrays["timestamp"].reshape(-1)
    nominal = frames / info["fps"]
    if np.all(np.abs(time - nominal) < NOMINAL):
        text = f"stamps are frames at {info['fps']:g} Hz: the dataset does not say when a frame was really taken"
        notes.append(Note("info", text))
        time = nominal
    for motor, (factor, offset, unit) in scales.items():
        if motor.endswith(GRIPPER) and offset:
            text = f"{printable(motor)}: 0 to 100 taken as {100 * factor:.4g} {unit} from its lower limit on"
            notes.append(Note("warning", text))
    quantities: dict[str, QuantityColumns] = {}
    for feature, prefix in zip(features, ("", "target_"), strict=False):
        if arrays[feature.key].shape != (len(time), feature.width):
            raise ImportFileError(
                f"{feature.key} has shape {arrays[feature.key].shape}; {(len(time), feature.width)} is expected",
                where=where,
            )
        quantities |= _quantities(feature, arrays[feature.key], scales, prefix, notes)
    files = tuple(file for file, _ in parts)
    return LeRobotEpisode(
        number, ForeignTable(f"LeRobot dataset {version}", time, "s", quantities, tuple(notes)), files
    )


def _quantities(
    feature: _Feature,
    values: FloatArray,
    scales: Mapping[str, tuple[float, float, str]],
    prefix: str,
    notes: list[Note],
) -> dict[str, QuantityColumns]:
    """Positions, and velocities where names say so; columns of other quantities are left out."""
    named = [_motor(name) for name in feature.names]
    if not any(quantity for _, quantity in named):
        named = [(motor, "position") for motor, _ in named] or [("", "position")] * feature.width
    left = [name for name, (_, quantity) in zip(feature.names, named, strict=False) if quantity is None]
    if left:
        notes.append(Note("info", f"not imported of {feature.key}: {listed(left)}"))
    quantities = {}
    for wanted in SUFFIXES.values():
        places = [place for place, (_, quantity) in enumerate(named) if quantity == wanted]
        if not places:
            continue
        factors = [scales.get(named[place][0], (1.0, 0.0, "")) for place in places]
        speed = wanted == "velocity"
        converted = values[:, places] * [factor for factor, _, _ in factors]
        if not speed:
            converted = converted + [offset for _, offset, _ in factors]
        quantities[prefix + wanted] = QuantityColumns(
            converted,
            tuple(feature.names[place] if feature.names else f"{feature.key}[:, {place}]" for place in places),
            tuple(f"{unit}/s" if speed and unit else unit for _, _, unit in factors),
            tuple(named[place][0] for place in places) if feature.names else None,
        )
    return quantities
