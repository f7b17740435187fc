"""The report page: its sections in order, rendered into one self-contained file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ident.regression.comparison import TorqueSeries
from ident.report.html_file import page_templates, write_html
from ident.report.recorded_runs import RecordedRuns
from ident.report.section import ReportData, ReportSection, TruthTable
from ident.report.sections import (
    correlation,
    data_quality,
    excitation,
    friction,
    links,
    merge,
    motion,
    parameters,
    provenance,
    residuals,
    summary,
    torques_fit,
    torques_validation,
    truth,
)
from ident.result.schema import Result

SECTIONS: tuple[Callable[[ReportData], ReportSection | None], ...] = (
    summary.section,
    merge.section,
    torques_validation.section,
    torques_fit.section,
    residuals.section,
    friction.section,
    parameters.section,
    links.section,
    truth.section,
    correlation.section,
    excitation.section,
    motion.section,
    data_quality.section,
    provenance.section,
)
"""In the order of the page; a section that does not apply to this result returns None."""


def write_report(
    path: Path,
    result: Result,
    fit: tuple[TorqueSeries, ...],
    validation: tuple[TorqueSeries, ...],
    truth: TruthTable | None = None,
    recorded: RecordedRuns | None = None,
) -> None:
    """Write report.html.

    Args:
        path: of the file.
        result: what was identified.
        fit: measured and predicted torques of the identification data.
        validation: the same of held-out data; empty where there are none.
        truth: true base parameters of a simulated arm.
        recorded: motion and temperatures of the recordings; without them, the section on the motion is left out.

    Raises:
        UsageError: the file cannot be written.
    """
    write_html(path, render_report(ReportData(result, fit, validation, truth, recorded or RecordedRuns())))


def render_report(data: ReportData) -> str:
    """The page as text."""
    from markupsafe import Markup

    environment = page_templates()
    sections = [section for make in SECTIONS if (section := make(data)) is not None]
    rendered = [
        (section, Markup(environment.get_template(section.template).render(section.context))) for section in sections
    ]
    return environment.get_template("page.html.j2").render(result=data.result, sections=rendered)
