"""The page of a recording, as `dynid info --page` writes it: one self-contained HTML file beside its JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from daq.recording.quality.stream_quality import LOST_FROM, StreamQuality
from daq.recording.recording import JOINTS_STREAM, Recording, Stream
from drivers.core.arrays import FloatArray
from drivers.core.text import counted
from drivers.core.units import common_unit
from ident.assessment.excitation import RecordedMotion
from ident.checks.recording_check import RecordingInfo
from ident.checks.recording_tables import column_table, gap_table, motion_table, shown_unit, stream_table
from ident.regression.options import SIGNIFICANT_RSD
from ident.report.figures.figures import LOG_AXIS, PREDICTED, RESIDUAL, SERIES_COLOURS, Figure, bold, plain, shortened
from ident.report.figures.panels import TIME_AXIS, Line, Panel, panel_figure
from ident.report.figures.traces import broken_line, curve_trace, envelope_indices, points_trace
from ident.report.html_file import rendered
from ident.report.section import Tile
from ident.signals.resampling import gap_free_segments
from ident.views.number_text import DASH, number, percent, whole

MOST_COLUMNS = 32
"""Lines of one panel; of a channel with more columns, the first ones are shown."""

MOST_POINTS = 3000
PAGE_POINTS = 60_000
"""Points of all signals together, and of one line at most."""

SIGNAL_PANEL, INTERVAL_PANEL, SPECTRUM_PANEL = 170, 130, 260
SPECTRUM_SECONDS = 8.0
"""Length of Welch's segments: a resolution of an eighth of a hertz, which shows the motion's band."""

BAND, TORQUE_CUTOFF, POSITION_CUTOFF = (
    {"color": RESIDUAL, "width": 1.5, "dash": "dot"},
    {"color": PREDICTED, "width": 1.5, "dash": "dash"},
    {"color": PREDICTED, "width": 1.5, "dash": "dashdot"},
)


def signals_figure(recording: Recording) -> Figure | None:
    """Every recorded channel over time, a panel each; None where nothing was recorded."""
    channels = [
        (stream, channel)
        for stream in recording.streams.values()
        for channel in stream.channels.values()
        if len(stream.time) and channel.columns
    ]
    if not channels:
        return None
    lines = sum(min(MOST_COLUMNS, len(channel.columns)) for _, channel in channels)
    points = min(MOST_POINTS, max(200, PAGE_POINTS // lines))
    colours = _colours(recording)
    named: set[str] = set()
    rows = []
    for stream, channel in channels:
        pieces, time = _pieces(stream), _shown_time(recording, stream)
        traces = []
        shown = channel.columns[:MOST_COLUMNS]
        for column, values in zip(shown, channel.values.T, strict=False):
            x, y = broken_line([time[piece] for piece in pieces], [values[piece] for piece in pieces], points)
            traces.append(
                curve_trace(
                    x,
                    np.where(np.isfinite(y), y, np.nan),
                    {"color": colours[column], "width": 1.3},
                    "%{y:.4g}",
                    name=plain(shortened(column, 24)),
                    legendgroup=plain(column),
                    showlegend=column not in named,
                )
            )
            named.add(column)
        label = f"{stream.name}/{channel.quantity}"
        unit = f" [{plain(shown_unit(channel.unit))}]" if channel.unit else ""
        shown_count = f" ({len(shown)} of {len(channel.columns)} columns)" if len(shown) < len(channel.columns) else ""
        heading = f"{bold(label, 34)}{unit}{shown_count}"
        rows.append([Panel(label, heading, traces, x=TIME_AXIS, y={"zeroline": False}, height=SIGNAL_PANEL)])
    caption = (
        f"As recorded, not filtered. Each line has at most about {points} points, the least and the largest value of "
        "every interval, which keeps all peaks; it breaks at gaps. Drag to zoom, double-click to reset."
    )
    return panel_figure("signals-plot", rows, caption, linked=True, hovermode="x unified")


def intervals_figure(recording: Recording, streams: Mapping[str, StreamQuality]) -> Figure | None:
    """Time between two stamps of each stream over the recording; None where there are no two stamps."""
    rows = []
    for name, quality in streams.items():
        stream = recording.streams[name]
        intervals = 1e3 * np.diff(stream.time)
        if not np.isfinite(quality.rate_hz) or not np.any(intervals > 0):
            continue
        kept = envelope_indices(np.where(intervals > 0, intervals, np.nan), MOST_POINTS)
        period = 1e3 / quality.rate_hz
        lines: list[dict[str, Any]] = [
            points_trace(
                _shown_time(recording, stream)[1:][kept],
                np.where(intervals > 0, intervals, np.nan)[kept],
                {"size": 4, "color": SERIES_COLOURS[0]},
                "%{y:.4g} ms",
                name=plain(name),
            )
        ]
        low, high = 0.5 * min(period, float(intervals[intervals > 0].min())), 2 * max(quality.longest_ms, 2 * period)
        rows.append(
            [
                Panel(
                    name,
                    f"{bold(name, 20)}: {number(quality.rate_hz, 4)} Hz, {_lost(quality)}",
                    lines,
                    x=TIME_AXIS,
                    y={**LOG_AXIS, "title": {"text": "ms"}, "range": [np.log10(low), np.log10(high)]},
                    horizontal=[(LOST_FROM * period, {"color": PREDICTED, "width": 1, "dash": "dash"})],
                    height=INTERVAL_PANEL,
                )
            ]
        )
    if not rows:
        return None
    caption = (
        f"Interval between a stamp and the one before, on a logarithmic scale. Above the dashed line, {LOST_FROM:g} "
        "periods, samples are missing. Stamps that do not increase are not shown."
    )
    return panel_figure("intervals-plot", rows, caption, linked=True, showlegend=False)


def spectra_figure(motion: RecordedMotion) -> Figure:
    """Amplitude spectral density of positions and torques with the cut-offs that identification would choose."""
    cutoffs = motion.prepared.cutoffs
    names, time = motion.positions.joint_names, motion.positions.time
    position_lines = [(cutoffs.band, BAND), (cutoffs.position, POSITION_CUTOFF)]
    torque_lines = [(cutoffs.band, BAND), (cutoffs.torque, TORQUE_CUTOFF)]
    travel, torque = (common_unit(unit, motion.model.sliding) for unit in ("rad", "N·m"))
    rows = [[_spectrum_panel("position", travel, names, time, motion.positions.position, position_lines)]]
    if motion.measured is not None:
        rows.append([_spectrum_panel("torque", torque, names, time, motion.measured.torque, torque_lines)])
    caption = (
        "Amplitude spectral density (Welch, of the longest segment without a gap) as recorded. Dotted: band of the "
        f"motion, {number(cutoffs.band, 3)} Hz. Dash-dotted: cut-off of the positions, {number(cutoffs.position, 3)} "
        f"Hz. Dashed: cut-off of the parallel filter over τ and W, {number(cutoffs.torque, 3)} Hz. These are chosen "
        "from the motion; --position-cutoff and --torque-cutoff of dynid identify change them."
    )
    return panel_figure("spectra-plot", rows, caption)


def _spectrum_panel(
    quantity: str, unit: str, names: Sequence[str], time: FloatArray, values: FloatArray, lines: Sequence[Line]
) -> Panel:
    frequency, density = _density(time, values)
    traces = [
        curve_trace(
            frequency,
            np.where(row > 0, row, np.nan),
            {"color": SERIES_COLOURS[index % len(SERIES_COLOURS)], "width": 1.2},
            f"%{{x:.3g}} Hz: %{{y:.3g}} {unit}/√Hz",
            name=plain(shortened(name, 24)),
            legendgroup=plain(name),
            showlegend=quantity == "position",
        )
        for index, (name, row) in enumerate(zip(names, density, strict=True))
    ]
    return Panel(
        f"{quantity} [{unit}/√Hz]",
        f"<b>{quantity}</b> [{unit}/√Hz]",
        traces,
        x={**LOG_AXIS, "nticks": 6, "title": {"text": "frequency [Hz]"}},
        y={**LOG_AXIS, "automargin": True},
        vertical=[(at, line) for at, line in lines if at > 0],
        height=SPECTRUM_PANEL,
    )


def _density(time: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Frequencies (K,) [Hz] above 0 and amplitude spectral densities (n, K) of `values` (N, n)."""
    from scipy.signal import detrend, welch

    rising = np.concatenate([[True], np.diff(time) > 0])
    time, values = time[rising], values[rising]
    period = float(np.median(np.diff(time)))
    longest = max(gap_free_segments(time, period), key=lambda segment: segment.stop - segment.start)
    samples = longest.stop - longest.start
    length = min(samples, max(16, round(SPECTRUM_SECONDS / period)))
    frequency, power = welch(detrend(values[longest].T), fs=1.0 / period, nperseg=length)
    kept = envelope_indices(power.max(axis=0)[1:], MOST_POINTS) + 1
    return np.asarray(frequency[kept]), np.asarray(np.sqrt(power[:, kept]))


def _colours(recording: Recording) -> dict[str, str]:
    """A colour per column name, the same in all panels."""
    names = dict.fromkeys(
        column
        for stream in recording.streams.values()
        for channel in stream.channels.values()
        for column in channel.columns
    )
    return {name: SERIES_COLOURS[index % len(SERIES_COLOURS)] for index, name in enumerate(names)}


def _shown_time(recording: Recording, stream: Stream) -> FloatArray:
    """Stamps [s] from the recording's first sample: the host's clock places the streams, each keeps its own pace."""
    begin = min(float(stream.host_time[0]) for stream in recording.streams.values() if len(stream.host_time))
    return np.asarray(stream.time - stream.time[0] + (stream.host_time[0] - begin))


def _pieces(stream: Stream) -> tuple[slice, ...]:
    """The gap-free segments of a stream."""
    steps = np.diff(stream.time)
    forward = steps[steps > 0]
    return gap_free_segments(stream.time, float(np.median(forward))) if len(forward) else (slice(None),)


def _lost(quality: StreamQuality) -> str:
    if not quality.lost:
        return "no gap"
    return f"{quality.lost} lost in {counted(len(quality.gaps), 'gap')}"


MOST_GAPS = 50
"""Gaps in the page's table; a recording that lost samples all the time has thousands."""


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
