"""Servo models at the command line: `identify --method servo`, and `validate` and `export` of what it wrote."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.core.errors import UsageError
from drivers.core.options import default_of, flag_of
from ident.tasks.options import IdentifyOptions

if TYPE_CHECKING:
    from ident.tasks.servo import ServoModel

SERVO = "servo"
"""Of --method: commands and encoders in place of torques."""

_TAKEN = frozenset({"runs", "validation", "robot", "method", "progress"})
"""Options of identify that a servo model has."""


def is_servo(method: str) -> bool:
    """Whether --method names the servo model.

    Raises:
        UsageError: with an option; it has none.
    """
    name, *rest = method.split(":")
    if name == SERVO and rest:
        raise UsageError("servo has no options", where="--method", hint="known values: `servo` of the robot file")
    return name == SERVO


def identify_servo_command(
    options: IdentifyOptions, folder: Path, progress: Callable[[str], None], *, limited: bool, overwrite: bool
) -> ServoModel:
    """Identify, and write the folder.

    Raises:
        UsageError: an option that a servo model does not have.
    """
    from ident.tasks.servo import identify_servo

    strange = [
        flag_of(of) for of in fields(options) if of.name not in _TAKEN and getattr(options, of.name) != default_of(of)
    ]
    if limited:
        strange.append("--accept, --max-…")
    if strange:
        raise UsageError(f"{', '.join(strange)} does nothing with --method servo", hint="leave it out")
    model = identify_servo(options.runs, validation=options.validation, robot=options.robot, progress=progress)
    progress("report")
    model.save(folder, overwrite=overwrite)
    return model


def print_servo(model: ServoModel, folder: Path, *, verbose: bool, as_json: bool) -> None:
    """The verdict and the errors; with `verbose` every parameter; or the JSON object alone."""
    from daq.output_files import REPORT_FILE, RESULT_FILE

    if as_json:
        print((folder / RESULT_FILE).read_text(encoding="utf-8"), end="")
        return
    _print(model.verdict, [model.errors, *([model.parameters] if verbose else [])])
    print(f"\n{'' if verbose else 'Parameters with intervals: --verbose, or the report. '}{folder / REPORT_FILE}")
    print(f"next: dynid validate {folder} OTHER.h5, dynid export {folder} --mjcf arm.xml")


def validate_servo_command(path: Path, runs: object, *, as_json: bool) -> None:
    """Judge a stored servo model on other recordings."""
    from ident.tasks.servo import load_servo_model

    judged = load_servo_model(path).validate(runs)  # type: ignore[arg-type]
    if as_json:
        from daq.commands.console import print_json

        result = judged.result
        assert result.validation is not None
        print_json(
            {
                "result": str(path),
                "joints": result.joints,
                "validation": result.validation.model_dump(mode="json"),
                "verdict": result.verdict.model_dump(mode="json"),
            }
        )
        return
    _print(judged.verdict, [judged.errors])


def export_servo_command(
    path: Path, mjcf: Path | None, ranges: Path | None, *, others: bool, force: bool, as_json: bool
) -> None:
    """Write a stored servo model as MJCF, and ranges of its parameters.

    Raises:
        UsageError: another format is asked for.
    """
    import json

    from daq.output_files import replace_files
    from ident.servo.mjcf import left_out
    from ident.tasks.servo import load_servo_model

    if others:
        raise UsageError("a servo model is exported as MJCF or ranges only", where=str(path), hint="--mjcf, --ranges")
    model = load_servo_model(path)
    files: list[dict[str, object]] = []
    words = list(left_out(model.result.values))
    if mjcf is not None:
        model.export_mjcf(mjcf, overwrite=force)
        files.append({"path": str(mjcf), "left_out": words})
    if ranges is not None:
        replace_files({ranges: json.dumps(model.ranges(), ensure_ascii=False, indent=1) + "\n"})
        files.append({"path": str(ranges), "left_out": []})
    if as_json:
        from daq.commands.console import print_json

        print_json({"model": str(path), "files": files})
        return
    if mjcf is not None:
        print(f"{mjcf}: MJCF with position actuators; ctrl is the commanded position")
        if words:
            print(f"not in this file: {', '.join(words)}")
    if ranges is not None:
        print(f"{ranges}: 95 % boxes and covariance of every parameter, for domain randomisation")


def _print(verdict: str, tables: list[object]) -> None:
    from ident.commands.printing.result import print_tables

    print(verdict)
    print_tables(tables)  # type: ignore[arg-type]
