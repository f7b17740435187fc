"""Gravity at the command line: `identify --gravity`, and `validate` and `export` of what it wrote."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.core.errors import UsageError
from ident.commands.options import ExportOptions, refuse_options_but
from ident.tasks.options import IdentifyOptions

if TYPE_CHECKING:
    from ident.tasks.experiments import IdentifiedGravity

_TAKEN = frozenset({"runs", "validation", "robot", "progress"})
"""Options of identify that gravity has."""


GRAVITY_USE = 'dynid export {folder} --c arm; in Python dynid.load_model("{folder}").gravity(q)'
"""What to do next with the model in a folder."""


def identify_gravity_command(
    options: IdentifyOptions, progress: Callable[[str], None], *, limited: bool
) -> IdentifiedGravity:
    """Identify.

    Raises:
        UsageError: an option that gravity does not have.
    """
    from ident.tasks.experiments import identify_gravity

    refuse_options_but(_TAKEN, options, "--gravity", limited=limited)
    return identify_gravity(options.runs, validation=options.validation, robot=options.robot, progress=progress)


def validate_gravity_command(path: Path, runs: object, *, as_json: bool) -> None:
    """Judge a stored model of gravity on other recordings."""
    from ident.commands.printing.result import print_validated
    from ident.tasks.experiments import load_gravity

    judged = load_gravity(path).validate(runs)  # type: ignore[arg-type]
    print_validated(judged, path, judged.result.validation_errors, as_json=as_json)


def export_gravity_command(options: ExportOptions, *, force: bool, as_json: bool) -> None:
    """Write a stored model of gravity as C code.

    Raises:
        UsageError: another format is asked for.
    """
    from daq.commands.console import print_json
    from ident.result.gravity import read_gravity_result
    from ident.result.models.gravity_model import GravityModel
    from ident.result.models.model import result_path

    path = options.model
    if options.c is None or options.given("urdf", "mjcf", "ros2_inertial"):
        raise UsageError(
            "a model of gravity has no inertias, which URDF, MJCF and YAML need", where=str(path), hint="--c"
        )
    model = GravityModel(read_gravity_result(result_path(path)))
    export = model.export_c(options.c, real="float" if options.c_float else "double", overwrite=force)
    verdict = model.result.verdict
    if as_json:
        print_json({"model": path, "files": [export], "gravity_compensation": verdict})
        return
    print(export, verdict.headline, sep="\n")
