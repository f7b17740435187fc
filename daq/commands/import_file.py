"""The command `dynid import`."""

from __future__ import annotations

from pathlib import Path

import typer

from daq.commands.help_text import CommandApp
from daq.commands.options import FORCE, JSON, out_option, takes
from daq.importers.choices import ImportChoices

app = CommandApp("Record")


@app.command("import")
@takes(ImportChoices)
def import_recording(
    *,
    file: Path = typer.Argument(help="CSV, npz, mat, ROS 2 bag (folder or .db3), MCAP or LeRobot dataset (folder)."),
    robot: str = typer.Option(..., "--robot", help="Built-in robot or robot file."),
    out: Path = out_option("Recording to write (.h5); of a LeRobot dataset a folder.", ...),
    options: ImportChoices,
    comment: str = typer.Option("", "--comment", help="Comment, kept in the recording."),
    force: bool = FORCE,
    as_json: bool = JSON,
) -> None:
    """Turn a CSV, npz, mat, ROS 2 bag or MCAP file into a recording.

    Example: dynid import run.csv --robot ur5e --degrees -o run.h5
    """
    from dataclasses import replace

    from daq.commands.console import print_json, progress_line
    from daq.importers.formats.lerobot import is_lerobot
    from daq.importers.import_file import import_episodes, import_file
    from daq.output_files import check_output_folder, check_outputs
    from daq.recording.quality.stream_quality import stream_quality
    from daq.recording.writer import write_recording
    from daq.robot.loader import load_robot
    from drivers.core.errors import UsageError

    robot_file = load_robot(robot)
    several = is_lerobot(file) and options.episode is None
    if several and out.suffix:
        raise UsageError(
            f"'{out.name}' is a file, but a LeRobot dataset becomes a recording per episode",
            where="--out",
            hint="name a folder (-o runs), or one episode (--episode 0)",
        )
    if not several:
        check_outputs([out], [file, *robot_file.files], overwrite=force)
    with progress_line(quiet=as_json) as progress:
        if several:
            episodes = import_episodes(file, robot_file, options, progress)
            recordings = {out / f"episode_{number:06d}.h5": recording for number, recording in episodes.items()}
            names = [path.name for path in recordings]
            check_output_folder(out, names, [file, *robot_file.files], overwrite=force)
            out.mkdir(exist_ok=True)
        else:
            recordings = {out: import_file(file, robot_file, options, progress)}
        for path, recording in recordings.items():
            if comment:
                recording = replace(recording, comment=f"{comment} ({recording.comment})")
            progress(f"writing {path}")
            write_recording(path, recording, overwrite=force)
    written = [
        {
            "file": path,
            "streams": {name: stream_quality(stream.time) for name, stream in recording.streams.items()},
            "events": recording.events,
        }
        for path, recording in recordings.items()
    ]
    if as_json:
        print_json({"recordings": written} if several else written[0])
        return
    for path, recording in recordings.items():
        for stream in recording.streams.values():
            quality = stream_quality(stream.time)
            print(f"{path}: {quality.samples} samples of {', '.join(stream.channels)} at {quality.rate_hz:.4g} Hz")
        for event in recording.events:
            print(f"  {event.level}: {event.message}")
