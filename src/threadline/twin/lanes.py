"""Rows of the workspace as vectors, while code for some lanes side by side is written."""

from __future__ import annotations

from threadline.twin.code import INTEGER, POINTER, Code, Number, Value
from threadline.twin.shape import Layout, Pattern

_OF_LENGTH = {"step", "leaving", "arriving"}

CONTEXT = (
    "work", "clock", "mode", "counts", "tables", "plans", "cells", "cell s", "meet",
    "kinds", "lengths", "steps", "references", "rows", "every", "window", "records", "samples",
    "ring", "ring length",
)  # fmt: skip
"""What a kernel is given, an array of integers: addresses, and counts of what lies there."""
EVENTS, SLOW, ENDLESS, UNMET, COUNTS = range(5)
"""Per block: changes of modes, slow advances, changes without end, modes without a table."""


class Context:
    """The array of integers that a kernel is given."""

    def __init__(self, code: Code, array: Value) -> None:
        self.code, self.array = code, array

    def integer(self, name: str) -> Value:
        """Return an entry."""
        return self.code.read(self.array, CONTEXT.index(name), INTEGER)

    def pointer(self, name: str) -> Value:
        """Return an entry as an address."""
        return self.code.read(self.array, CONTEXT.index(name), POINTER)


class Lanes:
    """Some lanes of a block: a row's name stands for a vector.

    Parameters
    ----------
    code
        The function that is being written.
    layout
        Where rows lie.
    base
        Address of the first of these lanes in row 0.
    length
        Which of the distinct advances; None where no row of one is used.
    """

    def __init__(self, code: Code, layout: Layout, base: Value, length: Value | None) -> None:
        self.code, self.layout, self.base = code, layout, base
        self.shape = layout.shape
        self._known: dict[tuple[object, ...], Value] = {}
        self._of_length = base
        if length is not None and self.shape.lengths > 1:
            offset = length * (layout.per_length * self.shape.lanes)
            self._of_length = code.place(base, offset)

    def __getitem__(self, name: tuple[object, ...]) -> Value:
        if name not in self._known:
            base = self._of_length if name[0] in _OF_LENGTH else self.base
            at = self.layout[name] * self.shape.lanes
            self._known[name] = self.code.read_lanes(base, at)
        return self._known[name]

    def __setitem__(self, name: tuple[object, ...], value: Number) -> None:
        lifted = Value(self.code, self.code.lift(value, self.code.vector))
        self.code.write_lanes(self.base, self.layout[name] * self.shape.lanes, lifted)
        self._known[name] = lifted

    def forget(self) -> None:
        """Read everything anew from here on: other code may have changed it."""
        self._known.clear()

    def column(self, j: int) -> Value:
        """Return column j of ``[states, inputs, 1]``."""
        return self.code.number(1.0) if j == self.shape.columns - 1 else self["z", j]

    def product(
        self, name: tuple[object, ...], pattern: Pattern, columns: list[Value] | None = None
    ) -> Value:
        """Return the product of the row ``name`` with the columns, its own when None."""
        constant = self.shape.columns - 1
        start = self[(*name, constant)] if constant in pattern else None
        terms = [
            (self[(*name, j)], self["z", j] if columns is None else columns[j])
            for j in pattern
            if j != constant
        ]
        return self.code.total(terms, start)

    def advanced(self) -> list[Value]:
        """Return the columns after an advance, as long as no guard is left."""
        reach, unit = self.shape.reach()
        after = []
        for i, pattern in enumerate(reach):
            constant = self.shape.columns - 1
            start = self["step", i, constant] if constant in pattern else None
            if unit[i]:
                start = self["z", i] if start is None else start + self["z", i]
            terms = [(self["step", i, j], self["z", j]) for j in pattern if j != constant]
            after.append(self.code.total(terms, start))
        return after + [self.column(j) for j in range(len(after), self.shape.columns)]

    def outside(self, w: int, values: list[Value]) -> Value:
        """Return where one of the values lies outside the bounds of guard w."""
        guard, code, found = self.shape.guards[w], self.code, None
        for bounded, pick, bound in (
            (guard.bounded_above, code.larger, "high"),
            (guard.bounded_below, code.smaller, "low"),
        ):
            if not bounded:
                continue
            most = values[0]
            for value in values[1:]:
                most = pick(most, value)
            limit = self[bound, w]
            beyond = most > limit if bound == "high" else most < limit
            found = beyond if found is None else found | beyond
        assert found is not None
        return found

    def may_leave(self, after: list[Value]) -> Value:
        """Return where a guard may be left on the way to ``after``.

        A cubic on an interval lies within the hull of its four Bezier points; those of a guard's
        Hermite interpolant are its ends and ``g + g' h/3``, ``g - g' h/3``.
        """
        found = None
        for w, point in enumerate(self.shape.points()):
            row = self.shape.guards[w].row
            values = [
                self.product(("guard", w), row),
                self.product(("leaving", w), point),
                self.product(("arriving", w), point, after),
                self.product(("guard", w), row, after),
            ]
            beyond = self.outside(w, values)
            found = beyond if found is None else found | beyond
        assert found is not None
        return found
