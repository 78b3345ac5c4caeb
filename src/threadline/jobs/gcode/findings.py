"""What a first pass over a part program notes for warnings and budgets."""

from __future__ import annotations

from dataclasses import dataclass, field

from threadline.jobs.gcode.block import CHANGE, Block
from threadline.jobs.gcode.in_force import FeedNotes

MAX_REMEMBERED = 1000
_LONG_DWELL_S = 1000


@dataclass(slots=True)
class Findings:
    """What the scan notes for warnings and budgets.

    Parameters
    ----------
    feeds
        Every F, with the modes and calls on which its unit depends.
    long_dwells, blends
        Lines of dwells that look like milliseconds, and of G64.
    idle
        The first line of each word without effect on motion.
    waits
        The first line where a program waits for a temperature.
    changes
        The first line of M6.
    anew
        Lines of M2 and M30 behind which other lines are run.
    rapid_f
        The first line of a G0 with an F of its own.
    unset
        The first line that reads each parameter that the program has not set before.
    doubtful
        The first line that compares numbers so near to each other that versions of the control
        answer differently.
    """

    feeds: FeedNotes = field(default_factory=FeedNotes)
    long_dwells: list[int] = field(default_factory=list)
    blends: list[int] = field(default_factory=list)
    idle: dict[str, int] = field(default_factory=dict)
    waits: int = 0
    changes: int = 0
    anew: list[int] = field(default_factory=list)
    rapid_f: int = 0
    unset: dict[int, int] = field(default_factory=dict)
    doubtful: int = 0

    def note(self, program: int | None, block: Block) -> None:
        """Note what may deserve a warning in a block of a program."""
        for code in block.settings:
            self.feeds.set_mode(program, code)
            if code == 640 and len(self.blends) < MAX_REMEMBERED:
                self.blends.append(block.line)
        if block.feed is not None:
            self.feeds.feed(program, block.feed, block.line)
        if block.action == 40 and block.dwell_s >= _LONG_DWELL_S:
            self.long_dwells.append(block.line)
            del self.long_dwells[MAX_REMEMBERED:]
        for word in block.idle:
            if len(self.idle) < MAX_REMEMBERED:
                self.idle.setdefault(word, block.line)
        if block.program == CHANGE and not self.changes:
            self.changes = block.line
        if block.waits and block.idle and not self.waits:
            self.waits = block.line
