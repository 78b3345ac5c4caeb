"""A reader of structured text (IEC 61131-3): it reads declarations, and bodies that can be run.

The reader is independent of the program that wrote the text. It takes the part of the language that
sequences need: BOOL, INT, DINT, TIME, STRING and constant arrays of them; assignments, IF, WHILE,
and calls of function blocks. Everything else is refused with its line.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from threadline.readback.scan_words import ScanError, Token, time_us, tokens_of

Value = bool | int | str
Variables = dict[str, Any]
Expression = Callable[[Variables], Any]
Statement = Callable[[Variables, int], None]

TIMER = "ton"
FIRST_VALUES: Mapping[str, Value] = {
    "bool": False, "int": 0, "dint": 0, "time": 0, "string": "",
}  # fmt: skip
"""Value that a variable of each type has before the first scan; TIME counts microseconds."""

_MOST_TURNS = 100_000  # of all WHILE loops in one scan: a controller's watchdog stops them before
_MOST_IN_ALL = 20_000_000  # in all scans
_MOST_PLACES = 1_000_000  # of an array
_DEEPEST = 60
_MOST_DIGITS = 18  # of a number: LINT has 19
_COMPARISONS: Mapping[str, Callable[[Any, Any], Any]] = {
    "=": operator.eq, "<>": operator.ne, "<": operator.lt, ">": operator.gt,
    "<=": operator.le, ">=": operator.ge,
}  # fmt: skip
_LEVELS: tuple[Mapping[str, Callable[[Any, Any], Any]], ...] = (
    {"or": lambda a, b: a or b},
    {"and": lambda a, b: a and b},
    _COMPARISONS,
    {"+": operator.add, "-": operator.sub},
    {"*": operator.mul, "mod": lambda a, b: a - b * int(a / b)},
)
"""Binary operators from the weakest to the strongest."""
_WORDS = frozenset(
    {
        "if", "then", "elsif", "else", "end_if", "while", "do", "end_while", "and", "or", "not",
        "mod", "true", "false", "var", "end_var",
    }
)  # fmt: skip


class Callee(Protocol):
    """An instance of a function block or a timer."""

    values: Variables

    def call(self, pins: Variables, now_us: int) -> None:
        """Run it once, with new values of its inputs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Declared:
    """A variable: its name, type, section, address, and its value before the first scan."""

    name: str
    type: str
    section: str
    address: str = ""
    initial: Any = None


@dataclass(slots=True, kw_only=True)
class Unit:
    """A program or function block: its variables by lower-case name, and its body."""

    kind: str
    name: str
    declared: dict[str, Declared] = field(default_factory=dict)
    body: Statement | None = None


class Parser:
    """Reads tokens from the first to the last; a wrong token raises ``ScanError``."""

    def __init__(self, tokens: list[Token]) -> None:
        self._tokens, self._at, self._depth = tokens, 0, 0
        self._turning_us, self._turns, self._all_turns = -1, 0, 0

    @property
    def done(self) -> bool:
        """Whether every token was read."""
        return self._at >= len(self._tokens)

    def peek(self) -> str:
        """Return the next word in lower case; empty at the end."""
        return "" if self.done else self._tokens[self._at].text.lower()

    def kind(self) -> str:
        """Return the kind of the next token; empty at the end."""
        return "" if self.done else self._tokens[self._at].kind

    def take(self, *allowed: str) -> str:
        """Take the next word, in its own letters; it must be one of ``allowed``, if any are given.

        Raises
        ------
        ScanError
            If it is another word, or the text has ended.
        """
        if self.done:
            raise ScanError("it ends too early: the file was cut off", self.line)
        token = self._tokens[self._at]
        if allowed and token.text.lower() not in allowed:
            expected = " or ".join(word.upper() for word in allowed)
            raise ScanError(f"{token.text[:40]!r} stands where {expected} is expected", token.line)
        self._at += 1
        return token.text

    @property
    def line(self) -> int:
        """Line of the next token, or of the last one at the end."""
        if not self._tokens:
            return 1
        return self._tokens[min(self._at, len(self._tokens) - 1)].line

    def name(self) -> str:
        """Take a name, in lower case."""
        if self.done:
            raise ScanError("it ends too early: the file was cut off", self.line)
        if self.kind() != "name" or self.peek() in _WORDS:
            raise ScanError(f"{self.peek()[:40]!r} stands where a name is expected", self.line)
        return self.take().lower()

    def whole(self, most: int) -> int:
        """Take a whole number up to ``most``."""
        line, text = self.line, self.take()
        if not text.isdecimal() or len(text) > 9 or int(text) > most:
            raise ScanError(f"{text[:40]!r} is not a number up to {most}", line)
        return int(text)

    def skip_to(self, word: str) -> list[str]:
        """Take all words up to ``word``, and ``word`` itself; return them in lower case."""
        words = list[str]()
        while not words or words[-1] != word:
            words.append(self.take().lower())
        return words

    # Declarations

    def sections(self, unit: Unit) -> None:
        """Read all VAR sections that come next."""
        while self.peek() in {"var", "var_input", "var_output"}:
            section = self.take().lower()
            if self.peek() == "constant":
                section += f" {self.take().lower()}"
            while self.peek() != "end_var":
                self._declaration(unit, section)
            self.take("end_var")

    def _declaration(self, unit: Unit, section: str) -> None:
        line, name, address = self.line, self.name(), ""
        initial: Any = None
        if self.peek() == "at":
            self.take()
            address = self.take().upper()
        self.take(":")
        count = None
        if self.peek() == "array":
            for word in ("array", "[", "0", ".."):
                self.take(word)
            count = self.whole(_MOST_PLACES) + 1
            self.take("]")
            self.take("of")
        kind = self.name()
        if self.peek() == ":=":
            self.take()
            initial = self.literals() if count is not None else self.literal()
        elif count is not None:
            initial = [FIRST_VALUES.get(kind, 0)] * count
        self.take(";")
        if isinstance(initial, list) and len(initial) != count:
            raise ScanError(f"{name} has {len(initial)} values for {count} places", line)
        add(unit, Declared(
            name=name, type=kind, section=section, address=address, initial=initial
        ), line)  # fmt: skip

    def literals(self) -> list[Value]:
        """Read the values of an array; ``3(FALSE)`` stands for three values."""
        values = list[Value]()
        self.take("[")
        while self.peek() != "]":
            value, count = self.literal(), 1
            if self.peek() == "(":
                self.take()
                if type(value) is not int or value > _MOST_PLACES - len(values):
                    raise ScanError(f"{str(value)[:40]!r} is not a number of values", self.line)
                count, value = value, self.literal()
                self.take(")")
            values += [value] * count
            if self.peek() == ",":
                self.take()
        self.take("]")
        return values

    def literal(self) -> Value:
        """Read a constant."""
        negative = self.peek() == "-"
        if negative:
            self.take()
        line, kind, text = self.line, self.kind(), self.take()
        if kind == "number" and len(text) <= _MOST_DIGITS:
            return -int(text) if negative else int(text)
        if kind == "time":
            return time_us(text, line)
        if kind == "text":
            return text[1:-1]
        if text.lower() in {"true", "false"} and not negative:
            return text.lower() == "true"
        raise ScanError(f"{text[:40]!r} stands where a constant is expected", line)

    # Bodies

    def statements(self, *ends: str) -> Statement:
        """Read statements up to one of the words ``ends``, which is not taken."""
        self._depth += 1
        if self._depth > _DEEPEST:
            raise ScanError(f"statements stand more than {_DEEPEST} deep in one another", self.line)
        statements = list[Statement]()
        while self.peek() not in ends:
            statements.append(self._statement())
        self._depth -= 1

        def run(v: Variables, now_us: int) -> None:
            for statement in statements:
                statement(v, now_us)

        return run

    def _statement(self) -> Statement:
        word = self.peek()
        if word == "if":
            return self._if()
        if word == "while":
            return self._while()
        name = self.name()
        if self.peek() == "(":
            return self._call(name)
        self.take(":=")
        line, value = self.line, self.expression()
        self.take(";")

        def assign(v: Variables, _: int) -> None:
            result = value(v)
            if isinstance(result, int) and abs(result) >> 63:
                raise ScanError(f"{name} becomes larger than any number of a controller", line)
            v[name] = result

        return assign

    def _if(self) -> Statement:
        branches = list[tuple[Expression, Statement]]()
        while self.peek() in {"if", "elsif"}:
            self.take()
            condition = self.expression()
            self.take("then")
            branches.append((condition, self.statements("elsif", "else", "end_if")))
        else_body = None
        if self.peek() == "else":
            self.take()
            else_body = self.statements("end_if")
        self.take("end_if")
        self.take(";")

        def run(v: Variables, now_us: int) -> None:
            for condition, body in branches:
                if condition(v):
                    body(v, now_us)
                    return
            if else_body is not None:
                else_body(v, now_us)

        return run

    def _while(self) -> Statement:
        line = self.line
        self.take("while")
        condition = self.expression()
        self.take("do")
        body = self.statements("end_while")
        self.take("end_while")
        self.take(";")

        def run(v: Variables, now_us: int) -> None:
            while condition(v):
                self._count_turn(now_us, line)
                body(v, now_us)

        return run

    def _count_turn(self, now_us: int, line: int) -> None:
        """Count one turn of any loop of this text."""
        turns_before = self._turns if now_us == self._turning_us else 0
        self._turning_us, self._turns, self._all_turns = (
            now_us,
            turns_before + 1,
            self._all_turns + 1,
        )
        if self._turns > _MOST_TURNS or self._all_turns > _MOST_IN_ALL:
            raise ScanError("its loop never ends", line)

    def _call(self, name: str) -> Statement:
        pins, outputs = dict[str, Expression](), dict[str, str]()
        self.take("(")
        while self.peek() != ")":
            pin = self.name()
            if self.take(":=", "=>") == ":=":
                pins[pin] = self.expression()
            else:
                outputs[pin] = self.name()
            if self.peek() != ")":
                self.take(",")
        self.take(")")
        self.take(";")

        def run(v: Variables, now_us: int) -> None:
            callee: Callee = v[name]
            callee.call({pin: value(v) for pin, value in pins.items()}, now_us)
            for pin, variable in outputs.items():
                v[variable] = callee.values[pin]

        return run

    def expression(self, level: int = 0) -> Expression:
        """Read an expression of operators from ``level`` on."""
        if level == len(_LEVELS):
            return self._operand()
        left = self.expression(level + 1)
        while self.peek() in _LEVELS[level]:
            word = self.take().lower()
            left = _binary(word, _LEVELS[level][word], left, self.expression(level + 1))
        return left

    def _operand(self) -> Expression:
        self._depth += 1
        if self._depth > _DEEPEST:
            raise ScanError(f"brackets stand more than {_DEEPEST} deep in one another", self.line)
        operand = self._single()
        self._depth -= 1
        return operand

    def _single(self) -> Expression:
        word = self.peek()
        if word == "not":
            self.take()
            inner = self._operand()
            return lambda v: not inner(v)
        if word == "(":
            self.take()
            inner = self.expression()
            self.take(")")
            return inner
        if self.kind() != "name" or word in {"true", "false"}:
            value = self.literal()
            return lambda _: value
        name = self.name()
        if self.peek() == "[":
            index = self._index()
            return lambda v: _of_array(name, v[name], index(v))
        if self.peek() == ".":
            self.take()
            pin = self.name()
            if self.peek() != "[":
                return lambda v: v[name].values[pin]
            place = self._index()
            return lambda v: _of_array(pin, v[name].values[pin], place(v))
        return lambda v: v[name]

    def _index(self) -> Expression:
        self.take("[")
        index = self.expression()
        self.take("]")
        return index


def _binary(
    word: str, operation: Callable[[Any, Any], Any], left: Expression, right: Expression
) -> Expression:
    if word == "or":
        return lambda v: left(v) or right(v)
    if word == "and":
        return lambda v: left(v) and right(v)
    if word in _COMPARISONS:
        return lambda v: operation(left(v), right(v))

    def calculated(v: Variables) -> Any:
        left_value, right_value = left(v), right(v)
        if not isinstance(left_value, int) or not isinstance(right_value, int):
            raise ScanError(f"{word.upper()} is between what are no numbers")
        return operation(left_value, right_value)

    return calculated


def _of_array(name: str, values: list[Value], index: int) -> Value:
    if not 0 <= index < len(values):
        raise ScanError(f"{name} has no place {index}")
    return values[index]


def add(unit: Unit, one: Declared, line: int | None = None) -> None:
    """Add a variable to a unit; raise ``ScanError`` if it has one of that name."""
    if one.name in unit.declared:
        raise ScanError(f"{one.name} is declared twice", line)
    unit.declared[one.name] = one


def read_units(text: str) -> Iterator[Unit]:
    """Yield the programs and function blocks of a text; configurations are passed over.

    Raises
    ------
    ScanError
        If the text is not in the language.
    """
    parser = Parser(tokens_of(text))
    while not parser.done:
        word = parser.take("function_block", "program", "configuration").lower()
        if word == "configuration":
            parser.skip_to("end_configuration")
            continue
        unit = Unit(kind=word, name=parser.name())
        parser.sections(unit)
        unit.body = parser.statements(f"end_{word}")
        parser.take(f"end_{word}")
        yield unit


def read_body(text: str) -> Statement:
    """Return the body of a text that consists of statements alone.

    Raises
    ------
    ScanError
        If the text is not in the language.
    """
    parser = Parser(tokens_of(text))
    return parser.statements("")
