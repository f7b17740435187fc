"""The report page: its sections in order, rendered into one self-contained file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from daq.output_files import REPORT_FILE, RESULT_FILE, save_folder
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
from ident.result.result_file import result_json

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


def write_result_folder(folder: Path, data: ReportData, *, overwrite: bool = False) -> None:
    """Write result.json and report.html into a folder: both or neither.

    Raises:
        UsageError: they exist already and may not be overwritten, it is a file, or cannot be written.
        DiskError: the disk is full or fails.
    """
    texts = {RESULT_FILE: result_json(data.result) + "\n", REPORT_FILE: render_report(data)}
    save_folder(folder, texts, overwrite=overwrite)


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
