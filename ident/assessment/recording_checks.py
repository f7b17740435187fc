"""Checks of a recording without identification: its end, import, time stamps, clipped signals, outliers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from daq.recording.recording import Recording
from daq.recording.signal_quality import ColumnQuality, channel_quality
from daq.recording.stream_quality import StreamQuality, stream_quality
from drivers.percentage import percent_text, percentage_text
from ident.assessment.time_axis import time_axis_checks
from ident.verdict.catalogue import raised
from ident.verdict.check import Check

MOTOR_SIGNALS = ("current", "voltage", "torque")

JITTER_SHARE = 0.2
"""Jitter beyond this share of the period makes the velocity of a steadily moving joint wrong by as much."""

CLIPPED_PERCENT = 0.1
"""Share of clipped samples [%] beyond which clipping is reported."""

IMPORT = "import"
"""Source of the events that importers write."""


def stream_qualities(recording: Recording) -> dict[str, StreamQuality]:
    """Evenness of each stream's clock, by its name."""
    return {name: stream_quality(stream.time) for name, stream in recording.streams.items()}


def column_qualities(
    recording: Recording, quantities: tuple[str, ...] | None = None
) -> dict[tuple[str, str], tuple[ColumnQuality, ...]]:
    """Figures of all columns, by stream and quantity; of some quantities only where they are named."""
    return {
        (name, quantity): channel_quality(channel, stream.time)
        for name, stream in recording.streams.items()
        for quantity, channel in stream.channels.items()
        if quantities is None or quantity in quantities
    }


def closing_checks(recording: Recording) -> list[Check]:
    """Whether the recording's writer closed it."""
    if recording.complete:
        return []
    return [raised("recording-not-closed", f"{recording.label} was not closed properly: its end may be missing")]


def recording_checks(
    recording: Recording,
    streams: Mapping[str, StreamQuality] | None = None,
    columns: Mapping[tuple[str, str], tuple[ColumnQuality, ...]] | None = None,
    label: str = "",
) -> list[Check]:
    """Properties of a recording.

    Args:
        recording: as read.
        streams: its `stream_qualities`, where they are known already.
        columns: its `column_qualities`, where they are known already.
        label: names the recording among several.
    """
    streams = stream_qualities(recording) if streams is None else streams
    columns = column_qualities(recording, ("position", *MOTOR_SIGNALS)) if columns is None else columns
    of = f"{label}: " if label else ""
    checks = closing_checks(recording)
    for event in recording.events:
        if event.source == IMPORT and event.level == "warning":
            checks.append(raised("import-warning", f"{of}import: {event.message}"))
    for name, quality in streams.items():
        if quality.lost:
            share = quality.lost / (quality.samples + quality.lost)
            text = f"{of}{name}: {quality.lost} samples lost ({percent_text(share, 2)}) in {len(quality.gaps)} gaps"
            checks.append(raised("samples-lost", text))
        if quality.duplicates:
            checks.append(raised("repeated-stamps", f"{of}{name}: {quality.duplicates} stamps do not increase"))
        if quality.jitter_ms * quality.rate_hz > JITTER_SHARE * 1e3:
            period = 1e3 / quality.rate_hz
            text = f"{of}{name}: stamps jitter by {quality.jitter_ms:.2g} ms at a period of {period:.2g} ms"
            checks.append(raised("jittering-stamps", text))
    checks += time_axis_checks(recording, of)
    for (stream, quantity), qualities in columns.items():
        clipped = [column for column in qualities if column.clipped_percent > CLIPPED_PERCENT]
        if quantity in MOTOR_SIGNALS and clipped:
            figures = ", ".join(f"{column.name} {percentage_text(column.clipped_percent, 2)} %" for column in clipped)
            text = f"{of}{stream}/{quantity} is clipped: {figures} of the samples; use a slower motion or a wider range"
            checks.append(raised("signal-clipped", text, [column.name for column in clipped]))
        if quantity in ("position", *MOTOR_SIGNALS):
            checks += _outlier_checks(f"{of}{stream}/{quantity}", qualities)
    return checks


def _outlier_checks(signal: str, columns: Sequence[ColumnQuality]) -> list[Check]:
    """Single wrong samples of a signal: those that are replaced, and columns with too many of them."""
    few = [column for column in columns if column.outliers and not column.outliers_stay]
    many = [column for column in columns if column.outliers_stay]
    checks = []
    if few:
        counts = ", ".join(f"{column.name} {column.outliers}" for column in few)
        text = (
            f"{signal}: single samples are far from what their neighbours say ({counts}) and are replaced by that: "
            "see the encoder, its cable and the bus"
        )
        checks.append(raised("outliers-replaced", text, [column.name for column in few]))
    if many:
        counts = ", ".join(f"{column.name} {column.outliers}" for column in many)
        text = (
            f"{signal}: single samples are far from what their neighbours say, and too many ({counts}) to be replaced: "
            "the fit uses them as they are; find what disturbs the signal and record again"
        )
        checks.append(raised("many-outliers", text, [column.name for column in many]))
    return checks
