"""The command `dynid import`."""

from __future__ import annotations

from pathlib import Path

import typer

from daq.commands.help_text import CommandApp
from daq.commands.options import FORCE, JSON, takes
from daq.importers.choices import ImportChoices

app = CommandApp("Record")


@app.command("import")
@takes(ImportChoices)
def import_recording(
    *,
    file: Path = typer.Argument(help="CSV, npz, mat, ROS 2 bag (folder or .db3) or MCAP."),
    robot: str = typer.Option(..., "--robot", help="Built-in robot or robot file."),
    out: Path = typer.Option(..., "-o", "--out", help="Recording to write (.h5)."),
    options: ImportChoices,
    comment: str = typer.Option("", "--comment", help="Your words, kept in the recording."),
    force: bool = FORCE,
    as_json: bool = JSON,
) -> None:
    """Turn a CSV, npz, mat, ROS 2 bag or MCAP file into a recording.

    Example: dynid import run.csv --robot ur5e --degrees -o run.h5
    """
    from dataclasses import asdict, replace

    from daq.commands.console import print_json, progress_line
    from daq.importers.import_file import import_file
    from daq.output_files import check_outputs
    from daq.recording.stream_quality import stream_quality
    from daq.recording.writer import write_recording
    from daq.robot.loader import load_robot

    robot_file = load_robot(robot)
    check_outputs([out], [file, *robot_file.files], overwrite=force)
    with progress_line(quiet=as_json) as progress:
        recording = import_file(file, robot_file, options, progress)
        if comment:
            recording = replace(recording, comment=f"{comment} ({recording.comment})")
        progress(f"writing {out}")
        write_recording(out, recording, overwrite=force)
    qualities = {name: stream_quality(stream.time) for name, stream in recording.streams.items()}
    if as_json:
        print_json(
            {
                "file": str(out),
                "streams": {name: asdict(quality) for name, quality in qualities.items()},
                "events": [asdict(event) for event in recording.events],
            }
        )
        return
    for name, stream in recording.streams.items():
        quality = qualities[name]
        print(f"{out}: {quality.samples} samples of {', '.join(stream.channels)} at {quality.rate_hz:.4g} Hz")
    for event in recording.events:
        print(f"  {event.level}: {event.message}")
