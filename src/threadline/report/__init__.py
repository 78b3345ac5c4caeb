"""Figures and documents of a verdict."""

from threadline.report.comparison import write_comparison
from threadline.report.proof import write_report

__all__ = ["write_comparison", "write_report"]
