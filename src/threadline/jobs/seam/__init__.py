"""The reader of seams: it turns drawings and tables of points into jobs of one move per stitch."""

from threadline.jobs.seam.job import SUFFIXES, read_seam
from threadline.jobs.seam.settings import STITCHING_KEYS, Stitching

__all__ = ["STITCHING_KEYS", "SUFFIXES", "Stitching", "read_seam"]
