"""Quality of the recordings, and their preprocessing."""

from __future__ import annotations

from ident.report.section import ReportData, ReportSection


def section(data: ReportData) -> ReportSection:
    """Recordings, their events, preprocessing, delay, drive gains."""
    result = data.result
    context = {
        "recordings": result.recordings,
        "segments": {"identification": len(data.fit), "validation": len(data.validation)},
        "steps": result.preprocessing,
        "delay": result.delay,
        "gains": result.drive_gains,
    }
    return ReportSection("Data quality", "data-quality", "data_quality.html.j2", context)
