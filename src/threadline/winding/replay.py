"""Replay of a winding: from the positions of the axes to the place of the fibre on its mandrel.

The replay reads nothing from a planner. It guesses the start of the fibre at a tangent from the eye
to the mandrel; after five laid free lengths the guess no longer counts. Nothing is laid until the
mandrel begins to turn.

A controller records a sample every few milliseconds, in which the eye moves about a tenth of a
millimetre. The replay interpolates the axes linearly between positions, so ``Thinning`` drops the
samples that lie within 5 um of a straight line between the kept positions. It never changes a
position.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.machine.tool import Tool
from threadline.winding.laying import (
    BRIDGED,
    KNOWN_AFTER,
    LIFTED,
    WAITING,
    Laid,
    Tables,
    first_look,
    lay,
    leads,
)
from threadline.winding.surface import Surface

STRAIGHT_M = 5e-6
"""Largest distance, in each axis, of a dropped position from the line between the kept positions. A
rotary axis counts at the largest radius of the mandrel. An axis that hunts between two counts of
its encoder stays within this distance.
"""
LONGEST_M = 1e-3
"""Longest move of the axes between two kept positions, unless they are neighbours."""
_BEGIN_M = 1e-7  # replaces STRAIGHT_M until the mandrel turned by LONGEST_M: the start matters
_ANGLES = (0, 4, 5)  # turn, yaw and roll among the parts of an eye

GUESSES = 801
"""Number of places along the meridian at which a start is tried."""
STATE = 12
"""Length of the state of ``laying.lay``."""
TURNED_M = 1e-4
"""Travel of the largest radius, m; until the mandrel has turned so far, the fibre is only tied."""


@dataclass(frozen=True, slots=True, eq=False)
class Fibre:
    """Where the fibre lies after each of n blocks.

    Parameters
    ----------
    state
        (n,) ``LAID``, ``LIFTED``, ``BRIDGED``, ``OFF``, ``WAITING`` or ``SUNK``.
    u, angle
        (n,) place along the meridian, m, and angle on the mandrel, rad, without wrap-round.
    length_m
        (n,) laid length since the start of the replay.
    free_m
        (n,) longest free length of the block.
    known
        (n,) whether five free lengths have been laid since the place was last unknown.
    lifted_m
        (n,) length unwound in one go up to the block, if the place was known when that began; else
        0.
    bridge_m
        (n,) height of the fibre over the hollow that it bridges.
    used_m
        (n,) length that the eye paid out in the block; negative: it took fibre back.
    slack_m
        (n,) slack that the eye has released and not yet taken up.
    winding
        (n,) angle between fibre and meridian, rad: 0 along the axis, positive round it.
    steer, least, most
        (n,) mean of the steering k_g / k_n over a group of blocks, NaN for a block that is judged
        with the blocks after it; least and largest value in the group so far, inf and -inf without
        any.
    """

    state: IntArray
    u: FloatArray
    angle: FloatArray
    length_m: FloatArray
    free_m: FloatArray
    known: NDArray[np.bool_]
    lifted_m: FloatArray
    bridge_m: FloatArray
    used_m: FloatArray
    slack_m: FloatArray
    winding: FloatArray
    steer: FloatArray
    least: FloatArray
    most: FloatArray

    def __len__(self) -> int:
        return len(self.state)


def eye_columns(eye: Tool, axes: Sequence[str], positions: FloatArray) -> FloatArray:
    """Return (n, 6) turn, along, across, up, yaw and roll of (n, axes) positions.

    An axis that is not among ``axes`` stands at 0.
    """
    columns = np.zeros((len(positions), 6))
    for number, part in enumerate(eye.parts):
        if part is None:
            continue
        if part.axis in axes:
            columns[:, number] = part.factor * positions[:, axes.index(part.axis)]
        columns[:, number] += part.zero_si
    return columns


class Replay:
    """The replay of one run, block by block.

    Parameters
    ----------
    surface
        The mandrel.
    eye
        The eye and its axes.
    friction
        Coefficient of friction.
    tied
        Place along the axis, m, where the fibre is tied at the start; None if unknown.
    """

    def __init__(
        self, surface: Surface, eye: Tool, friction: float, tied: float | None = None
    ) -> None:
        self.surface = surface
        self._tables = Tables(
            nodes=surface.nodes,
            x=surface.x,
            r=surface.r,
            payout=np.array([*eye.payout_m, *eye.roller_m, 0.0, 1.0, 0.0]),
            friction=friction,
            convex=surface.convex,
        )
        self._state = np.zeros(STATE)
        self._tied = None if tied is None else float(surface.place_of(np.array([tied]))[0])
        self._places = np.linspace(0.0, surface.length_m, GUESSES)
        self._begun = False
        self._least_turn = TURNED_M / float(surface.r[:, 0].max())
        self._rest: float | None = None
        self._waited = np.zeros(2)
        self._turns = False
        self._last: FloatArray | None = None

    def feed(
        self, eyes: FloatArray, group: IntArray | None = None, behind: int | None = None
    ) -> Fibre:
        """Take the next (n, 6) positions of ``eye_columns``; return the fibre at each of them.

        The first position of a run has no motion before it: its block is ``WAITING``.

        Parameters
        ----------
        group
            (n,) group of each block: consecutive blocks of a group are judged together; None: each
            block by itself.
        behind
            Group of the block after the last one; None: the last group ends with the last block.
        """
        count = len(eyes)
        eye_before = eyes[:1] if self._last is None else self._last
        chain = np.vstack([eye_before, eyes])
        self._last = chain[-1:] if len(chain) else None
        own_group = np.arange(count) if group is None else group
        groups = np.append(own_group, own_group[-1:] - 1 if behind is None else [behind])
        laid = Laid(
            state=np.full(count, WAITING, dtype=np.int64),
            place=np.full((count, 10), np.nan),
            steer=np.full((count, 3), np.nan),
        )
        block = 0
        while block < count:
            if not self._begun:
                block = self._start(chain, block)
                if block == count:
                    break
            end = lay(chain, groups, self._tables, self._state, laid, block)
            if end > block:
                self._waited[:] = 0.0
            self._begun = end == count
            block = end + 1
        place, steer, state = laid.place, laid.steer, laid.state
        return Fibre(
            state=state,
            u=place[:, 0],
            angle=place[:, 1],
            length_m=place[:, 2],
            free_m=place[:, 3],
            known=place[:, 4] >= KNOWN_AFTER,
            lifted_m=np.where((state == LIFTED) & (place[:, 9] == 1.0), place[:, 5], 0.0),
            bridge_m=np.where(state == BRIDGED, place[:, 5], 0.0),
            used_m=place[:, 8],
            slack_m=place[:, 6],
            winding=place[:, 7],
            steer=steer[:, 0],
            least=steer[:, 1],
            most=steer[:, 2],
        )

    def leads(self, eye: FloatArray, u: float, angle: float) -> FloatArray:
        """Return the (6,) length paid out per change of each coordinate of an eye, m per m or rad.

        Parameters
        ----------
        eye
            (6,) coordinates as in ``eye_columns``.
        u, angle
            Place along the meridian, m, and angle, rad, where the fibre leaves the mandrel.
        """
        state, lengths = np.zeros(STATE), np.empty(6)
        state[0], state[1] = u, angle
        leads(eye, state, self._tables, np.empty((2, 15)), lengths)
        return lengths

    def _start(self, chain: FloatArray, at: int) -> int:
        """Find the next block in which fibre can be laid, and set its start; return its number."""
        if self._rest is None:
            self._rest = float(chain[0, 0])
        if not self._turns:
            has_turned = np.abs(chain[1:, 0] - self._rest) > self._least_turn
            if not has_turned.any():
                return len(chain) - 1
            self._turns, at = True, max(at, int(np.argmax(has_turned)))
        places = self._places if self._tied is None else np.array([self._tied])
        block, row, angle = first_look(chain, at, self._tables, places, self._waited)
        if row >= 0:
            state = np.zeros(STATE)
            state[0], state[1] = places[row], angle
            state[2], state[6] = self._state[2], self._state[6]
            state[3] = 0.0 if self._tied is None else KNOWN_AFTER
            state[9], state[10] = np.inf, -np.inf
            self._tied = None
            self._state, self._begun = state, True
        return block


@njit(nogil=True)
def _keep(
    time: FloatArray, group: IntArray, places: FloatArray, turn: int, door: FloatArray,
    kept: NDArray[np.bool_], on_anchor: bool,
) -> bool:  # fmt: skip
    """Mark the rows that are kept; return whether the last row is one of them.

    Parameters
    ----------
    places
        (n, axes) positions in m; the first row repeats the last row of the previous call, if there
        was one.
    turn
        Number of the axis that turns the mandrel; -1 if it is not among them.
    door
        (3, axes + 1) state, which is updated. Row 0 is the last kept row with its time. Rows 1 and
        2 are the least and the largest rates at which a line from there passes all rows since;
        their last entries are the place from which the mandrel turned and the distance from a line
        that is allowed now.
    on_anchor
        Whether the first row is the last kept row.
    """
    axes = places.shape[1]
    for i in range(1, len(places)):
        step, distance2_m2, in_door = time[i] - door[0, axes], 0.0, group[i] == group[i - 1]
        for j in range(axes):
            moved_m = places[i, j] - door[0, j]
            distance2_m2 += moved_m * moved_m
            in_door = in_door and door[1, j] * step <= moved_m <= door[2, j] * step
        if not (on_anchor or (in_door and step > 0.0 and distance2_m2 <= LONGEST_M * LONGEST_M)):
            kept[i - 1] = True
            door[0, :axes], door[0, axes] = places[i - 1], time[i - 1]
            door[1, :axes], door[2, :axes] = -math.inf, math.inf
            step = time[i] - time[i - 1]
        on_anchor = False
        if turn < 0 or not abs(places[i, turn] - door[1, axes]) <= LONGEST_M:
            door[2, axes] = STRAIGHT_M
        tolerance_m = door[2, axes]
        for j in range(axes):
            moved_m = places[i, j] - door[0, j]
            if step > 0.0 and math.isfinite(moved_m):
                door[1, j] = max(door[1, j], (moved_m - tolerance_m) / step)
                door[2, j] = min(door[2, j], (moved_m + tolerance_m) / step)
            else:  # no line passes through this row
                door[1, j], door[2, j] = math.inf, -math.inf
    return on_anchor


def moves_of(eye: Tool, axes: Sequence[str], reach_m: float) -> FloatArray:
    """Return (axes,) the motion of the eye, relative to the mandrel, per unit of each axis, m.

    ``reach_m`` is the radius at which rotary axes act.
    """
    travel = np.zeros(len(axes))
    for number, part in enumerate(eye.parts):
        if part is not None and part.axis in axes:
            column = axes.index(part.axis)
            travel_m = abs(part.factor) * (reach_m if number in _ANGLES else 1.0)
            travel[column] = max(travel[column], travel_m)
    return travel


class Thinning:
    """Chooses the positions of a run to keep, however its samples are cut into blocks.

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
        Whether the latest position is not kept yet; the caller keeps it at the end of a run.
    """

    def __init__(self, eye: Tool, axes: Sequence[str], reach_m: float) -> None:
        self._scale = moves_of(eye, axes, reach_m)
        turns = eye.turn is not None and eye.turn.axis in axes
        self._turn = axes.index(eye.turn.axis) if turns and eye.turn is not None else -1
        self._door = np.full((3, len(axes) + 1), np.nan)
        self._begun, self.waits = False, False

    def kept(self, time: FloatArray, group: IntArray, positions: FloatArray) -> NDArray[np.bool_]:
        """Return (n,) which positions are kept; the next call decides on the last one.

        Parameters
        ----------
        time
            (n,) increasing times, between which the axes move linearly.
        group
            (n,) group numbers; the last position of consecutive equal numbers is kept.
        positions
            (n, axes); the first row is the last row of the previous call.
        """
        is_kept = np.zeros(len(positions), dtype=np.bool_)
        if not len(positions):
            return is_kept
        places = positions * self._scale
        if not self._begun:
            is_kept[0] = self._begun = True
            self._door[0, :-1], self._door[0, -1] = places[0], time[0]
            self._door[1], self._door[2] = -np.inf, np.inf
            self._door[1:, -1] = places[0, self._turn], _BEGIN_M
            self.waits = False
        self.waits = not _keep(time, group, places, self._turn, self._door, is_kept, not self.waits)
        return is_kept
