"""Embroidery designs: the readers of their formats, and the moves of the frame that they need."""

from threadline.jobs.embroidery.job import read_design
from threadline.jobs.embroidery.records import SUFFIXES

__all__ = ["SUFFIXES", "read_design"]
