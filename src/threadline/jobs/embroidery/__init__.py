"""Embroidery designs: readers of their formats, and the moves of the frame for each design."""

from threadline.jobs.embroidery.job import DESIGN_OPTIONS, read_design
from threadline.jobs.embroidery.records import SUFFIXES

__all__ = ["DESIGN_OPTIONS", "SUFFIXES", "read_design"]
