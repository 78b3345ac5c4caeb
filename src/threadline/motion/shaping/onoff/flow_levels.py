"""Moves of a cylinder whose valves set its speed, and the bound of all commands for them.

Open flow controls add up to a level, and every change of the level by h rings on by itself, for
each possible frequency of the mode. With levels free between 0 and 1 the shortest command on the
scan is a linear program, and no valves are faster. ``flow_search`` finds commands of real valves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray
from threadline.base.linear_programs import solved
from threadline.motion.shaping.onoff.switched import Valves

SHORT, OVER = 0.2, 0.02
"""Scans by which a command may fall short of the distance, and exceed it.

Commanded beyond its stroke, a piston runs into its stop.
"""
_DIRECTIONS = 16  # of the polygon that replaces a circle in the plane of ringing
_FINER = 4  # cells per scan, for a flow that does not begin or end with a scan
_ROWS = 11  # frequencies of a band in a program; all of them are checked afterwards


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FlowMove:
    """A move to be made by flow controls.

    Parameters
    ----------
    on_scans
        Distance over the speed of level 1, in scans.
    valves
        The flow controls, and their delays of opening and closing.
    dwell_scans
        Fewest scans between two switchings of one of them.
    turns
        (K,) factor on the complex ringing in one scan, for each frequency of a band.
    most
        (K,) permitted ringing after the command at each frequency, in units of a step of level 1.
    """

    on_scans: float
    valves: Valves
    dwell_scans: int
    turns: NDArray[np.complex128]
    most: FloatArray

    def left(self, ticks: tuple[int, ...], levels: tuple[float, ...]) -> NDArray[np.complex128]:
        """Return the (K,) ringing of each frequency at a command's last switching."""
        at, heights = self.valves.switchings(ticks, levels)
        rates = np.log(self.turns).astype(np.complex128)
        left: NDArray[np.complex128] = np.exp(np.outer(rates, ticks[-1] - at)) @ heights
        return left

    def quiet(self, command: FlowCommand) -> bool:
        """Return whether a command rings at most ``most`` at every frequency."""
        return bool((np.abs(self.left(command.ticks, command.levels)) <= self.most).all())

    def seen(self) -> NDArray[np.int64]:
        """Return the frequencies of a program or a search; commands are checked at all of them."""
        count = min(_ROWS, len(self.turns))
        return np.unique(np.rint(np.linspace(0, len(self.turns) - 1, count)).astype(np.int64))


@dataclass(frozen=True, slots=True)
class FlowCommand:
    """Level from each scan on, the last 0."""

    ticks: tuple[int, ...]
    levels: tuple[float, ...]

    @property
    def scans(self) -> int:
        """Duration."""
        return self.ticks[-1]


def around_a_circle() -> NDArray[np.complex128]:
    """Return unit vectors to the sides of the polygon that replaces a circle of ringing."""
    turned: NDArray[np.complex128] = np.exp(2j * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS)
    return turned


def least_scans(move: FlowMove, most_scans: int, known_scans: int = 1) -> int | None:
    """Return the fewest scans, from ``known_scans`` on, of any command with levels free in [0, 1].

    It is a lower bound for all valves: the circle of permitted ringing is replaced by a polygon
    around it, and the band by some of its frequencies. None if even ``most_scans`` do not suffice.
    """
    around = around_a_circle()
    seen, longer = move.seen(), move.valves.longer
    least = max(math.ceil(move.on_scans - longer - SHORT), known_scans)
    for scans in range(least, most_scans + 1):
        # The flow lasts longer than the command by this, and need not begin with a scan.
        cells = scans if longer == 0.0 else math.ceil(_FINER * (scans + longer))
        to_go = np.linspace(scans + longer, 0.0, cells + 1)
        grown = np.exp(np.log(move.turns[seen])[:, None] * to_go)
        ring = (grown[:, :-1] - grown[:, 1:]) / move.most[seen, None]
        rows = (ring[None] * around[:, None, None]).real.reshape(-1, cells)
        distance = -np.diff(to_go)[None, :]
        within = [*np.ones(len(rows)), move.on_scans + OVER, SHORT - move.on_scans]
        found = solved(
            np.zeros(cells),
            below=(np.vstack((rows, distance, -distance)), within),
            bounds=(0.0, 1.0),
        )
        if found.status == 0:
            return scans
    return None
