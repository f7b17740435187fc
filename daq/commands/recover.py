"""The command `dynid recover`."""

from __future__ import annotations

from pathlib import Path

import typer

from daq.commands.options import FORCE, JSON

app = typer.Typer()


@app.command("recover")
def recover_command(
    file: Path = typer.Argument(help="Recording whose writer died."),
    out: Path = typer.Option(None, "-o", "--out", help="Recording to write; FILE-recovered.h5 if absent."),
    force: bool = FORCE,
    as_json: bool = JSON,
) -> None:
    """Rescue what was flushed of a recording that was never closed.

    Example: dynid recover run.h5
    """
    from dataclasses import asdict

    from daq.commands.console import print_json
    from daq.recording.recover import recover
    from daq.recording.stream_quality import stream_quality

    target = out if out is not None else file.with_name(f"{file.stem}-recovered.h5")
    rescued = recover(file, target, overwrite=force)
    qualities = {name: stream_quality(stream.time) for name, stream in rescued.recording.streams.items()}
    if as_json:
        streams = {name: asdict(quality) for name, quality in qualities.items()}
        print_json({"file": str(target), "streams": streams, "cut": dict(rescued.cut)})
        return
    for name, quality in qualities.items():
        print(f"{target}: {name}: {quality.samples} samples rescued, {rescued.cut[name]} announced but not written")
