"""Joins: from the last turn of a layer to the first turn of the next one.

A join runs along the mandrel. Between the joints a constant friction ratio changes the winding
angle. Where one pass is too short for the change, the fibre turns back, and the angle goes on
changing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.errors import JobError, Place, placed
from threadline.jobs.winding.build_up import Laid
from threadline.jobs.winding.circuit import Site, Turn, traced, turn_of
from threadline.jobs.winding.layers import MARGIN
from threadline.winding.surface import Surface

_MOST_PASSES = 20
_HALVINGS = 60
_SAME_M = 1e-9
_MOST_RATIO, _ROUGH = 2.0, 8  # largest ratio and halvings of the search for enough friction


@dataclass(frozen=True, slots=True, eq=False)
class Join:
    """The path of the fibre between two layers.

    Parameters
    ----------
    surface
        Surface under the later layer.
    course
        (n, 4) length, u, angle round and winding angle to the right.
    side
        End at which the later layer begins: 1 right, -1 left.
    ratio
        Largest friction ratio.
    """

    surface: Surface
    course: FloatArray
    side: int
    ratio: float


def join(before: Laid, after: Laid, side: int) -> Join:
    """Return the join from a turn of a layer to a turn of the next one.

    Parameters
    ----------
    before, after
        The layers.
    side
        End at which the earlier layer ends: 1 right, -1 left.

    Raises
    ------
    JobError
        If the angle cannot change enough on the mandrel.
    """
    friction = after.wrap.friction
    with placed(Place(str(after.wrap.winding.path), after.layer.line)):
        path = _joined_at(before, after, side, friction)
    if path is not None:
        return path
    low, high = friction, 2.0 * friction
    while high < _MOST_RATIO and _joined_at(before, after, side, high) is None:
        low, high = high, 2.0 * high
    for _ in range(_ROUGH if high < _MOST_RATIO else 0):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if _joined_at(before, after, side, middle) else (middle, high)
    enough_text = f"A friction of {high / MARGIN:.2g} would do. " if high < _MOST_RATIO else ""
    raise JobError(
        f"the fibre cannot change from {_angle_words(before)} to {_angle_words(after)} with a "
        "friction ratio of "
        f"{friction:.3g} on this mandrel",
        place=Place(str(after.wrap.winding.path), after.layer.line),
        remedy=f"{enough_text}Put a layer with an angle between them, or wind them as two jobs.",
    )


def _joined_at(before: Laid, after: Laid, side: int, friction: float) -> Join | None:
    """Return the join of two layers at a friction ratio; None if the angle cannot change."""
    surface = after.wrap.surface
    name = f"the join to layer {after.layer.number}: "
    sites_before, sites_after = _sites_on(before, surface), after.wrap.sites
    constant, next_constant = before.circuit.constant_m, after.circuit.constant_m
    parts: list[FloatArray] = []
    site = sites_before[(side + 1) // 2]
    last_turn = before.circuit.right if side > 0 else before.circuit.left
    ratio = 0.0 if site.dome else last_turn.ratio
    _append_rows(parts, _inwards(turn_of(surface, site, constant, ratio, name)), side)
    largest_ratio = 0.0
    for _ in range(_MOST_PASSES):
        side = -side
        end = sites_after[(side + 1) // 2]
        rows, ratio, reached = _rows_between(
            surface, site, end, (constant, next_constant), friction
        )
        if rows is None:
            break
        constant, largest_ratio = reached, max(largest_ratio, abs(ratio))
        _append_rows(parts, rows, -side)
        if abs(constant - next_constant) < _SAME_M:
            first_turn = after.circuit.right if side > 0 else after.circuit.left
            _append_rows(parts, first_turn.rows, -side)
            return Join(surface, np.vstack(parts), side, largest_ratio)
        if not end.dome:
            site = sites_before[(side + 1) // 2]
            if not site.dome:
                break
            between = traced(surface, (end.joint, constant), 0.0, side, site.joint)
            if between is None:
                break
            _append_rows(parts, between, -side)
            end = site
        turn = turn_of(surface, end, constant, 0.0, name)
        _append_rows(parts, turn.rows, -side)
        _append_rows(parts, _inwards(turn), side)
        site = end
    return None


def _angle_words(laid: Laid) -> str:
    return f"{np.degrees(laid.circuit.angle):.1f} deg"


def _sites_on(before: Laid, surface: Surface) -> tuple[Site, Site]:
    """Return the sites of a layer on a later surface."""
    sites = []
    for site in before.wrap.sites:
        x = before.wrap.surface.at(np.array([site.joint]))[0][:, 0]
        sites.append(Site(site.side, float(surface.place_of(x)[0]), site.dome))
    return sites[0], sites[1]


def _inwards(turn: Turn) -> FloatArray:
    """Return the rows from a turn to its joint."""
    rows = turn.rows[::-1].copy()
    rows[:, 0] = turn.rows[-1, 0] - rows[:, 0]
    rows[:, 2] = turn.rows[-1, 2] - rows[:, 2]
    return rows


def _append_rows(parts: list[FloatArray], rows: FloatArray, side: int) -> None:
    """Add rows of a fibre that runs away from the end ``side``; their angle is in its direction."""
    rows = rows.copy()
    if side > 0:  # away from the right end, to the left
        rows[:, 3] = np.pi - rows[:, 3]
    if parts:
        last = parts[-1][-1]
        rows[:, 0] += last[0] - rows[0, 0]
        rows[:, 2] += last[2] - rows[0, 2]
        rows = rows[1:]
    if len(rows):
        parts.append(rows)


def _rows_between(
    surface: Surface, begin: Site, end: Site, constants: tuple[float, float], friction: float
) -> tuple[FloatArray | None, float, float]:
    """Return rows between two joints, the friction ratio and the Clairaut constant at the end."""

    def traced_at(ratio: float) -> tuple[FloatArray | None, float]:
        rows = traced(surface, (begin.joint, constants[0]), ratio, end.side, end.joint)
        if rows is None:
            return None, np.inf
        radius = float(surface.at(rows[-1:, 1])[1][0, 0])
        return rows, radius * float(np.sin(rows[-1, 3]))

    target = constants[1]
    low, high = -friction, friction
    rows, reached = traced_at(low)
    if reached >= target:
        return rows, low, reached
    rows, reached = traced_at(high)
    if reached <= target:
        return rows, high, reached
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        rows, reached = traced_at(middle)
        if reached > target:
            high = middle
        else:
            low = middle
    rows, reached = traced_at(low)
    return rows, low, reached
