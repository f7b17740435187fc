"""The page of a recording, as `dynid info --page` writes it: one self-contained HTML file beside its JSON."""

from __future__ import annotations

from pathlib import Path

from daq.output_files import save_folder
from daq.recording.recording import JOINTS_STREAM
from drivers.core.text import json_text
from ident.checks.page.plots import intervals_figure, signals_figure, spectra_figure
from ident.checks.recording_check import RecordingInfo, info_object
from ident.checks.recording_tables import column_table, gap_table, motion_table, stream_table
from ident.regression.options import SIGNIFICANT_RSD
from ident.report.html_file import rendered
from ident.report.section import Tile
from ident.views.number_text import DASH, number, percent, whole

JSON_FILE = "info.json"
PAGE_FILE = "info.html"
MOST_GAPS = 50
"""Gaps in the page's table; a recording that lost samples all the time has thousands."""


def write_page(folder: Path, info: RecordingInfo, file: str, *, overwrite: bool = False) -> None:
    """Write info.json and info.html into a folder.

    Raises:
        UsageError, DiskError: they exist already and may not be overwritten, or cannot be written.
    """
    texts = {JSON_FILE: json_text(info_object(info, file)) + "\n", PAGE_FILE: render_page(info, file)}
    save_folder(folder, texts, overwrite=overwrite)


def render_page(info: RecordingInfo, file: str) -> str:
    """The page as text."""
    recording = info.recording
    return rendered(
        "recording_page",
        "ident.checks.page",
        file=file,
        info=info,
        recording=recording,
        tiles=_tiles(info),
        streams=stream_table(info, file),
        columns=column_table(info),
        motion=motion_table(info),
        gaps=gap_table(info, MOST_GAPS),
        signals=signals_figure(recording),
        intervals=intervals_figure(recording, info.streams),
        spectra=None if info.motion is None else spectra_figure(info.motion),
    )


def _tiles(info: RecordingInfo) -> list[Tile]:
    streams = info.streams
    main = streams.get(JOINTS_STREAM)
    lost = sum(quality.lost for quality in streams.values())
    samples = sum(quality.samples for quality in streams.values())
    tiles = [
        Tile("Duration", f"{number(main.duration, 4)} s", f"{whole(main.samples)} samples of the joints")
        if main is not None
        else Tile("Streams", str(len(streams))),
        Tile("Rate", f"{number(main.rate_hz, 4)} Hz", f"jitter {number(main.jitter_ms, 2)} ms")
        if main is not None
        else Tile("Rate", DASH),
        Tile("Samples lost", whole(lost), f"{percent(lost / max(1, lost + samples), 2)} of all streams"),
    ]
    if info.excitation is not None:
        note = "column-normalised; below 50 is good"
        tiles.append(Tile("Condition of the motion", number(info.excitation.scaled_condition, 3), note))
    if info.sufficiency is not None:
        rsds = [p.rsd_percent for p in info.sufficiency.forecast.parameters if p.rsd_percent is not None]
        significant = sum(value < SIGNIFICANT_RSD for value in rsds)
        if rsds:
            tiles.append(
                Tile("Significant", str(significant), f"of {len(rsds)}: predicted RSD below {SIGNIFICANT_RSD:g} %")
            )
    return tiles
