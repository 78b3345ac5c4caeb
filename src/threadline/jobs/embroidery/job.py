"""The job of a design: its records, merged into moves of the frame.

A format with at most 12.1 mm per record splits a longer stitch into jumps and a stitch; this reader
merges them into one move. Jumps become travel with the needle up if their sum is longer than the
machine's longest move, if they lead to the first stitch, or if no stitch follows. A format that
holds such a length in one record tells the same stitch without jumps, and it is treated alike.
"""

from __future__ import annotations

import hashlib
import math
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from threadline.errors import JobError, Place
from threadline.files import Stream
from threadline.jobs.embroidery.records import UNIT_M, Act, read_records
from threadline.jobs.operations import (
    Job,
    MoveRun,
    Operation,
    OperationStream,
    Source,
    Stop,
    ToolEvent,
)
from threadline.machine import Machine

AXES = ("X", "Y")
EVENTS = {
    Act.TRIM: "trim",
    Act.STOP: "stop",
    Act.COLOUR: "colour",
    Act.NEEDLE: "colour",
    Act.SLOW: "slow",
    Act.FAST: "fast",
}
"""Name of the ``ToolEvent`` for each act without motion."""
_CUTS = ("trim", "stop", "colour")
_ROUNDING = 1e-9
_LONGEST_RUN = 4096


DESIGN_OPTIONS = ("long_stitches",)
TRAVEL, SPLIT, REFUSE = "travel", "split", "refuse"


def read_design(path: str | Path, *, machine: Machine, long_stitches: str | None = None) -> Job:
    """Return the job of an embroidery design.

    The operations are events and moves. A move has the tags ``stitch`` (from 1; 0 while the needle
    is up) and ``block`` (from 1; a thread change begins a new block). The line of an operation is
    the number of its record.

    Parameters
    ----------
    path
        Design file; the ending of its name gives the format.
    machine
        Embroidery machine with step tables, which give the longest move.
    long_stitches
        How stitches longer than the machine's longest move are sewn, with jumps before them or
        without: ``travel`` moves the frame with the needle up, ``split`` enters the needle on the
        way, ``refuse`` is an error. None: ``travel``. The way to the first stitch, and a way after
        a trim, a stop or a thread change, is always travel.

    Raises
    ------
    JobError
        If the machine has no step tables, the file cannot be read, nothing moves, or a stitch is
        longer than the machine's longest move and such stitches are refused.
    """
    path = Path(path)
    if machine.tables is None or set(machine.axis_names) != set(AXES):
        raise JobError(
            f"machine {machine.name!r} does not embroider: it has no step tables for X and Y",
            place=Place(str(path)),
            remedy="Take an embroidery machine, such as schiffli-frame.",
        )
    axes = machine.axis_names  # the columns follow the order of the machine file
    records = read_records(path)
    merged = _Merged(
        str(path), machine.tables.longest.si * (1.0 + _ROUNDING), long_stitches or TRAVEL
    )
    first, second = (records.position_m[:, AXES.index(axis)].tolist() for axis in axes)
    for number, (*target, act) in enumerate(
        zip(first, second, records.act.tolist(), strict=True), 1
    ):
        merged.take(number, (target[0], target[1]), Act(act))
    if not merged.stitches:
        raise JobError(
            "there is no stitch in the design",
            place=Place(str(path)),
            remedy="Is it the right file?",
        )
    if not merged.led:
        raise JobError(
            f"no stitch moves the frame: the needle enters {merged.stitches} times, all in one "
            "place",
            place=Place(str(path)),
            remedy="Is it the right file? A design has at least two places.",
        )
    return Job(
        name=path.stem,
        file=str(path),
        sha256=hashlib.sha256(records.content).hexdigest(),
        axes=axes,
        start=(0.0, 0.0),
        operations=OperationStream(Stream.of(tuple(merged.operations()))),
        warnings=(*records.warnings, *merged.warnings()),
        paced_by="shaft",
        threads=tuple(
            records.threads[k] if k < len(records.threads) else None for k in merged.thread_of_block
        ),
    )


@dataclass(slots=True)
class _Merged:
    """The moves and events from the records so far.

    ``targets`` holds both axes of each move; ``rows`` holds line, stitch and block of each move.
    """

    file: str
    longest_m: float
    long_stitches: str
    at: tuple[float, float] = (0.0, 0.0)
    stitches: int = 0
    block: int = 1
    still: int = 0
    long: int = 0
    led: bool = False
    jumped: bool = False
    cut: bool = True
    targets: array[float] = field(default_factory=lambda: array("d"))
    rows: array[int] = field(default_factory=lambda: array("q"))
    events: list[tuple[int, str, int]] = field(default_factory=list)  # moves before, name, line
    changes: int = 0
    thread_of_block: list[int] = field(default_factory=lambda: [0])

    def take(self, line: int, to: tuple[float, float], act: Act) -> None:
        """Take the next record of the design."""
        if act is Act.JUMP:
            self.jumped = True
            return
        if act is Act.STITCH:
            self._stitch(line, to)
            self.jumped = self.cut = False
            return
        if to != self.at:
            self._travel(line, to)
        self.jumped = False
        if act is Act.END:
            return
        name = EVENTS[act]
        self.cut = self.cut or name in _CUTS
        self.events.append((self.moves, name, line))
        if name == "colour":
            # Some files change the thread before the first stitch, too: no block begins there.
            self.changes += 1
            if self.stitches:
                self.block += 1
                self.thread_of_block.append(self.changes)
            else:
                self.thread_of_block[-1] = self.changes

    def _stitch(self, line: int, to: tuple[float, float]) -> None:
        distance_m = max(abs(a - b) for a, b in zip(to, self.at, strict=True))
        if distance_m > self.longest_m and not self.cut:
            self._long_stitch(line, to, distance_m)
        elif distance_m > 0.0 and (not self.stitches or distance_m > self.longest_m):
            self._travel(line, to)
        elif distance_m == 0.0 and self.stitches:
            self.still += 1
        self.led = self.led or (distance_m > 0.0 and self.stitches > 0)
        self.stitches += 1
        self._move(line, self.stitches, to)

    def _long_stitch(self, line: int, to: tuple[float, float], distance_m: float) -> None:
        """Travel the way of a long stitch, or enter the needle on the way, or refuse it."""
        if self.long_stitches == REFUSE:
            raise JobError(
                f"a stitch of {distance_m * 1e3:.4g} mm, the longest move of the machine is "
                f"{self.longest_m * 1e3:.4g} mm",
                place=Place(self.file, line),
                remedy=f"Have it sewn in parts (--long-stitches {SPLIT}), or travelled with the "
                f"needle up (--long-stitches {TRAVEL}).",
            )
        self.long += self.long_stitches == SPLIT or not self.jumped
        if self.long_stitches == TRAVEL:
            self._travel(line, to)
            return
        longest_units = math.floor(self.longest_m / UNIT_M)
        parts = math.ceil(round(distance_m / UNIT_M, 6) / longest_units)
        begin = self.at
        for part in range(1, parts):
            x, y = (
                a + round(part / parts * (b - a) / UNIT_M) * UNIT_M
                for a, b in zip(begin, to, strict=True)
            )
            self.stitches += 1
            self._move(line, self.stitches, (x, y))

    def _travel(self, line: int, to: tuple[float, float]) -> None:
        self._move(line, 0, to)

    def _move(self, line: int, stitch: int, to: tuple[float, float]) -> None:
        self.targets.extend(to)
        self.rows.extend((line, stitch, self.block))
        self.at = to

    @property
    def moves(self) -> int:
        """Number of moves so far."""
        return len(self.targets) // 2

    def operations(self) -> Iterator[Operation | MoveRun]:
        """Return the moves in runs, the events between the runs, and the final stop."""
        first = 0
        for before, name, line in self.events:
            yield from self._runs(first, before)
            yield ToolEvent(name, 0.0, Source(self.file, line))
            first = before
        yield from self._runs(first, self.moves)
        yield Stop(final=True, source=Source(self.file, self.rows[-3]))

    def _runs(self, first: int, end: int) -> Iterator[MoveRun]:
        targets = np.array(self.targets, dtype=np.float64).reshape(-1, 2)
        numbers = np.array(self.rows, dtype=np.int64).reshape(-1, 3)
        for begin in range(first, end, _LONGEST_RUN):
            run_rows = slice(begin, min(begin + _LONGEST_RUN, end))
            rows = numbers[run_rows]
            yield MoveRun(
                targets=targets[run_rows],
                line=rows[:, 0],
                feeds=((0, None),),
                file=self.file,
                passes=(),
                columns={"stitch": rows[:, 1], "block": rows[:, 2]},
            )

    def warnings(self) -> tuple[str, ...]:
        """Return warnings about the design."""
        texts = []
        if self.still:
            lead = "1 stitch leads" if self.still == 1 else f"{self.still} stitches lead"
            texts.append(f"{self.file}: {lead} nowhere: the needle enters twice there")
        if self.long:
            long_text = "1 stitch is" if self.long == 1 else f"{self.long} stitches are"
            treatment = "sewn in parts" if self.long_stitches == SPLIT else "travelled, needle up"
            other = TRAVEL if self.long_stitches == SPLIT else SPLIT
            texts.append(
                f"{self.file}: {long_text} longer than {self.longest_m * 1e3:.4g} mm, the "
                "longest move "
                f"of the machine, and {treatment}; --long-stitches {other} and {REFUSE} do "
                "otherwise"
            )
        return tuple(texts)
