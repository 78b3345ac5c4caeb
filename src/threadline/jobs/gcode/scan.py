"""The first pass over a part program, which collects data for warnings and budgets."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from threadline.errors import JobError
from threadline.jobs.gcode.block import CHANGE, Block, parse_line
from threadline.jobs.gcode.dialects import Reading
from threadline.jobs.gcode.feeds import FeedNotes
from threadline.jobs.gcode.plain_blocks import MOTION, RAPID_F, STEPS, plain_reader
from threadline.jobs.gcode.printer_lines import number_of_line
from threadline.jobs.gcode.subprograms import Call, Collector, Program, Structure
from threadline.jobs.gcode.textfile import Lines, SourceFile
from threadline.jobs.gcode.words import ONE, READ_TO_TAPE, TAPE, Tapes
from threadline.jobs.gcode.zeros import FIRST, SystemsUsed, ToolLengths, moves_length

MAX_REMEMBERED = 1000
_LONG_DWELL_S = 20.0  # pens, valves and spindles take less


@dataclass(slots=True)
class Findings:
    """The data that the scan collects for warnings and budgets.

    Parameters
    ----------
    feeds
        Every F, with the modes and calls that set its unit.
    long_dwells
        Times of dwells that look like milliseconds, by line.
    blends
        Lines of G64.
    idle
        First line of each word without effect on motion.
    waits
        First line that waits for a temperature; 0 without one.
    changes
        First line with M6; 0 without one.
    anew
        Lines of M2 and M30 after which later lines run.
    rapid_f
        First line with both G0 and F; 0 without one.
    unset
        First line that reads each parameter before the program sets it.
    doubtful
        First line that compares numbers so close that versions of the control give different
        results; 0 without one.
    tape
        First line with a % that the control refuses; 0 without one.
    length
        First line with G43; 0 without one.
    limits, decel
        First line that sets limits of velocity or acceleration, and the first with
        ACCEL_TO_DECEL; 0 without one.
    macros
        First line of each macro that is left out.
    """

    feeds: FeedNotes = field(default_factory=FeedNotes)
    long_dwells: dict[int, float] = field(default_factory=dict)
    blends: list[int] = field(default_factory=list)
    idle: dict[str, int] = field(default_factory=dict)
    waits: int = 0
    changes: int = 0
    anew: list[int] = field(default_factory=list)
    rapid_f: int = 0
    unset: dict[int, int] = field(default_factory=dict)
    doubtful: int = 0
    tape: int = 0
    length: int = 0
    limits: int = 0
    decel: int = 0
    macros: dict[str, int] = field(default_factory=dict)

    def note(self, program: int | None, block: Block) -> None:
        """Note the parts of a block that may need a warning."""
        for code in block.settings:
            self.feeds.set_mode(program, code)
            if code == 640 and len(self.blends) < MAX_REMEMBERED:
                self.blends.append(block.line)
        if block.feed is not None:
            self.feeds.feed(program, block.feed, block.line)
        if block.action == 40 and block.dwell_s >= _LONG_DWELL_S:
            self.long_dwells[block.line] = block.dwell_s
        for word in block.idle:
            if len(self.idle) < MAX_REMEMBERED:
                self.idle.setdefault(word, block.line)
        if block.program == CHANGE and not self.changes:
            self.changes = block.line
        if block.limits is not None and not self.limits:
            self.limits = block.line
        if block.limits is not None and "ACCEL_TO_DECEL" in block.acts[0].upper():
            self.decel = self.decel or block.line
        if block.macro and len(self.macros) < MAX_REMEMBERED:
            self.macros.setdefault(block.macro, block.line)
        if block.waits and block.idle and not self.waits:
            self.waits = block.line


class Scanner:
    """Scans the blocks of a file in their order."""

    def __init__(self, file: SourceFile, reading: Reading) -> None:
        self.findings = Findings()
        self._file = file
        self._reading = reading
        self._programs = Collector(file)
        self._plain = plain_reader(reading, (True,) * len(reading.names), follow=False)
        self.systems = SystemsUsed()
        self._lengths = ToolLengths(file, reading.lengths)
        self._program_end: tuple[Block, int] | None = None  # ending block, next byte
        first_line_only = reading.dialect.grammar.tape == "first"
        self._tapes = Tapes(file, reading.dialect.name if first_line_only else "")
        self._begun = False
        self._later = False  # the current program is not the first of its file
        self._numbered: int | None = 0  # N of the last numbered line

    def run(self) -> Structure:
        """Read the file once and return its programs.

        Raises
        ------
        JobError
            If a line is no block of the dialect (the first such line), or the programs do not fit
            together.
        """
        lines = Lines(self._file, self._file.begin, 1)
        while lines.more():
            program = self._programs.current
            if program is not None and self._plain.worth_trying():
                count = self._plain.read(lines)
                if count:
                    self._go_on(program)
                program.moves += count
                self._note_plain(program.label, count)
                if count or not lines.more():
                    continue
            number, offset, text = lines.take()
            if text.strip() == TAPE:
                self._tapes.take(number, self._begun)
                continue
            self._tapes.pass_by(text)
            self._check_number(text, number)
            for block in parse_line(text, number, self._reading):
                self._take(block, offset, lines.offset)
        number = max(1, lines.number - 1)
        program = self._programs.current
        dialect = self._reading.dialect
        ended = program is None or self._program_end is not None
        if program is not None and self._program_end is not None:
            block, next_byte = self._program_end
            program.closes = block.line
            self._programs.end(block.program, next_byte)
        elif program is not None and not dialect.needs_end:
            program.stops += 1
            program.closes = number + 1
            self._programs.end(30, lines.offset)
        self._tapes.finish(number, ended=ended and dialect.name not in READ_TO_TAPE)
        if dialect.grammar.tape == "refused":
            self.findings.tape = self._tapes.first
        self.findings.length = self._lengths.line
        self.findings.rapid_f = int(self._plain.state[RAPID_F])
        return self._programs.finish(number)

    def _check_number(self, text: str, line: int) -> None:
        """Refuse a line number that is out of order: the firmware would ask for the line again."""
        if not self._reading.dialect.grammar.numbers_up:
            return
        number = number_of_line(text)
        if "M110" in text:  # M110 sets the line number
            self._numbered = None
            return
        if number is None:
            return
        if self._numbered is not None and number != self._numbered + 1:
            raise JobError(
                f"N{number} where {self._reading.dialect.name} waits for N{self._numbered + 1}: it "
                "does not run the line",
                place=self._file.place(line),
                remedy="Take the N words and the checksums out: the program that sends the file "
                "writes its own.",
            )
        self._numbered = number

    def _take(self, block: Block, offset: int, next_byte: int) -> None:
        self._tapes.check(block.line)
        programs = self._programs
        if block.label >= 0:
            self._later = self._begun
            programs.begin(block.label, offset, block.line)
            # The system that the caller chose is not known here. A move before the program's own
            # G54 to G59 counts for the first system; if the file uses another system, too, the
            # machine file must give both zeros.
            self.systems.now = FIRST
        elif programs.current is None:
            if self._begun:
                if not self._reading.dialect.needs_end and _only_ends(block):
                    return  # post-processors for lasers write the end twice
                raise JobError(
                    "a block after the end of a program is never run",
                    place=self._file.place(block.line),
                    remedy="Begin another program with an O number, or take it out.",
                )
            programs.begin(None, offset, block.line)
        self._begun = True
        program = programs.current
        assert program is not None
        if self._program_end is not None:
            if _only_ends(block):
                return
            self._go_on(program)
        moves = block.goes
        self.systems.take(block.settings, block.line, moves=moves)
        lifts = moves_length(block, self._reading, calls=block.program == 98)
        self._lengths.take(block.length, block.settings, block.line, moves=lifts, later=self._later)
        if block.action == 280:
            program.moves += 2
        elif moves:
            program.moves += 1
        program.stops += (block.action == 40) + (bool(block.acts) or block.waits)
        program.stops += block.ends == "end"
        self._note(program.label, block)
        if block.program == 98:
            assert block.p is not None
            self.findings.feeds.call(program.label, block.p // ONE, block.passes or 1)
            call = program.calls.setdefault(block.p // ONE, Call(block.line, 0))
            call.passes += block.passes or 1
        elif block.ends == "end" and program.label is None and self._reading.dialect.streams:
            self._program_end = block, next_byte
        elif block.ends in {"end", "return"}:
            programs.end(block.program, next_byte)

    def _go_on(self, program: Program) -> None:
        """Go on after M2 or M30 in a dialect in which they only reset the modes."""
        if self._program_end is None:
            return
        self.findings.anew.append(self._program_end[0].line)
        del self.findings.anew[MAX_REMEMBERED:]
        self.findings.feeds.set_mode(program.label, 940)
        self._plain.state[MOTION] = 1
        self.systems.now = FIRST
        self._program_end = None

    @property
    def moved_axes(self) -> list[int]:
        """Indices of the axes that the file names."""
        return [int(index) for index in np.flatnonzero(self._plain.used)]

    def _note_plain(self, program: int | None, count: int) -> None:
        """Note the results of the plain reader for ``count`` blocks of a program."""
        plain = self._plain
        if count:
            line = int(plain.out_line[0])
            self.systems.take((), line, moves=True)
            z = self._reading.axes.get("Z")
            lifts = z is None or bool(plain.used[z])
            self._lengths.take("", (), line, moves=lifts, later=False)
        (with_word,) = np.nonzero(plain.out_word[:count] >= 0)
        words, first = np.unique(plain.out_word[with_word], return_index=True)
        for word, row in zip(words.tolist(), with_word[first].tolist(), strict=True):
            line = int(plain.out_line[row])
            self.findings.feeds.feed(program, word * (ONE // STEPS), line)

    def _note(self, program: int | None, block: Block) -> None:
        """Note the parts of a block that may need a warning, and the state of the plain reader."""
        self.findings.note(program, block)
        for index, _ in block.axes:
            self._plain.used[index] = True
        state = self._plain.state
        if block.motion >= 0:
            state[MOTION] = block.motion
        if block.feed is not None and block.axes and state[MOTION] == 0 and not state[RAPID_F]:
            state[RAPID_F] = block.line


def _only_ends(block: Block) -> bool:
    """Say whether a block ends a program and does nothing else."""
    moves = block.axes or block.action != -1 or block.motion != -1
    return block.ends == "end" and not (moves or block.settings or block.feed is not None)
