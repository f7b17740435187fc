"""The command `dynid recover`."""

from __future__ import annotations

from pathlib import Path

import typer

from daq.commands.help_text import CommandApp
from daq.commands.options import FORCE, JSON, out_option

app = CommandApp("Record")


@app.command("recover")
def recover_command(
    file: Path = typer.Argument(
        help="Recording whose writer crashed, or its intended name: `dynid record` writes into "
        "FILE.unfinished-….h5 until it closes the recording."
    ),
    out: Path = out_option("Recording to write; default: FILE-recovered.h5."),
    force: bool = FORCE,
    as_json: bool = JSON,
) -> None:
    """Rescue a recording that was never closed.

    Example: dynid recover run.h5
    """
    import sys

    from daq.commands.console import print_json, progress_line
    from daq.output_files import intended_name, unfinished_files
    from daq.recording.quality.stream_quality import stream_quality
    from daq.recording.reader import read_stamps
    from daq.recording.recover import half_written, recover

    intended = intended_name(file)
    target = out if out is not None else intended.parent / f"{intended.stem}-recovered.h5"
    source = half_written(file)
    if source == file:
        for other in unfinished_files(file):
            print(f"dynid: warning: {other} is unfinished, too (dynid recover {other})", file=sys.stderr)
    with progress_line(quiet=as_json) as progress:
        progress(f"reading {source}")
        cut = recover(source, target, overwrite=force)
    qualities = {name: stream_quality(time) for name, time in read_stamps(target).items()}
    if as_json:
        print_json({"file": target, "streams": qualities, "cut": cut})
        return
    for name, quality in qualities.items():
        print(f"{target}: {name}: {quality.samples} samples recovered, {cut[name]} announced but not written")
