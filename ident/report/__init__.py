"""The HTML report: one self-contained file, a list of small sections (see `ident.report.page` for their order)."""

from ident.report.page import render_report
from ident.report.recorded_runs import RecordedRuns, recorded_runs
from ident.report.section import ReportData, TruthTable

__all__ = ["RecordedRuns", "ReportData", "TruthTable", "recorded_runs", "render_report"]
