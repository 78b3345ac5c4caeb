"""Zeros of part programs: G92 to G92.3, the home of G28.1, G53 to G59, and tool lengths.

Where a system has its zero is kept in the control, and is not in the program. A program that moves
in one system alone is read with its zero there, as one in G54 is. One that moves in several, or by
G53, needs to be told where they are in the machine's own (``[programs.offsets]``).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NoReturn

from threadline.errors import JobError
from threadline.jobs.gcode.textfile import SourceFile
from threadline.jobs.gcode.words import ONE
from threadline.machine import Machine

FIRST, MACHINE = 540, 530
SYSTEMS = range(540, 600, 10)
LENGTH, NO_LENGTH = 430, 490
_FINE = 10**7  # parts of a millimetre or degree, as fine as plain blocks are read
_OTHERS = (
    'Name the zero of each in the machine file, like [programs.offsets] G54 = { X = "0 mm exact, '
    'assumed" }, or give each a program of its own.'
)


@dataclass(slots=True)
class SystemsUsed:
    """The coordinate systems in which a file moves, noted as it is scanned.

    Attributes
    ----------
    lines
        The first line of a move in each, by ten times its G word.
    """

    lines: dict[int, int] = field(default_factory=dict)
    now: int = FIRST

    def take(self, settings: Sequence[int], line: int, *, moves: bool) -> None:
        """Note the G words of a block, and whether it moves."""
        for code in settings:
            if code in SYSTEMS:
                self.now = code
        if moves:
            self.lines.setdefault(MACHINE if MACHINE in settings else self.now, line)


@dataclass(slots=True)
class ToolLengths:
    """The tool lengths (G43) in force, noted as a file is scanned or run.

    How long a tool is the control alone knows. One that holds for all moves is a matter of where
    the zero lies, which is at the start position here, as that of G54 is; another is refused.

    Parameters
    ----------
    file
        The file, for errors.

    Attributes
    ----------
    line
        The first line with G43, 0 without one.
    """

    file: SourceFile
    line: int = 0
    _now: str = ""
    _left: int = 0  # the line of G49 behind moves
    _moved: bool = False

    def take(
        self, length: str, settings: Sequence[int], line: int, *, moves: bool, later: bool
    ) -> None:
        """Take a block: its G43 as written or nothing, its G words, and whether it moves.

        ``later`` says that it stands in another program than the first of its file.

        Raises
        ------
        JobError
            If a tool length is taken or left between moves, or in a subroutine.
        """
        if length and (length != self._now or later) and (self._moved or later):
            self._refuse(f"{length} begins it", line)
        if length:
            self._now, self._left = length, 0
            self.line = self.line or line
        elif NO_LENGTH in settings and self._now:
            self._left = line
            if later:
                self._refuse("G49 ends it", line)
        self._moved = self._moved or moves
        if moves and self._left:
            self._refuse(f"G49 on line {self._left} ends it", line)

    def _refuse(self, what: str, line: int) -> NoReturn:
        raise JobError(
            f"G43 is compensation of the tool's length: {what} between moves, and how far it "
            "shifts them the control alone knows",
            place=self.file.place(line),
            remedy="Write one G43 before the first move, or a program for each tool.",
        )


def zeros_of(
    used: SystemsUsed, machine: Machine, file: SourceFile
) -> Mapping[int, tuple[int, ...]]:
    """Return the exact (axes,) zero of each system that is used, from that of the first one.

    Raises
    ------
    JobError
        If there are several and the machine file does not say where one is.
    """
    first = next((code for code in used.lines if code != MACHINE), FIRST)
    if set(used.lines) <= {first}:
        return {}
    found = {MACHINE: (0,) * len(machine.axis_names)}
    for code in {first, *used.lines} - {MACHINE}:
        name = f"G{code // 10}"
        told = machine.programs.offsets.get(name)
        if told is None:
            line = max(used.lines.values())
            names = " and ".join(f"G{one // 10}" for one in used.lines)
            raise JobError(
                f"the program moves by {names}: how far {name} is from the machine's zero, the "
                "control alone knows",
                place=file.place(line),
                remedy=_OTHERS,
            )
        found[code] = tuple(
            _exact(
                told[axis].si * (1e3 if machine.axes[axis].kind == "linear" else math.degrees(1.0))
            )
            if axis in told
            else 0
            for axis in machine.axis_names
        )
    begin = found[first]
    return {
        code: tuple(value - zero for value, zero in zip(values, begin, strict=True))
        for code, values in found.items()
    }


def _exact(value: float) -> int:
    return round(value * _FINE) * (ONE // _FINE)


_HOME, _SHIFT, _SUSPEND, _RESTORE = 281, 920, 922, 923


class Zeros:
    """Positions on the machine for a number of ``axes``, as exact 10**-18 mm or degrees.

    Attributes
    ----------
    offset
        Position of the programmed zero.
    home
        Position to which G28 moves.
    machine
        Zero of the machine's own system.
    kept
        What G92 has shifted, for G92.3, while G92.2 has set it aside, too.

    Parameters
    ----------
    systems
        Zero of each work coordinate system, by ten times its G word, and of the machine; none where
        a program uses one system alone.
    """

    def __init__(self, axes: int, systems: Mapping[int, tuple[int, ...]]) -> None:
        self.offset = [0] * axes
        self.machine = systems.get(MACHINE, (0,) * axes)
        self._systems = systems
        self._system = (0,) * axes
        self.home = [0] * axes
        self.kept = [0] * axes

    def take(self, code: int, at: Sequence[int], given: Mapping[int, int]) -> None:
        """Apply a G word, given as ten times its number, at the position ``at``.

        Parameters
        ----------
        given
            Programmed positions that G92 gives the present position, by the index of the axis.
        """
        if code == _HOME:
            self.home = list(at)
        elif code == _SHIFT:
            self.offset = [
                at[index] - given[index] if index in given else offset
                for index, offset in enumerate(self.offset)
            ]
            self.kept = _moved(self.offset, self._system, -1)
        elif code == _RESTORE:
            self.offset = _moved(self.kept, self._system, 1)
        else:
            if code != _SUSPEND:
                self.kept = [0] * len(self.offset)
            self.offset = list(self._system)

    def choose(self, code: int) -> None:
        """Go over to a work coordinate system, ten times its G word; what G92 shifted stays."""
        system = self._systems.get(code, self._system)
        self.offset = _moved(_moved(self.offset, self._system, -1), system, 1)
        self._system = system


def _moved(values: Sequence[int], by: Sequence[int], times: int) -> list[int]:
    return [value + times * way for value, way in zip(values, by, strict=True)]
