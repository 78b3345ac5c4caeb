"""Something other than motion that happens: asked for by commands, told by recordings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

EventKind = Literal[
    "output", "wait", "stop", "dwell", "tool", "end",
    "hold", "resume", "late", "completed", "stopped", "fault",
]  # fmt: skip
"""The first line is what commands ask for; the second is what recordings tell besides."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """Something other than motion that happens at a tick of the commands' clock.

    Parameters
    ----------
    tick
        When, counted from the start of the commands.
    kind
        ``output`` sets ``name`` to ``value``; ``wait`` waits for input ``name`` to be ``value``;
        ``stop`` waits for the operator; ``dwell`` marks a pause; ``tool`` names a tool action;
        ``end`` is the end of the job. A recording tells of ``hold`` and ``resume`` of the rows, of
        ``value`` ticks at which they came ``late``, and how it ended: ``completed``, ``stopped``
        or ``fault``, with the reason as ``name``.
    operation
        Index of the operation of the job that asked for it.
    """

    tick: int
    kind: EventKind
    operation: int
    name: str = ""
    value: float = 0.0
