"""Figures and documents of a verdict."""

from threadline.report.proof import about, write_comparison, write_report

__all__ = ["about", "write_comparison", "write_report"]
