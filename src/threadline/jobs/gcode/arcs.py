"""Arcs and splines of part programs as chords: G2, G3 and G5.

A chord is at most 2 um away from its curve, the default of grbl's own arcs (setting $12, 0.002 mm).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

from threadline.errors import JobError, Place
from threadline.jobs.gcode.grammar import Grammar

TOLERANCE_MM = 0.002
MOST_CHORDS = 100_000
_CLOSE_MM, _OFF_MM, _OFF_SHARE = 0.005, 0.5, 0.001

_NO_SWEEP = 1e-12
_SHORT_SWEEP = 2e-6
"""Sweep in rad from which controls may take an arc for a full circle: grbl below 5e-7."""
_SINGLE = 6e-8
"""Share of a number to which single precision rounds it."""

Point = tuple[float, float]


class Circle(NamedTuple):
    """Start, end and centre of an arc in mm, and the control that goes along it."""

    start: Point
    end: Point
    centre: Point
    grammar: Grammar

    def noise(self) -> float:
        """Return by how much in rad the control may round the sweep."""
        radius = math.dist(self.start, self.centre)
        if not self.grammar.single or not radius:
            return 0.0
        return 8.0 * _SINGLE * max(abs(value) for point in self[:3] for value in point) / radius


def centre_by_radius(start: Point, end: Point, radius: float, clockwise: bool, at: Place) -> Point:
    """Return the centre of an arc in mm; a negative ``radius`` gives more than half a turn.

    Parameters
    ----------
    start, end
        Points in the plane of the arc, in mm.
    radius
        Radius in mm, as the word R gives it.
    at
        Place of the block, for errors.

    Raises
    ------
    JobError
        If no such circle goes through both points, or they are the same.
    """
    u, v = end[0] - start[0], end[1] - start[1]
    apart = math.hypot(u, v)
    if apart == 0.0:
        raise JobError(
            "an arc with R ends where it begins: its centre may be anywhere",
            place=at,
            remedy="Give the centre of a full circle with I, J or K.",
        )
    if not apart <= 2.0 * abs(radius) * (1.0 + 1e-6):
        raise JobError(
            f"no circle of R {radius:.6g} mm goes through points {apart:.6g} mm apart",
            place=at,
            remedy="Correct R, or the end of the arc.",
        )
    rise = math.sqrt(max(0.0, radius**2 - apart**2 / 4.0))
    side = -1.0 if clockwise == (radius > 0) else 1.0
    return (
        start[0] + u / 2.0 - side * rise * v / apart,
        start[1] + v / 2.0 + side * rise * u / apart,
    )


def check_centre(start: Point, end: Point, centre: Point, at: Place) -> None:
    """Refuse a centre with unequal distances from start and end, with the tolerances of grbl.

    Raises
    ------
    JobError
        If the radii differ by more than 0.5 mm, or by more than 0.005 mm and 0.1 %, or are 0.
    """
    first, last = math.dist(start, centre), math.dist(end, centre)
    off = abs(first - last)
    if first == 0.0 or off > _OFF_MM or (off > _CLOSE_MM and off > _OFF_SHARE * first):
        raise JobError(
            f"the arc begins {first:.6g} mm from its centre and ends {last:.6g} mm from it",
            place=at,
            remedy="Correct I, J, K or the end of the arc.",
        )


def arc(
    circle: Circle, clockwise: bool, turns: int, at: Place
) -> Iterator[tuple[float, float, float]]:
    """Yield the end of every chord of an arc but the last: share of the arc, x and y in mm.

    An arc that ends where it begins is a full circle. The radius changes evenly from that of the
    start to that of the end, or stays up to the last chord where the control keeps it. ``turns`` is
    the number of turns, the last of which may be a part.

    Raises
    ------
    JobError
        If it takes more than ``MOST_CHORDS``, or is so short that the control may go a full circle.
    """
    start, end, centre, grammar = circle
    first, last = math.dist(start, centre), math.dist(end, centre)
    begin = math.atan2(start[1] - centre[1], start[0] - centre[0])
    sweep = math.atan2(end[1] - centre[1], end[0] - centre[0]) - begin
    full = 2.0 * math.pi
    if clockwise:
        sweep = -sweep
    sweep = sweep % full
    noise = circle.noise()
    if start == end or (sweep < _NO_SWEEP and not grammar.exact_circles):
        sweep = full
    elif sweep < max(_SHORT_SWEEP, noise) or full - sweep < noise:
        raise JobError(
            f"the arc turns by {sweep:.3g} rad: the control rounds, and may take it for a full "
            f"circle of radius {first:.6g} mm, or for none",
            place=at,
            remedy="Write a short arc as G1, and a full circle with an end that is its start.",
        )
    sweep += full * (turns - 1)
    radius = max(first, last)
    bend = 2.0 * math.acos(max(0.0, 1.0 - TOLERANCE_MM / radius)) if radius > TOLERANCE_MM else 1.0
    count = math.ceil(sweep / bend)
    _check(count, at)
    sign = -1.0 if clockwise else 1.0
    for k in range(1, count):
        share = k / count
        angle = begin + sign * sweep * share
        r = first if grammar.round_arcs else first + (last - first) * share
        yield share, centre[0] + r * math.cos(angle), centre[1] + r * math.sin(angle)


def spline(
    start: Point, first: Point, second: Point, end: Point, at: Place
) -> Iterator[tuple[float, float, float]]:
    """Yield the end of every chord of a cubic Bezier curve but the last: parameter, x and y in mm.

    A chord over a step h is at most h^2 max|f''| / 8 away from the curve, and f'' lies between its
    values at the ends.

    Raises
    ------
    JobError
        If it takes more than ``MOST_CHORDS``.
    """
    bend = max(
        math.hypot(*(6.0 * (a - 2.0 * b + c) for a, b, c in zip(*three, strict=True)))
        for three in ((start, first, second), (first, second, end))
    )
    count = max(1, math.ceil(math.sqrt(bend / (8.0 * TOLERANCE_MM))))
    _check(count, at)
    for k in range(1, count):
        t = k / count
        weights = ((1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3)
        x, y = (
            sum(w * p[i] for w, p in zip(weights, (start, first, second, end), strict=True))
            for i in (0, 1)
        )
        yield t, x, y


def _check(count: int, at: Place) -> None:
    if count > MOST_CHORDS:
        raise JobError(
            f"the curve takes {count} chords of {TOLERANCE_MM} mm; at most {MOST_CHORDS} are made",
            place=at,
            remedy="Correct its size, or write it in parts.",
        )
