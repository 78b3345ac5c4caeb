"""Expressions of part programs: ``[#1 * SIN[30] + 2]``, numbers, parameters and functions.

Operators of equal rank are evaluated from the left, including powers: ``[2 ** 3 ** 2]`` is 64.
Ranks from the highest: ``**``; ``* / MOD``; ``+ -``; ``EQ NE GT GE LT LE``; ``AND OR XOR``. A true
comparison is 1, and every number except 0 counts as true. Angles are in degrees.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import NoReturn

import numpy as np

from threadline.errors import JobError, Place
from threadline.jobs.gcode.dialects import FLUIDNC, Flavour, in_degrees, radians, single
from threadline.jobs.gcode.parametric.parameters import Values

Formula = Callable[[Values], float]
NUMBER = re.compile(r"[-+]?(?:[0-9]++(?:\.[0-9]*+)?|\.[0-9]++)")
MAX_NESTED = 30
MAX_OPERATORS = 200
_MAX_SHOWN = 40
_ALMOST_WHOLE = 1e-4
_OPERATOR = re.compile(r"\*\*|and|xor|or|mod|eq|ne|ge|gt|le|lt|[-+*/]")
_FUNCTION = re.compile(r"(exists|abs|acos|asin|atan|cos|exp|fix|fup|ln|round|sin|sqrt|tan)(?=\[)")
_RANK = {
    "**": 5, "*": 4, "/": 4, "mod": 4, "+": 3, "-": 3, "eq": 2, "ne": 2, "ge": 2, "gt": 2,
    "le": 2, "lt": 2, "and": 1, "or": 1, "xor": 1,
}  # fmt: skip


class FormulaReader:
    """Reads the formulas of a line from a position that moves forward.

    Parameters
    ----------
    text
        The line in lower case, without blanks and comments.
    flavour
        Rules of the control for expressions.
    place
        Place of the line.
    """

    def __init__(self, text: str, flavour: Flavour, place: Place) -> None:
        self.text = text
        self.at = 0
        self._flavour = flavour
        self._place = place
        self._nested = self._operators = 0

    def more(self) -> bool:
        """Say whether the line has more text."""
        return self.at < len(self.text)

    def peek(self) -> str:
        """Return the next character, empty at the end of the line."""
        return self.text[self.at : self.at + 1]

    def take(self, what: str) -> bool:
        """Skip ``what`` if it comes next; return whether it does."""
        if not self.text.startswith(what, self.at):
            return False
        self.at += len(what)
        return True

    def refuse(self, message: str, remedy: str = "Correct it.") -> NoReturn:
        """Raise an error that quotes the next text of the line."""
        rest = self.text[self.at : self.at + _MAX_SHOWN] or "the end of the line"
        raise JobError(f"{message}, at {rest!r}", place=self._place, remedy=remedy)

    def value(self) -> Formula:
        """Read a number, a parameter, a function, or an expression in brackets.

        Raises
        ------
        JobError
            If the text is none of these.
        """
        c = self.peek()
        if c == "[":
            return self.bracketed()
        if c == "#":
            self.at += 1
            return self._parameter()
        number = NUMBER.match(self.text, self.at)
        if number is not None:
            self.at = number.end()
            constant = self._flavour.rounded(float(number[0]))
            return lambda _: constant
        if c in {"+", "-"} and c:
            self.at += 1
            self._deeper()
            inner = self.value()
            self._nested -= 1
            return inner if c == "+" else lambda values: -inner(values)
        function = _FUNCTION.match(self.text, self.at)
        if function is None:
            self.refuse("a number, a parameter or an expression is missing")
        self.at = function.end()
        return self._function(function[1])

    def bracketed(self) -> Formula:
        """Read an expression with its brackets.

        Raises
        ------
        JobError
            If the text is no expression in brackets.
        """
        if not self.take("["):
            self.refuse("an expression in [ ] is missing")
        self._deeper()
        formula = self._ranked(self.value(), 0)
        self._nested -= 1
        if not self.take("]"):
            self.refuse("an operator or ] is missing")
        return formula

    def whole(self) -> Callable[[Values], int]:
        """Read a value that must be a whole number, within 0.0001 (exactly for FluidNC)."""
        value, place = self.value(), self._place
        apart = 0.0 if self._flavour is FLUIDNC else _ALMOST_WHOLE  # FluidNC cuts decimals off

        def whole(values: Values) -> int:
            number = value(values)
            nearest = math.floor(number + 0.5)
            if abs(number - nearest) > apart:
                raise JobError(
                    f"{number:g} must be a whole number here", place=place, remedy="Correct it."
                )
            return nearest

        return whole

    def name(self) -> str:
        """Read a name with its angle brackets."""
        end = self.text.find(">", self.at)
        if not self.take("<") or end < 0:
            self.refuse("a name in < > is missing")
        name = self.text[self.at : end]
        if not name:
            self.refuse("a name is empty")
        self.at = end + 1
        return name

    def _deeper(self) -> None:
        self._nested += 1
        if self._nested > MAX_NESTED:
            self.refuse(f"expressions are nested more than {MAX_NESTED} deep", "Write it in parts.")

    def _parameter(self) -> Formula:
        place = self._place
        if self.peek() == "<":
            name = self.name()
            return lambda values: values.named(name, place)
        self._deeper()
        which = self.whole()
        self._nested -= 1
        return lambda values: values.number(which(values), place)

    def _exists(self) -> Formula:
        self.take("[")
        marked = self.take("#")
        if marked and self.peek() != "<":
            self._deeper()
            which = self.whole()
            self._nested -= 1
            found: Formula = lambda values: float(values.has_number(which(values)))  # noqa: E731
        else:
            bare = re.compile(r"[^\]<>#\[]+").match(self.text, self.at)
            if marked or bare is None or self._flavour.subroutines:
                name = self.name() if marked else self.refuse("EXISTS[#<name>] needs a name")
            else:
                name, self.at = bare[0], bare.end()  # FluidNC also takes a bare name
            found = lambda values: float(values.exists(name, self._place))  # noqa: E731
        if not self.take("]"):
            self.refuse("] is missing")
        return found

    def _function(self, name: str) -> Formula:
        if name == "exists":
            return self._exists()
        first, rounded, place = self.bracketed(), self._flavour.rounded, self._place
        if name == "atan":
            if not self.take("/"):
                self.refuse("ATAN needs two numbers", "Write ATAN[y]/[x].")
            second = self.bracketed()
            arc = _single_atan if self._flavour is FLUIDNC else _atan
            return lambda values: rounded(arc(first(values), second(values)))
        work = _FUNCTIONS[name]
        if self._flavour is FLUIDNC:
            work = _IN_SINGLE.get(name, work)

        def function(values: Values) -> float:
            number = first(values)
            try:
                return _finite(rounded(work(number)))
            except (ValueError, OverflowError):
                raise JobError(
                    f"{name.upper()}[{number:g}] has no value", place=place, remedy="Correct it."
                ) from None

        return function

    def _ranked(self, left: Formula, least: int) -> Formula:
        """Read the operators of a rank above ``least`` and their right operands."""
        while (found := _OPERATOR.match(self.text, self.at)) and _RANK[found[0]] > least:
            self.at = found.end()
            self._operators += 1
            if self._operators > MAX_OPERATORS:
                self.refuse(f"more than {MAX_OPERATORS} operators in a line", "Write it in parts.")
            rank = _RANK[found[0]]
            left = self._joined(left, found[0], self._ranked(self.value(), rank))
        return left

    def _joined(self, left: Formula, operator: str, right: Formula) -> Formula:
        work, place = _operators(self._flavour)[operator], self._place
        flavour, rounded = self._flavour, self._flavour.rounded
        compares = operator in {"eq", "ne", "le", "ge"}

        def joined(values: Values) -> float:
            a, b = left(values), right(values)
            if compares and not values.doubtful and _in_doubt(operator, a, b, flavour):
                values.doubtful = place.line
            try:
                return _finite(rounded(work(a, b)))
            except (ValueError, OverflowError, ZeroDivisionError):
                raise JobError(
                    f"{a:g} {operator.upper()} {b:g} has no value",
                    place=place,
                    remedy="Correct it.",
                ) from None

        return joined


def _finite(value: float) -> float:
    if not math.isfinite(value):
        raise OverflowError
    return value


def _modulo(a: float, b: float) -> float:
    rest = math.fmod(a, b)
    return rest + abs(b) if rest < 0.0 else rest


_FUNCTIONS: dict[str, Callable[[float], float]] = {
    "abs": abs,
    "acos": lambda x: in_degrees(math.acos(x)),
    "asin": lambda x: in_degrees(math.asin(x)),
    "cos": lambda x: float(np.cos(radians(x))),
    "exp": math.exp,
    "fix": lambda x: float(math.floor(x)),
    "fup": lambda x: float(math.ceil(x)),
    "ln": math.log,
    "round": lambda x: float(math.trunc(x - 0.5 if x < 0.0 else x + 0.5)),
    "sin": lambda x: float(np.sin(radians(x))),
    "sqrt": math.sqrt,
    "tan": lambda x: float(np.tan(radians(x))),
}


_DEGREE = math.pi / 180


def _atan(y: float, x: float) -> float:
    return in_degrees(math.atan2(y, x))


def _single_atan(y: float, x: float) -> float:
    return single(math.atan2(y, x)) * (180 / math.pi)


def _single_round(x: float) -> float:
    return float(math.trunc(single(x - 0.5 if x < 0.0 else x + 0.5)))


_IN_SINGLE: dict[str, Callable[[float], float]] = {
    "acos": lambda x: single(math.acos(x)) * (180 / math.pi),
    "asin": lambda x: single(math.asin(x)) * (180 / math.pi),
    "cos": lambda x: math.cos(single(x * _DEGREE)),
    "round": _single_round,
    "sin": lambda x: math.sin(single(x * _DEGREE)),
    "tan": lambda x: math.tan(single(x * _DEGREE)),
}
"""FluidNC's functions, which round intermediate values: its cosine of 90 is -4e-8, not 0."""


def _operators(flavour: Flavour) -> dict[str, Callable[[float, float], float]]:
    alike = flavour.alike
    return {
        "**": math.pow,
        "*": lambda a, b: a * b,
        "/": lambda a, b: a / b,
        "mod": _modulo,
        "+": lambda a, b: a + b,
        "-": lambda a, b: a - b,
        "eq": lambda a, b: float(abs(a - b) < alike),
        "ne": lambda a, b: float(abs(a - b) >= alike),
        "lt": lambda a, b: float(a < b),
        "gt": lambda a, b: float(a > b),
        "le": lambda a, b: float(a <= b),
        "ge": lambda a, b: float(a >= b),
        "and": lambda a, b: float(a != 0.0 and b != 0.0),
        "or": lambda a, b: float(a != 0.0 or b != 0.0),
        "xor": lambda a, b: float((a != 0.0) != (b != 0.0)),
    }


def _in_doubt(operator: str, a: float, b: float, flavour: Flavour) -> bool:
    """Say whether versions of the control compare these two numbers differently."""
    later = flavour.alike_later
    if later is None or a == b:
        return False
    apart = abs(a - b)
    if operator in {"eq", "ne"}:
        return later <= apart < flavour.alike
    return apart < later and ((operator == "le" and a > b) or (operator == "ge" and a < b))
