"""O words: their lines, and the line to which each O word leads.

Blocks of ``if``, ``while``, ``do``, ``repeat`` and ``sub`` nest, and each block has its end.
LinuxCNC searches for the end while it runs; this reader refuses blocks without a matching end
before the program runs.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import NamedTuple, NoReturn

from threadline.errors import JobError, Place
from threadline.jobs.gcode.dialects import Flavour
from threadline.jobs.gcode.words import O_WORDS

_O_WORD = re.compile(
    rf"(?:n[0-9]+)?o(?:<([^<>]*)>|([0-9]+)|([#\[].*?))({'|'.join(O_WORDS)})(.*)", re.DOTALL
)
_NUMBERED = re.compile(r"(?:n[0-9]+)?o(?:<[^<>]*>|[0-9]+)?$")
MAX_NESTED = 100
_OPENS = ("if", "while", "do", "repeat", "sub")
_CLOSES = {"endif": "if", "endwhile": "while", "endrepeat": "repeat", "endsub": "sub"}
_WITH_FORMULA = ("if", "elseif", "while", "repeat")


class OWord(NamedTuple):
    """An O word: its label (or the label's formula), its word, and the text after the word."""

    label: str
    formula: str
    word: str
    rest: str


def o_word(code: str, place: Place) -> OWord | None:
    """Return the O word of a line (lower case, no blanks); None if the line is another block.

    Raises
    ------
    JobError
        If the line begins with ``o`` and is no O word.
    """
    unnumbered_code = code.lstrip("n0123456789") if code[:1] == "n" else code
    if unnumbered_code[:1] != "o":
        return None
    match = _O_WORD.fullmatch(code)
    if match is None:
        if _NUMBERED.fullmatch(code):
            raise JobError(
                "a program that begins with its number does not go with O words and parameters "
                "here",
                place=place,
                remedy="Write it as o100 sub ... o100 endsub, and its call as o100 call.",
            )
        raise JobError(
            f"{code[:40]!r} is no O word",
            place=place,
            remedy="After the label stands sub, endsub, call, return, if, elseif, else, endif, "
            "while, endwhile, do, repeat, endrepeat, break or continue.",
        )
    name, number, formula, word, rest = match.groups()
    label = str(int(number)) if number and len(number) < 10 else (number or name or "")
    return OWord(label, formula or "", word, rest)


@dataclass(slots=True)
class Step:
    """An O word and its place in the program.

    Parameters
    ----------
    line
        Index of the line of the O word.
    end
        Index of the line that ends the block: ``endif``, ``endwhile``, ``endrepeat`` or
        ``endsub``; for a ``do``, the closing ``while``.
    begin
        Index of the line that begins the block.
    branches
        For an ``if``: line indices of each ``elseif``, ``else`` and ``endif``, in order. For a
        loop: line indices of each ``break``.
    """

    o: OWord
    line: int
    end: int = -1
    begin: int = -1
    branches: list[int] = field(default_factory=list)


@dataclass(slots=True)
class Flow:
    """The O words of a program by line index, and the lines of its subroutines by label."""

    steps: dict[int, Step]
    subs: dict[str, int]


class FlowReader:
    """Takes the O words of a program in order and matches the ends of blocks to their beginnings.

    Parameters
    ----------
    file
        Path of the file, for errors.
    flavour
        Rules of the control for parameters and O words.
    """

    def __init__(self, file: str, flavour: Flavour) -> None:
        self._file = file
        self._flavour = flavour
        self._flow = Flow({}, {})
        self._open: list[Step] = []
        self._labels: dict[tuple[str, str], int] = {}
        self._sub = ""

    def take(self, o: OWord, line: int) -> None:
        """Take the O word on the line with index ``line``.

        Raises
        ------
        JobError
            If the O word does not match the O words before it.
        """
        step = Step(o, line)
        self._flow.steps[line] = step
        word = o.word
        self._check(o, line)
        if word == "while" and self._open and self._is(self._open[-1], "do", o.label):
            opener = self._open.pop()
            opener.end, step.begin = line, opener.line
        elif word in _OPENS:
            self._refuse_while_in_do(o, line)
            self._begin(step)
        elif word in _CLOSES:
            opener = self._innermost(step, _CLOSES[word])
            self._open.pop()
            opener.end, step.begin = line, opener.line
            if word == "endif":
                opener.branches.append(line)
            if word == "endsub":
                self._sub = ""
        elif word in {"elseif", "else"}:
            opener = self._innermost(step, "if")
            if opener.branches and self._flow.steps[opener.branches[-1]].o.word == "else":
                self._refuse(line, f"{word} stands behind else", "Write else last.")
            opener.branches.append(line)
            step.begin = opener.line
        elif word in {"break", "continue"}:
            loop = self._loop(o, line)
            step.begin = loop.line
            if word == "break":
                loop.branches.append(line)
        elif word == "return":
            if not self._sub:
                self._refuse(line, "return stands outside of a subroutine", "Take it out.")
            if any(block.o.word == "repeat" for block in self._open):
                self._refuse(
                    line,
                    "return stands in a repeat, whose count LinuxCNC then keeps for the next call",
                    "Write a while in its place.",
                )

    def finish(self) -> Flow:
        """Return the flow of the whole program.

        Raises
        ------
        JobError
            If a block has no end.
        """
        if self._open:
            innermost = self._open[-1]
            self._refuse(
                innermost.line,
                f"{innermost.o.word} {innermost.o.label} has no end",
                "Add it, with the same label.",
            )
        return self._flow

    def _check(self, o: OWord, line: int) -> None:
        if not self._flavour.subroutines:
            if o.word in {"sub", "endsub", "call", "return"} or o.formula or not o.label.isdigit():
                self._refuse(
                    line,
                    "FluidNC has no subroutines, and labels that are numbers only",
                    "The dialect linuxcnc has them (--dialect).",
                )
        elif o.word in {"alarm", "error"}:
            self._refuse(line, f"{o.word} is no O word of LinuxCNC", "FluidNC has it (--dialect).")
        if o.formula and o.word != "call":
            self._refuse(line, "a label that is worked out goes with call only", "Write a number.")
        if not o.formula and not o.label:
            self._refuse(line, "an O word has no label", "Write a number, or a name in < >.")
        if o.rest and o.word not in {*_WITH_FORMULA, "call", "return", "endsub", "alarm", "error"}:
            self._refuse(line, f"{o.rest[:40]!r} stands behind {o.word}", "Take it out.")

    def _refuse_while_in_do(self, o: OWord, line: int) -> None:
        if self._flavour.subroutines or o.word != "while":
            return
        if self._open and self._open[-1].o.word == "do":
            self._refuse(
                line,
                f"while {o.label} stands directly in do {self._open[-1].o.label}: FluidNC takes it "
                "for the end of a do, runs its lines once and stops at endwhile",
                "Write an if [1] ... endif around it.",
            )

    def _begin(self, step: Step) -> None:
        label, line = step.o.label, step.line
        if step.o.word == "sub":
            if self._open:
                self._refuse(line, "a subroutine begins inside another block", "Move it outside.")
            if label in self._flow.subs:
                first_line = self._flow.subs[label] + 1
                self._refuse(
                    line, f"sub {label} is defined twice, first on line {first_line}", "Rename one."
                )
            self._flow.subs[label] = line
            self._sub = label
        elif self._flavour.labels_once and (self._sub, label) in self._labels:
            first_line = self._labels[self._sub, label] + 1
            self._refuse(
                line,
                f"the label {label} names a block twice, first on line {first_line}",
                "Give one another label, as LinuxCNC wants it.",
            )
        elif any(block.o.label == label for block in self._open if block.o.word != "sub"):
            self._refuse(line, f"the label {label} names a block inside its own", "Rename one.")
        if len(self._open) >= MAX_NESTED:
            self._refuse(
                line, f"blocks are nested more than {MAX_NESTED} deep", "Write it flatter."
            )
        if step.o.word != "sub":
            self._labels[self._sub, label] = line
        self._open.append(step)

    def _innermost(self, step: Step, word: str) -> Step:
        o, line = step.o, step.line
        if not self._open or not self._is(self._open[-1], word, o.label):
            enclosing_block = (
                f", which stands in {self._open[-1].o.word} {self._open[-1].o.label}"
                if (self._open)
                else ""
            )
            self._refuse(
                line,
                f"{o.word} {o.label} has no {word} of that label before it{enclosing_block}",
                "Blocks end in the reverse order of their beginnings.",
            )
        return self._open[-1]

    def _loop(self, o: OWord, line: int) -> Step:
        loops = [
            block
            for block in self._open
            if block.o.word in {"while", "do", "repeat"} and block.o.label == o.label
        ]
        if not loops:
            self._refuse(line, f"{o.word} {o.label} stands in no loop of that label", "Correct it.")
        if loops[-1].o.word == "repeat" and not self._flavour.breaks_repeats:
            self._refuse(
                line, f"LinuxCNC has no {o.word} of a repeat", "Write a while in its place."
            )
        return loops[-1]

    @staticmethod
    def _is(step: Step, word: str, label: str) -> bool:
        return step.o.word == word and step.o.label == label

    def _refuse(self, line: int, message: str, remedy: str) -> NoReturn:
        raise JobError(message, place=Place(self._file, line + 1), remedy=remedy)
