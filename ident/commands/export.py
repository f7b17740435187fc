"""The command `dynid export`."""

from __future__ import annotations

from pathlib import Path

import typer

from daq.commands.help_text import CommandApp
from daq.commands.options import FORCE, JSON

app = CommandApp("Use")


@app.command("export")
def export(
    model: Path = typer.Argument(help="Folder that identify wrote, or its result.json."),
    urdf: Path = typer.Option(None, "--urdf", help="URDF to write: the robot's own, or a complete one from MDH."),
    into: Path = typer.Option(None, "--into", help="URDF of the same arm to put the model in, beside --urdf."),
    mjcf: Path = typer.Option(None, "--mjcf", help="MJCF to write, for MuJoCo."),
    ros2_inertial: Path = typer.Option(
        None, "--ros2-inertial", help="YAML to write, as in Universal_Robots_ROS2_Description."
    ),
    c: Path = typer.Option(None, "--c", help="C99 code to write: `arm` for arm.h and arm.c."),
    c_float: bool = typer.Option(False, "--c-float", help="C code in float, not double."),
    isaaclab: Path = typer.Option(
        None, "--isaaclab", help="Of a servo model: Python configuration for Isaac Lab, with events."
    ),
    usd: Path = typer.Option(None, "--usd", help="Of a servo model: USD stage with joint drives (.usda)."),
    ranges: Path = typer.Option(
        None, "--ranges", help="Of a servo model: JSON of ranges for domain randomisation, boxes and covariance."
    ),
    unit_spread: float = typer.Option(
        0.0, "--unit-spread", help="Of ranges and events: how much units of a type differ, as σ of logarithms."
    ),
    replay: list[Path] = typer.Option(
        [], "--replay", help="Of a servo model: recording to roll the files out on; repeatable."
    ),
    parameters: str = typer.Option(
        None,
        "--parameters",
        help="Of the C code: consistent, full or essential; consistent where there are any. Other formats need them.",
    ),
    force: bool = FORCE,
    as_json: bool = JSON,
) -> None:
    """Write the model as URDF, MJCF or C, read again and verified.

    Example: dynid export model --urdf arm.urdf --mjcf arm.xml --c arm
    """
    from dataclasses import asdict
    from typing import cast

    from daq.commands.console import print_json, progress_line
    from daq.output_files import check_outputs, written_together
    from drivers.core.errors import UsageError
    from ident.commands.gravity import export_gravity_command
    from ident.commands.servo import ServoExports, export_servo_command, refuse_servo_formats
    from ident.export.c_code.names import source_paths
    from ident.result.delivered import Parameters
    from ident.result.gravity import is_gravity_file
    from ident.result.load_model import load_model
    from ident.result.model import result_path
    from ident.servo.result import is_servo_file
    from ident.verdict.verdict import judge, together

    files = (urdf, mjcf, ros2_inertial, isaaclab, usd, ranges, *(source_paths(c) if c else ()))
    targets = [path for path in files if path is not None]
    if not targets:
        raise UsageError(
            "names no file to write", hint="--urdf, --mjcf, --ros2-inertial, --c, --isaaclab, --usd or --ranges"
        )
    for asked, file, text in (
        (c_float, c, "--c-float needs --c, the files to write"),
        (into, urdf, "--into needs --urdf, the file to write"),
    ):
        if asked and file is None:
            raise UsageError(text)
    check_outputs(targets, [result_path(model), into, *replay], overwrite=force)
    exports = ServoExports(mjcf, isaaclab, usd, ranges, unit_spread, tuple(replay))
    if is_servo_file(result_path(model)):
        others = any(path is not None for path in (urdf, ros2_inertial, c))
        export_servo_command(model, exports, others=others, force=force, as_json=as_json)
        return
    refuse_servo_formats(model, exports)
    if is_gravity_file(result_path(model)):
        others = any(path is not None for path in (urdf, mjcf, ros2_inertial))
        export_gravity_command(model, c, others=others, c_float=c_float, force=force, as_json=as_json)
        return
    written = []
    with progress_line(quiet=as_json) as progress, written_together():
        progress("model")
        identified = load_model(model, cast("Parameters | None", parameters))
        if urdf is not None:
            progress("URDF")
            written.append(identified.export_urdf(urdf, into=into, overwrite=force))
        if mjcf is not None:
            progress("MJCF")
            written.append(identified.export_mjcf(mjcf, overwrite=force))
        if ros2_inertial is not None:
            progress("ROS 2 inertial parameters")
            written.append(identified.export_ros2_inertial(ros2_inertial, overwrite=force))
        if c is not None:
            progress("C code")
            written.append(identified.export_c(c, real="float" if c_float else "double", overwrite=force))
    checks = [check for one in written for check in one.checks]
    verdicts = [("identification", identified.result.verdict), ("export", judge(checks, None))]
    simulation = together([verdict for verdict in verdicts if "simulation" in verdict[1].purposes]).purposes[
        "simulation"
    ]
    if as_json:
        described = [{**asdict(one), "path": str(one.path)} for one in written]
        print_json({"model": str(model), "files": described, "simulation": asdict(simulation)})
        return
    for one in written:
        print(one)
    print(f"for simulation: {simulation.grade}, {simulation.because}")
