"""The merged models, and whether they agree."""

from __future__ import annotations

from ident.report.section import ReportData, ReportSection


def section(data: ReportData) -> ReportSection | None:
    """Models, test of their consistency, values that differ significantly; None where nothing was merged."""
    merge = data.result.merge
    if merge is None:
        return None
    context = {"models": merge.models, "consistency": merge.consistency}
    return ReportSection("Merged models", "merge", "merge.html.j2", context)
