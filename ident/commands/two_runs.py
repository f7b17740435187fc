"""Arguments and options of the commands that compare a run without and a run with a load."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

from ident.commands.options import DELAY, FORCE, JSON, delay_option, numbers_option


@dataclass(frozen=True)
class TwoRuns:
    """What the commands are given: two recordings, what is known of the load, where the results go."""

    free: Annotated[Path, typer.Argument(help="Recording (.h5) of the arm without the load.")]
    loaded: Annotated[Path, typer.Argument(help="Recording (.h5) of the same arm with it.")]
    mass: Annotated[float | None, typer.Option(help="Mass of the load [kg].")] = None
    com: Annotated[str | None, typer.Option(metavar="X,Y,Z", help="Its centre of mass in the tool frame [m].")] = None
    inertia: Annotated[
        str | None, typer.Option(metavar="XX,XY,XZ,YY,YZ,ZZ", help="Its inertia about the centre of mass [kg·m²].")
    ] = None
    robot: Annotated[str | None, typer.Option(help="Robot file in place of the free recording's own.")] = None
    delay: str = DELAY
    out: Annotated[Path | None, typer.Option("-o", "--out", help="Folder for the result (.json) and report.html.")] = (
        None
    )
    force: bool = FORCE
    as_json: bool = JSON

    def folder(self, experiment: str, result: str) -> Path:
        """The folder for the results, checked: `--out`, or the loaded recording's name and what the experiment is.

        Raises:
            UsageError: its files exist already, or cannot be written.
        """
        from daq.output_files import REPORT_FILE, check_output_folder
        from daq.robot.loader import load_robot

        folder = self.out if self.out is not None else Path(f"{self.loaded.stem}-{experiment}")
        inputs = [self.free, self.loaded, *(load_robot(self.robot).files if self.robot else ())]
        check_output_folder(folder, (result, REPORT_FILE), inputs, overwrite=self.force)
        return folder

    def options(self) -> dict[str, Any]:
        """Options of the tasks `payload` and `drive_gains` that both have, the mass left out.

        Raises:
            UsageError: a list of numbers or a delay that is none.
        """
        return {
            "com": numbers_option(self.com, "--com"),
            "inertia": numbers_option(self.inertia, "--inertia"),
            "robot": self.robot,
            "delay": delay_option(self.delay),
        }


def takes_two_runs(function: Callable[..., None]) -> Callable[..., None]:
    """A command whose first parameter is a `TwoRuns` with the fields of that class in its place."""
    own = inspect.signature(function, eval_str=True)
    hints = get_type_hints(TwoRuns, include_extras=True)
    shared = [
        inspect.Parameter(
            field.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=field.default if field.name not in ("free", "loaded") else inspect.Parameter.empty,
            annotation=hints[field.name],
        )
        for field in fields(TwoRuns)
    ]
    more = [one.replace(kind=inspect.Parameter.KEYWORD_ONLY) for one in list(own.parameters.values())[1:]]

    def command(**given: Any) -> None:
        runs = TwoRuns(**{one.name: given.pop(one.name) for one in shared})
        function(runs, **given)

    command.__doc__ = function.__doc__
    command.__signature__ = inspect.Signature([*shared, *more])  # type: ignore[attr-defined]
    command.__annotations__ = {one.name: one.annotation for one in [*shared, *more]}
    return command
