"""What F means.

In G94, F is a speed in mm/min (G20: inch/min). Which speed, when axes of different kinds move
together, is a choice:

``FeedMode.FASTEST_AXIS`` (the default)
    of the fastest axis, where a rotary axis counts with the length of its arc at the tool radius
    of the machine. A move by the differences d_i takes max_i(r_i |d_i|) / F, r_i = 1 for a linear
    axis. No axis moves faster than F, and F of a move of one linear axis is its speed.
``FeedMode.BASE_AXES``
    of the base axes alone, as CADFIL has it: mode 1 has the base A, mode 2 A and X. The move
    takes |(r_i d_i), i in the base| / F, and the other axes follow. A move in which no base axis
    moves has no such speed and is refused.
``FeedMode.PATH``
    along the path of the linear axes, as other controllers have it; a move of rotary axes alone
    is taken by its fastest axis.

In G93, F is the inverse of the time of the move in minutes, and every G1 block has its own. G0
moves as fast as the limits of the machine allow.

The operator's normal feed (counts per tick of the fastest axis) caps F in G94: the 1994
controller ran the printed program, whose F 12000 would be 200 mm/s, at 10 counts per tick.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from threadline.errors import JobError, OptionError, Place
from threadline.jobs.operations import Feed, FeedMode
from threadline.machine import Machine

F_MODES = (FeedMode.FASTEST_AXIS, FeedMode.BASE_AXES, FeedMode.PATH)


@dataclass(frozen=True, slots=True)
class FeedRule:
    """Turns F into the feed of a move.

    Parameters
    ----------
    mode, base_axes
        The meaning of F in G94, and the indices of the base axes.
    base_names
        Their names.
    radius_m, counts, linear
        (axes,) radius at which an axis acts, counts per m or rad, whether it is linear.
    cap
        The operator's normal feed; None for no cap.
    cap_si
        (axes,) the same as m/s at the tool, infinite without a cap.
    """

    mode: FeedMode
    base_axes: tuple[int, ...]
    base_names: tuple[str, ...]
    radius_m: tuple[float, ...]
    counts: tuple[float, ...]
    linear: tuple[bool, ...]
    cap: Feed | None
    cap_m_s: tuple[float, ...]

    def duration_s(self, mode: FeedMode, speed_m_s: float, difference: list[float]) -> float:
        """Return the time of a move by ``difference``, (axes,) m or rad, at F = ``speed_m_s``."""
        arcs = [abs(d) * r for d, r in zip(difference, self.radius_m, strict=True)]
        if mode is FeedMode.BASE_AXES:
            return math.hypot(*[arcs[i] for i in self.base_axes]) / speed_m_s
        if mode is FeedMode.PATH:
            path = math.hypot(*[a for a, lin in zip(arcs, self.linear, strict=True) if lin])
            return (path or max(arcs)) / speed_m_s
        return max(arcs) / speed_m_s

    def capped(self, feed: Feed, difference: list[float], place: Place) -> Feed:
        """Return ``feed``, or the cap where that is slower, for a move by ``difference``.

        Raises
        ------
        JobError
            If F is the speed of base axes that do not move.
        """
        mode = feed.mode
        if mode is FeedMode.BASE_AXES and not any(difference[i] for i in self.base_axes):
            raise JobError(
                f"F is the speed of {', '.join(self.base_names)}, which does not move here",
                place=place,
                remedy="Read the program with F as the speed of the fastest axis.",
            )
        if mode is FeedMode.PATH and not any(
            d for d, linear in zip(difference, self.linear, strict=True) if linear
        ):
            feed = Feed(FeedMode.FASTEST_AXIS, feed.value)
        if self.cap is None:
            return feed
        at_cap_s = max(
            abs(d) * r / c for d, r, c in zip(difference, self.radius_m, self.cap_m_s, strict=True)
        )
        return self.cap if at_cap_s > self.duration_s(mode, feed.value, difference) else feed


def feed_rule(
    machine: Machine, *, feed_mode: FeedMode | str, base_axes: tuple[str, ...], cap: bool
) -> FeedRule:
    """Return the rule for ``machine``.

    Raises
    ------
    OptionError
        If the mode is none for F, or a base axis is missing or not of the machine.
    """
    if feed_mode not in F_MODES:
        raise OptionError(
            f"F cannot be read as {str(feed_mode)!r}",
            remedy=f"Choose {', '.join(m.value for m in F_MODES)}.",
        )
    mode = FeedMode(feed_mode)
    names = machine.axis_names
    for name in base_axes:
        if name not in names:
            raise OptionError(
                f"the base axis {name!r} is not one of {machine.name!r}",
                remedy=f"It has {', '.join(names)}.",
            )
    if (mode is FeedMode.BASE_AXES) != bool(base_axes):
        raise OptionError(
            "base axes go with the feed mode base-axes, and only with it",
            remedy="CADFIL's mode 1 has the base A, mode 2 the base A, X.",
        )
    radius_m = tuple(machine.radius_m.tolist())
    counts = tuple(machine.counts_per_unit.tolist())
    feed = None
    cap_m_s = tuple(math.inf for _ in names)
    if cap and machine.operator is not None:
        feed = Feed(FeedMode.COUNT_PER_TICK, machine.operator.normal_feed.si)
        tick_s = float(machine.tick_clock.period_s)
        cap_m_s = tuple(feed.value / c / tick_s * r for c, r in zip(counts, radius_m, strict=True))
    return FeedRule(
        mode=mode,
        base_axes=tuple(names.index(name) for name in base_axes),
        base_names=base_axes,
        radius_m=radius_m,
        counts=counts,
        linear=tuple(axis.kind == "linear" for axis in machine.axes.values()),
        cap=feed,
        cap_m_s=cap_m_s,
    )
