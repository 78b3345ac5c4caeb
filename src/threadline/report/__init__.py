"""Figures and documents of a verdict."""

from threadline.report.comparison import write_comparison
from threadline.report.proof import write_report
from threadline.report.switching import write_switching

__all__ = ["write_comparison", "write_report", "write_switching"]
