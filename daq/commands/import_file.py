"""The command `dynid import`."""

from __future__ import annotations

from pathlib import Path

import typer

from daq.commands.options import FORCE, JSON

app = typer.Typer()


@app.command("import")
def import_recording(
    file: Path = typer.Argument(help="CSV, npz, mat, ROS 2 bag (folder or .db3) or MCAP."),
    robot: str = typer.Option(..., "--robot", help="Built-in robot or robot file."),
    out: Path = typer.Option(..., "-o", "--out", help="Recording to write (.h5)."),
    column: list[str] = typer.Option(
        [], "--column", help="NAME=COLUMN: q1=JointPos1; position='q{}' for all joints; position=2-7 by number (CSV)."
    ),
    degrees: bool = typer.Option(False, "--degrees", help="Positions and velocities of the file are in degrees."),
    effort: str = typer.Option(None, "--effort", help="What JointState.effort is: torque or current."),
    topic: str = typer.Option(None, "--topic", help="Topic of a bag with several JointState topics."),
    rate: float = typer.Option(None, "--rate", help="Rate [Hz] of a file without a time column."),
    time_unit: str = typer.Option(None, "--time-unit", help="Unit of the time column: s, ms, us or ns."),
    repair: list[str] = typer.Option(
        [], "--repair", help="Repair to make: drop-nan, drop-duplicates, drop-repeats, opposite-torque, sort."
    ),
    by_order: bool = typer.Option(False, "--by-order", help="Match joints by their order, whatever their names."),
    comment: str = typer.Option("", "--comment", help="Your words, kept in the recording."),
    force: bool = FORCE,
    as_json: bool = JSON,
) -> None:
    """Take over a recording made by something else.

    Example: dynid import run.csv --robot ur5e --degrees -o run.h5
    """
    from dataclasses import asdict, replace

    from daq.commands.console import print_json, progress_line
    from daq.importers import import_file
    from daq.importers.choices import ImportChoices
    from daq.output_files import check_outputs
    from daq.recording.stream_quality import stream_quality
    from daq.recording.writer import write_recording
    from daq.robot.loader import load_robot

    choices = ImportChoices(
        columns=_column_mapping(column),
        degrees=degrees,
        effort=effort,  # type: ignore[arg-type]  # ImportChoices checks it
        topic=topic,
        rate=rate,
        repair=frozenset(repair),
        by_order=by_order,
        time_unit=time_unit,  # type: ignore[arg-type]
    )
    robot_file = load_robot(robot)
    check_outputs([out], [file, *robot_file.files], overwrite=force)
    with progress_line(quiet=as_json) as progress:
        recording = import_file(file, robot_file, choices, progress)
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


def _column_mapping(pairs: list[str]) -> dict[str, str]:
    from drivers.core.errors import UsageError

    mapping: dict[str, str] = {}
    for pair in pairs:
        name, equals, column = pair.partition("=")
        if not (name.strip() and equals and column.strip()):
            raise UsageError(f"--column {pair} is not NAME=COLUMN", hint="for example --column q1=JointPos1")
        if name.strip() in mapping:
            raise UsageError(f"--column gives '{name.strip()}' twice")
        mapping[name.strip()] = column.strip()
    return mapping
