"""A drawn line, with its points by the length along it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray
from threadline.drawing.arclength import ArcTable


@dataclass(frozen=True, slots=True, eq=False)
class DrawnLine:
    """A contour of a drawing.

    Parameters
    ----------
    table
        The curve.
    closed
        Whether it ends where it begins; lengths are then modulo its own.
    """

    table: ArcTable
    closed: bool

    def points(self, at_m: FloatArray) -> FloatArray:
        """Return the (n, 2) points at lengths along the line, m."""
        return self.table.points(np.mod(at_m, self.table.length_m) if self.closed else at_m)
