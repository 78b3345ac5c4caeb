"""Programs of X-Winder Designer (.X4G), in which a mandrel keeps turning while other axes move.

No description of the format is published, but comments in brackets in the files explain the lines.
These meanings were checked against the numbers in the files (the winding angle follows from F, S
and the diameter, and the dwells add up to whole circuits):

=============== ==================================================================================
``M4 S``         the mandrel turns at S rpm until ``M5``, through all blocks between
``G1 F Z B``     the carriage moves to Z at F inches (mm in G21) per second; the head turns to B
                 at the same time; F is modal
``G1 .. S C``    a ``G1`` move while the mandrel turns by C degrees at S rpm
``G4 C``         the mandrel turns by C degrees
``G4 L601 C``    the mandrel turns on to the angle saved by ``M601``, plus C degrees
``G4 P``         a dwell of P tenths of a millisecond
``M601``         the mandrel's angle is saved under this number (``M601`` to ``M699``)
``M0``           a stop until the operator presses a button
=============== ==================================================================================

The machine's axis C is the mandrel, Z the carriage, B the head, Y the cross feed. The meaning of
``R``, the speed of the head, is not published: here the head turns evenly through its block.
Acceleration words (``G1 I J K N O T``) and ``G28`` have no effect: the machine file has the limits.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from threadline.errors import BudgetError, JobError, Place
from threadline.files import Stream
from threadline.jobs.gcode.foreign import letters_of
from threadline.jobs.gcode.textfile import Lines, SourceFile, identify
from threadline.jobs.operations import Dwell, Feed, FeedMode, Job, Move, Operation, Source, Stop
from threadline.machine import Machine

_WORD = re.compile(r"[ \t]*([A-Z])[ \t]*([-+]?(?:[0-9]{1,9}(?:\.[0-9]{0,9})?|\.[0-9]{1,9}))?")
_ESTIMATE = 711
_SAVE = range(601, 700)
_IDLE_M = {17: "M17", _ESTIMATE: "M711"}
_ACCELERATIONS = frozenset("IJKNOT")
_AXES = {"Z": "linear", "Y": "linear", "B": "rotary", "C": "rotary"}
_P_S = 1e-4


def read_x_winder(path: Path, *, machine: Machine, axes: str | None = None) -> Job:
    """Return the job of an X-Winder Designer program.

    Parameters
    ----------
    axes
        Axes of the machine for letters of the program, such as ``"C=A,Z=X"`` (the program's C is
        the machine's A); None: axes with the same letters.

    Raises
    ------
    JobError
        If a line is not part of the dialect, or the machine lacks axis C or Z; the error gives file
        and line.
    BudgetError
        If the program has more operations than the machine's tick budget.
    """
    letters = letters_of(machine, axes)
    kinds = _kinds(machine)
    for name in "CZ":
        index = letters.axes.get(name)
        if index is None or kinds[index] != _AXES[name]:
            raise JobError(
                f"an X-Winder program turns the mandrel C and moves the carriage Z; "
                f"{machine.name!r} has no {_AXES[name]} axis {name}",
                place=Place(str(path)),
                remedy=f"Rename the program's axes (--axes {_renaming(machine)}), or the machine's "
                "in its file.",
            )
    file = identify(path)
    letter_of = {index: letter for letter, index in letters.axes.items()}
    # An axis without a letter stays where it is; no word has its name in brackets.
    axis_letters = tuple(letter_of.get(i, f"({name})") for i, name in enumerate(machine.axis_names))
    program = XWinderProgram(file, machine.name, axis_letters, kinds, letters.dropped)
    reading = _Reading(program)
    moves = 0
    budget = int(machine.tick_budget.si)
    for count, operation in enumerate(reading.run(), start=1):
        moves += isinstance(operation, Move)
        if count > budget:
            raise BudgetError(
                f"the program asks for more operations than the machine's tick budget, {budget}",
                place=operation.source.place,
                remedy="Raise tick_budget in the machine file.",
            )
    if not moves:
        raise JobError("the program moves nothing", place=file.place(), remedy="Name another.")
    return Job(
        name=path.name,
        file=str(path),
        sha256=file.sha256,
        axes=machine.axis_names,
        start=(0.0,) * len(machine.axis_names),
        operations=Stream(XWinderProgram.operations, program),
        warnings=reading.warnings(),
        feed_rule="x-winder",
        dialect="x-winder",
    )


def _renaming(machine: Machine) -> str:
    """Return the pairs of ``--axes`` that name the mandrel and the carriage of a machine."""
    rotary_axis = next((n for n, axis in machine.axes.items() if axis.kind == "rotary"), "A")
    linear_axis = next((n for n, axis in machine.axes.items() if axis.kind == "linear"), "X")
    return f'"C={rotary_axis},Z={linear_axis}"'


def _kinds(machine: Machine) -> tuple[str, ...]:
    return tuple(axis.kind for axis in machine.axes.values())


@dataclass(frozen=True, slots=True)
class XWinderProgram:
    """A checked program; it can be read any number of times."""

    file: SourceFile
    machine: str
    axes: tuple[str, ...]
    kinds: tuple[str, ...]
    dropped: frozenset[str] = frozenset()

    def operations(self) -> Iterator[Operation]:
        """Return the operations from the start position."""
        return _Reading(self).run()


@dataclass(slots=True)
class _Reading:
    """The state of one reading, with lengths in m and angles in degrees."""

    program: XWinderProgram
    unit_m: float = 1e-3
    rpm: float = 0.0
    feed: float = 0.0  # units per second
    saved: dict[int, float] = field(default_factory=dict)
    at: dict[str, float] = field(default_factory=dict)  # position by axis letter, m or degrees
    idle: dict[str, int] = field(default_factory=dict)
    head_line: int = 0
    endless: int = 0
    ended: bool = False
    place: Place | None = None
    line: int = 0

    def run(self) -> Iterator[Operation]:
        self.at = dict.fromkeys(self.program.axes, 0.0)
        lines = Lines(self.program.file, self.program.file.begin, 1)
        while lines.more() and not self.ended:
            self.line, _, text = lines.take()
            self.place = self.program.file.place(self.line)
            code = _without_brackets(text, self.place).strip()
            if code and code[0] != "D":  # D: text for the display
                yield from self._step(code)
        yield Stop(True, self._source())

    def warnings(self) -> tuple[str, ...]:
        """Return warnings about the program, after a reading."""
        file = self.program.file
        texts = []
        if self.head_line:
            texts.append(
                f"{file.place(self.head_line)}: how fast the head turns (R) is not published; it "
                "turns evenly through each block here."
            )
        if self.endless:
            texts.append(
                f"{file.place(self.endless)}: G51 goes to and fro until the operator ends it; the "
                "job ends before it here."
            )
        if self.idle:
            words = ", ".join(f"{w} (line {line})" for w, line in self.idle.items())
            texts.append(f"{file.place()}: without effect on motion here, first seen: {words}.")
        return tuple(texts)

    def _source(self) -> Source:
        return Source(self.program.file.path, max(1, self.line))

    def _step(self, code: str) -> Iterator[Operation]:
        words = self._words(code)
        letter, number = words[0]
        if letter in "CX" or number is None:
            if letter not in "CX":
                raise self._error(f"{code[:40]!r} is no line of an X-Winder program")
            self._note(letter)  # decimal comma and version
            return
        if letter == "G" and number == 51:
            self.endless, self.ended = self.line, True
            return
        parameters = dict(words[1:])
        if len(parameters) != len(words) - 1:
            raise self._error(f"a word stands twice in {code[:40]!r}")
        if letter == "M":
            yield from self._m(number, parameters)
        elif letter == "G":
            yield from self._g(number, parameters, code)
        else:
            raise self._error(f"{code[:40]!r} is no line of an X-Winder program")

    def _words(self, code: str) -> list[tuple[str, float | None]]:
        words: list[tuple[str, float | None]] = []
        position = 0
        while position < len(code):
            match = _WORD.match(code, position)
            if match is None:
                raise self._error(
                    f"{code[position : position + 40]!r} is no word of an X-Winder program"
                )
            words.append((match[1], None if match[2] is None else float(match[2])))
            position = match.end()
            while position < len(code) and code[position] in " \t":
                position += 1
        return words

    def _m(self, code: float, parameters: dict[str, float | None]) -> Iterator[Operation]:
        if code == 0:
            yield Stop(False, self._source())
        elif code in (3, 4):
            rpm = self._number(parameters, "S")
            self.rpm = rpm if code == 4 else -rpm
        elif code == 5:
            self.rpm = 0.0
        elif code in _SAVE:
            self.saved[int(code)] = self.at["C"]
        elif code in _IDLE_M:
            self._note(_IDLE_M[int(code)])
        else:
            raise self._error(f"unknown word M{code:g}")

    def _g(
        self, code: float, parameters: dict[str, float | None], text: str
    ) -> Iterator[Operation]:
        if code in (20, 21):
            self.unit_m = 25.4e-3 if code == 20 else 1e-3
        elif code in (28, 90):
            self._note(f"G{code:g}")
        elif code == 4:
            yield from self._dwell(parameters)
        elif code == 1 and parameters and set(parameters) <= _ACCELERATIONS:
            self._note("G1 I J K N O T")
        elif code == 1:
            yield from self._move(parameters, text)
        else:
            raise self._error(f"unknown word G{code:g}")

    def _dwell(self, parameters: dict[str, float | None]) -> Iterator[Operation]:
        if "P" in parameters:
            yield from self._turning(_P_S * self._number(parameters, "P"))
            return
        angle = self._number(parameters, "C")
        if "L" in parameters:
            register = self._number(parameters, "L")
            if register not in self.saved:
                raise self._error(f"L{register:g} waits for an angle that no M{register:g} saved")
            angle = (self.saved[int(register)] + angle - self.at["C"]) % 360.0
        if self.rpm == 0.0:
            raise self._error("G4 C waits for a mandrel that does not turn", "Write M4 S first.")
        target = self._targets(parameters, "B")
        duration_s = angle / abs(6.0 * self.rpm)
        yield from self._go(target, duration_s)

    def _move(self, parameters: dict[str, float | None], text: str) -> Iterator[Operation]:
        unknown = set(parameters) - set("FZYBRESCA")
        if unknown:
            raise self._error(f"{text[:40]!r}: {min(unknown)} has no use in a move")
        if "F" in parameters:
            self.feed = self._number(parameters, "F")
        target = self._targets(parameters, "ZYB")
        if "C" in parameters:
            rpm = self._number(parameters, "S")
            duration_s = self._number(parameters, "C") / (6.0 * rpm)
            rpm_before, self.rpm = self.rpm, rpm
            yield from self._go(target, duration_s)
            self.rpm = rpm_before
            return
        speeds = {
            "Z": self.feed,
            "Y": self._number(parameters, "E") if "E" in parameters else self.feed,
        }
        times_s = [
            abs(target[name] - self.at[name]) / (speed * self.unit_m)
            for name, speed in speeds.items()
            if name in target and target[name] != self.at[name] and self._above_0(speed)
        ]
        yield from self._go(target, max(times_s, default=0.0))

    def _above_0(self, speed: float) -> bool:
        if speed <= 0.0:
            raise self._error("a move has no feed F above 0", "Give F.")
        return True

    def _targets(self, parameters: dict[str, float | None], letters: str) -> dict[str, float]:
        targets = {}
        for letter in letters:
            if letter not in parameters:
                continue
            value = self._signed(parameters, letter)
            if letter in self.program.dropped:
                self._note(letter)
                continue
            if letter not in self.at:
                if value:
                    raise self._error(
                        f"the machine {self.program.machine!r} has no axis {letter}",
                        f"Leave its words out (--axes {letter}=none), or choose another machine "
                        "(-m).",
                    )
                continue
            linear = self.program.kinds[self.program.axes.index(letter)] == "linear"
            targets[letter] = value * self.unit_m if linear else value
            if (
                letter == "B"
                and "R" in parameters
                and not self.head_line
                and targets["B"] != self.at["B"]
            ):
                self.head_line = self.line
        return targets

    def _turning(self, duration_s: float) -> Iterator[Operation]:
        if self.rpm == 0.0:
            yield Dwell(duration_s, self._source())
        else:
            yield from self._go({}, duration_s)

    def _go(self, target: dict[str, float], duration_s: float) -> Iterator[Operation]:
        """Yield the move to ``target`` in ``duration_s``, while the mandrel keeps turning."""
        moves = any(self.at[name] != value for name, value in target.items())
        turned_deg = 6.0 * self.rpm * duration_s
        self.at.update(target)
        self.at["C"] += turned_deg
        if not moves and not turned_deg:
            return
        position = tuple(
            self.at[name] if kind == "linear" else math.radians(self.at[name])
            for name, kind in zip(self.program.axes, self.program.kinds, strict=True)
        )
        feed = (
            Feed(FeedMode.INVERSE_TIME, 1.0 / duration_s)
            if duration_s > 0.0
            else Feed(FeedMode.RAPID, 0.0)
        )
        yield Move(position, feed, self._source())

    def _signed(self, parameters: dict[str, float | None], letter: str) -> float:
        value = parameters.get(letter)
        if value is None:
            raise self._error(f"{letter} has no number")
        return value

    def _number(self, parameters: dict[str, float | None], letter: str) -> float:
        """Return the number of a required word: not negative, and above 0 for S and L."""
        value = parameters.get(letter)
        if value is None or value < 0.0 or (value == 0.0 and letter in "SL"):
            fault = "no number" if value is None else f"{value:g}"
            raise self._error(f"the word {letter} has {fault}", f"Write {letter} and a number.")
        return value

    def _note(self, word: str) -> None:
        if len(self.idle) < 100:
            self.idle.setdefault(word, self.line)

    def _error(self, message: str, remedy: str = "Correct it.") -> JobError:
        return JobError(message, place=self.place, remedy=remedy)


def _without_brackets(text: str, place: Place) -> str:
    """Return a line without its comments in brackets."""
    code = re.sub(r"\[[^\[\]]*\]", " ", text)
    if "[" in code or "]" in code:
        raise JobError(
            "a comment in brackets is not closed, or not opened",
            place=place,
            remedy="Put it between one [ and one ] on the line.",
        )
    return code
