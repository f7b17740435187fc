"""The report page: its sections in order, rendered into one self-contained file."""

from __future__ import annotations

from collections.abc import Callable

from ident.report.html_file import page_templates
from ident.report.section import ReportData, ReportSection
from ident.report.sections import (
    convergence,
    correlation,
    friction,
    motion,
    parameters,
    provenance,
    residuals,
    summary,
    truth,
)

SECTIONS: tuple[Callable[[ReportData], ReportSection | None], ...] = (
    summary.section,
    summary.errors_section,
    summary.merge_section,
    residuals.validation_section,
    residuals.fit_section,
    residuals.section,
    convergence.section,
    friction.section,
    parameters.section,
    parameters.links_section,
    truth.section,
    correlation.section,
    motion.excitation_section,
    motion.section,
    provenance.data_quality_section,
    provenance.section,
)
"""Sections in the order of the page; one that does not apply to this result returns None."""


def render_report(data: ReportData) -> str:
    """The page as text."""
    from markupsafe import Markup

    environment = page_templates()
    sections = [section for make in SECTIONS if (section := make(data)) is not None]
    rendered = [
        (section, Markup(environment.get_template(section.template).render(section.context, unit=data.result.unit)))
        for section in sections
    ]
    return environment.get_template("page.html.j2").render(result=data.result, sections=rendered)
