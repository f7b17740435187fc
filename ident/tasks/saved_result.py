"""What every result that a task returns can do: be written into a folder, and, where it has one grade, be shown."""

from __future__ import annotations

from abc import ABC, abstractmethod
from os import PathLike
from typing import TYPE_CHECKING, ClassVar

from daq.output_files import REPORT_FILE, RESULT_FILE, check_output_folder, write_folder
from drivers.core.files import path_of
from ident.result.result_file import result_json
from ident.result.tables import Table

if TYPE_CHECKING:
    from ident.result.gravity import GravityResult
    from ident.servo.result import ServoResult


class SavedResult(ABC):
    """A result with a JSON object and a page."""

    FILE: ClassVar[str] = RESULT_FILE
    """Name of the JSON file."""

    @abstractmethod
    def to_json(self) -> str:
        """The text of the JSON file."""

    @abstractmethod
    def _page(self) -> str:
        """The text of `report.html`."""

    def save(self, folder: str | PathLike[str], *, overwrite: bool = False) -> None:
        """Write the result (JSON) and `report.html` into a folder, as the command does with `-o`.

        Args:
            folder: made where it does not exist.
            overwrite: replace the files where they exist.

        Raises:
            UsageError: they exist already, it is a file, or cannot be written.
            DiskError: the disk is full or fails.
        """
        place = path_of(folder)
        check_output_folder(place, (self.FILE, REPORT_FILE), overwrite=overwrite)
        write_folder(place, {self.FILE: self.to_json() + "\n", REPORT_FILE: self._page()})


class GradedResult(SavedResult):
    """A model that is identified for one purpose, with a grade for it.

    Attributes:
        result: all of it, as `result.json` holds it.
    """

    result: GravityResult | ServoResult

    @property
    def verdict(self) -> str:
        """How far the model can be trusted for its purpose, in a sentence, and what spoils it."""
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

    def __str__(self) -> str:
        return f"{self.verdict}\n\n{self.errors}\n\n{self.parameters}"

    def _repr_html_(self) -> str:
        return f"<pre>{self.verdict}</pre>{self.errors._repr_html_()}{self.parameters._repr_html_()}"
