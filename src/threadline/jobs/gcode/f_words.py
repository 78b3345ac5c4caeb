"""The meaning of F words.

In G94, F is a speed in mm/min (G20: inch/min). Which speed that is when axes of different kinds
move together differs from controller to controller. ``RULES`` has their rules by name:

``fastest-axis`` (the default: the printed winder's)
    of the fastest axis, where a rotary axis counts with the length of its arc at its radius. A
    move by the differences d_i takes max_i(r_i |d_i|) / F, r_i = 1 for a linear axis. No axis moves
    faster than F, and F of a move of one linear axis is its speed.
``base-axes``
    of the base axes alone, as CADFIL has it: mode 1 has the base A, mode 2 A and X. The move
    takes |(r_i d_i), i in the base| / F, and the other axes follow. A move that leaves the base
    at rest takes the length of all axes instead.
``path``
    along the path of the linear axes; a move of rotary axes alone takes their length at their
    radii.
``cadfil``, ``grbl``, ``fluidnc``, ``fanuc``
    along the path of all axes together, a degree counted as a millimetre: the times in the
    reports of CADFIL; grbl's and FluidNC's planner, which takes the length of a block over every
    axis that it has; Fanuc's G01 of linear and rotary axes (B-63174EN, section 4.2: the tangential
    speed in the Cartesian system of the axes).
``linuxcnc``, ``rs274``, ``marlin``
    along the path of X Y Z; where these rest of U V W; where they rest, too, of A B C in
    degrees a minute: RS274/NGC version 3 section 2.1.2.5 (which has no U V W), LinuxCNC's canon
    and Marlin 2.1's ``get_move_distance`` with rotational axes.

The last three rules depend on the letters of the axes alone, as in the firmwares: a mandrel that is
axis Y of a Marlin counts with the linear axes, a degree as a millimetre. For a move of A B C alone
F is in degrees, so that G20 does not scale it.

In G93, F is the inverse of the time of the move in minutes, and every G1 block has its own. G0
moves as fast as the limits of the machine allow.

The reader reports F as it is written. The operator's normal feed (counts per tick of the fastest
axis), where a machine file has one, caps it when the path is planned, unless another feed is given:
the 1994 controller ran the printed program, whose F 12000 would be 200 mm/s, at 10 counts per tick.
The reader warns where that will happen.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from threadline.errors import OptionError
from threadline.jobs.operations import Feed, FeedMode
from threadline.machine import Machine

_AT_RADIUS = "a rotary axis at its radius"
_DEGREE = "a degree as a millimetre"
_ALL = (FeedMode.ALL_AXES, f"of all axes together, {_DEGREE}")
_IN_TURN = (FeedMode.IN_TURN, "of X Y Z, else of U V W, else of A B C in degrees")
RULES: Mapping[str, tuple[FeedMode, str]] = {
    "fastest-axis": (FeedMode.FASTEST_AXIS, f"of the fastest axis, {_AT_RADIUS}"),
    "base-axes": (FeedMode.BASE_AXES, f"of the base axes, {_AT_RADIUS}"),
    "path": (FeedMode.PATH, "of the linear axes"),
    "cadfil": _ALL,
    "grbl": _ALL,
    "fluidnc": _ALL,
    "fanuc": _ALL,
    "linuxcnc": _IN_TURN,
    "rs274": _IN_TURN,
    "marlin": _IN_TURN,
}
"""The mode of each rule, and the text of which speed F is."""
F_MODES = tuple(dict.fromkeys(mode for mode, _ in RULES.values()))
_WITHOUT_UVW = "rs274"


@dataclass(frozen=True, slots=True)
class FRule:
    """What F means in G94: ``mode``, by the rule called ``name``."""

    name: str
    mode: FeedMode
    base_axes: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """Name of the rule with its base axes."""
        base = f":{','.join(self.base_axes)}" if self.base_axes else ""
        return f"{self.name}{base}"


def parse_feed_mode(text: str) -> dict[str, Any]:
    """Return the reader's options ``feed_mode`` and ``base_axes`` of a text.

    The text is like ``"path"`` or ``"base-axes:A,X"``. The reader refuses unknown rules and axes.
    """
    mode, _, axes = text.partition(":")
    base = tuple(name.strip().upper() for name in axes.split(",")) if axes.strip() else ()
    return {"feed_mode": mode.strip(), "base_axes": base}


def f_rule(
    machine: Machine,
    feed_mode: str | None,
    base_axes: tuple[str, ...] = (),
    of_dialect: str = "fastest-axis",
) -> FRule:
    """Return the rule for F on ``machine``; with None that of its file, else that of the dialect.

    Raises
    ------
    OptionError
        If there is no such rule, a base axis is missing or not of the machine, or the machine has
        axes that the rule does not know.
    """
    if feed_mode is None:
        feed_mode = machine.programs.feed_mode or of_dialect
        base_axes = machine.programs.base_axes
    if feed_mode not in RULES:
        raise OptionError(
            f"F cannot be read as {str(feed_mode)!r}", remedy=f"Choose {', '.join(RULES)}."
        )
    for name in base_axes:
        if name not in machine.axis_names:
            raise OptionError(
                f"the base axis {name!r} is not one of {machine.name!r}",
                remedy=f"It has {', '.join(machine.axis_names)}.",
            )
    mode, _ = RULES[feed_mode]
    if (mode is FeedMode.BASE_AXES) != bool(base_axes):
        raise OptionError(
            "base axes go with the feed mode base-axes, and only with it",
            remedy="CADFIL's mode 1 has the base A, mode 2 the base A, X.",
        )
    beyond = [axis for axis in machine.axis_names if axis in "UVW"]
    if feed_mode == _WITHOUT_UVW and beyond:
        raise OptionError(
            f"RS274/NGC does not say what F means to the axis {beyond[0]}",
            remedy="Choose linuxcnc, which takes U V W behind X Y Z.",
        )
    return FRule(feed_mode, mode, tuple(base_axes))


def normal_feed_m_s(machine: Machine) -> tuple[float, ...] | None:
    """Return the (axes,) speed of each axis at the tool at the operator's normal feed."""
    if machine.operator is None:
        return None
    tick_s = float(machine.tick_clock.period_s)
    per_axis = machine.operator.normal_feed.si / machine.counts_per_unit / tick_s
    return tuple((per_axis * machine.radius_m).tolist())


def as_f_words(value_m_s: float, rule: str) -> Feed:
    """Return the feed of F words of that value, by ``Job.feed_rule``.

    Raises
    ------
    OptionError
        If the job has no F words that are a speed.
    """
    name, _, base = rule.partition(":")
    if name not in RULES:
        raise OptionError(
            f"feed 'F {60_000.0 * value_m_s:.6g}': F of this job is no speed of its moves",
            remedy='Give the speed of the fastest axis, like "36 mm/s".',
        )
    return Feed(RULES[name][0], value_m_s, tuple(base.split(",")) if base else ())


def of_which(rule: str) -> str:
    """Return of which speed F is, in words, by ``Job.feed_rule``.

    >>> of_which("base-axes:A,X"), of_which("x-winder")
    ('of the base axes, a rotary axis at its radius', 'of the carriage, a second')
    """
    name = rule.partition(":")[0]
    return RULES[name][1] if name in RULES else "of the carriage, a second"
