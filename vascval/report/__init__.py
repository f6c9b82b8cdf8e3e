"""Figures and the self-contained HTML report."""

from vascval.report.write import write_analysis_report, write_compare_report

__all__ = ["write_analysis_report", "write_compare_report"]
