"""Rows of the workspace as vectors, for code over several lanes."""

from __future__ import annotations

from collections.abc import Mapping
from functools import reduce
from typing import Any

from threadline.twin.kernel.code import INTEGER, POINTER, Code, Number, Value
from threadline.twin.kernel.layout import Layout
from threadline.twin.kernel.names import PER_LENGTH_FIELDS, Field, Row, Slot
from threadline.twin.kernel.shape import Pattern


class Context:
    """The integer array argument of a kernel, see ``Slot``."""

    def __init__(self, code: Code, array: Value) -> None:
        self.code, self.array = code, array

    def integer(self, slot: Slot) -> Value:
        """Return an entry."""
        return self.code.read(self.array, slot, INTEGER)

    def pointer(self, slot: Slot) -> Value:
        """Return an entry as an address."""
        return self.code.read(self.array, slot, POINTER)


class Lanes:
    """The lanes of one vector; a row's name gives their numbers.

    Parameters
    ----------
    code
        The function being written.
    layout
        Positions of the rows.
    base
        Address of their rows.
    uniform
        Rows that are already read.
    """

    def __init__(
        self, code: Code, layout: Layout, base: Value, uniform: Mapping[Row, Value] | None = None
    ) -> None:
        self.code, self.layout, self.base = code, layout, base
        self.shape = layout.shape
        self._uniform = dict(uniform or {})
        self._known = self._uniform.copy()
        self._of_length = base

    def __getitem__(self, row: Row) -> Value:
        if row not in self._known:
            base = self._of_length if row[0] in PER_LENGTH_FIELDS else self.base
            at = self.layout[row]
            if base is not self.base:
                at -= self.layout.first_length
            self._known[row] = self.code.read_lanes(base, at * self.shape.width)
        return self._known[row]

    def __setitem__(self, row: Row, value: Number) -> None:
        lifted = Value(self.code, self.code.lift(value, self.code.vector))
        self.code.write_lanes(self.base, self.layout[row] * self.shape.width, lifted)
        self._known[row] = lifted

    def leave_behind(self, row: Row, value: Value) -> None:
        """Set a row in memory for other code; this code keeps using the value that it has read."""
        self.code.write_lanes(self.base, self.layout[row] * self.shape.width, value)

    def forget(self) -> None:
        """Read all rows again from here on, because other code may have changed them."""
        self._known = self._uniform.copy()

    def choose_length(self, gather: Any, number: Value, length: Value, array: Value) -> None:
        """From here on, read the rows of one of several advances.

        Parameters
        ----------
        gather
            The function that collects them if lanes are in different modes.
        number
            Index of these lanes among all groups.
        """
        code, layout, width = self.code, self.layout, self.shape.width
        if self.shape.lengths == 1:
            return
        source = code.read(self.base, layout[Field.SOURCE,] * width, POINTER)
        place = code.place(source, length * (layout.per_length * width))
        where = code.variable(POINTER, place)
        if gather is not None and width > 1:
            mixed = Value(code, code.at.ptrtoint(source.ir, INTEGER)).equals(0)
            with code.when_seldom(mixed):
                code.run(gather, self.base, number, length, array)
                where.set(code.place(self.base, layout.first_length * width))
        self._of_length = where.get()

    def column(self, j: int) -> Value:
        """Return column j of ``[states, inputs, 1]``."""
        return self.code.number(1.0) if j == self.shape.columns - 1 else self[Field.COLUMN, j]

    def product(
        self, field: Field, index: int, pattern: Pattern, columns: list[Value] | None = None
    ) -> Value:
        """Return the product of a row with ``columns``; None for the present columns."""
        constant = self.shape.columns - 1
        start = self[field, index, constant] if constant in pattern else None
        terms = [
            (self[field, index, j], self[Field.COLUMN, j] if columns is None else columns[j])
            for j in pattern
            if j != constant
        ]
        return self.code.total(terms, start)

    def columns(self) -> list[Value]:
        """Return all present columns."""
        return [self.column(j) for j in range(self.shape.columns)]

    def product_of(self, row: Row, pattern: Pattern, columns: list[Value]) -> Value:
        """Return the product of the numbers that begin with ``row`` and ``columns``."""
        return self.code.total([(self[(*row, j)], columns[j]) for j in pattern])

    def advanced(self) -> list[Value]:
        """Return the columns after an advance, valid if no guard is violated."""
        reach, unit = self.shape.reach()
        after = []
        for i, pattern in enumerate(reach):
            constant = self.shape.columns - 1
            start = self[Field.STEP, i, constant] if constant in pattern else None
            if unit[i]:
                start = self[Field.COLUMN, i] if start is None else start + self[Field.COLUMN, i]
            terms = [
                (self[Field.STEP, i, j], self[Field.COLUMN, j]) for j in pattern if j != constant
            ]
            after.append(self.code.total(terms, start))
        return after + [self.column(j) for j in range(len(after), self.shape.columns)]

    def outside(self, w: int, ends: list[Value], turns: list[Value]) -> list[Value]:
        """Return numbers that are negative if a value lies outside the bounds of guard w.

        The values are the ends, and both ends plus or minus their turns.
        """
        guard, code = self.shape.guards[w], self.code
        values = ends + ([ends[0] + turns[0], ends[1] - turns[1]] if turns else [])
        found = []
        if guard.bounded_above:
            found.append(self[Field.HIGH, w] - reduce(code.larger, values))
        if guard.bounded_below:
            found.append(reduce(code.smaller, values) - self[Field.LOW, w])
        return found

    def may_leave(self, after: list[Value]) -> Value:
        """Return the lanes in which a guard may be violated on the way to ``after``.

        A cubic on an interval lies within the hull of its four Bezier points; the points of a
        guard's Hermite interpolant are its ends and ``g + g' h/3``, ``g - g' h/3``. A monotone
        guard lies between its ends.
        """
        found: list[Value] = []
        for w, rate in enumerate(self.shape.rates()):
            found += self._left(w, rate, after)
        return self.code.any_negative(found)

    def _left(self, w: int, rate: Pattern, after: list[Value]) -> list[Value]:
        row = self.shape.guards[w].row
        ends = [self.product(Field.GUARD, w, row), self.product(Field.GUARD, w, row, after)]
        turns: list[Value] = []
        if rate:
            turns = [self.product(Field.THIRD, w, rate), self.product(Field.THIRD, w, rate, after)]
        return self.outside(w, ends, turns)

    def may_be_near(self, after: list[Value]) -> Value | None:
        """Return the lanes in which an advance might violate a guard, by a cheaper test, or None.

        The four Bezier points are rows times the columns at the start; all lie within
        ``middle . z +- spread . |z|``.
        """
        found: list[Value] = []
        for w, pattern in enumerate(self.shape.nearness()):
            if not pattern:
                found += self._left(w, (), after)
                continue
            guard, code = self.shape.guards[w], self.code
            sizes = {j: code.call("fabs", self[Field.COLUMN, j]) for j in pattern}
            middle = self.product(Field.MIDDLE, w, pattern)
            spread = code.total([(self[Field.SPREAD, w, j], sizes[j]) for j in pattern])
            if guard.bounded_above:
                found.append(self[Field.NEAR_HIGH, w] - (middle + spread))
            if guard.bounded_below:
                found.append((middle - spread) - self[Field.NEAR_LOW, w])
        return self.code.any_negative(found) if found else None

    def jumped(self) -> Value:
        """Return the lanes in which a guard is already violated."""
        found: list[Value] = []
        for w, guard in enumerate(self.shape.guards):
            found += self.outside(w, [self.product(Field.GUARD, w, guard.row)], [])
        return self.code.any_negative(found)
