"""Torques of the data that the parameters were fitted to."""

from __future__ import annotations

from ident.report.figures.torque_figure import torque_figure
from ident.report.section import ReportData, ReportSection


def section(data: ReportData) -> ReportSection:
    """Measured against predicted torque of the identification data."""
    context = {
        "intro": "The data that the parameters were fitted to: a small error here is necessary, not sufficient.",
        "figure": torque_figure("torques-fit-plot", data.result, data.worst_first, data.fit, data.result.fit),
        "empty": "No torques of the identification data were handed to this report.",
    }
    return ReportSection("Torques: fit", "torques-fit", "torques.html.j2", context)
