"""A three-joint arm, samples of its motion, and writers of foreign files, for the importers' tests."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from daq.importers.choices import ImportChoices
from daq.importers.import_file import import_file
from daq.recording.recording import JOINTS_STREAM, Recording
from daq.robot.loader import RobotFile, parse_robot
from drivers.core.errors import ImportFileError

NAMES = ("shoulder", "elbow", "wrist")
ROBOT_TEXT = """
name: three-links
model:
  mdh:
    - {joint: shoulder, alpha: 0, d: 0, r: 0.3}
    - {joint: elbow, alpha: pi/2, d: 0.4, r: 0, antecedent: shoulder}
    - {joint: wrist, type: TYPE, alpha: 0, d: 0.3, r: 0, antecedent: elbow}
joints:
  - {name: shoulder, position: [-3, 3], velocity: 2, torque: 100}
  - {name: elbow, position: [-2, 2], velocity: 2, torque: 60}
  - {name: wrist, position: [-3, 3], velocity: 2}
"""
Arrays = dict[str, np.ndarray]
DEGREE = np.pi / 180


def make_robot(wrist: str = "revolute", rename: dict[str, str] | None = None) -> RobotFile:
    text = ROBOT_TEXT.replace("TYPE", wrist).replace("r: 0.3}", "r: 0.3, antecedent: base}")
    for old, new in (rename or {}).items():
        text = text.replace(old, new)
    return parse_robot(text, where="test", folder=None)


def samples(count: int = 200) -> Arrays:
    """A motion at 125 Hz with its exact velocity; temperature as float64 that text can carry."""
    time = np.arange(count) / 125.0
    phase = np.array([0.0, 1.0, 2.0])
    q = np.sin(2.0 * time[:, None] + phase)
    qd = 2.0 * np.cos(2.0 * time[:, None] + phase)
    torque = 5.0 * q + 3.0 * np.sign(qd)
    return {"t": time, "q": q, "qd": qd, "torque": torque, "current": torque / 10.0}


def columns_of(arrays: Arrays) -> Arrays:
    columns: Arrays = {}
    for name, values in arrays.items():
        if values.ndim == 1:
            columns[name] = values
        else:
            columns |= {f"{name}{k + 1}": values[:, k] for k in range(values.shape[1])}
    return columns


def write_csv(folder: Path, arrays: Arrays, separator: str = ",") -> Path:
    columns = columns_of(arrays)
    rows = zip(*(values.tolist() for values in columns.values()), strict=True)
    lines = [separator.join(columns), *(separator.join(repr(value) for value in row) for row in rows)]
    path = folder / "run.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


def write_npz(folder: Path, arrays: Arrays) -> Path:
    path = folder / "run.npz"
    np.savez(path, **arrays)  # type: ignore[arg-type]
    return path


def content(recording: Recording) -> Arrays:
    """The stamps and the channels of the joints."""
    stream = recording.streams[JOINTS_STREAM]
    return {"time": stream.time, **{name: channel.values for name, channel in stream.channels.items()}}


def messages(recording: Recording) -> str:
    """What the importer said, a line each."""
    return "\n".join(f"{event.level}: {event.message}" for event in recording.events)


def accept_or_refuse(path: Path, choices: ImportChoices, robot: RobotFile | None = None) -> None:
    """Import a file, or be refused in words that name it."""
    problem = ""
    try:
        import_file(path, robot or make_robot(), choices)
    except ImportFileError as error:
        problem = str(error)
    assert not problem or str(path) in problem
