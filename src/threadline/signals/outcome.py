"""How a run ended and whether its rows came in time, from the events of its recording."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import StrEnum

from threadline.signals.event import Event


class Ended(StrEnum):
    """How a run ended; an event of one of these kinds is the last of a recording."""

    COMPLETED = "completed"  # every row was played
    STOPPED = "stopped"  # the operator, or a stop that nobody answered, ended it early
    FAULT = "fault"  # the machine or the link to it failed


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What the events of a recording say of the run as a whole.

    Parameters
    ----------
    ended
        How the run ended; None where no event says so, as in a trace of another controller.
    text
        Reason of a stop or a fault; empty where the run was completed.
    tick
        Tick of the end on the clock of the recording; None with ``ended``.
    operation
        Index of the operation that was under way at the end.
    late_ticks
        Number of ticks at which a row was due and had not come.
    halted_ticks
        Ticks from each stop, wait or hold to the resumption, summed; a halt that the run ended in
        is not counted.
    halted_since
        Tick at which a halt began that has not been resumed; None where there is none.

    Examples
    --------
    >>> run = (Event(tick=5, kind="late", operation=1, value=3.0),
    ...        Event(tick=9, kind="fault", operation=2, name="the link is gone"))
    >>> outcome = Outcome().after(run)
    >>> outcome.incomplete, outcome.late_ticks, outcome.text
    (True, 3, 'the link is gone')
    """

    ended: Ended | None = None
    text: str = ""
    tick: int | None = None
    operation: int | None = None
    late_ticks: int = 0
    halted_ticks: int = 0
    halted_since: int | None = None

    @property
    def incomplete(self) -> bool:
        """Whether the run ended before its last row."""
        return self.ended in {Ended.STOPPED, Ended.FAULT}

    def after(self, events: Iterable[Event]) -> Outcome:
        """Return the outcome with further events, in their order, taken into account."""
        known = self
        for event in events:
            if event.kind in tuple(Ended):
                known = replace(
                    known,
                    ended=Ended(event.kind),
                    text=event.name,
                    tick=event.tick,
                    operation=event.operation,
                )
            elif event.kind == "late":
                known = replace(known, late_ticks=known.late_ticks + int(event.value))
            elif event.kind in {"stop", "wait", "hold"} and known.halted_since is None:
                known = replace(known, halted_since=event.tick)
            elif event.kind == "resume" and known.halted_since is not None:
                halted = known.halted_ticks + event.tick - known.halted_since
                known = replace(known, halted_ticks=halted, halted_since=None)
        return known


def said_once(ended: str, why: str) -> str:
    """Return how a run ended, and why, without saying a word twice.

    >>> said_once("stopped", "stopped by the operator"), said_once("fault", "the link is gone")
    ('stopped by the operator', 'fault: the link is gone')
    """
    if not why:
        return ended
    return why if why.startswith(ended) else f"{ended}: {why}"
