"""Tables of a recording: its streams, columns and gaps, and the motion of its joints."""

from __future__ import annotations

from daq.recording.recording import JOINTS_STREAM
from drivers.streams import UNITS
from ident.checks.recording_check import RecordingInfo
from ident.result.tables import Column, Table, table_of_rows


def shown_unit(unit: str) -> str:
    """A recorded unit as people write it."""
    return "°C" if unit == UNITS["temperature"] else unit.replace("^2", "²").replace("*", "·")


def stream_table(info: RecordingInfo, file: str) -> Table:
    """A row per stream: samples, duration [s], rate [Hz], jitter [ms], samples lost, duplicate stamps."""
    columns = (
        Column("stream"),
        Column("samples"),
        Column("duration", unit="s"),
        Column("rate", unit="Hz"),
        Column("jitter", unit="ms", digits=3),
        Column("longest", unit="ms", label="longest interval", digits=3),
        Column("lost"),
        Column("duplicates"),
    )
    rows = [
        (name, q.samples, q.duration, q.rate_hz, q.jitter_ms, q.longest_ms, q.lost, q.duplicates)
        for name, q in info.streams.items()
    ]
    return table_of_rows(f"Streams of {file}", columns, rows)


def motion_table(info: RecordingInfo) -> Table:
    """A row per joint: range of positions, velocity reached, utilisation of its limit [%]; none without motion."""
    travel, speed = info.motion_units
    columns = (
        Column("joint"),
        Column("range", unit=travel, digits=3),
        Column("velocity", unit=speed, digits=3),
        Column("limit_utilisation", unit="%"),
    )
    reached = info.excitation
    if reached is None:
        return table_of_rows("Motion", columns, [])
    joints = info.recording.streams[JOINTS_STREAM].channels["position"].columns
    cells = (joints, reached.position_range, reached.velocity_reached, reached.velocity_share_percent)
    return table_of_rows("Motion", columns, list(zip(*cells, strict=False)))


def column_table(info: RecordingInfo) -> Table:
    """A row per recorded column: smallest and largest value, noise (σ), step, share clipped [%], outliers."""
    columns = (
        Column("column"),
        Column("signal"),
        Column("unit"),
        Column("smallest"),
        Column("largest"),
        Column("noise", label="noise (σ)", digits=3),
        Column("step", digits=3),
        Column("clipped", unit="%"),
        Column("outliers"),
    )
    rows = [
        (c.name, f"{stream}/{quantity}", unit, c.smallest, c.largest, c.noise, c.step, c.clipped_percent, c.outliers)
        for (stream, quantity), qualities in info.columns.items()
        for unit in (shown_unit(info.recording.streams[stream].channels[quantity].unit),)
        for c in qualities
    ]
    return table_of_rows("Columns", columns, rows)


def gap_table(info: RecordingInfo, most: int) -> Table:
    """A row per gap, the first ones: last stamp before it [s], duration [s], samples lost."""
    columns = (
        Column("stream"),
        Column("start", unit="s", label="last stamp before", digits=6),
        Column("duration", unit="s", digits=3),
        Column("lost", label="samples lost"),
    )
    gaps = [(name, gap.start, gap.duration, gap.lost) for name, q in info.streams.items() for gap in q.gaps]
    note = f"The first {most} of {len(gaps)}; all are in info.json." if len(gaps) > most else ""
    table = table_of_rows("Gaps", columns, gaps[:most])
    return Table(table.title, table.columns, note)
