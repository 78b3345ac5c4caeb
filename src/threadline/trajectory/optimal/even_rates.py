"""How fast each element can be gone through evenly."""

from __future__ import annotations

import numpy as np

from threadline.arrays import FloatArray
from threadline.trajectory.optimal.along_path import across
from threadline.trajectory.optimal.first_guess import even
from threadline.trajectory.optimal.motion_limits import Limits
from threadline.trajectory.optimal.path_elements import Elements


def top_of(elements: Elements, limits: Limits) -> FloatArray:
    """Return the (n,) largest u'^2 of feed, guards and what may be across the path."""
    along = limits.along
    if along is None or not np.isfinite(along.centripetal):
        return elements.top
    bent = across(elements.c[:, :, :-1] * along.radius_m)
    with np.errstate(divide="ignore"):
        return np.minimum(elements.top, along.centripetal / bent)


def evenly(elements: Elements, limits: Limits) -> FloatArray:
    """Return the (n,) largest x of each element that is within all limits while it is even."""
    at, of = elements, limits
    least, top = np.minimum(*of.sides), top_of(at, of)
    most = even(at.length, at.c, at.guard, of.velocity, least, of.jerk, of.demand, top)
    return np.asarray(most)
