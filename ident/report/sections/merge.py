"""The merged models, and whether they agree."""

from __future__ import annotations

from ident.report.section import ReportData, ReportSection
from ident.views.result_tables import merge_tables


def section(data: ReportData) -> ReportSection | None:
    """Models, test of their consistency, values that differ significantly; None where nothing was merged."""
    merge = data.result.merge
    if merge is None:
        return None
    models, contradictions = merge_tables(merge)
    context = {"models": models, "contradictions": contradictions, "consistency": merge.consistency}
    return ReportSection("Merged models", "merge", "merge.html.j2", context)
