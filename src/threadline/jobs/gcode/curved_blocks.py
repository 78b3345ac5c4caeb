"""Curved blocks of a part program (G2, G3, G5): their axes, and their chords in exact positions."""

from __future__ import annotations

from collections.abc import Iterator

from threadline.errors import JobError, Place
from threadline.jobs.gcode.arcs import Circle, arc, centre_by_radius, check_centre, spline
from threadline.jobs.gcode.block import Block
from threadline.jobs.gcode.dialects import Reading
from threadline.jobs.gcode.words import ONE

CURVED = (2, 3, 5)
_PLANES = {170: ("X", "Y", "I", "J"), 180: ("Z", "X", "K", "I"), 190: ("Y", "Z", "J", "K")}
_MOST_TURNS = 10_000


class Curves:
    """The plane of arcs and the last control point of splines, while a program is read.

    Parameters
    ----------
    reading
        Axes and file of the program.
    linear
        (axes,) whether an axis is linear.

    Attributes
    ----------
    plane
        Ten times 17, 18 or 19, for that G word.
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
        """Return the exact (axes,) ends of all chords but the last.

        Parameters
        ----------
        motion
            2, 3 or 5, for that G word.
        block
            The block.
        before, after
            Exact positions at the beginning and at the end of the curve.
        tenth_mm
            Unit of length of the words, in tenths of a millimetre.

        Raises
        ------
        JobError
            If the words give no curve, or an axis of it is rotary or not on the machine.
        """
        at = Place(self._reading.file, block.line)
        if motion == 5 and self.plane != 170:
            raise JobError("G5 is a curve of X and Y", place=at, remedy="Write G17 before it.")
        first, second, own_u, own_v = _PLANES[self.plane]
        u, v = (self._axis(name, motion, at) for name in (first, second))
        words = {letter: value * tenth_mm / (10 * ONE) for letter, value in block.curve}
        start, end = (
            (before[u] / ONE, before[v] / ONE),
            (after[u] / ONE, after[v] / ONE),
        )
        p = None if block.p is None else block.p
        if motion == 5:
            shares = self._spline(words, p, tenth_mm, before, after, (start, end), at)
        else:
            allowed = {own_u, own_v, "R"}
            wrong = [letter for letter in words if letter not in allowed]
            if wrong:
                raise JobError(
                    f"{wrong[0]} has no use in an arc of {first} and {second}",
                    place=at,
                    remedy=f"Its centre is {own_u} {own_v}; G17 G18 G19 choose another plane.",
                )
            dialect = self._reading.dialect
            if p is not None and not dialect.grammar.turns:
                raise JobError(
                    f"P of an arc is no number of turns for {dialect.name}, which refuses it or "
                    "passes over it",
                    place=at,
                    remedy="Take P out, or write one arc for each turn.",
                )
            if dialect.grammar.arc_ends and not {u, v} & {index for index, _ in block.axes}:
                raise JobError(
                    f"{dialect.name} takes no arc without an axis word of {first} or {second}",
                    place=at,
                    remedy=f"Write its end, too, like {first} and {second}.",
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
                centre = (start[0] + words.get(own_u, 0.0), start[1] + words.get(own_v, 0.0))
            else:
                raise JobError(
                    f"an arc without {own_u}, {own_v} or R has no centre",
                    place=at,
                    remedy="Give the centre from the start of the arc, or the radius.",
                )
            check_centre(start, end, centre, at)
            shares = arc(Circle(start, end, centre, dialect.grammar), motion == 2, turns, at)
        for share, x, y in shares:
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
        """Return the chords of G5; without I and J it continues the spline of the last G5."""
        wrong = [letter for letter in words if letter not in "IJQ"]
        if wrong or p is None or "Q" not in words or ("I" in words) != ("J" in words):
            raise JobError(
                "G5 needs P and Q, and both of I and J or none",
                place=at,
                remedy="P Q lead from the end to its control point, I J from the start to its own.",
            )
        start, end = ends
        away = p * tenth_mm / (10 * ONE), words["Q"]
        if "I" in words:
            lead = words["I"], words["J"]
        elif self._last_control is not None and self._last_control[0] == before:
            last = self._last_control[1]
            lead = -last[0], -last[1]
        else:
            raise JobError(
                "the first G5 of a curve needs I and J", place=at, remedy="Give I and J."
            )
        self._last_control = after, away
        return spline(
            start,
            (start[0] + lead[0], start[1] + lead[1]),
            (end[0] + away[0], end[1] + away[1]),
            end,
            at,
        )


_FINE = 10**9  # parts of a millimetre to which the ends of chords are rounded
_STEP = ONE // _FINE
