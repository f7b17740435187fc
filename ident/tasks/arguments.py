"""What tasks take and give: recordings, read already or by path; limits; the arm; a result that can be saved."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from html import escape
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TypeGuard

from daq.output_files import REPORT_FILE, RESULT_FILE, check_output_folder, check_outputs, replace_files, write_folder
from daq.recording.reader import read_recording
from daq.recording.recording import Recording
from daq.robot.loader import RobotFile, load_robot
from drivers.core.errors import UsageError
from drivers.core.files import given_kind, path_of
from drivers.core.text import json_text
from ident.model import base_parameters as numeric
from ident.model.dynamic_model import build_model
from ident.model.symbols import symbolic_expressions
from ident.result.result_file import result_json
from ident.result.tables import Table, table_of_rows
from ident.result.units import parameter_unit
from ident.verdict.acceptance import AcceptanceLimits, declared, read_limits
from ident.verdict.verdict import Verdict

if TYPE_CHECKING:
    from ident.result.gravity import GravityResult
    from ident.servo.result import ServoResult


Run = Recording | str | PathLike[str]
"""A recording, or the path of one."""

Runs = Run | Sequence[Run]


def recording_of(run: Run) -> Recording:
    """The recording, read where a path is given.

    Raises:
        RecordingError: it cannot be read.
        UsageError: it is neither recording nor path; says how to make a recording of it.
    """
    if isinstance(run, Recording):
        return run
    if isinstance(run, (str, PathLike)):
        return read_recording(Path(run))
    if hasattr(run, "iloc"):
        door = "dynid.Recording.from_dataframe(robot, frame)"
    elif isinstance(run, Mapping):
        door = "dynid.Recording.from_dict(robot, arrays)"
    else:
        door = "dynid.Recording.from_arrays(robot, time=…, position=…, torque=… or current=…)"
    raise UsageError(f"{given_kind(run)} is not a recording: it states neither robot nor units", hint=door)


def is_trajectory(run: Run) -> TypeGuard[str | PathLike[str]]:
    """Return whether it is the path of a trajectory file (.yaml), which holds a motion in place of a recording."""
    return isinstance(run, (str, PathLike)) and Path(run).suffix in {".yaml", ".yml"}


def recordings_of(runs: Runs) -> list[Recording]:
    """The recordings, one or several.

    Raises:
        RecordingError, UsageError: as `recording_of`.
    """
    if isinstance(runs, (list, tuple)):
        return [recording_of(run) for run in runs]
    return [recording_of(runs)]  # type: ignore[arg-type]


def held_out_of(runs: Runs | None) -> list[Recording]:
    """Held-out recordings, none where None is given.

    Raises:
        RecordingError, UsageError: as `recording_of`.
    """
    return [] if runs is None else recordings_of(runs)


def paths_of(*given: object) -> list[Path]:
    """The paths among arguments of a task, and in lists of them; recordings that were read already have none."""
    flat = [run for entry in given for run in (entry if isinstance(entry, (list, tuple)) else [entry])]
    return [Path(run) for run in flat if isinstance(run, (str, PathLike))]


Limits = Mapping[str, Any] | str | PathLike[str]
"""Limits by their keys (docs/identification.md), or the path of a YAML file with them."""


def limits_of(accept: Limits) -> AcceptanceLimits:
    """The limits, read where a path is given.

    Raises:
        UsageError: the file cannot be read, or a key is wrong.
    """
    if isinstance(accept, Mapping):
        return declared(accept, "accept")
    return read_limits(path_of(accept, "or give the limits by their keys"))


def base_parameters(robot: str | Path | RobotFile) -> Table:
    """The base parameters of an arm: the fewest combinations of standard parameters that fix the torque (SR400 .3.2).

    Args:
        robot: built-in name, robot file, URDF, or the result of `load_robot`.

    Returns:
        One row per parameter: name, kind, joint, unit (kg·m², kg·m, …) and its expression.

    Raises:
        RobotFileError: no such robot, or its geometry cannot be used.
        IdentificationError: the rank cannot be decided.

    Example:
        >>> import dynid
        >>> table = dynid.base_parameters("ur5e")
        >>> len(table), table.row("ZZR1")["unit"]
        (58, 'kg·m²')
    """
    robot_file = load_robot(robot)
    model = build_model(robot_file)
    base = numeric.base_parameters(model)
    rows = [
        (name, kind, model.link_names[joint], parameter_unit(model, column), expression)
        for name, kind, joint, column, expression in zip(
            base.names,
            base.kinds,
            base.joints,
            base.columns,
            symbolic_expressions(robot_file, model, base),
            strict=True,
        )
    ]
    headings = [(name, "") for name in ("name", "kind", "joint", "unit", "expression")]
    return table_of_rows(f"Base parameters of {model.name}", headings, rows)


def write_text(path: str | PathLike[str], text: Callable[[], str], *, overwrite: bool) -> None:
    """Write a file; its text is made once it is known that it can stand there.

    Raises:
        UsageError: it exists already, or cannot be written.
    """
    check_outputs([path_of(path)], overwrite=overwrite)
    replace_files({path_of(path): text()})


class ShownResult(ABC):
    """A result that shows itself as text and in a notebook: its parts, one below the other."""

    @abstractmethod
    def _parts(self) -> tuple[object, ...]:
        """Tables, verdicts and texts; empty texts are left out."""

    def __str__(self) -> str:
        return "\n\n".join(str(part) for part in self._parts() if part != "")

    def _repr_html_(self) -> str:
        return "".join(
            part._repr_html_()
            if isinstance(part, (Table, Verdict))
            else "".join(f"<p>{escape(line)}</p>" for line in str(part).splitlines())
            for part in self._parts()
        )


class PagedResult(ShownResult):
    """A result that is shown on a page."""

    @abstractmethod
    def _page(self) -> str:
        """The text of the page."""

    def page(self, path: str | PathLike[str], *, overwrite: bool = False) -> None:
        """Write a page (HTML) with all tables and figures.

        Args:
            path: of the file.
            overwrite: replace a file that exists.

        Raises:
            UsageError: it exists already, or cannot be written.
        """
        write_text(path, self._page, overwrite=overwrite)


class SavedResult(ShownResult):
    """A result with a JSON object and a page."""

    FILE: ClassVar[str] = RESULT_FILE
    PAGE: ClassVar[str] = REPORT_FILE
    """Names of the JSON file and of the page."""

    def to_json(self) -> str:
        """The text of the JSON file, which the command prints with `--json`."""
        return json_text(self.result)  # type: ignore[attr-defined]

    @abstractmethod
    def _page(self) -> str:
        """The text of the page."""

    def save(self, folder: str | PathLike[str], *, overwrite: bool = False) -> None:
        """Write the result (JSON) and its page into a folder, as its command does with `-o` or `--page`.

        Args:
            folder: made where it does not exist.
            overwrite: replace the files where they exist.

        Raises:
            UsageError: they exist already, it is a file, or cannot be written.
            DiskError: the disk is full or fails.
        """
        place = path_of(folder)
        check_output_folder(place, (self.FILE, self.PAGE), overwrite=overwrite)
        write_folder(place, {self.FILE: self.to_json() + "\n", self.PAGE: self._page()})


class GradedResult(SavedResult):
    """A model that is identified for one purpose, with a grade for it.

    Attributes:
        result: all of it, as `result.json` holds it.
    """

    result: GravityResult | ServoResult

    @property
    def verdict(self) -> str:
        """Return how far the model can be trusted for its purpose, in a sentence, and what spoils it."""
        return str(self.result.verdict)

    @property
    def parameters(self) -> Table:
        """Every parameter with its 95 % interval; what the recordings do not determine has none."""
        return self.result.parameters

    @property
    def errors(self) -> Table:
        """Errors of each joint on held-out data, beside what they are to be compared with."""
        return self.result.errors

    def to_json(self) -> str:
        """The text of `result.json`."""
        return result_json(self.result)

    def _parts(self) -> tuple[object, ...]:
        return self.verdict, self.errors, self.parameters
