"""Torques of the data that the parameters were fitted to, and of data that the estimator never saw."""

from __future__ import annotations

from ident.report.figures.torque_figure import torque_figure
from ident.report.section import ReportData, ReportSection


def validation_section(data: ReportData) -> ReportSection:
    """Measured against predicted torque of the held-out data."""
    result = data.result
    source = result.validation_source or "held-out data"
    delivered = result.delivered
    errors = result.validation if delivered is None else delivered.validation_all_samples
    intro = f"Held out: {source}. These are the errors to believe, samples at rest included."
    if errors is not None and errors.held_out is False:
        intro = f"NOT held out: {source}. Samples of these data were used in the identification."
    context = {
        "intro": intro if data.validation else "",
        "figure": torque_figure("torques-validation-plot", result, data.worst_first, data.validation, errors),
        "empty": "Nothing was held out of the identification, so nothing here can say how far to trust the model. "
        "Record a second motion and name it with --validate.",
    }
    return ReportSection("Torques: validation", "torques-validation", "torques.html.j2", context)


def fit_section(data: ReportData) -> ReportSection:
    """Measured against predicted torque of the identification data."""
    context = {
        "intro": "The data that the parameters were fitted to: a small error here is necessary, not sufficient.",
        "figure": torque_figure("torques-fit-plot", data.result, data.worst_first, data.fit, data.result.fit),
        "empty": "No torques of the identification data were handed to this report.",
    }
    return ReportSection("Torques: fit", "torques-fit", "torques.html.j2", context)
