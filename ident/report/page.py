"""The page: its sections in order, rendered into one file that needs nothing else."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.errors import UsageError
from ident.comparison import TorqueSeries
from ident.report import number_text
from ident.report.section import ReportData, Section, TruthTable
from ident.report.sections import (
    data_quality,
    excitation,
    parameters,
    provenance,
    residuals,
    summary,
    torques_fit,
    torques_validation,
    truth,
)
from ident.result import Result, replace_file

if TYPE_CHECKING:
    from jinja2 import Environment

SECTIONS: tuple[Callable[[ReportData], Section | None], ...] = (
    summary.section,
    torques_validation.section,
    torques_fit.section,
    residuals.section,
    parameters.section,
    truth.section,
    excitation.section,
    data_quality.section,
    provenance.section,
)
"""In the order of the page; a section that has nothing to say for this result returns None."""


def write_report(
    path: Path,
    result: Result,
    fit: tuple[TorqueSeries, ...],
    validation: tuple[TorqueSeries, ...],
    truth: TruthTable | None = None,
) -> None:
    """Write report.html.

    Args:
        path: of the file.
        result: what was identified.
        fit: measured and predicted torques of the identification data.
        validation: the same of held-out data; empty where there are none.
        truth: true base parameters of a simulated arm.

    Raises:
        UsageError: the file cannot be written.
    """
    text = render_report(ReportData(result, fit, validation, truth))
    try:
        replace_file(path, text)
    except OSError as error:
        raise UsageError(
            f"cannot be written: {error.strerror}", where=str(path), hint="name a folder that exists and is yours"
        ) from error


def render_report(data: ReportData) -> str:
    """The page as text."""
    from markupsafe import Markup
    from plotly.offline import get_plotlyjs

    environment = _environment()
    sections = [found for make in SECTIONS if (found := make(data)) is not None]
    rendered = [(part, Markup(environment.get_template(part.template).render(part.context))) for part in sections]
    return environment.get_template("page.html.j2").render(
        result=data.result, sections=rendered, plotlyjs=Markup(get_plotlyjs())
    )


def _environment() -> Environment:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("ident.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals["dash"] = number_text.DASH
    for name in ("number", "percent", "whole", "with_error", "setting"):
        environment.filters[name] = getattr(number_text, name)
    return environment
