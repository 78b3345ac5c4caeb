"""Arcs and splines of part programs (G2, G3, G5), divided into chords with exact positions.

A chord leaves its curve by at most 2 um, grbl's default for arcs (setting $12, 0.002 mm).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

from threadline.errors import JobError, Place
from threadline.jobs.gcode.block import Block
from threadline.jobs.gcode.dialects import Reading
from threadline.jobs.gcode.grammar import Grammar
from threadline.jobs.gcode.words import ONE

TOLERANCE_MM = 0.002
MOST_CHORDS = 100_000
_CLOSE_MM, _OFF_MM, _OFF_SHARE = 0.005, 0.5, 0.001

_NO_SWEEP = 1e-12
_SHORT_SWEEP = 2e-6
"""Sweep in rad below which a control may take an arc for a full circle; grbl does below 5e-7."""
_SINGLE = 6e-8
"""Relative rounding error of a number in single precision."""

Point = tuple[float, float]


class Circle(NamedTuple):
    """Start, end and centre of an arc in mm, and the grammar of its control."""

    start: Point
    end: Point
    centre: Point
    grammar: Grammar

    def noise(self) -> float:
        """Return the rounding error of the control's sweep, in rad."""
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
        Radius in mm, with the sign of the word R.
    at
        Place of the block, for errors.

    Raises
    ------
    JobError
        If no circle of this radius goes through both points, or the points are equal.
    """
    u, v = end[0] - start[0], end[1] - start[1]
    chord_mm = math.hypot(u, v)
    if chord_mm == 0.0:
        raise JobError(
            "an arc with R ends where it begins: its centre may be anywhere",
            place=at,
            remedy="Give the centre of a full circle with I, J or K.",
        )
    if not chord_mm <= 2.0 * abs(radius) * (1.0 + 1e-6):
        raise JobError(
            f"no circle of R {radius:.6g} mm goes through points {chord_mm:.6g} mm apart",
            place=at,
            remedy="Correct R, or the end of the arc.",
        )
    apothem_mm = math.sqrt(max(0.0, radius**2 - chord_mm**2 / 4.0))
    side = -1.0 if clockwise == (radius > 0) else 1.0
    return (
        start[0] + u / 2.0 - side * apothem_mm * v / chord_mm,
        start[1] + v / 2.0 + side * apothem_mm * u / chord_mm,
    )


def check_centre(start: Point, end: Point, centre: Point, at: Place) -> None:
    """Refuse a centre whose distances from start and end differ by more than grbl tolerates.

    Raises
    ------
    JobError
        If the radii differ by more than 0.5 mm, or by more than both 0.005 mm and 0.1 %, or
        the first radius is 0.
    """
    start_radius_mm, end_radius_mm = math.dist(start, centre), math.dist(end, centre)
    difference_mm = abs(start_radius_mm - end_radius_mm)
    if (
        start_radius_mm == 0.0
        or difference_mm > _OFF_MM
        or (difference_mm > _CLOSE_MM and difference_mm > _OFF_SHARE * start_radius_mm)
    ):
        raise JobError(
            f"the arc begins {start_radius_mm:.6g} mm from its centre and ends "
            f"{end_radius_mm:.6g} mm from it",
            place=at,
            remedy="Correct I, J, K or the end of the arc.",
        )


def arc(
    circle: Circle, clockwise: bool, turns: int, at: Place
) -> Iterator[tuple[float, float, float]]:
    """Yield the end of each chord of an arc except the last: share of the arc, x and y in mm.

    An arc that ends where it begins is a full circle. The radius changes evenly from the start
    radius to the end radius; with ``round_arcs`` the start radius holds up to the last chord.
    ``turns`` is the number of turns; the last turn may be a partial turn.

    Raises
    ------
    JobError
        If the arc takes more than ``MOST_CHORDS`` chords, or is so short that the control may run
        a full circle.
    """
    start, end, centre, grammar = circle
    start_radius_mm, end_radius_mm = math.dist(start, centre), math.dist(end, centre)
    start_angle_rad = math.atan2(start[1] - centre[1], start[0] - centre[0])
    sweep = math.atan2(end[1] - centre[1], end[0] - centre[0]) - start_angle_rad
    full_turn = 2.0 * math.pi
    if clockwise:
        sweep = -sweep
    sweep = sweep % full_turn
    noise = circle.noise()
    if start == end or (sweep < _NO_SWEEP and not grammar.exact_circles):
        sweep = full_turn
    elif sweep < max(_SHORT_SWEEP, noise) or full_turn - sweep < noise:
        raise JobError(
            f"the arc turns by {sweep:.3g} rad: the control rounds, and may take it for a full "
            f"circle of radius {start_radius_mm:.6g} mm, or for none",
            place=at,
            remedy="Write a short arc as G1, and a full circle with an end that is its start.",
        )
    sweep += full_turn * (turns - 1)
    larger_radius_mm = max(start_radius_mm, end_radius_mm)
    chord_angle_rad = (
        2.0 * math.acos(max(0.0, 1.0 - TOLERANCE_MM / larger_radius_mm))
        if larger_radius_mm > TOLERANCE_MM
        else 1.0
    )
    chord_count = math.ceil(sweep / chord_angle_rad)
    _check(chord_count, at)
    sign = -1.0 if clockwise else 1.0
    for k in range(1, chord_count):
        share = k / chord_count
        angle = start_angle_rad + sign * sweep * share
        radius_mm = (
            start_radius_mm
            if grammar.round_arcs
            else start_radius_mm + (end_radius_mm - start_radius_mm) * share
        )
        yield (
            share,
            centre[0] + radius_mm * math.cos(angle),
            centre[1] + radius_mm * math.sin(angle),
        )


def spline(
    start: Point, first: Point, second: Point, end: Point, at: Place
) -> Iterator[tuple[float, float, float]]:
    """Yield the end of each chord of a cubic Bezier curve except the last: parameter, x, y in mm.

    A chord over a step h leaves the curve by at most h^2 max|f''| / 8. f'' is linear, so its
    maximum lies at an end.

    Raises
    ------
    JobError
        If the spline takes more than ``MOST_CHORDS`` chords.
    """
    second_derivative_mm = max(
        math.hypot(*(6.0 * (a - 2.0 * b + c) for a, b, c in zip(*control_points, strict=True)))
        for control_points in ((start, first, second), (first, second, end))
    )
    chord_count = max(1, math.ceil(math.sqrt(second_derivative_mm / (8.0 * TOLERANCE_MM))))
    _check(chord_count, at)
    for k in range(1, chord_count):
        t = k / chord_count
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


CURVED = (2, 3, 5)
_PLANES = {170: ("X", "Y", "I", "J"), 180: ("Z", "X", "K", "I"), 190: ("Y", "Z", "J", "K")}
_MOST_TURNS = 10_000


class Curves:
    """The arc plane and the last spline control point while a program is read.

    Parameters
    ----------
    reading
        Axes and file of the program.
    linear
        (axes,) whether each axis is linear.

    Attributes
    ----------
    plane
        Ten times the number of G17, G18 or G19.
    """

    def __init__(self, reading: Reading, linear: tuple[bool, ...]) -> None:
        self._reading = reading
        self._linear = linear
        self._letters = {index: name for name, index in reading.axes.items()}
        self._last_control: tuple[tuple[int, ...], tuple[float, float]] | None = None
        self.plane = 170

    def points(
        self,
        motion: int,
        block: Block,
        before: tuple[int, ...],
        after: tuple[int, ...],
        tenth_mm: int,
    ) -> Iterator[tuple[int, ...]]:
        """Return the exact (axes,) ends of all chords except the last.

        Parameters
        ----------
        motion
            Number of the G word: 2, 3 or 5.
        block
            Block with the words of the curve.
        before, after
            Exact positions at the beginning and at the end of the curve.
        tenth_mm
            Unit of length of the words, in tenths of a millimetre.

        Raises
        ------
        JobError
            If the words define no curve, or the machine has no such axis, or the axis is rotary.
        """
        at = Place(self._reading.file, block.line)
        if motion == 5 and self.plane != 170:
            raise JobError("G5 is a curve of X and Y", place=at, remedy="Write G17 before it.")
        letter_u, letter_v, centre_u, centre_v = _PLANES[self.plane]
        u, v = (self._axis(name, motion, at) for name in (letter_u, letter_v))
        words = {letter: value * tenth_mm / (10 * ONE) for letter, value in block.curve}
        start, end = (
            (before[u] / ONE, before[v] / ONE),
            (after[u] / ONE, after[v] / ONE),
        )
        p = None if block.p is None else block.p
        if motion == 5:
            chord_ends = self._spline(words, p, tenth_mm, before, after, (start, end), at)
        else:
            allowed = {centre_u, centre_v, "R"}
            if self._reading.dialect.grammar.idle_centre:
                words = {
                    letter: value for letter, value in words.items() if value or letter in allowed
                }
            useless_letters = [letter for letter in words if letter not in allowed]
            if useless_letters:
                raise JobError(
                    f"{useless_letters[0]} has no use in an arc of {letter_u} and {letter_v}",
                    place=at,
                    remedy=f"Its centre is {centre_u} {centre_v}; "
                    "G17 G18 G19 choose another plane.",
                )
            dialect = self._reading.dialect
            if p is not None and not dialect.grammar.turns:
                raise JobError(
                    f"P of an arc is not a number of turns for {dialect.name}, which refuses it or "
                    "passes over it",
                    place=at,
                    remedy="Take P out, or write one arc for each turn.",
                )
            if dialect.grammar.arc_ends and not {u, v} & {index for index, _ in block.axes}:
                raise JobError(
                    f"{dialect.name} takes no arc without an axis word of {letter_u} or {letter_v}",
                    place=at,
                    remedy=f"Write its end, too, like {letter_u} and {letter_v}.",
                )
            turns = 1 if p is None else p // ONE
            if p is not None and (p % ONE or not 1 <= turns <= _MOST_TURNS):
                raise JobError(
                    f"P {p / ONE:g} of an arc is its turns, a whole number from 1 to {_MOST_TURNS}",
                    place=at,
                    remedy="Correct it.",
                )
            if "R" in words:
                if len(words) > 1:
                    raise JobError(
                        "an arc has R or a centre", place=at, remedy="Take one of them out."
                    )
                centre = centre_by_radius(start, end, words["R"], motion == 2, at)
            elif words:
                centre = (
                    start[0] + words.get(centre_u, 0.0),
                    start[1] + words.get(centre_v, 0.0),
                )
            else:
                raise JobError(
                    f"an arc without {centre_u}, {centre_v} or R has no centre",
                    place=at,
                    remedy="Give the centre from the start of the arc, or the radius.",
                )
            check_centre(start, end, centre, at)
            chord_ends = arc(Circle(start, end, centre, dialect.grammar), motion == 2, turns, at)
        for share, x, y in chord_ends:
            point = [a + round(share * (b - a)) for a, b in zip(before, after, strict=True)]
            point[u], point[v] = round(x * _FINE) * _STEP, round(y * _FINE) * _STEP
            yield tuple(point)

    def _axis(self, name: str, motion: int, at: Place) -> int:
        index = self._reading.axes.get(name)
        if index is None or not self._linear[index]:
            what = "turns" if index is not None else f"is not one of {self._reading.machine!r}"
            raise JobError(
                f"G{motion} bends the axis {name}, which {what}",
                place=at,
                remedy="Choose a plane of linear axes with G17, G18 or G19.",
            )
        return index

    def _spline(
        self,
        words: dict[str, float],
        p: int | None,
        tenth_mm: int,
        before: tuple[int, ...],
        after: tuple[int, ...],
        ends: tuple[tuple[float, float], tuple[float, float]],
        at: Place,
    ) -> Iterator[tuple[float, float, float]]:
        """Return the chords of G5; without I and J they continue the last G5's spline."""
        useless_letters = [letter for letter in words if letter not in "IJQ"]
        if useless_letters or p is None or "Q" not in words or ("I" in words) != ("J" in words):
            raise JobError(
                "G5 needs P and Q, and both of I and J or none",
                place=at,
                remedy="P Q lead from the end to its control point, I J from the start to its own.",
            )
        start, end = ends
        end_control = p * tenth_mm / (10 * ONE), words["Q"]
        if "I" in words:
            start_control = words["I"], words["J"]
        elif self._last_control is not None and self._last_control[0] == before:
            last_end_control = self._last_control[1]
            start_control = -last_end_control[0], -last_end_control[1]
        else:
            raise JobError(
                "the first G5 of a curve needs I and J", place=at, remedy="Give I and J."
            )
        self._last_control = after, end_control
        return spline(
            start,
            (start[0] + start_control[0], start[1] + start_control[1]),
            (end[0] + end_control[0], end[1] + end_control[1]),
            end,
            at,
        )


_FINE = 10**9  # chord ends are rounded to this fraction of a millimetre
_STEP = ONE // _FINE
