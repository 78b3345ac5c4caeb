"""A circuit of fibre: from one turn to the other and back, and the advance that closes a pattern.

Between its two joints the fibre is a geodesic. Beyond a joint it has a constant friction ratio, k_g
/ k_n, up to the place where it turns back. On a dome, where it turns by Clairaut's law, the ratio
is 0 or nearly 0; at an open end it is as large as the friction allows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.errors import JobError
from threadline.jobs.winding.tracing import AWAY, REACHED, TURNED, trace
from threadline.winding.surface import Surface

_MOST_ROWS = 200_000
_GRID = 8193
LEVEL = 1e-9
ROUGH_LEVEL = 1e-4  # on a layer, whose meridian is a spline
_TAKEN_UP_M = 1e-9
_HALVINGS = 30
_MOST_RATIO = 100.0


@dataclass(frozen=True, slots=True)
class Site:
    """Where a fibre turns back.

    Parameters
    ----------
    side
        1 at the right end, -1 at the left.
    joint
        u from which the friction ratio acts, m.
    dome
        Whether the fibre turns there by Clairaut, without friction.
    """

    side: int
    joint: float
    dome: bool


@dataclass(frozen=True, slots=True, eq=False)
class Turn:
    """The path of the fibre from a joint to its turn.

    Parameters
    ----------
    rows
        (n, 4) length, u, angle round and winding angle from the joint on; the last row is the turn.
    ratio
        k_g / k_n, positive where the fibre is steered round the mandrel.
    radius_m
        Radius at the turn.
    dwell
        Angle of a dwell on the parallel of the turn, rad.
    """

    rows: FloatArray
    ratio: float
    radius_m: float
    dwell: float = 0.0

    @property
    def length_m(self) -> float:
        """Length of the fibre from the joint to the turn, without a dwell."""
        return float(self.rows[-1, 0])

    @property
    def round(self) -> float:
        """Angle round from the joint to the turn, rad, without a dwell."""
        return float(self.rows[-1, 2])


@dataclass(frozen=True, slots=True, eq=False)
class Circuit:
    """A circuit: from the left turn to the right one and back.

    Parameters
    ----------
    surface
        The mandrel under this layer.
    constant_m
        Radius times sine of the winding angle between the joints (Clairaut).
    left, right
        The turns.
    middle
        (n, 4) rows from the left joint to the right one.
    """

    surface: Surface
    constant_m: float
    left: Turn
    middle: FloatArray
    right: Turn

    @property
    def advance(self) -> float:
        """Angle round in a circuit, rad, with dwells."""
        round_rad = self.left.round + float(self.middle[-1, 2]) + self.right.round
        return 2.0 * round_rad + self.left.dwell + self.right.dwell

    @property
    def length_m(self) -> float:
        """Length of fibre in a circuit without dwells."""
        return 2.0 * (self.left.length_m + float(self.middle[-1, 0]) + self.right.length_m)

    @property
    def dwells_m(self) -> float:
        """Length of fibre on the parallels of the turns."""
        return sum(abs(turn.dwell) * turn.radius_m for turn in (self.left, self.right))

    @property
    def widest_m(self) -> float:
        """Largest radius of the mandrel between the joints."""
        if self.left.rows[0, 1] >= self.right.rows[0, 1]:  # a cone: it turns over all of it
            return widest(self.surface)[0]
        return float(self.surface.at(self.middle[:, 1])[1][:, 0].max())

    @property
    def angle(self) -> float:
        """Winding angle at the largest radius, rad."""
        return math.asin(min(self.constant_m / self.widest_m, 1.0))

    def course(self, side: int = -1) -> FloatArray:
        """Return (n, 4) length, u, angle round and winding angle from a turn to itself.

        It begins at the left turn, or with ``side`` 1 at the right one.

        The winding angle is between the fibre and the meridian to the right: above 90 degrees on
        the way back.
        """
        forward = self._pass()
        turns = self.right, self.left
        if side > 0:
            forward, turns = _reversed_rows(forward), (self.left, self.right)
        backward = np.empty((len(forward), 4))
        backward[:, 0] = 2.0 * forward[-1, 0] - forward[::-1, 0]
        backward[:, 1] = forward[::-1, 1]
        backward[:, 2] = 2.0 * forward[-1, 2] - forward[::-1, 2]
        backward[:, 3] = math.pi - forward[::-1, 3]
        parts = [forward]
        for turn, rows in zip(turns, (backward[1:], np.empty((0, 4))), strict=True):
            last = parts[-1][-1]
            if turn.dwell:
                count = max(math.ceil(abs(turn.dwell) / 0.05), 1)
                share = np.arange(1, count + 1) / count
                dwell_rows = np.tile(last, (count, 1))
                dwell_rows[:, 0] += abs(turn.dwell) * turn.radius_m * share
                dwell_rows[:, 2] += turn.dwell * share
                parts.append(dwell_rows)
            if len(rows):
                moved_rows = rows.copy()
                moved_rows[:, 0] += parts[-1][-1, 0] - last[0]
                moved_rows[:, 2] += parts[-1][-1, 2] - last[2]
                parts.append(moved_rows)
        return np.vstack(parts)

    def _pass(self) -> FloatArray:
        """Return the rows from the left turn to the right one."""
        left, right = self.left.rows, self.right.rows
        left_rows = left[::-1].copy()
        left_rows[:, 0] = left[-1, 0] - left_rows[:, 0]
        left_rows[:, 2] = left[-1, 2] - left_rows[:, 2]
        parts = [left_rows]
        for rows in (self.middle, right):
            moved_rows = rows[1:].copy()
            moved_rows[:, (0, 2)] += parts[-1][-1, (0, 2)]
            if len(moved_rows):
                parts.append(moved_rows)
        return np.vstack(parts)


def _reversed_rows(rows: FloatArray) -> FloatArray:
    """Return the rows of the way back, from its own beginning on."""
    backward = np.empty_like(rows)
    backward[:, 0] = rows[-1, 0] - rows[::-1, 0]
    backward[:, 1] = rows[::-1, 1]
    backward[:, 2] = rows[-1, 2] - rows[::-1, 2]
    backward[:, 3] = math.pi - rows[::-1, 3]
    return backward


def widest(surface: Surface, level: float = LEVEL) -> tuple[float, float, float]:
    """Return the largest radius, m, and u at the left and the right end of the widest part.

    A place belongs to the widest part if its radius is within the share ``level`` of the largest.
    """
    u = np.unique(np.concatenate([np.linspace(0.0, surface.length_m, _GRID), surface.nodes]))
    r = surface.at(u)[1][:, 0]
    most = float(r.max())
    wide = u[r >= most * (1.0 - level)]
    ends = surface.nodes[np.isin(surface.nodes, wide)]
    if not len(ends):  # the widest place is inside a piece
        ends = u[r == most]
    return most, float(ends[0]), float(ends[-1])


def _traced(
    surface: Surface, begin: tuple[float, float], ratio: float, side: int, until: float
) -> tuple[FloatArray, int]:
    """Return rows from a place, (u, Clairaut constant), towards an end, and why they ended."""
    u, constant = begin
    radius = float(surface.at(np.array([u]))[1][0, 0])
    rows = np.empty((_MOST_ROWS, 4))
    start = np.array([u, math.asin(min(constant / radius, 1.0))])
    count, why = trace(surface.nodes, surface.x, surface.r, start, ratio, float(side), until, rows)
    return rows[:count].copy(), why


def traced(
    surface: Surface, begin: tuple[float, float], ratio: float, side: int, until: float
) -> FloatArray | None:
    """Return the rows of a fibre from one place to another; None if it does not arrive.

    Parameters
    ----------
    begin
        u, m, and radius times sine of the winding angle there, m.
    ratio
        k_g / k_n, positive where the angle grows.
    side
        1 to the right, -1 to the left.
    until
        u where it ends, m.
    """
    if side * (until - begin[0]) <= _TAKEN_UP_M:
        radius = float(surface.at(np.array([begin[0]]))[1][0, 0])
        return np.array([[0.0, begin[0], 0.0, math.asin(min(begin[1] / radius, 1.0))]])
    rows, why = _traced(surface, begin, ratio, side, until)
    return rows if why == REACHED else None


def turn_of(surface: Surface, site: Site, constant_m: float, ratio: float, name: str = "") -> Turn:
    """Return the turn of a fibre that has a friction ratio from a joint on.

    Raises
    ------
    JobError
        If the fibre does not turn on the mandrel.
    """
    until = surface.length_m if site.side > 0 else 0.0
    rows, why = _traced(surface, (site.joint, constant_m), ratio, site.side, until)
    if why != TURNED:
        side_name = "right" if site.side > 0 else "left"
        fault = {REACHED: "runs off the mandrel", AWAY: "is steered along the meridian"}.get(
            why, "never turns back"
        )
        raise JobError(
            f"{name}the fibre {fault} at the {side_name} end with a friction ratio of "
            f"{abs(ratio):.3g}",
            remedy=_friction_remedy(surface, site, constant_m, ratio),
        )
    return Turn(rows, ratio, float(surface.at(rows[-1:, 1])[1][0, 0]))


def turns(surface: Surface, site: Site, constant_m: float, ratio: float, until: float) -> bool:
    """Return whether a fibre turns at a friction ratio before it reaches a place u, m."""
    if site.side * (until - site.joint) <= 0.0:
        return False
    return _traced(surface, (site.joint, constant_m), ratio, site.side, until)[1] == TURNED


def _friction_remedy(surface: Surface, site: Site, constant_m: float, ratio: float) -> str:
    """Return which friction would turn the fibre before the end of the mandrel."""
    if site.dome or ratio <= 0.0:
        return "Give a larger turn, or a mandrel that ends at a smaller opening."
    until = surface.length_m if site.side > 0 else 0.0

    def turns_at(tried_ratio: float) -> bool:
        return turns(surface, site, constant_m, tried_ratio, until)

    low, high = ratio, 2.0 * ratio
    while not turns_at(high):
        low, high = high, 2.0 * high
        if high > _MOST_RATIO:
            return "Make the mandrel longer, or the angle larger."
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if turns_at(middle) else (middle, high)
    return (
        f"A ratio of {high:.3g} would turn it: pins, a longer mandrel or a larger angle help, too."
    )


def circuit_of(
    surface: Surface,
    sites: tuple[Site, Site],
    constant_m: float,
    ratios: tuple[float, float],
    name: str = "",
) -> Circuit:
    """Return the circuit of a Clairaut constant.

    Parameters
    ----------
    sites
        Sites of the left and the right turn.
    constant_m
        Radius times sine of the winding angle between the joints.
    ratios
        k_g / k_n from each joint to its turn.
    name
        Name of the layer, with which a message begins.

    Raises
    ------
    JobError
        If the fibre does not turn, or cannot pass between the joints.
    """
    left, right = sites
    middle = traced(surface, (left.joint, constant_m), 0.0, 1, right.joint)
    if middle is None:
        raise JobError(
            f"{name}the fibre turns back where the radius is {1e3 * constant_m:.4g} mm, before the "
            "end that is to be covered",
            remedy="Give a smaller angle.",
        )
    both_turns = [
        turn_of(surface, site, constant_m, ratio, name)
        for site, ratio in zip(sites, ratios, strict=True)
    ]
    return Circuit(surface, constant_m, both_turns[0], middle, both_turns[1])
