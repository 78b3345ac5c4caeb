"""Seams: drawings and tables of points -> a job of one move a stitch."""

from threadline.jobs.seam.job import SUFFIXES, read_seam
from threadline.jobs.seam.settings import STITCHING_KEYS, Stitching

__all__ = ["STITCHING_KEYS", "SUFFIXES", "Stitching", "read_seam"]
