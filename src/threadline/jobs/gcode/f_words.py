"""What F means.

In G94, F is a speed in mm/min (G20: inch/min). Which speed, when axes of different kinds move
together, is a choice:

``FeedMode.FASTEST_AXIS`` (the default)
    of the fastest axis, where a rotary axis counts with the length of its arc at the tool radius
    of the machine. A move by the differences d_i takes max_i(r_i |d_i|) / F, r_i = 1 for a linear
    axis. No axis moves faster than F, and F of a move of one linear axis is its speed.
``FeedMode.BASE_AXES``
    of the base axes alone, as CADFIL has it: mode 1 has the base A, mode 2 A and X. The move
    takes |(r_i d_i), i in the base| / F, and the other axes follow. A move that leaves the base
    at rest takes the length of all axes instead.
``FeedMode.PATH``
    along the path of the linear axes, as other controllers have it; a move of rotary axes alone
    takes their length at the tool.

In G93, F is the inverse of the time of the move in minutes, and every G1 block has its own. G0
moves as fast as the limits of the machine allow.

The reader reports F as it is written. The operator's normal feed (counts per tick of the fastest
axis) caps it when the path is planned, unless another feed is given: the 1994 controller ran the
printed program, whose F 12000 would be 200 mm/s, at 10 counts per tick. The reader warns where
that will happen.
"""

from __future__ import annotations

from threadline.errors import OptionError
from threadline.jobs.operations import FeedMode
from threadline.machine import Machine

F_MODES = (FeedMode.FASTEST_AXIS, FeedMode.BASE_AXES, FeedMode.PATH)


def check_feed_mode(machine: Machine, feed_mode: str, base_axes: tuple[str, ...]) -> FeedMode:
    """Return the mode of F.

    Raises
    ------
    OptionError
        If the mode is none for F, or a base axis is missing or not of the machine.
    """
    if feed_mode not in [mode.value for mode in F_MODES]:
        raise OptionError(
            f"F cannot be read as {str(feed_mode)!r}",
            remedy=f"Choose {', '.join(mode.value for mode in F_MODES)}.",
        )
    mode = FeedMode(feed_mode)
    for name in base_axes:
        if name not in machine.axis_names:
            raise OptionError(
                f"the base axis {name!r} is not one of {machine.name!r}",
                remedy=f"It has {', '.join(machine.axis_names)}.",
            )
    if (mode is FeedMode.BASE_AXES) != bool(base_axes):
        raise OptionError(
            "base axes go with the feed mode base-axes, and only with it",
            remedy="CADFIL's mode 1 has the base A, mode 2 the base A, X.",
        )
    return mode


def normal_feed_m_s(machine: Machine) -> tuple[float, ...] | None:
    """Return the (axes,) speed of each axis at the tool at the operator's normal feed."""
    if machine.operator is None:
        return None
    tick_s = float(machine.tick_clock.period_s)
    per_axis = machine.operator.normal_feed.si / machine.counts_per_unit / tick_s
    return tuple((per_axis * machine.radius_m).tolist())
