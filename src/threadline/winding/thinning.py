"""Samples of a run that a replay needs: those between them lie on straight lines, within 5 um.

A controller writes a sample every few milliseconds, in which the eye moves a tenth of a millimetre.
The replay takes the axes as linear between two positions, so it needs a new position only where
they are not. Positions are dropped here, never changed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.machine.tool import Tool

STRAIGHT_M = 5e-6
"""Largest distance of a dropped position from the line between those that are kept, in each axis: a
rotary axis counts by the largest radius of the mandrel. An axis that hunts between two counts of
its encoder is straight within it."""
LONGEST_M = 1e-3
"""Longest move of the axes between two positions that are kept, unless they are neighbours."""
_BEGIN_M = 1e-7  # the same until the mandrel has turned by LONGEST_M: where a fibre begins counts
_ANGLES = (0, 4, 5)  # turn, yaw and roll among the parts of an eye


@njit(nogil=True)
def _keep(
    time: FloatArray, group: IntArray, places: FloatArray, turn: int, door: FloatArray,
    kept: NDArray[np.bool_], on_anchor: bool,
) -> bool:  # fmt: skip
    """Mark the rows that are kept; return whether the last row is one of them.

    Parameters
    ----------
    places
        (n, axes) in m; the first row is the last one of the call before, if there was one.
    turn
        Number of the axis that turns the mandrel; -1 if it is not among them.
    door
        (3, axes + 1) state, which is updated: the row that was kept last with its time; the least
        and the largest rates at which a line from there passes all rows since, with the place from
        which the mandrel turned, and the distance from a line that is allowed now.
    on_anchor
        Whether the first row is the row that was kept last.
    """
    axes = places.shape[1]
    for i in range(1, len(places)):
        step, way, straight = time[i] - door[0, axes], 0.0, group[i] == group[i - 1]
        for j in range(axes):
            moved = places[i, j] - door[0, j]
            way += moved * moved
            straight = straight and door[1, j] * step <= moved <= door[2, j] * step
        if not (on_anchor or (straight and step > 0.0 and way <= LONGEST_M * LONGEST_M)):
            kept[i - 1] = True
            door[0, :axes], door[0, axes] = places[i - 1], time[i - 1]
            door[1, :axes], door[2, :axes] = -math.inf, math.inf
            step = time[i] - time[i - 1]
        on_anchor = False
        if turn < 0 or not abs(places[i, turn] - door[1, axes]) <= LONGEST_M:
            door[2, axes] = STRAIGHT_M
        off = door[2, axes]
        for j in range(axes):
            moved = places[i, j] - door[0, j]
            if step > 0.0 and math.isfinite(moved):
                door[1, j] = max(door[1, j], (moved - off) / step)
                door[2, j] = min(door[2, j], (moved + off) / step)
            else:  # nothing is on a line with it
                door[1, j], door[2, j] = math.inf, -math.inf
    return on_anchor


def moves_of(eye: Tool, axes: Sequence[str], reach_m: float) -> FloatArray:
    """Return (axes,) how far the eye moves, relative to the mandrel, per unit of each axis, m.

    ``reach_m`` is the radius at which rotary axes act.
    """
    found = np.zeros(len(axes))
    for number, part in enumerate(eye.parts):
        if part is not None and part.axis in axes:
            at = axes.index(part.axis)
            size = abs(part.factor) * (reach_m if number in _ANGLES else 1.0)
            found[at] = max(found[at], size)
    return found


class Thinning:
    """Chooses the positions of a run that are kept, wherever its samples are cut into blocks.

    Parameters
    ----------
    eye
        The eye and its axes.
    axes
        Names of the axes of the positions.
    reach_m
        Largest radius of the mandrel.

    Attributes
    ----------
    waits
        Whether the latest position is not kept yet; at the end of a run it is.
    """

    def __init__(self, eye: Tool, axes: Sequence[str], reach_m: float) -> None:
        self._scale = moves_of(eye, axes, reach_m)
        turns = eye.turn is not None and eye.turn.axis in axes
        self._turn = axes.index(eye.turn.axis) if turns and eye.turn is not None else -1
        self._door = np.full((3, len(axes) + 1), np.nan)
        self._begun, self.waits = False, False

    def kept(self, time: FloatArray, group: IntArray, positions: FloatArray) -> NDArray[np.bool_]:
        """Return which of n positions are kept; the last is never decided on.

        Parameters
        ----------
        time
            (n,) increasing: in which the axes move on straight lines.
        group
            (n,) numbers; the last position of consecutive equal numbers is kept.
        positions
            (n, axes); the first row is the last row of the previous call.
        """
        found = np.zeros(len(positions), dtype=np.bool_)
        if not len(positions):
            return found
        places = positions * self._scale
        if not self._begun:
            found[0] = self._begun = True
            self._door[0, :-1], self._door[0, -1] = places[0], time[0]
            self._door[1], self._door[2] = -np.inf, np.inf
            self._door[1:, -1] = places[0, self._turn], _BEGIN_M
            self.waits = False
        self.waits = not _keep(time, group, places, self._turn, self._door, found, not self.waits)
        return found
