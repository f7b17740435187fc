"""Gravity at the command line: `identify --gravity`, and `validate` and `export` of what it wrote."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.core.errors import UsageError
from ident.commands.options import ExportOptions, refuse_options_but
from ident.tasks.options import IdentifyOptions

if TYPE_CHECKING:
    from ident.tasks.gravity import IdentifiedGravity

_TAKEN = frozenset({"runs", "validation", "robot", "progress"})
"""Options of identify that gravity has."""


def identify_gravity_command(
    options: IdentifyOptions, folder: Path, progress: Callable[[str], None], *, limited: bool, overwrite: bool
) -> IdentifiedGravity:
    """Identify, and write the folder.

    Raises:
        UsageError: an option that gravity does not have.
    """
    from ident.tasks.gravity import identify_gravity

    refuse_options_but(_TAKEN, options, "--gravity", limited=limited)
    found = identify_gravity(options.runs, validation=options.validation, robot=options.robot, progress=progress)
    progress("report")
    found.save(folder, overwrite=overwrite)
    return found


def print_gravity(found: IdentifiedGravity, folder: Path, *, verbose: bool, as_json: bool) -> None:
    """The verdict and the errors; with `verbose` every parameter; or the JSON object alone."""
    from daq.output_files import REPORT_FILE, RESULT_FILE
    from ident.commands.printing.result import print_tables

    if as_json:
        print((folder / RESULT_FILE).read_text(encoding="utf-8"), end="")
        return
    print(found.verdict)
    print()
    print_tables([found.errors, *([found.parameters] if verbose else [])])
    print(f"\n{'' if verbose else 'Parameters with intervals: --verbose, or the report. '}{folder / REPORT_FILE}")
    print(f'next: dynid export {folder} --c arm; in Python dynid.load_model("{folder}").gravity(q)')


def validate_gravity_command(path: Path, runs: object, *, as_json: bool) -> None:
    """Judge a stored model of gravity on other recordings."""
    from ident.commands.printing.result import print_tables
    from ident.tasks.gravity import load_gravity

    result = load_gravity(path).validate(runs).result  # type: ignore[arg-type]
    assert result.validation is not None
    if as_json:
        from daq.commands.console import print_json

        print_json(
            {
                "result": str(path),
                "joints": result.joints,
                "validation": result.validation.model_dump(mode="json"),
                "verdict": result.verdict.model_dump(mode="json"),
            }
        )
        return
    print("\n".join([result.verdict.headline, *(f"  {check}" for check in result.verdict.checks)]))
    print()
    print_tables([result.validation_errors])


def export_gravity_command(options: ExportOptions, *, force: bool, as_json: bool) -> None:
    """Write a stored model of gravity as C code.

    Raises:
        UsageError: another format is asked for.
    """
    from dataclasses import asdict

    from daq.commands.console import print_json
    from ident.result.gravity import read_gravity_result
    from ident.result.gravity_model import GravityModel
    from ident.result.model import result_path

    path = options.model
    if options.c is None or options.given("urdf", "mjcf", "ros2_inertial"):
        raise UsageError(
            "a model of gravity knows no inertias, which URDF, MJCF and YAML need", where=str(path), hint="--c"
        )
    model = GravityModel(read_gravity_result(result_path(path)))
    export = model.export_c(options.c, real="float" if options.c_float else "double", overwrite=force)
    verdict = model.result.verdict
    if as_json:
        grade = verdict.model_dump(mode="json")
        print_json(
            {"model": str(path), "files": [{**asdict(export), "path": str(export.path)}], "gravity_compensation": grade}
        )
        return
    print(export, verdict.headline, sep="\n")
