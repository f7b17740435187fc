"""Servo models at the command line: `identify --method servo`, and `validate` and `export` of what it wrote."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.core.errors import UsageError
from ident.commands.options import ExportOptions, refuse_options_but
from ident.tasks.options import IdentifyOptions

if TYPE_CHECKING:
    from ident.tasks.servo import ServoModel

SERVO = "servo"
"""Value of --method that identifies from commands and encoders in place of torques."""

SERVO_USE = "dynid validate {folder} OTHER.h5, dynid export {folder} --mjcf arm.xml"
"""What to do next with the model in a folder."""

_TAKEN = frozenset({"runs", "validation", "robot", "method", "progress"})
"""Options of identify that a servo model has."""


def is_servo(method: str) -> bool:
    """Return whether --method names the servo model.

    Raises:
        UsageError: with an option; it has none.
    """
    name, *rest = method.split(":")
    if name == SERVO and rest:
        raise UsageError("servo has no options", where="--method", hint="known values: `servo` of the robot file")
    return name == SERVO


def identify_servo_command(
    options: IdentifyOptions, progress: Callable[[str], None], *, model_file: Path | None, limited: bool
) -> ServoModel:
    """Identify.

    Raises:
        UsageError: an option that a servo model does not have.
    """
    from ident.tasks.servo import identify_servo

    refuse_options_but(_TAKEN, options, "--method servo", limited=limited)
    return identify_servo(
        options.runs, validation=options.validation, robot=options.robot, model_file=model_file, progress=progress
    )


def validate_servo_command(path: Path, runs: object, *, model_file: Path | None, as_json: bool) -> None:
    """Judge a stored servo model on other recordings."""
    from ident.commands.printing.result import print_validated
    from ident.tasks.servo import load_servo_model

    judged = load_servo_model(path).validate(runs, model_file=model_file)  # type: ignore[arg-type]
    print_validated(judged, path, judged.errors, as_json=as_json)


def predict_servo_command(path: Path, run: Path, out: Path, *, as_json: bool, force: bool) -> None:
    """Write a recording whose positions are rolled out on another's commands, or on those of a trajectory file."""
    from daq.recording.writer import write_recording
    from ident.commands.printing.result import print_tables
    from ident.identify.data_split import labelled
    from ident.tasks.arguments import is_trajectory
    from ident.tasks.servo import load_servo_model

    model = load_servo_model(path)
    if is_trajectory(run):
        write_recording(out, model.play(run), overwrite=force)
        if as_json:
            from daq.commands.console import print_json

            print_json({"file": str(out), "joints": model.result.joints, "validation": None})
            return
        print(f"Positions rolled out on the motion's commands: {out}")
        return
    rolled = model.predict(run)
    judged = model.validate(run)
    write_recording(out, rolled, overwrite=force)
    validation = judged.result.validation
    assert validation is not None
    if as_json:
        from daq.commands.console import print_json

        print_json({"file": out, "joints": judged.result.joints, "validation": validation})
        return
    source = labelled(str(run), 0.0 if validation.held_out else 1.0)
    print(f"Positions rolled out on the commands of {source} alone: {out}")
    print_tables([judged.errors])


def refuse_model_file(model_file: Path | None) -> None:
    """Refuse --model-file where the model is none of servos.

    Raises:
        UsageError: it is given.
    """
    if model_file is not None:
        raise UsageError("is of a servo model", where="--model-file", hint="dynid identify --method servo")


def refuse_servo_formats(options: ExportOptions) -> None:
    """Refuse what only a servo model has.

    Raises:
        UsageError: it is asked for.
    """
    for flag in options.given("isaaclab", "usd", "ranges", "unit_spread", "replay"):
        raise UsageError(f"{flag} is of a servo model", where=str(options.model), hint="dynid identify --method servo")


def export_servo_command(options: ExportOptions, *, force: bool, as_json: bool) -> None:
    """Write a stored servo model for simulators, each file rolled out on recorded commands.

    Raises:
        UsageError: another format is asked for.
    """
    import json

    from daq.output_files import replace_files, written_together
    from ident.servo.simulators import isaaclab, mjcf, usd
    from ident.servo.simulators.actuator_law import left_out
    from ident.tasks.servo import load_servo_model

    if options.given("urdf", "ros2_inertial", "c"):
        hint = "--mjcf, --isaaclab, --usd, --ranges"
        raise UsageError("a servo model is exported for simulators only", where=str(options.model), hint=hint)
    model = load_servo_model(options.model)
    runs = options.replay or model.recordings()
    files: list[dict[str, object]] = []
    with written_together():
        for target, write, missing, what in (
            (options.mjcf, model.export_mjcf, mjcf.MISSING, "MJCF with position actuators; ctrl is the command"),
            (
                options.isaaclab,
                partial(model.export_isaaclab, unit_spread=options.unit_spread),
                isaaclab.MISSING,
                "actuators and events for Isaac Lab, checked without it",
            ),
            (options.usd, model.export_usd, usd.MISSING, "USD with joint drives, in degrees"),
        ):
            if target is None:
                continue
            replayed = write(target, runs, overwrite=force)
            files.append(
                {
                    "path": str(target),
                    "what": what,
                    "left_out": list(left_out(model.result.values, missing)),
                    "replay": None if replayed is None else {**asdict(replayed), "faithful": replayed.faithful},
                    "text": "" if replayed is None else str(replayed),
                }
            )
        if options.ranges is not None:
            text = json.dumps(model.ranges(options.unit_spread), ensure_ascii=False, indent=1) + "\n"
            replace_files({options.ranges: text})
            what = "95 % boxes and covariance of every parameter, for domain randomisation"
            files.append({"path": str(options.ranges), "what": what, "left_out": [], "replay": None, "text": ""})
    if as_json:
        from daq.commands.console import print_json

        print_json(
            {"model": str(options.model), "files": [{k: v for k, v in entry.items() if k != "text"} for entry in files]}
        )
        return
    for file in files:
        print(f"{file['path']}: {file['what']}")
        if file["left_out"]:
            print(f"  not in this file: {', '.join(file['left_out'])}")  # type: ignore[arg-type]
        if file["text"]:
            print(f"  {file['text']}")
    if not runs and any(file["left_out"] for file in files):
        print("not rolled out: the recordings of the identification were moved; give --replay RUN.h5")
