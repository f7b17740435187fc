"""The HTML report: one self-contained file, a list of small sections (see `ident.report.page` for their order)."""

from ident.report.page import render_report, write_report
from ident.report.section import TruthTable

__all__ = ["TruthTable", "render_report", "write_report"]
