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
            operand = self.value()
            self._nested -= 1
            return operand if c == "+" else lambda values: -operand(values)
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
        formula, place = self.value(), self._place
        # FluidNC cuts decimals off.
        tolerance = 0.0 if self._flavour is FLUIDNC else _ALMOST_WHOLE

        def whole(values: Values) -> int:
            number = formula(values)
            nearest = math.floor(number + 0.5)
            if abs(number - nearest) > tolerance:
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
        number_formula = self.whole()
        self._nested -= 1
        return lambda values: values.number(number_formula(values), place)

    def _exists(self) -> Formula:
        self.take("[")
        has_hash = self.take("#")
        if has_hash and self.peek() != "<":
            self._deeper()
            number_formula = self.whole()
            self._nested -= 1
            formula: Formula = lambda values: float(values.has_number(number_formula(values)))  # noqa: E731
        else:
            name_match = re.compile(r"[^\]<>#\[]+").match(self.text, self.at)
            if has_hash or name_match is None or self._flavour.subroutines:
                name = self.name() if has_hash else self.refuse("EXISTS[#<name>] needs a name")
            else:
                name, self.at = name_match[0], name_match.end()  # FluidNC also takes a bare name
            formula = lambda values: float(values.exists(name, self._place))  # noqa: E731
        if not self.take("]"):
            self.refuse("] is missing")
        return formula

    def _function(self, name: str) -> Formula:
        if name == "exists":
            return self._exists()
        first_argument, rounded, place = self.bracketed(), self._flavour.rounded, self._place
        if name == "atan":
            if not self.take("/"):
                self.refuse("ATAN needs two numbers", "Write ATAN[y]/[x].")
            second_argument = self.bracketed()
            arctangent = _single_atan if self._flavour is FLUIDNC else _atan
            return lambda values: rounded(
                arctangent(first_argument(values), second_argument(values))
            )
        operation = _FUNCTIONS[name]
        if self._flavour is FLUIDNC:
            operation = _IN_SINGLE.get(name, operation)

        def function(values: Values) -> float:
            number = first_argument(values)
            try:
                return _finite(rounded(operation(number)))
            except (ValueError, OverflowError):
                raise JobError(
                    f"{name.upper()}[{number:g}] has no value", place=place, remedy="Correct it."
                ) from None

        return function

    def _ranked(self, left: Formula, least_rank: int) -> Formula:
        """Read the operators of a rank above ``least_rank`` and their right operands."""
        while (match := _OPERATOR.match(self.text, self.at)) and _RANK[match[0]] > least_rank:
            self.at = match.end()
            self._operators += 1
            if self._operators > MAX_OPERATORS:
                self.refuse(f"more than {MAX_OPERATORS} operators in a line", "Write it in parts.")
            rank = _RANK[match[0]]
            left = self._joined(left, match[0], self._ranked(self.value(), rank))
        return left

    def _joined(self, left: Formula, operator: str, right: Formula) -> Formula:
        operation, place = _operators(self._flavour)[operator], self._place
        flavour, rounded = self._flavour, self._flavour.rounded
        compares = operator in {"eq", "ne", "le", "ge"}

        def joined(values: Values) -> float:
            a, b = left(values), right(values)
            if compares and not values.doubtful and _in_doubt(operator, a, b, flavour):
                values.doubtful = place.line
            try:
                return _finite(rounded(operation(a, b)))
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
    remainder = math.fmod(a, b)
    return remainder + abs(b) if remainder < 0.0 else remainder


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
    tolerance = flavour.alike
    return {
        "**": math.pow,
        "*": lambda a, b: a * b,
        "/": lambda a, b: a / b,
        "mod": _modulo,
        "+": lambda a, b: a + b,
        "-": lambda a, b: a - b,
        "eq": lambda a, b: float(abs(a - b) < tolerance),
        "ne": lambda a, b: float(abs(a - b) >= tolerance),
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
    later_tolerance = flavour.alike_later
    if later_tolerance is None or a == b:
        return False
    difference = abs(a - b)
    if operator in {"eq", "ne"}:
        return later_tolerance <= difference < flavour.alike
    return difference < later_tolerance and (
        (operator == "le" and a > b) or (operator == "ge" and a < b)
    )
