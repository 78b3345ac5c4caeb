"""Part programs for the winder, LinuxCNC and Fanuc, with passes of subroutines as calls.

A program for LinuxCNC differs in two points. Every G1 has its time as G93 F, because F of LinuxCNC
is the speed along the path of X Y Z, and F of the winder is the speed of the fastest axis. G64 asks
for corners blended within a stated distance of the program. LinuxCNC accepts O words only alone on
a line, and the main program only before its subroutines; all kinds of programs keep these rules.

A program for Fanuc has the time of every G1, too, and a point and at most four decimals in every
number. Fanuc controls take the number of passes in different words: some in L, others in the first
digits of P. The program therefore repeats the call for every pass.

A winding can also be written from its design, as circuits and their passes. Each move then has the
time at which the fibre runs at its set speed, and the control plans the motion. The chords of a
planned motion do not repeat: a plan begins and ends at rest, and its chords lie elsewhere in every
circuit.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import chain, groupby, islice
from pathlib import Path

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.base.wording import nc_comment
from threadline.base.writing import staged_file
from threadline.commands import nc_numbers as numbers
from threadline.commands.boards import refuse_lost
from threadline.commands.nc_blocks import OutBlock, Wording, blocks_of
from threadline.commands.planned_job import CHORD_TOLERANCE_M, planned_job
from threadline.errors import OptionError, Place, PlanError
from threadline.files.formats.common import Written, atomic_file, written
from threadline.jobs.gcode import read_part_program
from threadline.jobs.operations import Feed, FeedMode, Job, Move, MoveRun, Stop, ToolEvent
from threadline.machine import Machine
from threadline.motion.timing.types import Trajectory

MAX_BODY = 100_000
MAX_KEPT = 1_000_000
"""Largest number of blocks of bodies that are in memory at the same time."""
_NINTH = 10**8 // 2  # one over two units in the ninth digit of a number that begins with 1
_NEAR_M = 1e-5  # rotary axes at their radius
_NO_SUBROUTINES: Mapping[str, str] = {
    "grbl": "grbl has no subprograms",
    "fluidnc": "FluidNC has no subprograms (its loops are not written)",
    "marlin": "Marlin has no subprograms within a program (M32 P calls another file of the card)",
    "klipper": "Klipper has no subprograms within a program (its macros are in its configuration)",
    "reprapfirmware": "RepRapFirmware has no subprograms within a program (M98 calls a macro file)",
}


@dataclass(frozen=True, slots=True)
class Loop:
    """The blocks of ``body``, run ``passes`` times."""

    body: tuple[OutBlock, ...]
    passes: int


def fold(blocks: Iterable[OutBlock], *, most_kept: int = MAX_KEPT) -> Iterator[OutBlock | Loop]:
    """Return ``blocks`` with equal passes of outermost subroutines as loops.

    Nested subroutines are unrolled. Passes that differ, for example where a program sets absolute
    positions, become separate loops. Times that differ in the ninth digit, from rounding, do not
    count: passes take the times of the first. Bodies stay in memory until the end of the program.
    A body longer than ``MAX_BODY`` blocks, and every body that would bring the blocks in memory
    above ``most_kept``, is written out instead.
    """
    bodies: dict[tuple[OutBlock, ...], None] = {}
    body_blocks = 0
    pending: Loop | None = None
    for pass_, group in groupby(blocks, key=_outermost_pass):
        if pass_ == 0:
            if pending is not None:
                yield pending
                pending = None
            yield from group
            continue
        body = tuple(block._replace(passes=()) for block in islice(group, MAX_BODY + 1))
        if pending is not None and pass_ > 1 and _alike(body, pending.body):
            pending = Loop(body, pending.passes + 1)
            continue
        if pending is not None:
            yield pending
            pending = None
        if body not in bodies:
            if len(body) > MAX_BODY or body_blocks + len(body) > most_kept:
                yield from chain(body, group)
                continue
            bodies[body] = None
            body_blocks += len(body)
        pending = Loop(body, 1)
    if pending is not None:
        yield pending


def _alike(body: Sequence[OutBlock], other: Sequence[OutBlock]) -> bool:
    """Return whether two passes are equal except for the last digit of their times."""
    return len(body) == len(other) and all(
        one == two
        or (
            one.inverse_time
            and two.inverse_time
            and one.feed is not None
            and two.feed is not None
            and abs(one.feed - two.feed) * _NINTH <= one.feed
            and one._replace(feed=two.feed) == two
        )
        for one, two in zip(body, other, strict=True)
    )


def _outermost_pass(block: OutBlock) -> int:
    return block.passes[0] if block.passes else 0


MAIN_LABEL = 1
_N_STEP = 5
_N_LIMIT = 99_999
_MOST_FANUC = 7999  # higher numbers are for programs of the builder of the machine


class NcStyle(StrEnum):
    """The reader of a part program."""

    WINDER = "winder"
    LINUXCNC = "linuxcnc"
    FANUC = "fanuc"


def part_program_lines(
    job: Job,
    machine: Machine,
    *,
    style: NcStyle | str = NcStyle.WINDER,
    subroutines: bool = False,
    feed: Feed | None = None,
    blend_m: float = CHORD_TOLERANCE_M,
) -> Iterator[str]:
    """Return the lines of a part program, without line feeds.

    Parameters
    ----------
    job, machine
        Job to write, and its machine.
    style
        Reader of the program.
    subroutines
        True: equal passes of the job's subroutines become calls. False: every move is written out.
    feed
        Feed that replaces the programmed feeds; not for the winder.
    blend_m
        Largest distance from the program where LinuxCNC blends corners (G64 P), m.

    Raises
    ------
    PlanError
        If a part program has no word for a part of the job.
    """
    style = NcStyle(style)
    printed = style is NcStyle.WINDER
    if feed is not None and printed:
        raise PlanError(
            "a program for the winder keeps the feeds of its job",
            remedy="Give the feed when the program is run.",
        )
    wording = Wording(
        incremental=subroutines,
        blank=" " if printed else "",
        timed=not printed,
        points=style is NcStyle.FANUC,
    )
    blocks = blocks_of(job, machine, wording, feed)
    if subroutines:
        return _Writer(style, blend_m, incremental=True).lines(fold(blocks))
    return _Writer(style, blend_m, incremental=False).lines(blocks)


def write_part_program(
    job: Job,
    machine: Machine,
    path: str | Path,
    *,
    style: NcStyle | str = NcStyle.WINDER,
    subroutines: bool = False,
    feed: Feed | None = None,
) -> None:
    """Write ``job`` to ``path``; the file appears only when it is complete.

    Raises
    ------
    PlanError
        As ``part_program_lines``.
    RecordingError
        If the file cannot be written.
    """
    lines = part_program_lines(job, machine, style=style, subroutines=subroutines, feed=feed)
    with atomic_file(Path(path)) as file:
        file.writelines(f"{line}\n".encode() for line in lines)


class _Writer:
    def __init__(self, style: NcStyle, blend_m: float, *, incremental: bool) -> None:
        self._blend = numbers.text(numbers.millimetres(blend_m))
        self._linuxcnc, self._fanuc = style is NcStyle.LINUXCNC, style is NcStyle.FANUC
        self._blank = " " if style is NcStyle.WINDER else ""
        self._end = ";" if style is NcStyle.WINDER else ""
        self._points = Wording(incremental, self._blank, False, points=self._fanuc)
        self._incremental = incremental
        self._number = 0
        self._motion = -1
        self._inverse_time = False
        self._feed: int | None = None
        self._unsure = True
        self._bodies: dict[tuple[OutBlock, ...], int] = {}

    def lines(self, items: Iterable[OutBlock | Loop]) -> Iterator[str]:
        yield "%"
        yield f"O{self._blank}{MAIN_LABEL}{self._end}"
        yield self._numbered(
            self._words("G", 91 if self._incremental else 90), self._words("G", 21)
        )
        if self._linuxcnc:
            yield self._numbered(self._words("G", 64), f"P{self._blend}")
        has_end = False
        for item in items:
            if isinstance(item, Loop):
                label = self._bodies.setdefault(item.body, MAIN_LABEL + 1 + len(self._bodies))
                if self._fanuc and label > _MOST_FANUC:
                    raise PlanError(
                        f"the program has more than {_MOST_FANUC} different subprograms, and O of "
                        "Fanuc has four digits",
                        remedy="Write every move with threadline compile.",
                    )
                call = [self._words("M", 98), self._words("P", label)]
                if item.passes > 1 and not self._fanuc:
                    call.append(self._words("L", item.passes))
                for _ in range(item.passes if self._fanuc else 1):
                    yield self._numbered(*call)
                # The body changes the modes, so the next block states all of them again.
                self._forget()
            else:
                yield from self._block(item)
                has_end = item.final
        if not has_end:
            yield self._numbered(self._words("M", 30))
        for body, label in self._bodies.items():
            yield f"O{self._blank}{label}{self._end}"
            self._forget()
            for block in body:
                yield from self._block(block)
            yield self._numbered(self._words("M", 99))
        yield "%"

    def _forget(self) -> None:
        self._motion, self._feed, self._unsure = -1, None, True

    def _block(self, block: OutBlock) -> Iterator[str]:
        words = []
        if block.feed is not None and (block.inverse_time != self._inverse_time or self._unsure):
            self._inverse_time = block.inverse_time
            self._unsure = False
            words.append(self._words("G", 93 if block.inverse_time else 94))
            self._feed = None
        if block.motion >= 0 and block.motion != self._motion:
            words.append(self._words("G", block.motion))
            self._motion = block.motion
        words.append(block.words)
        if block.feed is not None and (block.inverse_time or block.feed != self._feed):
            words.append(f"F{self._blank}{self._points.text(block.feed)}")
            self._feed = block.feed
        yield self._numbered(*words, comment=block.comment)

    def _words(self, letter: str, number: int) -> str:
        return f"{letter}{self._blank}{number}"

    def _numbered(self, *words: str, comment: str = "") -> str:
        self._number = self._number % _N_LIMIT + _N_STEP
        text = " ".join([self._words("N", self._number), *words])
        if comment and self._fanuc:
            return f"{text} ({nc_comment(comment).upper()})"
        return f"{text} ; {nc_comment(comment)}" if comment else f"{text}{self._end}"


def write_nc(job: Job, trajectory: Trajectory, machine: Machine, path: Path) -> Written:
    """Write the planned motion as a part program: chords with their times (G93), blended (G64).

    A G0 becomes a G1 with its planned time, because LinuxCNC would choose its own time for a G0,
    and the program would no longer match the plan. A G0 with a laser on is refused: HAL tells G0
    from G1 (``motion.motion-type``), and a laser may burn in G1 only. A tool that goes down into
    the material is no laser, and its spindle turns in a G0 as in a G1. Outputs (M62, M64) have the
    state that the program gives them in either.

    Raises
    ------
    PlanError
        If LinuxCNC reads a word of the job differently, or a G0 has a spindle on that may be a
        laser.
    """
    refuse_lost(job, machine, NcStyle.LINUXCNC)
    rapids = _dark_rapids(job)
    timed = planned_job(job, trajectory, machine)
    # The plan already respects the operator's normal feed; do not apply the feed to its times
    # again.
    write_part_program(timed, replace(machine, operator=None), path, style=NcStyle.LINUXCNC)
    if not rapids:
        return written(path)
    count = "1 G0 is a G1" if rapids == 1 else f"{rapids} G0 are G1"
    summary = f"{count} with the planned time (G93)"
    return written(path, (f"{path.name}: {summary}; --target linuxcnc keeps G0",))


def _dark_rapids(job: Job) -> int:
    """Return the number of moves at G0; refuse a G0 with a spindle on that may be a laser.

    A spindle with which a feed move goes down along Z is no laser.
    """
    spindle, power, count, at = "", 1.0, 0, job.start
    lit: tuple[str, Place] | None = None  # the first G0 with the spindle on
    height = job.axes.index("Z") if "Z" in job.axes else None
    plunges = False
    for operation in job:
        acts: tuple[ToolEvent | Stop, ...] = ()
        if isinstance(operation, Move):
            acts = operation.acts
        elif isinstance(operation, ToolEvent | Stop):
            acts = (operation,)
        for act in acts:
            for word in act.words.split():
                if word in {"M3", "M4", "M5"}:
                    spindle = "" if word == "M5" else f"{word} (line {act.source.line})"
                elif word.startswith("S"):
                    power = float(word[1:])
        if not isinstance(operation, Move):
            continue
        before, at = at, operation.target
        feed, lights = operation.feed, bool(spindle and power)
        if feed is None or feed.mode is not FeedMode.RAPID:
            plunges |= lights and height is not None and at[height] < before[height]
        elif before != at:
            count += 1
            lit = lit or ((spindle, operation.source.place) if lights else None)
    if lit is not None and not plunges:
        raise PlanError(
            f"{lit[0]} is on in a G0, which the target nc writes as a G1 with its planned time, "
            "and no feed move goes down along Z: a laser that HAL switches off in G0 would burn "
            "there",
            place=lit[1],
            remedy="Write M5 before the G0, or choose --target linuxcnc, which keeps G0.",
        )
    return count


_STYLE_OF_TARGET = {"nc": NcStyle.LINUXCNC}


def write_passes(job: Job, machine: Machine, path: Path, dialect: str | None = None) -> str:
    """Write a job with equal passes as calls of subroutines, in a dialect, or in the machine's.

    The program is read back and compared with the job. Returns, for people, the size of the program
    and the size with all moves written out.

    Raises
    ------
    OptionError
        If the control has no subroutines.
    PlanError
        If a part program has no word for a part of the job, or the program read back differs.
    """
    dialect = check_passes(dialect or machine.programs.dialect)
    sizes = []
    with staged_file(path) as stream:
        for passes in (False, True):
            size = 0
            for line in part_program_lines(job, machine, style=dialect, subroutines=passes):
                text = f"{line}\n".encode()
                size += len(text)
                if passes:
                    stream.write(text)
            sizes.append(size)
        stream.flush()
        off_m = _farthest_m(job, machine, Path(stream.name), dialect)
    whole, short = sizes
    summary = f"{short} bytes, {whole} with every move written out"
    if short >= whole:
        summary += ": passes save nothing, because no part is long and repeats"
    return f"{summary}; read back within {1e3 * off_m:.1g} mm"


def check_passes(control: str) -> NcStyle:
    """Return the style of programs with passes for a dialect or target.

    Raises
    ------
    OptionError
        If the control has no subroutines; says which has them.
    """
    known = _STYLE_OF_TARGET.get(control)
    if known is not None:
        return known
    if control not in set(NcStyle):
        why = _NO_SUBROUTINES.get(control, f"{control[:40]!r} is no format of a part program")
        raise OptionError(
            f"{why}: programs of passes are written for winder, linuxcnc and fanuc",
            remedy="Write linuxcnc or fanuc, or every move with threadline compile.",
        )
    return NcStyle(control)


def _farthest_m(job: Job, machine: Machine, path: Path, dialect: str) -> float:
    """Return the largest distance, m, of the moves of a program from the moves of a job."""
    radius = machine.radius_m[[machine.axis_names.index(axis) for axis in job.axes]]
    again = read_part_program(path, machine=machine, dialect=dialect)
    order = [again.axes.index(axis) for axis in job.axes]
    expected, found = _ends_of_moves(job), _ends_of_moves(again)[:, order]
    if expected.shape != found.shape:
        raise _not_the_job(f"{len(found)} moves instead of {len(expected)}")
    off = float(np.abs((found - expected) * radius).max())
    if off > _NEAR_M:
        raise _not_the_job(f"{1e3 * off:.3g} mm beside the job")
    return off


def _ends_of_moves(job: Job) -> FloatArray:
    """Return where every move of a job ends: (moves, axes), m or rad."""
    ends = [np.empty((0, len(job.axes)))]
    for item in job.runs():
        if isinstance(item, MoveRun):
            ends.append(item.targets)
        elif isinstance(item, Move):
            ends.append(np.array([item.target]))
    return np.concatenate(ends)


def _not_the_job(what: str) -> PlanError:
    return PlanError(
        f"the program, read back, is not the job: {what}",
        remedy="Report it with the product and the machine file.",
    )
