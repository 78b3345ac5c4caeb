"""Moves of a cylinder whose valves set its speed: the shortest command with permitted ringing.

Open flow controls add up to a level, and every change of the level by h rings on by itself, for
each possible frequency of the mode. With levels free between 0 and 1 the shortest command on the
scan is a linear program, and no valves are faster. Which flow control is open in which scan is an
integer program. The command is taken symmetric about its middle, as undamped optima are, which
halves the unknowns; each returned command was checked with its damping.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray
from threadline.base.linear_programs import solved
from threadline.motion.shaping.onoff.switched import Valves

_NODES = 200
"""Most nodes of an integer program's tree: unlike a time limit, independent of the computer."""
_SHORT, _OVER = 0.2, 0.02
"""Scans by which a command may fall short of the distance, and exceed it.

Commanded beyond its stroke, a piston runs into its stop.
"""
_ROUNDS = 4
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

    def _seen(self) -> NDArray[np.int64]:
        """Return the frequencies in the program."""
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


def least_scans(move: FlowMove, most_scans: int, known_scans: int = 1) -> int | None:
    """Return the fewest scans, from ``known_scans`` on, of any command with levels free in [0, 1].

    It is a lower bound for all valves: the circle of permitted ringing is replaced by a polygon
    around it, and the band by some of its frequencies. None if even ``most_scans`` do not suffice.
    """
    around = np.exp(2j * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS)
    seen, longer = move._seen(), move.valves.longer
    least = max(math.ceil(move.on_scans - longer - _SHORT), known_scans)
    for scans in range(least, most_scans + 1):
        # The flow lasts longer than the command by this, and need not begin with a scan.
        cells = scans if longer == 0.0 else math.ceil(_FINER * (scans + longer))
        to_go = np.linspace(scans + longer, 0.0, cells + 1)
        grown = np.exp(np.log(move.turns[seen])[:, None] * to_go)
        ring = (grown[:, :-1] - grown[:, 1:]) / move.most[seen, None]
        rows = (ring[None] * around[:, None, None]).real.reshape(-1, cells)
        distance = -np.diff(to_go)[None, :]
        within = [*np.ones(len(rows)), move.on_scans + _OVER, _SHORT - move.on_scans]
        found = solved(
            np.zeros(cells),
            below=(np.vstack((rows, distance, -distance)), within),
            bounds=(0.0, 1.0),
        )
        if found.status == 0:
            return scans
    return None


def flow_command(move: FlowMove, scans: int) -> FlowCommand | None:
    """Return a command of ``scans`` scans that rings at most ``move.most``.

    None if none was found among symmetric ones; that does not prove that there is none.
    """
    half = (scans + 1) // 2
    share = 1.0
    for _ in range(_ROUNDS):
        opened = _opened(move, scans, half, share)
        if opened is None:
            return None
        levels = np.asarray(move.valves.flows) @ opened
        command = _command(np.concatenate((levels, levels[: scans - half][::-1])))
        if (np.abs(move.left(command.ticks, command.levels)) <= move.most).all():
            return command
        # Between the frequencies of the program, or through damping, it rings more.
        share *= 0.95
    return None


def shortest_flow_command(move: FlowMove, least: int, most_scans: int) -> FlowCommand | None:
    """Return the shortest command of at least ``least`` scans that is found."""
    found = (flow_command(move, scans) for scans in range(least, most_scans + 1))
    return next((command for command in found if command is not None), None)


def _command(levels: FloatArray) -> FlowCommand:
    """Return a level of every scan as a command."""
    changes = np.flatnonzero(np.abs(np.diff(levels, prepend=0.0, append=0.0)) > 1e-9)
    kept = np.append(levels, 0.0)[changes]
    return FlowCommand(tuple(changes.tolist()), tuple(kept.tolist()))


def _opened(move: FlowMove, scans: int, half: int, share: float) -> FloatArray | None:
    """Return which flow control is open in which scan of the first half, (flows, half).

    Unknowns: whether each is open in each scan, then whether it switches at each edge.
    """
    from scipy.optimize import Bounds, LinearConstraint, milp
    from scipy.sparse import csr_matrix

    seen, flows, longer = move._seen(), move.valves.flows, move.valves.longer
    count = len(flows)
    turning = np.angle(move.turns[seen])[:, None]
    edges = np.arange(half, dtype=np.float64) - 0.5 * scans
    # Symmetric about its middle an undamped command rings in one quadrature only: an edge and its
    # image twice as much as the edge alone. The flow is symmetric, too, about its own middle: by
    # half of the difference between closing and opening time it begins before the command and ends
    # after it. An edge contributes half of its ringing for either sense in which it switches.
    up = -np.sin(turning * (edges - 0.5 * longer)) / move.most[seen, None]
    down = -np.sin(turning * (edges + 0.5 * longer)) / move.most[seen, None]
    rows = up + down
    rows[:, :-1] -= rows[:, 1:].copy()
    distance = np.full((1, half), 2.0)
    if scans % 2:
        distance[0, -1] = 1.0
    unknowns = count * half
    switched = np.vstack((up - down, np.full((1, half), longer)))
    quiet = np.hstack([flow * switched for flow in flows])
    by_flow = np.hstack([flow * np.vstack((rows, distance)) for flow in flows])
    least = [*np.full(len(rows), -share), move.on_scans - _SHORT]
    largest = [*np.full(len(rows), share), move.on_scans + _OVER]
    apart, most = _apart(half, scans, move.dwell_scans, longer != 0.0)
    constraints = [LinearConstraint(np.hstack((by_flow, quiet)), least, largest)]
    for flow in range(count):
        placed = np.zeros((len(apart), 2 * unknowns))
        placed[:, flow * half : (flow + 1) * half] = apart[:, :half]
        placed[:, unknowns + flow * half : unknowns + (flow + 1) * half] = apart[:, half:]
        constraints.append(LinearConstraint(csr_matrix(placed), -np.inf, most))
    found = milp(
        np.repeat([0.0, 1.0], unknowns),  # of all permitted commands, one with few switchings
        constraints=constraints,
        integrality=np.ones(2 * unknowns, dtype=np.int64),
        bounds=Bounds(0.0, 1.0),
        options={"node_limit": _NODES, "mip_rel_gap": 0.2},
    )
    if found.x is None:
        return None
    return np.rint(found.x[:unknowns]).reshape(count, half)


def _apart(half: int, scans: int, dwell: int, exact: bool) -> tuple[FloatArray, FloatArray]:
    """Return rows over (open, switches) of one flow control, and their upper bounds.

    It starts shut; of ``dwell`` consecutive edges one may switch; an edge near the middle and its
    mirror image count as two. With ``exact`` only actual changes count as switchings.
    """
    step = np.eye(half) - np.eye(half, k=-1)
    marks = np.eye(half)
    rows = [np.hstack((step, -marks)), np.hstack((-step, -marks))]
    most = [np.zeros(2 * half)]
    windows = np.zeros((half, 2 * half))
    for first in range(half):
        windows[first, half + first : half + min(first + dwell, half)] = 1.0
    near = [edge for edge in range(half) if 0 < scans - 2 * edge < dwell]
    forbidden = np.zeros((len(near), 2 * half))
    for row, edge in enumerate(near):
        forbidden[row, half + edge] = 1.0
    rows += [windows, forbidden]
    most += [np.ones(half), np.zeros(len(near))]
    if exact:
        both = np.eye(half) + np.eye(half, k=-1)
        rows += [np.hstack((-both, marks)), np.hstack((both, marks))]
        most += [np.zeros(half), np.full(half, 2.0)]
    return np.vstack(rows), np.concatenate(most)
