"""A run over the lines of a program: the order of the lines, and the limit on their number."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NoReturn

from threadline.errors import JobError, Place
from threadline.jobs.gcode.dialects import Flavour
from threadline.jobs.gcode.parametric.flow import Flow, Step
from threadline.jobs.gcode.parametric.formulas import Formula, FormulaReader
from threadline.jobs.gcode.parametric.parameters import Values
from threadline.jobs.gcode.parametric.statements import Code, Statement, statement
from threadline.jobs.gcode.words import RawBlock

MOST_LINES = 1_000_000
"""Most lines that a run may repeat."""
MOST_IDLE = 100_000
"""Most lines that may run in sequence without a move."""
_MOST_CACHED = 100_000


class Run:
    """One run of a program.

    Parameters
    ----------
    codes
        Lines of the program.
    flow
        Order of the O words in these lines.
    flavour
        Rules of the control for parameters and O words.
    values
        Parameters of the run.
    file
        Path of the file, for errors.

    Attributes
    ----------
    idle
        Number of lines since the last move; a move resets the number to 0.
    """

    def __init__(
        self, codes: tuple[Code, ...], flow: Flow, flavour: Flavour, values: Values, file: str
    ) -> None:
        self._codes = codes
        self._flow = flow
        self._flavour = flavour
        self._values = values
        self._file = file
        self.idle = 0
        self._statements: dict[int, Statement | None] = {}
        self._formulas: dict[int, Formula] = {}
        self._arguments: dict[int, tuple[str, list[Formula]]] = {}
        self._counts: dict[int, int] = {}  # passes left in each repeat
        self._callers: list[int] = []
        # LinuxCNC keeps two flags: ``_broken`` ends the next do; ``_continued`` restarts a while
        # or a repeat at its end.
        self._broken = self._continued = False

    def statements(self) -> Iterator[tuple[RawBlock, int]]:
        """Return the blocks of the run, with formulas replaced by numbers, and their lines, from 1.

        Raises
        ------
        JobError
            If a line cannot be read, a formula has no value, or too many lines run.
        """
        line, lines_run = 0, 0
        steps, cached_statements = self._flow.steps, self._statements
        most_lines = MOST_LINES + len(self._codes)
        while line < len(self._codes):
            lines_run += 1
            self.idle += 1
            if lines_run > most_lines or self.idle > MOST_IDLE + len(self._codes):
                self._endless(line, lines_run > most_lines)
            step = steps.get(line)
            if step is not None:
                line = self._next(step)
                continue
            if line in cached_statements:
                block_statement = cached_statements[line]
            else:
                block_statement = statement(self._codes[line], self._flavour, self._place(line))
                if len(cached_statements) < _MOST_CACHED:
                    cached_statements[line] = block_statement
            line += 1
            if block_statement is not None:
                yield block_statement.worked_out(self._values), line

    def _endless(self, line: int, all_lines: bool) -> NoReturn:
        count = f"{MOST_LINES} lines again" if all_lines else f"{MOST_IDLE} lines without a move"
        raise JobError(
            f"the program runs more than {count}: a loop may have no end",
            place=self._place(line),
            remedy="Correct the condition of its loops, or write it in parts.",
        )

    def _place(self, line: int) -> Place:
        return Place(self._file, line + 1)

    def _next(self, step: Step) -> int:
        """Return the index of the line that runs after an O word."""
        word, line = step.o.word, step.line
        if word == "if":
            return self._branch(step)
        if word in {"elseif", "else"}:  # the end of the branch before
            return self._flow.steps[step.begin].branches[-1] + 1
        if word == "while":
            return self._while(step)
        if word == "repeat":
            return self._repeat(step)
        if word in {"endwhile", "endrepeat"}:
            return step.begin
        if word == "sub":
            return step.end + 1
        if word == "call":
            return self._call(step)
        if word in {"return", "endsub"}:
            return self._return(step)
        if word == "break":
            return self._break(step)
        if word == "continue":
            return self._continue(step)
        if word in {"alarm", "error"}:
            raise JobError(
                f"the program stops here with {word} {step.o.rest[:40]}",
                place=self._place(line),
                remedy="Correct what makes it stop.",
            )
        return line + 1  # do, endif

    def _value(self, step: Step) -> float:
        """Return the value of the expression after an O word."""
        formula = self._formulas.get(step.line)
        if formula is None:
            reader = FormulaReader(step.o.rest, self._flavour, self._place(step.line))
            formula = reader.bracketed()
            if reader.more():
                reader.refuse(f"something stands behind {step.o.word}", "Take it out.")
            self._formulas[step.line] = formula
        return formula(self._values)

    def _branch(self, step: Step) -> int:
        if self._value(step):
            return step.line + 1
        for branch_line in step.branches[:-1]:
            branch = self._flow.steps[branch_line]
            if branch.o.word == "else" or self._value(branch):
                return branch_line + 1
        return step.branches[-1] + 1

    def _while(self, step: Step) -> int:
        if step.begin >= 0:  # this while ends a do
            goes_on = bool(self._value(step)) and not self._broken
            self._broken = self._broken and goes_on
            return step.begin + 1 if goes_on else step.line + 1
        return step.line + 1 if self._value(step) else self._leave(step, step.line)

    def _leave(self, loop: Step, line: int) -> int:
        """Return the line that runs next after a loop is left at ``line``.

        LinuxCNC reads on to the end of the loop. It takes each ``break`` of the same label on the
        way, which also ends the next ``do``; and a ``continue`` of a ``do`` leaves a flag set,
        which restarts the loop.
        """
        if not self._flavour.subroutines:
            return loop.end + 1
        self._broken = self._broken or any(break_line > line for break_line in loop.branches)
        if loop.o.word == "do":
            return loop.end
        is_continued, self._continued = self._continued, False
        return loop.line if is_continued else loop.end + 1

    def _repeat(self, step: Step) -> int:
        passes_left = self._counts.get(step.line)
        if passes_left is None:
            passes_left = self._times(step, self._value(step))
        if passes_left <= 0:
            self._counts.pop(step.line, None)
            return self._leave(step, step.line)
        self._counts[step.line] = passes_left - 1
        return step.line + 1

    def _times(self, step: Step, value: float) -> int:
        if abs(value) > 1e9:
            raise JobError(
                f"repeat [{value:g}] is beyond 10^9",
                place=self._place(step.line),
                remedy="Correct it.",
            )
        if self._flavour.subroutines:
            return round(value)
        if value < 0.0:
            raise JobError(
                f"repeat [{value:g}] is negative",
                place=self._place(step.line),
                remedy="Correct it.",
            )
        return max(1, int(value)) if value else 0

    def _break(self, step: Step) -> int:
        loop = self._flow.steps[step.begin]
        self._counts.pop(loop.line, None)
        self._leave_inner(loop, step)
        self._broken = self._flavour.subroutines
        return self._leave(loop, step.line)

    def _continue(self, step: Step) -> int:
        loop = self._flow.steps[step.begin]
        if self._flavour.subroutines:
            self._continued = True
            return self._leave(loop, step.line)
        self._leave_inner(loop, step)
        if loop.o.word == "do":
            return loop.line + 1  # FluidNC restarts without testing the condition
        if loop.o.word == "while" and not self._value(loop):
            raise JobError(
                f"continue {loop.o.label}, where its while no longer holds: FluidNC goes on "
                "behind it, and stops at endwhile",
                place=self._place(step.line),
                remedy="Write if ... endif around the rest of the loop.",
            )
        if loop.o.word == "repeat" and self._counts.get(loop.line, 0) <= 0:
            raise JobError(
                f"continue {loop.o.label} in its last pass: FluidNC goes on behind it, and stops "
                "at endrepeat",
                place=self._place(step.line),
                remedy="Write if ... endif around the rest of the loop.",
            )
        return loop.line

    def _leave_inner(self, loop: Step, step: Step) -> None:
        """Drop the counts of repeats inside a loop when a break or continue leaves them.

        LinuxCNC keeps these counts.
        """
        if not self._flavour.subroutines:
            for line in [k for k in self._counts if loop.line < k < step.line]:
                del self._counts[line]

    def _call(self, step: Step) -> int:
        place = self._place(step.line)
        if step.line not in self._arguments:
            reader = FormulaReader(step.o.rest, self._flavour, place)
            arguments: list[Formula] = []
            while reader.more():
                if len(arguments) == 30:
                    reader.refuse("a call has at most 30 arguments", "Pass fewer.")
                arguments.append(reader.bracketed())
            self._arguments[step.line] = step.o.label, arguments
        label, formulas = self._arguments[step.line]
        if step.o.formula:
            reader = FormulaReader(step.o.formula, self._flavour, place)
            label_formula = reader.whole()
            if reader.more():
                reader.refuse("an O word has no such label")
            label = str(label_formula(self._values))
        sub_line = self._flow.subs.get(label)
        if sub_line is None:
            labels = ", ".join(list(self._flow.subs)[:5])
            raise JobError(
                f"sub {label[:40]} is not in this file",
                place=place,
                remedy=f"It has {labels or 'none'}. Files of their own are not looked for: put the "
                "subroutine into the program.",
            )
        self._values.enter([formula(self._values) for formula in formulas], place)
        self._callers.append(step.line + 1)
        return sub_line + 1

    def _return(self, step: Step) -> int:
        returned = self._value(step) if step.o.rest else None
        self._values.leave(returned)
        return self._callers.pop()
