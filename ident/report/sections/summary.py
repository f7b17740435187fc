"""The first screen: verdict, checks, and the torques, friction and parameters at a glance."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ident.assessment.validation import LOW_SPEED, Fit
from ident.report.figures.torque_figure import small_torque_figure
from ident.report.section import ReportData, ReportSection, Tile
from ident.report.sections.friction import small_friction_figure
from ident.report.sections.parameters import small_parameter_figure
from ident.result.delivered import DELIVERED_WORDS, delivered_parameters
from ident.result.schema import Result
from ident.verdict.check import PURPOSE_WORDS
from ident.views.number_text import DASH, number, percent, whole
from ident.views.result_tables import merge_tables


def section(data: ReportData) -> ReportSection:
    """Return what one looks at first, unfolded."""
    result = data.result
    held_out = bool(data.validation)
    errors = result.delivered.validation_all_samples if held_out else result.fit
    figures = [
        (
            f"Measured against predicted torque, {'held-out data' if held_out else 'data of the fit'}",
            "torques-validation" if held_out else "torques-fit",
            small_torque_figure("torques-glance", result, data.worst_first, data.validation or data.fit, errors),
        ),
        ("Friction over velocity", "friction", small_friction_figure("friction-glance", data)),
    ]
    context = {
        "verdict": result.verdict,
        "acceptance": result.acceptance,
        "purpose_words": PURPOSE_WORDS,
        "figures": [(title, anchor, figure) for title, anchor, figure in figures if figure is not None],
        "parameters": small_parameter_figure("parameters-glance", data),
    }
    return ReportSection("Summary", "summary", "summary.html.j2", context, folded=False)


def errors_section(data: ReportData) -> ReportSection:
    """Key figures, and the errors of each joint."""
    result = data.result
    context = {
        "tiles": _tiles(result),
        "rows": [_row(result, joint) for joint in data.worst_first],
        "low_speed": LOW_SPEED,
        "validated": result.validation is not None,
        "model": DELIVERED_WORDS[delivered_parameters(result.consistent)],
        "validation_source": result.validation_source,
        "essential": result.essential,
        "method": result.method,
    }
    return ReportSection("Errors", "errors", "errors.html.j2", context)


def _tiles(result: Result) -> list[Tile]:
    every, moving, fit = _fits(result)
    significant = sum(parameter.significant for parameter in result.base_parameters)
    return [
        Tile(
            "Validation error",
            percent(every.relative_error) if every else DASH,
            f"{percent(moving.relative_error)} in motion, {'held out' if moving.held_out else 'NOT held out'}"
            if moving
            else "nothing was held out",
        ),
        Tile("Fit error", percent(fit.relative_error), f"{whole(fit.samples)} samples")
        if fit
        else Tile("Models merged", str(len(result.merge.models)) if result.merge else DASH),
        Tile("Base parameters", str(len(result.base_parameters)), f"{significant} significant"),
        Tile("Condition of W", number(result.condition, 3), "not normalised"),
        Tile(
            "Equations", whole(result.residuals.rows), f"{whole(result.residuals.effective_rows)} effective independent"
        ),
    ]


def _row(result: Result, joint: int) -> dict[str, Any]:
    return {"joint": result.joints[joint], "sets": [_errors(fit, joint) for fit in _fits(result)]}


def _fits(result: Result) -> tuple[Fit | None, Fit | None, Fit | None]:
    """Errors of the delivered model: over all held-out samples, over those in motion, on the identification data."""
    return result.delivered.validation_all_samples, result.delivered.validation, result.delivered.fit


def _errors(fit: Fit | None, joint: int) -> list[float | None]:
    """Relative error [%], RMSE, at low speed, at high speed, largest error [N·m]."""
    if fit is None:
        return [None] * 5
    relative = _entry(fit.joint_relative_error, joint)
    columns = (fit.rmse, fit.low_speed_rmse, fit.high_speed_rmse, fit.max_error)
    return [None if relative is None else 100 * relative, *(_entry(column, joint) for column in columns)]


def _entry(values: Sequence[float | None], joint: int) -> float | None:
    return values[joint] if joint < len(values) else None


def merge_section(data: ReportData) -> ReportSection | None:
    """Models, test of their consistency, values that differ significantly; None where nothing was merged."""
    merge = data.result.merge
    if merge is None:
        return None
    models, contradictions = merge_tables(merge)
    context = {"models": models, "contradictions": contradictions, "consistency": merge.consistency}
    return ReportSection("Merged models", "merge", "merge.html.j2", context)
