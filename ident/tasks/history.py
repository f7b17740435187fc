"""The history of arms over many results: add to it, and see what changed."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from os import PathLike
from pathlib import Path
from typing import Any

from drivers.core.errors import UsageError
from drivers.core.files import path_of
from drivers.core.text import counted, did_you_mean
from ident.history.arm import ArmHistory, arm_history
from ident.history.database import add_entries, read_entries
from ident.history.entry import HistoryEntry, parse_time, read_entry
from ident.report.history_page import history_page
from ident.result.models.model import result_path
from ident.result.result_file import read_content
from ident.result.tables import Table
from ident.tasks.arguments import PagedResult, SavedResult, write_text
from ident.views.history_tables import notes, sentences, step_table, trend_table


@dataclass(frozen=True)
class ArmTrends(PagedResult):
    """What became of an arm's parameters over its results."""

    history: ArmHistory  # series and trends as arrays
    entries: Sequence[HistoryEntry]  # the results

    @property
    def sentences(self) -> list[str]:
        """Return what changed, the most significant first."""
        return sentences(self.history)

    @property
    def notes(self) -> list[str]:
        """Return what was left out, and how certain findings are."""
        return notes(self.history)

    @property
    def trends(self) -> Table:
        """A row per parameter: start, change with half of its 95 % interval, p, σ between results, change per kelvin.

        Values are those at the arm's mean temperature.
        """
        return trend_table(self.history)

    @property
    def steps(self) -> Table:
        """A row per sudden change: between which results it lies, its size with half of its 95 % interval."""
        return step_table(self.history)

    def save_csv(self, path: str | PathLike[str], *, overwrite: bool = False) -> None:
        """Write every parameter of every result as a table: a row per value.

        Args:
            path: of the file (.csv).
            overwrite: replace a file that exists.

        Raises:
            UsageError, DiskError: it exists already, or cannot be written.
        """
        write_text(path, self._csv, overwrite=overwrite)

    def _csv(self) -> str:
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(
            ("time", "result", "kind", "name", "joint", "parameter", "value", "std", "unit", "temperature", "basis")
        )
        for entry in self.entries:
            time = datetime.fromtimestamp(entry.time, UTC).isoformat(timespec="seconds")
            for value in entry.values:
                heat = "" if value.temperature is None else value.temperature
                writer.writerow(
                    (time, entry.source, entry.kind, value.name, value.joint, value.kind, value.value, value.std,
                     value.unit, heat, value.basis)
                )  # fmt: skip
        return text.getvalue()

    def _page(self) -> str:
        return history_page(self.history)

    def _parts(self) -> tuple[object, ...]:
        return "\n".join(self.sentences), self.trends


class History:
    """Parameters of arms over many results, in a file: what `dynid history` reads and writes.

    Each arm is followed by itself: its name is the robot's, with the controller's serial number where the recordings
    say it. Results are placed at the start of their recordings.

    Args:
        path: of the file; it need not exist before something is added.

    Example:
        >>> import dynid, pathlib, tempfile
        >>> result = dynid.identify(dynid.simulate("up6", duration=10.0, rate=100.0, seed=1))
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     history = dynid.History(pathlib.Path(folder, "arm.db"))
        ...     new, again = history.add(result), history.add(result)
        ...     history.trend().sentences
        ['A trend needs 5 results of one arm; there are 1.']
        >>> new, again
        (1, 0)
    """

    def __init__(self, path: str | PathLike[str]) -> None:
        self.path = path_of(path)

    def add(self, *results: SavedResult | str | PathLike[str], time: str | float | datetime | None = None) -> int:
        """Add results, all of them or none; one that is there already is not added again.

        Args:
            results: results, or folders that `identify` wrote, or their result.json; of gravity and servo models, too.
            time: when the data were recorded, in place of what the results say: [s] since 1970, or ISO 8601, which is
                UTC without a zone.

        Returns:
            How many were new.

        Raises:
            ResultFileError: no result, or one without times; the file is not a history, or damaged.
            UsageError: the file cannot be written, or is held by another program; the time is none.
            DiskError: the disk is full or fails.
        """
        recorded = _time_of(time)
        entries = []
        for given in results:
            if isinstance(given, SavedResult):
                entries.append(read_entry(json.loads(given.to_json()), Path(type(given).__name__), recorded))
            else:
                path = result_path(given)
                entries.append(read_entry(read_content(path), path, recorded))
        return add_entries(self.path, entries)

    @property
    def arms(self) -> tuple[str, ...]:
        """Names of the arms, in the order of their first results."""
        return tuple(dict.fromkeys(entry.arm for entry in read_entries(self.path)))

    def trend(self, arm: str | None = None) -> ArmTrends:
        """Return what became of the parameters of an arm.

        Args:
            arm: one of `arms`; not needed where there is only one.

        Raises:
            ResultFileError: no such file, no history, or damaged.
            UsageError: there are several arms and none is named, or no arm of this name.
        """
        entries = read_entries(self.path)
        arms = tuple(dict.fromkeys(entry.arm for entry in entries))
        if arm is None and len(arms) != 1:
            said = f"holds {counted(len(arms), 'arm')}: {', '.join(arms)}" if arms else "holds no results yet"
            hint = "name one: --arm, in Python arm=" if arms else "dynid history add RESULT --history FILE"
            raise UsageError(said, where=str(self.path), hint=hint)
        if arm is not None and arm not in arms:
            hint = did_you_mean(arm, arms) or f"arms: {', '.join(arms)}"
            raise UsageError(f"holds no arm '{arm}'", where=str(self.path), hint=hint)
        of_arm = [entry for entry in entries if entry.arm == (arm or arms[0])]
        return ArmTrends(arm_history(arm or arms[0], of_arm), of_arm)

    def __repr__(self) -> str:
        return f"<dynid.History {str(self.path)!r}>"


def _time_of(given: Any) -> datetime | None:
    if given is None:
        return None
    try:
        if isinstance(given, (int, float)):
            return datetime.fromtimestamp(given, UTC)
        return parse_time(given.isoformat() if isinstance(given, datetime) else given)
    except (ValueError, TypeError, OverflowError, OSError):
        raise UsageError(f"--time: '{given}' is not a time", hint="write it as 2026-05-01T12:00") from None
