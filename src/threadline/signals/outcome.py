"""How a run ended and whether its rows came in time, told by the events of its recording."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import StrEnum

from threadline.signals.event import Event


class Ended(StrEnum):
    """How a run ended; each is a kind of event, the last of a recording that knows."""

    COMPLETED = "completed"  # every row was taken up
    STOPPED = "stopped"  # somebody, or a stop that nobody answered, ended it before
    FAULT = "fault"  # the machine or the link to it failed


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What the events of a recording say of the run as a whole.

    Parameters
    ----------
    ended
        How it ended; None while nothing says so, as in a trace of another controller.
    text
        Why, for people; empty where it was completed.
    tick
        When, on the clock of the recording; None with ``ended``.
    operation
        Under way at that time.
    late_ticks
        Ticks at which a row was due and had not come.
    halted_ticks
        Ticks from a stop, a wait or a hold to the resumption, summed; the last one is open where
        the run ended in it.

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
        """Whether it ended before its last row."""
        return self.ended in {Ended.STOPPED, Ended.FAULT}

    def after(self, events: Iterable[Event]) -> Outcome:
        """Return what is known after further events, in order."""
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
