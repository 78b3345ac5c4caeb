"""Embroidery designs: a stitch after the other, each where the needle enters the cloth."""

from threadline.jobs.embroidery.job import read_design
from threadline.jobs.embroidery.records import SUFFIXES

__all__ = ["SUFFIXES", "read_design"]
