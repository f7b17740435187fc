"""Torques of data that the estimator never saw."""

from __future__ import annotations

from ident.report.figures.torque_figure import torque_figure
from ident.report.section import ReportData, ReportSection


def section(data: ReportData) -> ReportSection:
    """Measured against predicted torque of the held-out data."""
    result = data.result
    source = result.validation_source or "held-out data"
    context = {
        "intro": f"Held out: {source}. These are the errors to believe." if data.validation else "",
        "figure": torque_figure(
            "torques-validation-plot", result.joints, data.worst_first, data.validation, result.validation
        ),
        "empty": "Nothing was held out of the identification, so nothing here can say how far to trust the model. "
        "Record a second motion and name it with --validate.",
    }
    return ReportSection("Torques: validation", "torques-validation", "torques.html.j2", context)
