"""Exact extremes of many polynomial pieces; only pieces that can contain one are solved.

The planner checks its limits with it and the judge measures with it: it is pure mathematics of
pieces and knows neither limits nor criteria. Tests compare both with dense sampling.

Polynomials are (order, n) arrays, one row per power of u in [0, 1]: numpy is several times faster
on long rows than on many short ones.
"""

from __future__ import annotations

from functools import cache
from math import comb

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.motion.timing.types import TrajectoryBlock

_ROUNDED = 1.0 + 1e-12
"""Relative margin on a bound, which is rounded otherwise than the value that it bounds."""
_TURNED = 1e-12
"""Share of a velocity's largest coefficient below which a reverse motion is rounding."""
_NOTHING = 1e-14  # relative: smaller leading coefficients would spoil the roots


def derivatives(block: TrajectoryBlock, column: int, highest: int) -> list[FloatArray]:
    """Return the (order, n) polynomials of one axis' time derivatives 0 to ``highest``."""
    polynomials = [np.ascontiguousarray(block.coefficients[:, :, column].T)]
    rate = 1.0 / block.duration_s
    for _ in range(highest):
        previous = polynomials[-1]
        powers = np.arange(1.0, len(previous))[:, None]
        polynomials.append(
            previous[1:] * powers * rate if len(previous) > 1 else np.zeros_like(previous)
        )
    return polynomials


def hull_of(poly: FloatArray) -> FloatArray:
    """Return the Bernstein coefficients of (order, n) polynomials, which enclose them."""
    return _bernstein(len(poly)) @ poly


@cache
def _bernstein(order: int) -> FloatArray:
    """Return the (order, order) change to the Bernstein basis, whose hull encloses a polynomial."""
    return np.array([[comb(i, k) / comb(order - 1, k) for k in range(order)] for i in range(order)])


def highest(poly: FloatArray, above: float) -> tuple[float, int, float] | None:
    """Return the highest value of (order, n) polynomials on [0, 1], its piece and its place.

    None if no piece exceeds ``above``. Pieces are solved in the order of their bounds, until no
    bound exceeds the highest value found.
    """
    ends = np.maximum(poly[0], poly.sum(axis=0))
    highest_end = int(np.argmax(ends))
    best: tuple[float, int, float] | None = None
    if ends[highest_end] > above:
        above = float(ends[highest_end])
        best = (above, highest_end, 0.0 if poly[0, highest_end] >= above else 1.0)
    bounds = hull_of(poly).max(axis=0)
    candidates = np.flatnonzero(bounds > above)
    for piece in candidates[np.argsort(-bounds[candidates], kind="stable")].tolist():
        if bounds[piece] <= above:
            break
        value, where = _highest_of(poly[:, piece])
        if value > above:
            above, best = value, (value, piece, where)
    return best


def farthest(poly: FloatArray, above: float) -> tuple[float, int, float] | None:
    """Return the largest absolute value of polynomials, in the form of ``highest``."""
    hull = hull_of(poly)
    above_hull, below_hull = float(hull.max()), -float(hull.min())
    top = None if above_hull * _ROUNDED <= above else highest(poly, above)
    largest = above if top is None else top[0]
    bottom = None if below_hull * _ROUNDED <= largest else highest(-poly, largest)
    return top if bottom is None else bottom


def in_direction(
    velocity: FloatArray, push: FloatArray
) -> tuple[FloatArray, IntArray, FloatArray, FloatArray]:
    """Return accelerations in the direction of motion, on parts where the direction is constant.

    Parameters
    ----------
    velocity, push
        (order, n) polynomials of the velocities and accelerations of one axis.

    Returns
    -------
    tuple
        (order, m) polynomials over [0, 1] of each part, positive if the axis speeds up; the (m,)
        pieces of the parts, and where in these they begin and how wide they are.
    """
    hull = hull_of(velocity)
    rounding = _TURNED * np.abs(hull).max(axis=0)
    forward, backward = (hull >= -rounding).all(axis=0), (hull <= rounding).all(axis=0)
    sign = np.where(forward, 1.0, -1.0)
    single_direction = np.flatnonzero(forward | backward)
    parts = [push[:, single_direction] * sign[single_direction]]
    piece, begin, width = (
        [single_direction],
        [np.zeros(len(single_direction))],
        [np.ones(len(single_direction))],
    )
    for k in np.flatnonzero(~(forward | backward)).tolist():
        edges = np.array([0.0, *_turns(velocity[:, k]), 1.0])
        middles = 0.5 * (edges[1:] + edges[:-1])
        speed = np.polynomial.polynomial.polyval(middles, velocity[:, k])
        widths = np.diff(edges)
        parts.append(_parts(push[:, k], edges[:-1], widths) * np.sign(speed))
        piece.append(np.full(len(widths), k))
        begin.append(edges[:-1])
        width.append(widths)
    return (
        np.concatenate(parts, axis=1),
        np.concatenate(piece),
        np.concatenate(begin),
        np.concatenate(width),
    )


def _turns(poly: FloatArray) -> list[float]:
    """Return the places inside [0, 1] at which one polynomial may change its sign, in order."""
    leading = np.flatnonzero(np.abs(poly) > _NOTHING * np.abs(poly).max())[-1]
    roots = np.atleast_1d(np.roots(poly[leading::-1]))
    return sorted({float(root.real) for root in roots if 0.0 < root.real < 1.0})


def _parts(poly: FloatArray, begin: FloatArray, width: FloatArray) -> FloatArray:
    """Return (order, m) one polynomial on m parts, each over [0, 1]."""
    parts = np.zeros((len(poly), len(begin)))
    for power, factor in enumerate(poly.tolist()):
        for k in range(power + 1):
            parts[k] += factor * comb(power, k) * begin ** (power - k) * width**k
    return parts


def _highest_of(poly: FloatArray) -> tuple[float, float]:
    slope = poly[1:] * np.arange(1, len(poly))
    places = [0.0, 1.0]
    if slope.any():
        leading = np.flatnonzero(np.abs(slope) > _NOTHING * np.abs(slope).max())[-1]
        for root in np.atleast_1d(np.roots(slope[leading::-1])):
            # Extra candidates do no harm: rounding may have split a double root into a pair.
            if 0.0 < root.real < 1.0:
                places.append(float(root.real))
    values = np.polynomial.polynomial.polyval(np.array(places), poly)
    best_index = int(np.argmax(values))
    return float(values[best_index]), places[best_index]
