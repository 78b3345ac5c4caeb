"""Zeros of part programs: G92 to G92.3, the home of G28.1, G53 to G59, and tool lengths.

The control stores the zero of each coordinate system; the program does not have it. A program that
uses only one system is read as if in G54, with its zero at the start position. A program that uses
several systems, or G53, needs their zeros in machine coordinates (``[programs.offsets]``). The same
holds for tool lengths: a program that needs their numbers takes them from ``[programs.lengths]``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NoReturn

from threadline.errors import JobError
from threadline.jobs.gcode.block import SET_NATIVE, SHIFT, Block
from threadline.jobs.gcode.dialects import Reading
from threadline.jobs.gcode.textfile import SourceFile
from threadline.jobs.gcode.words import ONE
from threadline.machine import Machine

FIRST, MACHINE = 540, 530
SYSTEMS = range(540, 600, 10)
LENGTH, NO_LENGTH = 430, 490
TURN = 360 * ONE
_FINE = 10**7  # steps per millimetre or degree, as in plain blocks
_OTHER_ZEROS_REMEDY = (
    'Name the zero of each in the machine file, like [programs.offsets] G54 = { X = "0 mm exact, '
    'assumed" }, or give each a program of its own.'
)
_LENGTHS_REMEDY = (
    "Or give the lengths of the tools in the machine file, like [programs.lengths] H1 = "
    '"50 mm exact, assumed", and write G43 with its H.'
)


@dataclass(slots=True)
class SystemsUsed:
    """The coordinate systems in which a file moves; the scan fills them in.

    Attributes
    ----------
    lines
        First line of a move in each system, by ten times the number of its G word.
    """

    lines: dict[int, int] = field(default_factory=dict)
    now: int = FIRST

    def take(self, settings: Sequence[int], line: int, *, moves: bool) -> None:
        """Note the G words of a block, and whether the block moves the axes."""
        for code in settings:
            if code in SYSTEMS:
                self.now = code
        if moves:
            self.lines.setdefault(MACHINE if MACHINE in settings else self.now, line)


def moves_length(block: Block, reading: Reading, *, calls: bool = False) -> bool:
    """Say whether a block moves the axis Z, which a tool length shifts; without Z, any axis.

    ``calls`` says that the block calls a subroutine, whose moves are not known here.
    """
    z = reading.axes.get("Z")
    named = {index for index, _ in block.axes}
    if block.action == 280:
        return z is None or not named or z in named
    return calls or (block.goes and (z is None or z in named))


@dataclass(slots=True)
class ToolLengths:
    """The tool lengths (G43) in force while a file is scanned or run.

    A length that the machine file gives is read exactly. Any other length is known only to the
    control. If such a length holds for all moves of Z, it only shifts the zero, which is at the
    start position here, as for G54; any other use is refused. Moves of other axes may come before:
    posts first move over the place, and then down.

    Parameters
    ----------
    file
        The file, for errors.
    known
        Exact lengths in the machine file, by the words that take them.

    Attributes
    ----------
    line
        First line with a G43 of unknown length, 0 without one.
    """

    file: SourceFile
    known: Mapping[str, int] = field(default_factory=dict)
    line: int = 0
    _now: str = ""
    _left: int = 0  # line of a G49 that ended a tool length
    _shifted_by: int = 0  # line of the first move of Z
    _machine: int = 0  # line of the first move of Z by G53

    def take(
        self, length: str, settings: Sequence[int], line: int, *, moves: bool, later: bool
    ) -> None:
        """Take a block: its G43 as written or empty, its G words, and whether the block moves Z.

        ``later`` says that the block is not in the first program of its file.

        Raises
        ------
        JobError
            If an unknown tool length begins or ends between moves of Z, or in a subroutine, or
            stands beside moves of Z by G53.
        """
        if length in self.known:
            if self.line:
                self._refuse(f"{length} ends the tool length of line {self.line}", line)
        elif length and (length != self._now or later) and (self._shifted_by or later):
            self._refuse(f"{length} begins it", line)
        if length:
            self._now, self._left = length, 0
            self.line = self.line or (0 if length in self.known else line)
        elif NO_LENGTH in settings and self._now in self.known:
            self._now = ""
        elif NO_LENGTH in settings and self._now:
            self._left = line
            if later:
                self._refuse("G49 ends it", line)
        if moves:
            self._shifted_by = self._shifted_by or line
            self._machine = self._machine or (line if MACHINE in settings else 0)
        if moves and self._left:
            self._refuse(f"G49 on line {self._left} ends it", line)
        if self._machine and self.line:
            raise JobError(
                "G53 goes to a place of the machine, and how far the tool length of G43 "
                f"(line {self.line}) shifts Z from there the control alone knows",
                place=self.file.place(self._machine),
                remedy=_LENGTHS_REMEDY,
            )

    def _refuse(self, event: str, line: int) -> NoReturn:
        retract = "."
        if self._shifted_by and not self.line:
            retract = (
                f" (leave out the move on line {self._shifted_by}, if it only lifts the tool to "
                "change "
                "it)."
            )
        raise JobError(
            f"G43 is compensation of the tool's length: {event} between moves of Z, and how far it "
            "shifts them the control alone knows",
            place=self.file.place(line),
            remedy=f"Write one G43 before the first move of Z, or a program for each tool{retract} "
            + _LENGTHS_REMEDY,
        )


def zeros_of(
    used: SystemsUsed, machine: Machine, file: SourceFile
) -> Mapping[int, tuple[int, ...]]:
    """Return the exact (axes,) zero of each used system, relative to the zero of the first one.

    Raises
    ------
    JobError
        If the file uses several systems and the machine file lacks the zero of one.
    """
    first = next((code for code in used.lines if code != MACHINE), FIRST)
    if set(used.lines) <= {first}:
        return {}
    zeros = {MACHINE: (0,) * len(machine.axis_names)}
    for code in {first, *used.lines} - {MACHINE}:
        name = f"G{code // 10}"
        offset = machine.programs.offsets.get(name)
        if offset is None:
            line = max(used.lines.values())
            names = " and ".join(f"G{code_used // 10}" for code_used in used.lines)
            raise JobError(
                f"the program moves by {names}: only the control knows how far {name} is from the "
                "machine's zero",
                place=file.place(line),
                remedy=_OTHER_ZEROS_REMEDY,
            )
        zeros[code] = tuple(
            _exact(
                offset[axis].si
                * (1e3 if machine.axes[axis].kind == "linear" else math.degrees(1.0))
            )
            if axis in offset
            else 0
            for axis in machine.axis_names
        )
    begin = zeros[first]
    return {
        code: tuple(value - zero for value, zero in zip(values, begin, strict=True))
        for code, values in zeros.items()
    }


def tool_lengths(machine: Machine, axes: Mapping[str, int]) -> Mapping[str, int]:
    """Return the exact lengths of the machine file, mm, by the words that take them (``G43 H1``).

    ``axes`` are the indices of the axes by their letters in the program; a program without a linear
    Z has no lengths.
    """
    z = axes.get("Z")
    if z is None or machine.axes[machine.axis_names[z]].kind != "linear":
        return {}
    return {f"G43 {tool}": _exact(1e3 * long.si) for tool, long in machine.programs.lengths.items()}


def _exact(value: float) -> int:
    return round(value * _FINE) * (ONE // _FINE)


_HOME, _SUSPEND, _RESTORE = 281, 922, 923


class Zeros:
    """Zeros and home position of ``axes`` axes, exact in units of 10**-18 mm or degrees.

    Attributes
    ----------
    offset
        Position of the programmed zero.
    home
        Target position of G28.
    machine
        Zero of the machine coordinates.
    saved_offset
        Shift of G92, which G92.3 restores; G92.2 suspends the shift and keeps it here.
    shifted
        Indices of the axes that a G92 has named.

    Parameters
    ----------
    systems
        Zero of each work coordinate system and of the machine coordinates, by ten times the number
        of the G word; empty if a program uses only one system.
    """

    def __init__(self, axes: int, systems: Mapping[int, tuple[int, ...]]) -> None:
        self.offset = [0] * axes
        self.machine = systems.get(MACHINE, (0,) * axes)
        self._systems = systems
        self._system: tuple[int, ...] = (0,) * axes
        self._length = (0,) * axes
        self._base: Sequence[int] = self._system  # the system, shifted by the tool length
        self.home = [0] * axes
        self.saved_offset = [0] * axes
        self.shifted: set[int] = set()

    def take(self, code: int, at: Sequence[int], assigned: Mapping[int, int]) -> None:
        """Apply a G word (ten times its number) at the position ``at``.

        Parameters
        ----------
        assigned
            Programmed position that G92 assigns to the present position, by axis index.
        """
        if code == _HOME:
            self.home = list(at)
        elif code in (SHIFT, SET_NATIVE):
            if code == SHIFT:
                self.shifted.update(assigned)
            self.offset = [
                at[index] - assigned[index] if index in assigned else offset
                for index, offset in enumerate(self.offset)
            ]
            self.saved_offset = _shifted_by(self.offset, self._base, -1)
        elif code == _RESTORE:
            self.offset = _shifted_by(self.saved_offset, self._base, 1)
        else:
            if code != _SUSPEND:
                self.saved_offset = [0] * len(self.offset)
            self.offset = list(self._base)

    def choose(self, code: int) -> None:
        """Select a work coordinate system (ten times its G number); the shift of G92 stays."""
        self._system = self._systems.get(code, self._system)
        self._shift()

    def within_turn(self, index: int, angle: int, at: int, *, back: bool) -> int:
        """Return the position of an axis, now at ``at``, that turns to ``angle``, 0 to a turn.

        The sign of the word is the direction (``back``), not a part of the angle. Source:
        ``unwrap_rotary`` of LinuxCNC 2.9, ``interp_find.cc``; ``rs274`` is compared with it.
        """
        present = at - self.offset[index]
        target = angle + present // TURN * TURN
        if not back and target < present:
            target += TURN
        elif back and target > present:
            target -= TURN
        return self.offset[index] + target

    def lengthen(self, index: int, length: int) -> None:
        """Take the tool length ``length`` along an axis; the shift of G92 stays."""
        self._length = tuple(length if k == index else 0 for k in range(len(self.offset)))
        self._shift()

    def _shift(self) -> None:
        base = _shifted_by(self._system, self._length, 1)
        self.offset = _shifted_by(_shifted_by(self.offset, self._base, -1), base, 1)
        self._base = base


def _shifted_by(values: Sequence[int], shift: Sequence[int], times: int) -> list[int]:
    return [value + times * step for value, step in zip(values, shift, strict=True)]
