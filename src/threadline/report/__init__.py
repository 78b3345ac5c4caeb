"""Reports of proofs, analyses, shapers and laws: figures, tables, HTML pages and PDF."""

from threadline.report.proof import about, write_comparison, write_report

__all__ = ["about", "write_comparison", "write_report"]
