"""The programs of a file: their first and last lines, their calls, their numbers of operations.

One pass over the file finds every mistake that shows without following the calls. The number of
moves is multiplied by the passes, so ``L 1000000000`` is refused at once.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from threadline.errors import JobError
from threadline.jobs.gcode.block import Block, parse_line
from threadline.jobs.gcode.dialects import Reading
from threadline.jobs.gcode.textfile import Chunk, Lines, SourceFile
from threadline.jobs.gcode.words import TAPE

MAX_DEPTH = 99
_MAX_PROGRAMS = 100_000


@dataclass(slots=True)
class Call:
    """All calls of one subroutine from one program: the first line, and the sum of passes."""

    line: int
    passes: int


@dataclass(slots=True)
class Program:
    """One program of the file; the scan fills it in.

    Parameters
    ----------
    label
        O number, None for a main program without one.
    offset, line
        First byte, and first line, from 1.
    end
        Byte after the last line of the program.
    ends_with
        Number of the M word that ends the program: 99, 2 or 30; None while the program is open.
    moves
        Number of the program's own moves, without the moves of subroutines.
    closes
        Line of the last end of the program; lines after earlier ends run (grbl).
    stops
        Number of the program's own stops, dwells and tool events.
    calls
        Calls of each subroutine, by its O number.
    """

    label: int | None
    offset: int
    line: int
    end: int = 0
    ends_with: int | None = None
    moves: int = 0
    closes: int = 0
    stops: int = 0
    calls: dict[int, Call] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Name of the program in messages."""
        return "the program" if self.label is None else f"O {self.label}"


@dataclass(frozen=True, slots=True)
class Totals:
    """Numbers of moves and other operations of a program, with all its calls."""

    moves: int
    others: int

    @property
    def operations(self) -> int:
        """Number of all operations."""
        return self.moves + self.others


@dataclass(frozen=True, slots=True)
class Structure:
    """The programs of a file, and the main program that the operator starts."""

    programs: dict[int, Program]
    main: Program
    totals: dict[int | None, Totals]


class Collector:
    """Collects the programs of a file in their order."""

    def __init__(self, file: SourceFile) -> None:
        self._file = file
        self._programs: dict[int, Program] = {}
        self._mains: list[Program] = []
        self._unnamed: Program | None = None
        self.current: Program | None = None

    def begin(self, label: int | None, offset: int, line: int) -> Program:
        """Begin a program with its label, first byte and first line.

        Raises
        ------
        JobError
            If the previous program has no end, or the label is taken.
        """
        self._refuse_open_program(line)
        if label is not None and label in self._programs:
            raise JobError(
                f"O {label} is defined twice, first on line {self._programs[label].line}",
                place=self._file.place(line),
                remedy="Give one of them another number.",
            )
        if len(self._programs) >= _MAX_PROGRAMS:
            raise JobError(
                f"the file has more than {_MAX_PROGRAMS} programs", place=self._file.place(line)
            )
        self.current = Program(label, offset, line)
        if label is None:
            self._unnamed = self.current
        else:
            self._programs[label] = self.current
        return self.current

    def end(self, code: int, offset: int) -> None:
        """End the current program with M99, M2 or M30, in the line before byte ``offset``."""
        assert self.current is not None
        self.current.end = offset
        self.current.ends_with = code
        if code != 99:
            self._mains.append(self.current)
        self.current = None

    def _refuse_open_program(self, line: int) -> None:
        if self.current is not None:
            raise JobError(
                f"{self.current.name}, begun on line {self.current.line}, has no end before the "
                "next program",
                place=self._file.place(line),
                remedy="Close a subroutine with M99, a main program with M30.",
            )

    def finish(self, line: int) -> Structure:
        """Return the structure once the file has been read to its last ``line``.

        Raises
        ------
        JobError
            If the last program is open, there is no single main program, a subroutine is
            missing or has the wrong end, or a program calls itself.
        """
        file = self._file
        if self.current is not None:
            raise JobError(
                f"{self.current.name}, begun on line {self.current.line}, has no end: the file "
                "may be truncated",
                place=file.place(line),
                remedy="Close a subroutine with M99, a main program with M30.",
            )
        if not self._programs and self._unnamed is None:
            raise JobError(
                "the file holds no block", place=file.place(), remedy="Name a file with a program."
            )
        if not self._mains:
            raise JobError(
                "the file has subroutines only: no program ends with M30",
                place=file.place(),
                remedy="Add a main program that calls them with M98 and ends with M30.",
            )
        if len(self._mains) > 1:
            second = self._mains[1]
            raise JobError(
                f"two main programs end with M30 or M2: {self._mains[0].name} and {second.name}",
                place=file.place(second.line),
                remedy="Close subroutines with M99, or give each program a file of its own.",
            )
        totals = self._count()
        return Structure(self._programs, self._mains[0], totals)

    def _count(self) -> dict[int | None, Totals]:
        """Return the totals of every program, with its calls multiplied by their passes."""
        totals: dict[int | None, Totals] = {}
        programs = list(self._programs.values())
        if self._unnamed is not None:
            programs.append(self._unnamed)
        for program in programs:
            self._total(program, (), totals)
        return totals

    def _total(
        self, program: Program, callers: tuple[Program, ...], totals: dict[int | None, Totals]
    ) -> Totals:
        if program.label in totals:
            return totals[program.label]
        chain = (*callers, program)
        moves, others = program.moves, program.stops
        for label, call in program.calls.items():
            callee = self._callee(label, call, program)
            if callee in chain:
                names = " -> ".join(p.name for p in (*chain[chain.index(callee) :], callee))
                raise JobError(
                    f"{callee.name} calls itself without end: {names}",
                    place=self._file.place(call.line),
                    remedy="Take one of the calls out.",
                )
            if callee.ends_with != 99:
                raise JobError(
                    f"subroutine {callee.name} ends with M{callee.ends_with} and not with M99",
                    place=self._file.place(call.line),
                    remedy="Close it with M99.",
                )
            if len(chain) > MAX_DEPTH:
                raise JobError(
                    f"calls are nested more than {MAX_DEPTH} deep",
                    place=self._file.place(call.line),
                )
            callee_totals = self._total(callee, chain, totals)
            moves += call.passes * callee_totals.moves
            others += call.passes * callee_totals.others
        totals[program.label] = Totals(moves, others)
        return totals[program.label]

    def _callee(self, label: int, call: Call, caller: Program) -> Program:
        callee = self._programs.get(label)
        place = self._file.place(call.line)
        if callee is None:
            known = ", ".join(f"O {p}" for p in list(self._programs)[:5] if p != caller.label)
            raise JobError(
                f"subroutine O {label} does not exist",
                place=place,
                remedy=f"The file has {known or 'no other program'}.",
            )
        return callee


_CACHED_BYTES = 1 << 21
_CACHED_BLOCKS = 10_000


@dataclass(slots=True)
class Frame:
    """An open program: its present pass, its number of passes, and its next line."""

    program: Program
    lines: Lines
    pass_: int
    passes: int
    calls: int = 1  # number of times that the call happens
    line: int = 0  # line of the call in the main program
    folded: int = 1  # number of passes that the present pass stands for
    start: tuple[int, ...] = ()  # exact position and zeros at the start of the folded pass

    @property
    def times(self) -> int:
        """Number of times that an operation of the present pass happens."""
        return self.calls * self.folded

    def fold_rest(self, start: tuple[int, ...]) -> None:
        """Let the pass that begins at ``start`` stand for itself and all later passes."""
        self.folded = self.passes - self.pass_ + 1
        self.pass_ = self.passes
        self.start = start


class CachedText:
    """The lines of programs; short programs, and the blocks of loops, stay in memory.

    Parameters
    ----------
    file, reading
        The file, and the axes and dialect for reading its blocks.
    """

    def __init__(self, file: SourceFile, reading: Reading) -> None:
        self._file = file
        self._reading = reading
        self._cache: dict[int | None, Chunk] = {}
        self._cached_bytes = 0
        self._parsed: dict[int, tuple[Block, ...]] = {}

    def lines_of(self, program: Program) -> Lines:
        """Return the lines of a program."""
        size = program.end - program.offset
        chunk_cached = self._cache.get(program.label)
        if chunk_cached is None and self._cached_bytes + size <= _CACHED_BYTES:
            chunks = self._file.chunks(program.offset, max(size, 1), program.end)
            chunk_cached = Chunk(program.offset, b"".join(chunk.data for chunk in chunks))
            self._cache[program.label] = chunk_cached
            self._cached_bytes += size
        return Lines(self._file, program.offset, program.line, chunk_cached)

    def next_line(self, lines: Lines, looping: bool) -> tuple[Block, ...]:
        """Return the blocks on the next line, none for a line without words.

        Raises
        ------
        JobError
            If the line is no block of the dialect.
        """
        offset = lines.offset
        if looping and offset in self._parsed:
            lines.skip()
            return self._parsed[offset]
        number, _, text = lines.take()
        blocks = () if text.strip() == TAPE else parse_line(text, number, self._reading)
        if looping and len(self._parsed) < _CACHED_BLOCKS:
            self._parsed[offset] = blocks
        return blocks
