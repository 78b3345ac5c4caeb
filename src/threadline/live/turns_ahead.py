"""The turns of a shaft sent ahead to an embroidery frame.

A turn moves the frame from rest to rest, so that the sent turns end at rest by themselves. To stop,
the executor sends no more turns, and withdraws the turns that have not begun.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from math import ceil
from typing import Any

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.errors import CommandError, LimitError
from threadline.files import Commands, Event, StepPlay, played
from threadline.live.wire import Message, event_row
from threadline.machine import Machine

_REST_S = 2.0
"""Recording time in s after the last turn, as in a simulation."""
_COLUMNS = ("begin", "window", "table", "sign", "start", "needle", "operation")


@dataclass(frozen=True, slots=True, eq=False)
class _Turn:
    """One turn: its columns, and the events due from its beginning on, in samples."""

    begin: int
    window: int
    table: IntArray
    sign: IntArray
    start: int
    needle: int
    operation: int
    events: tuple[Event, ...]


class TurnsAhead:
    """The turns of a program that were sent.

    Parameters
    ----------
    commands
        Step tables to play.
    machine
        Machine with its axes.
    pass_stops, loads_follow
        Unused: tables have no stops, and their axes have no feed-forward.

    Attributes
    ----------
    end
        Sample up to which the beginnings of turns are known.
    start
        (A,) starting position in steps.
    to_rest
        Unused: every turn ends at rest.

    Raises
    ------
    CommandError
        If the tables are for other axes.
    """

    keeps_home = True
    share_done = None  # it follows from the time
    rate = 1.0  # turns have no feed override
    rests = False

    def __init__(
        self,
        commands: Commands,
        machine: Machine,
        *,
        pass_stops: bool = False,  # noqa: ARG002
        loads_follow: bool = False,  # noqa: ARG002
    ) -> None:
        play = played(commands)
        if play.axes != machine.axis_names:
            raise CommandError(
                f"the tables are for other axes than {machine.name} has", remedy="Prove it again."
            )
        self._play, self._machine = play, machine
        period_s = machine.command_clock.period_s
        self._every = int(period_s / play.clock.period_s)
        self.start = play.start_steps
        self.settle_ticks = ceil(_REST_S / float(period_s))
        self.end = 0
        self.to_rest = self.gently = False
        self._turns = _turns_of(play, self._every)
        self._waiting: list[_Turn] = []  # read, and not sent
        self._sent: list[_Turn] = []  # sent, perhaps not begun, with their beginnings as sent
        self._all = False
        self._number = 0  # of turns that the machine has
        self._shift = 0  # timer counts by which the program is late
        self._stands = play.start_steps.astype(np.int64)
        self._lengths = np.array([*(len(table) for table in play.library), 0])
        self._before: tuple[list[_Turn], list[_Turn], int, int, IntArray] | None = None
        self._cut = self._tables_sent = False

    @property
    def complete(self) -> bool:
        """Whether the last turn has been sent."""
        return self._all and not self._waiting and not self._cut

    @property
    def halt(self) -> Event | None:
        """None: tables have no stops."""
        return None

    def refuse_elsewhere(self, stands: IntArray) -> None:
        """Refuse a run that does not begin where the frame stands.

        Raises
        ------
        CommandError
            If the frame stands elsewhere; the error names both positions, in steps.
        """
        if not np.array_equal(stands, self.start):
            raise CommandError(
                f"the frame stands at {stands.tolist()} steps, the run begins at "
                f"{self.start.tolist()}",
                remedy="Home the machine, or move it there.",
            )

    def hear(self, head: Mapping[str, Any]) -> str:  # noqa: ARG002
        """Return nothing: the place of turns is known from their beginnings."""
        return ""

    def met(self, now: Mapping[str, float]) -> bool:  # noqa: ARG002
        """Return False: there is no halt."""
        return False

    def pass_halt(self) -> None:
        """Do nothing: there is no halt."""

    def forget(self, tick: int) -> None:
        """Delete the turns that have begun, except the last one."""
        while len(self._sent) > 1 and self._sent[1].begin < tick * self._every:
            self._sent.pop(0)

    def rest_until(self, tick: int) -> None:
        """Let the next turn begin at a tick, or later."""
        self._read(1)
        self._cut = False
        if self._waiting:
            missing_counts = tick * self._every - (self._waiting[0].begin + self._shift)
            self._shift += max(-(-missing_counts // self._every), 0) * self._every

    def start_again(self) -> None:
        """Do nothing: a turn begins at rest."""

    def extend(self, until: int) -> Message:
        """Return the refill with all turns that begin before the sample ``until``."""
        self._before = None
        new_turns: list[_Turn] = []
        while self._read(1) and self._waiting[0].begin + self._shift < until * self._every:
            new_turns.append(self._late(self._waiting.pop(0)))
        following = None
        if self._read(1):
            following = [self._waiting[0].begin + self._shift, self._waiting[0].window]
        self._check(new_turns)
        is_last = self._all and not self._waiting
        self.end = until
        if is_last:
            self.end = -(-(self._play.duration_ticks + self._shift) // self._every)
        arrays: dict[str, IntArray | FloatArray] = {
            name: np.array([getattr(turn, name) for turn in new_turns], dtype=np.int64)
            for name in _COLUMNS
        }
        for name in ("table", "sign"):
            arrays[name] = arrays[name].reshape(len(new_turns), len(self._play.axes))
        head: dict[str, Any] = {
            "after": self._number,
            "until": until,
            "last": is_last,
            "following": following,
            "events": [event_row(event) for turn in new_turns for event in turn.events],
        }
        if not self._tables_sent:
            self._tell_tables(head, arrays)
            self._tables_sent = True
        self._number += len(new_turns)
        self._sent += new_turns
        return Message("refill", head, arrays)

    def cut(self, tick: int) -> Message:
        """Return the message that withdraws the turns that begin at a tick, or later."""
        self._before = (
            list(self._waiting), list(self._sent), self._number, self.end, self._stands.copy(),
        )  # fmt: skip
        self._cut = True
        withdrawn = [turn for turn in self._sent if turn.begin >= tick * self._every]
        self._sent = self._sent[: len(self._sent) - len(withdrawn)]
        self._number -= len(withdrawn)
        self._waiting = [self._unshifted(turn) for turn in withdrawn] + self._waiting
        for turn in withdrawn:
            self._stands -= turn.sign * self._lengths[turn.table]
        ends = [turn.begin + turn.window for turn in self._sent[-1:]]
        self.end = max(tick, *(-(-end // self._every) for end in ends), 0)
        return Message("refill", {"drop": tick})

    def undo(self) -> bool:
        """Undo the last cut, which the machine refused; return whether there was one."""
        if self._before is None:
            return False
        self._waiting, self._sent, self._number, self.end, self._stands = self._before
        self._before, self._cut = None, False
        return True

    def _read(self, count: int) -> bool:
        """Read turns until ``count`` wait; return whether there are as many."""
        while len(self._waiting) < count and not self._all:
            turn = next(self._turns, None)
            if turn is None:
                self._all = True
            else:
                self._waiting.append(turn)
        return len(self._waiting) >= count

    def _late(self, turn: _Turn) -> _Turn:
        return self._moved(turn, self._shift)

    def _unshifted(self, turn: _Turn) -> _Turn:
        return self._moved(turn, -self._shift)

    def _moved(self, turn: _Turn, shift: int) -> _Turn:
        """Return a turn that begins by some timer counts later, its events with it."""
        begin = turn.begin + shift
        events = tuple(
            replace(event, tick=event.tick + shift // self._every) for event in turn.events
        )
        columns = {name: getattr(turn, name) for name in _COLUMNS[1:]}
        return _Turn(begin=begin, events=events, **columns)

    def _tell_tables(self, head: dict[str, Any], arrays: dict[str, IntArray | FloatArray]) -> None:
        play = self._play
        head |= {
            "clock": play.clock.name,
            "counted_by": play.counted_by,
            "steps_per_turn": play.steps_per_turn,
            "window_angle": play.window_angle,
        }
        arrays["steps_per_unit"] = play.steps_per_unit
        arrays["lengths"] = self._lengths[:-1]
        arrays["units"] = np.array([table.units for table in play.library])
        arrays["intervals"] = np.concatenate([table.intervals for table in play.library])

    def _check(self, turns: list[_Turn]) -> None:
        """Refuse turns that leave the travel of an axis.

        Raises
        ------
        LimitError
            If a turn does so; the error names the axis, and the turns are not sent.
        """
        for turn in turns:
            self._stands = self._stands + turn.sign * self._lengths[turn.table]
            positions = self._stands / self._play.steps_per_unit
            for position, (name, axis) in zip(
                positions.tolist(), self._machine.axes.items(), strict=True
            ):
                if axis.travel is None or axis.travel[0].si <= position <= axis.travel[1].si:
                    continue
                limit = axis.travel[0].si if position < axis.travel[0].si else axis.travel[1].si
                raise LimitError(
                    f"axis {name}: a turn goes to {position:.4g}, beyond its travel, which ends at "
                    f"{limit:.4g}",
                    axis=name,
                    quantity="position",
                    value_si=position,
                    limit_si=limit,
                    remedy="Move the design, or the position where it starts.",
                )


def _turns_of(play: StepPlay, counts_per_sample: int) -> Iterator[_Turn]:
    """Yield the turns of a program; their events count in samples, as in a recording."""
    for block in play:
        for k in range(len(block)):
            stitch = block.first_stitch + k
            begin, is_last = int(block.begin[k]), k == len(block) - 1
            due_events = [(event, begin) for event in block.events if event.tick == stitch]
            if is_last:  # events due after its last turn
                late_events = (event for event in block.events if event.tick > stitch)
                due_events += [(event, play.duration_ticks) for event in late_events]
            yield _Turn(
                begin=begin,
                window=int(block.window[k]),
                table=block.table[k],
                sign=block.sign[k],
                start=int(block.start[k]),
                needle=int(block.needle[k]),
                operation=int(block.operation[k]),
                events=tuple(
                    Event(
                        tick=begin_count // counts_per_sample, kind=event.kind,
                        operation=event.operation, name=event.name,
                    )
                    for event, begin_count in due_events
                ),
            )  # fmt: skip
