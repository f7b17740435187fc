"""The command `dynid predict`."""

from __future__ import annotations

from pathlib import Path

from daq.commands.help_text import CommandApp
from daq.commands.options import FORCE, JSON, out_option, page_option, takes
from ident.tasks.options import PredictOptions

app = CommandApp("Use")


@app.command("predict")
@takes(PredictOptions)
def predict_torque(
    *,
    out: Path = out_option("Recording to write (.h5)."),
    options: PredictOptions,
    page: Path = page_option(),
    force: bool = FORCE,
    as_json: bool = JSON,
) -> None:
    """Predict the torques of a recording or planned motion, part by part; of a servo model, its positions.

    Example: dynid predict model run.h5 -o predicted.h5 --page predicted.html
    """
    from daq.commands.console import print_json, print_table, progress_line
    from daq.output_files import check_outputs
    from drivers.core.errors import UsageError
    from ident.commands.identification.servo import predict_servo_command
    from ident.result.models.model import result_path
    from ident.result.result_file import GRAVITY, SERVO, kind_of
    from ident.tasks.arguments import paths_of
    from ident.tasks.prediction import predict

    model, recording = paths_of(options.identified, options.run)
    file = out if out is not None else Path(f"{recording.stem}-predicted.h5")
    check_outputs([file, page], [recording, result_path(model)], overwrite=force)
    kind = kind_of(result_path(model))
    if kind == GRAVITY:
        raise UsageError(
            f"{model} is a model of gravity, which cannot predict the torque of a motion",
            hint="dynid validate compares it with static poses",
        )
    if kind == SERVO:
        if page is not None or options.parameters is not None:
            raise UsageError("--page and --parameters need a model with torques", hint="leave them out")
        predict_servo_command(model, recording, file, as_json=as_json, force=force)
        return
    with progress_line(quiet=as_json) as progress:
        progress("prediction")
        prediction = predict(**vars(options))
        progress(f"writing {file}")
        prediction.save(file, overwrite=force)
        if page is not None:
            progress("page")
            prediction.page(page, overwrite=force)
    summary = prediction.summary
    if as_json:
        print_json(
            {
                "file": file,
                "page": page,
                "parameters": options.parameters,
                "presliding": prediction.segments.presliding,
                "overlap": prediction.segments.overlap,
                "samples": len(prediction.time),
                "segments": len(prediction.segments.segments),
                "rate_hz": prediction.segments.segments[0].rate,
                "joints": summary,
            }
        )
        return
    print_table(
        f"{summary.title} [{summary.columns[1].unit}]",
        [column.name.replace("_", " ") for column in summary.columns],
        [list(row.values()) for row in summary],
    )
    print(f"\n{file}" + ("" if page is None else f"\n{page}"))
