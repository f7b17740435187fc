"""Import in one call, with the names of `dynid import`'s options."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from os import PathLike
from pathlib import Path
from typing import Literal

from daq.importers import import_file
from daq.importers.choices import ImportChoices, TimeUnit
from daq.recording.recording import Recording
from daq.robot.loader import RobotFile, load_robot


def import_recording(
    path: str | PathLike[str],
    robot: str | Path | RobotFile,
    *,
    columns: Mapping[str, str] | None = None,
    degrees: bool = False,
    effort: Literal["torque", "current"] | None = None,
    topic: str | None = None,
    rate: float | None = None,
    repair: Collection[str] = (),
    by_order: bool = False,
    time_unit: TimeUnit | None = None,
) -> Recording:
    """Import a CSV, npz, mat, HDF5, ROS 2 bag or MCAP file as a recording in memory, in SI.

    Args:
        path: of the file, or of a bag's folder.
        robot: built-in name, robot file, URDF, or the result of `load_robot`.
        columns: our name (`t`, `q1`, `qd1`, `torque3`, `current2`, …, or `q` for a whole array) → the file's name; for
            a whole quantity also a pattern (`position` → `q{}`) or numbers of CSV columns (`2-7`).
        degrees: positions and velocities of revolute joints are in degrees.
        effort: whether an array called `effort` is "torque" [N·m] or "current" [A].
        topic: of a bag.
        rate: of uniform stamps [Hz], for a file without a time column.
        repair: of "drop-nan", "drop-duplicates", "drop-repeats", "opposite-torque" and "sort"; none is made unasked.
        by_order: take joints of other names in the file's order.
        time_unit: of the stamps: "s", "ms", "us" or "ns".

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
    choices = ImportChoices(
        columns=dict(columns or {}),
        degrees=degrees,
        effort=effort,
        topic=topic,
        rate=rate,
        repair=frozenset(repair),
        by_order=by_order,
        time_unit=time_unit,
    )
    return import_file(Path(path), load_robot(robot), choices)
