"""Quality of the recordings, and provenance of the result: recordings, versions, options, robot file."""

from __future__ import annotations

from typing import Any

from ident.report.section import ReportData, ReportSection
from ident.result.schema import Result


def data_quality_section(data: ReportData) -> ReportSection:
    """Recordings, their events, preprocessing, delay, drive gains."""
    context = {"result": data.result, "segments": {"identification": len(data.fit), "validation": len(data.validation)}}
    return ReportSection("Data quality", "data-quality", "data_quality.html.j2", context)


def section(data: ReportData) -> ReportSection:
    """Files with their hashes, software versions, options, the robot file."""
    context = {"result": data.result, "columns": _columns(data.result)}
    return ReportSection("Provenance", "provenance", "provenance.html.j2", context)


def _columns(result: Result) -> list[dict[str, Any]]:
    """Return which joint has which of the model's optional columns, in words."""
    options = result.model_options
    named = (
        ("motor inertia", options.motor_inertia),
        ("viscous friction", options.viscous),
        ("Coulomb friction", options.coulomb),
        ("offset", options.offset),
    )
    return [{"name": name, "joints": _which(result.joints, chosen)} for name, chosen in named]


def _which(joints: list[str], chosen: list[bool]) -> str:
    having = [name for name, has in zip(joints, chosen, strict=False) if has]
    if not having:
        return "no joint"
    return "every joint" if len(having) == len(joints) else ", ".join(having)
