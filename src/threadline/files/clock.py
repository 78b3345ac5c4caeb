"""Time as an integer count of an exact period, and events at its ticks."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import reduce
from math import gcd, lcm
from typing import Literal

import numpy as np

from threadline.base.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class Clock:
    """A clock with an exact rational period.

    An instant is a whole number of periods. One rounded division converts it to seconds, so that
    the millionth tick is as exact as the first.

    Parameters
    ----------
    name
        Name of the clock in the machine file.
    period_s
        Exact period in seconds, greater than zero.
    """

    name: str
    period_s: Fraction

    def __post_init__(self) -> None:
        if self.period_s <= 0:
            raise ValueError(
                f"clock {self.name!r}: period must be greater than 0 s, got {self.period_s}"
            )

    def time_s(self, tick: int) -> float:
        """Return the instant of ``tick`` in seconds, correctly rounded."""
        # The quotient of two integers is rounded correctly, without reducing a fraction.
        return self.period_s.numerator * int(tick) / self.period_s.denominator

    def times_s(self, first_tick: int, count: int, stride: int = 1) -> FloatArray:
        """Return (count,) instants, s, from ``first_tick`` on, one every ``stride`` ticks."""
        ticks = np.arange(first_tick, first_tick + stride * count, stride, dtype=np.float64)
        # One product (exact below 2**53) and one division: no error accumulates.
        return ticks * float(self.period_s.numerator) / float(self.period_s.denominator)


def common_period_s(periods_s: list[Fraction]) -> Fraction:
    """Return the longest period of which all ``periods_s`` are whole multiples.

    >>> common_period_s([Fraction(136, 10**6), Fraction(1, 1000)])
    Fraction(1, 125000)

    Raises
    ------
    ValueError
        If there are no periods.
    """
    if not periods_s:
        raise ValueError("no periods given")
    denominator = reduce(lcm, (p.denominator for p in periods_s))
    numerators = [p.numerator * (denominator // p.denominator) for p in periods_s]
    return Fraction(reduce(gcd, numerators), denominator)


EventKind = Literal[
    "output", "wait", "stop", "dwell", "tool", "end",
    "hold", "resume", "late", "completed", "stopped", "fault", "plan", "override",
]  # fmt: skip
"""Kinds of events. Commands contain only the kinds of the first line; recordings contain all kinds.

NPZ files store the index of a kind in this list, so a new kind must be appended.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """Something other than motion that happens at a tick of the commands' clock.

    Parameters
    ----------
    tick
        Tick of the event, counted from the start of the commands.
    kind
        ``output`` sets the output ``name`` to ``value``. ``wait`` waits until the input ``name`` is
        ``value``. ``stop`` waits for the operator. ``dwell`` marks a pause. ``tool`` names a tool
        action. ``end`` is the end of the job.

        In recordings, ``hold`` and ``resume`` stop and continue the playing of rows. ``late`` means
        that rows were missing for ``value`` ticks. ``override`` has the speed overrides in
        ``name``; ``value`` is the share of the feed if the run was overridden, and 0 if the
        controller was overridden. ``completed``, ``stopped`` or ``fault`` ends the run, with the
        reason in ``name``. ``plan`` maps this tick to the plan time ``value`` in s. After it the
        plan time runs with the clock, or at the rate in ``name``; it stands still if the preceding
        ``plan`` event has the same ``value``.
    operation
        Index of the job operation of the event; -1 for none.
    name, value
        Arguments of the event; their meaning depends on ``kind``.
    """

    tick: int
    kind: EventKind
    operation: int
    name: str = ""
    value: float = 0.0
