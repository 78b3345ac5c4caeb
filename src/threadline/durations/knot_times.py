"""Time of the knot intervals of the 1994 controller's B-spline, from the feeds of its moves."""

from __future__ import annotations

import numpy as np

from threadline.arrays import FloatArray


def longest_demand_s(first: FloatArray, middle: FloatArray, last: FloatArray) -> float:
    """Return the time of an even knot interval, s, at which none of these is above its feed.

    Parameters
    ----------
    first, middle, last
        (n,) Bezier values of the time at the feed over each interval, s for an even one.

    Notes
    -----
    The velocity in an interval is a weighted mean of three successive differences of control points
    (with even knots the weights are (1-u)^2/2, -u^2+u+1/2, u^2/2). The same mean of the times that
    these differences take at their feeds is an upper bound of the time that the interval needs,
    whichever kind of feed it is. The bound is exact where the three differences have one direction.
    Its largest value is at an end of the interval or where its derivative is 0.
    """
    bend = first - 2.0 * middle + last
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.where(bend < 0, np.clip((first - middle) / bend, 0.0, 1.0), 0.0)
    longest = 0.0
    for at in (np.zeros_like(u), u, np.ones_like(u)):
        demand = (1 - at) ** 2 * first + 2.0 * at * (1 - at) * middle + at * at * last
        longest = max(longest, float(demand.max(initial=0.0)))
    return longest
