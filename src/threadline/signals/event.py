"""Events: what commands ask for besides motion, and what recordings report besides samples."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

EventKind = Literal[
    "output", "wait", "stop", "dwell", "tool", "end",
    "hold", "resume", "late", "completed", "stopped", "fault", "plan",
]  # fmt: skip
"""Commands ask for the kinds of the first line; recordings report all of them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """Something other than motion that happens at a tick of the commands' clock.

    Parameters
    ----------
    tick
        Tick of the event, counted from the start of the commands.
    kind
        ``output`` sets ``name`` to ``value``; ``wait`` waits for input ``name`` to be ``value``;
        ``stop`` waits for the operator; ``dwell`` marks a pause; ``tool`` names a tool action;
        ``end`` is the end of the job. In recordings ``hold`` and ``resume`` stop and continue the
        rows, ``late`` means that rows were missing for ``value`` ticks, and ``completed``,
        ``stopped`` or ``fault`` is how the run ended, with the reason in ``name``. ``plan`` says
        that what was done at this tick was due at ``value`` s of the plan: behind it the plan goes
        on with the clock, or stands where the ``plan`` before it has the same time.
    operation
        Index of the operation of the job that the event belongs to; -1 for none.
    name, value
        Arguments of the event, as its kind says.
    """

    tick: int
    kind: EventKind
    operation: int
    name: str = ""
    value: float = 0.0
