"""The command `dynid export`."""

from __future__ import annotations

from daq.commands.help_text import CommandApp
from daq.commands.options import FORCE, JSON, takes
from ident.commands.options import ExportOptions

app = CommandApp("Use")


@app.command("export")
@takes(ExportOptions)
def export(*, options: ExportOptions, force: bool = FORCE, as_json: bool = JSON) -> None:
    """Write the model as URDF, MJCF or C, read again and verified.

    Example: dynid export model --urdf arm.urdf --mjcf arm.xml --c arm
    """
    from daq.commands.console import print_json, progress_line
    from daq.output_files import check_outputs, written_together
    from ident.commands.identification.gravity import export_gravity_command
    from ident.commands.identification.servo import export_servo_command, refuse_servo_formats
    from ident.export.c_code.names import source_paths
    from ident.result.models.load_model import load_model
    from ident.result.models.model import result_path
    from ident.result.result_file import GRAVITY, SERVO, kind_of
    from ident.verdict.verdict import GRADES, judge

    model, result = options.model, result_path(options.model)
    code = source_paths(options.c) if options.c is not None else ()
    targets = [path for path in options.targets if path != options.c]
    check_outputs([*targets, *code], [result, options.into, *options.replay], overwrite=force)
    kind = kind_of(result)
    if kind == SERVO:
        export_servo_command(options, force=force, as_json=as_json)
        return
    refuse_servo_formats(options)
    if kind == GRAVITY:
        export_gravity_command(options, force=force, as_json=as_json)
        return
    written = []
    with progress_line(quiet=as_json) as progress, written_together():
        progress("model")
        identified = load_model(model, options.parameters)
        if options.urdf is not None:
            progress("URDF")
            written.append(identified.export_urdf(options.urdf, into=options.into, overwrite=force))
        if options.mjcf is not None:
            progress("MJCF")
            written.append(identified.export_mjcf(options.mjcf, overwrite=force))
        if options.ros2_inertial is not None:
            progress("ROS 2 inertial parameters")
            written.append(identified.export_ros2_inertial(options.ros2_inertial, overwrite=force))
        if options.c is not None:
            progress("C code")
            written.append(
                identified.export_c(options.c, real="float" if options.c_float else "double", overwrite=force)
            )
    checks = [check for file in written for check in file.checks]
    purposes = (identified.result.verdict.purposes, judge(checks, None).purposes)
    simulation = max(
        (judged["simulation"] for judged in purposes if "simulation" in judged),
        key=lambda judged: GRADES.index(judged.grade),
    )
    if as_json:
        print_json({"model": model, "files": written, "simulation": simulation})
        return
    for file in written:
        print(file)
    print(f"for simulation: {simulation.grade}, {simulation.because}")
