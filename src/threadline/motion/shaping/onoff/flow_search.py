"""Moves of a cylinder whose valves set its speed: the bound of their commands, and the search.

Open flow controls add up to a level, and every change of the level by h rings on by itself, for
each possible frequency of the mode. With levels free between 0 and 1 the shortest command on the
scan is a linear program, and no valves are faster.

A command of real valves is known by the scans at which each flow control opens and shuts. A search
shifts these by one scan, singly and in pairs, as long as the worst ringing over the band falls. It
starts from the best command with free levels, rounded to the flow controls with some noise, and
from shifted copies of the best commands so far. It does not assume a symmetric command. An integer
program over the same switchings takes a hundred times as long and finds longer commands: a pair of
shifts keeps the distance, while the branches of an integer program reach it late. A shorter command
than the one found may exist.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import ComplexArray, FloatArray, IntArray
from threadline.base.linear_programs import solved
from threadline.motion.shaping.onoff.switched import Valves

_STARTS = 900
"""Starts for each duration: unlike a time limit, independent of the computer."""
_HOPELESS = ((150, 1.7), (400, 1.3))
"""After so many starts a duration is given up if the best command rings more, x the limit."""
_FRESH = 0.1  # share of the starts that begin at the free levels
_HOP = 4  # most scans by which an edge of a kept command is shifted for a further start
_MOST_CANDIDATES = 12
_STEPS = 80
_MEAN_WEIGHT = 0.15  # of the root mean square beside the worst: it leads out of corners
_NOISE = 0.6  # most, of a dwell, in the rounding of free levels
_CHANGE = 0.3  # scans of distance that a switching must gain in the rounding
_BY_ONE: IntArray = np.array([-1, 1], dtype=np.int64)

Edges = tuple[tuple[int, ...], ...]
"""For each flow control the scans at which it opens, shuts, opens and so on."""
SHORT, OVER = 0.2, 0.02
"""Scans by which a command may fall short of the distance, and exceed it.

Commanded beyond its stroke, a piston runs into its stop.
"""
_DIRECTIONS = 16  # of the polygon that replaces a circle in the plane of ringing
_FINER = 4  # cells per scan, for a flow that does not begin or end with a scan
_ROWS = 11  # frequencies of a band in a program; all of them are checked afterwards


def shortest_flow_command(move: FlowMove, least: int, most_scans: int) -> FlowCommand | None:
    """Return the shortest command of at least ``least`` scans that is found."""
    commands = (flow_command(move, scans) for scans in range(least, most_scans + 1))
    return next((command for command in commands if command is not None), None)


def flow_command(move: FlowMove, scans: int, seed: int = 0) -> FlowCommand | None:
    """Return a command of at most ``scans`` scans that rings at most ``move.most``.

    Other seeds find other commands. None if none was found; that does not prove that there is none.
    """
    if scans < move.dwell_scans:
        return None
    search, rng = _Search(move, scans), np.random.default_rng(seed)
    free_levels = _free_levels(move, scans)
    kept_costs: dict[Edges, float] = {}
    for start in range(_STARTS):
        if any(
            start == start_count and min(kept_costs.values()) > cost_limit
            for start_count, cost_limit in _HOPELESS
        ):
            return None
        if not kept_costs or rng.random() < _FRESH:
            start_edges = _rounded(move, free_levels, _NOISE * rng.random() if start else 0.0, rng)
        else:
            ranked_edges = list(kept_costs)
            start_edges = search.shifted(
                ranked_edges[min(int(rng.exponential(2.0)), len(ranked_edges) - 1)], rng
            )
        if not search.fits(start_edges):
            continue
        edges, value = search.improved(start_edges)
        command = search.command(edges)
        if value < 1.1 and search.within(command):
            return command
        kept_costs[edges] = value
        kept_costs = dict(sorted(kept_costs.items(), key=lambda pair: pair[1])[:_MOST_CANDIDATES])
    return None


def _free_levels(move: FlowMove, scans: int) -> FloatArray:
    """Return the level of each scan that rings least with levels free in [0, 1], (scans,)."""
    sampled, directions = move.seen(), around_a_circle()
    step_ringing = np.exp(np.log(move.turns[sampled])[:, None] * np.arange(scans, -1.0, -1.0))
    level_ringing = (step_ringing[:, :-1] - step_ringing[:, 1:]) / move.most[sampled, None]
    rows = (level_ringing[None] * directions[:, None, None]).real.reshape(-1, scans)
    solution = solved(
        np.append(np.zeros(scans), 1.0),
        below=(np.hstack((rows, -np.ones((len(rows), 1)))), np.zeros(len(rows))),
        equal=(np.append(np.ones(scans), 0.0)[None], [min(move.on_scans, float(scans))]),
        bounds=[(0.0, 1.0)] * scans + [(0.0, None)],
    )
    levels: FloatArray = (
        np.zeros(scans) if solution.x is None else np.clip(solution.x[:scans], 0.0, 1.0)
    )
    return levels


def _rounded(
    move: FlowMove, free_levels: FloatArray, noise: float, rng: np.random.Generator
) -> Edges:
    """Return switchings whose distance follows the free levels one dwell ahead of each scan."""
    flows, dwell, scans = np.asarray(move.valves.flows), move.dwell_scans, len(free_levels)
    sets = np.array(list(product((0, 1), repeat=len(flows))))
    distance_ahead = np.concatenate((np.cumsum(free_levels), np.full(dwell, free_levels.sum())))
    distance_before = np.concatenate(([0.0], distance_ahead))
    open_flows = np.zeros(len(flows), dtype=np.int64)
    scans_since = np.full(len(flows), dwell)
    edges: list[list[int]] = [[] for _ in flows]
    distance_behind = 0.0
    for scan in range(scans):
        look_ahead = min(dwell, scans - scan)
        changes = sets != open_flows
        allowed = ~(changes & (scans_since < dwell)).any(axis=1)
        if look_ahead < dwell:
            allowed &= ~((sets == 1) & changes).any(axis=1)
        error = (
            distance_behind
            + distance_before[scan + look_ahead]
            - distance_before[scan]
            - look_ahead * (sets @ flows)
        )
        cost = np.abs(error) + noise * dwell * rng.random(len(sets)) + _CHANGE * changes.sum(1)
        chosen_set = int(np.argmin(np.where(allowed, cost, np.inf)))
        for flow in np.flatnonzero(changes[chosen_set]):
            edges[flow].append(scan)
            scans_since[flow] = 0
        open_flows = sets[chosen_set]
        scans_since += 1
        distance_behind += float(free_levels[scan] - open_flows @ flows)
    for flow in np.flatnonzero(open_flows):
        edges[flow].append(scans)
    return tuple(tuple(of_flow) for of_flow in edges)


class _Search:
    """The commands of one duration: their cost, and the effect of shifting their switchings."""

    def __init__(self, move: FlowMove, scans: int) -> None:
        self._move, self._scans = move, scans
        valves, sampled = move.valves, move.seen()
        rates = np.log(move.turns[sampled])[None, :]
        to_go = scans - np.arange(scans + 1.0)[:, None]
        # Ringing of a step of level 1 at each scan, in units of the limit, (scans + 1, K).
        self._opening = np.exp(rates * (to_go - valves.opens)) / move.most[sampled]
        self._closing = np.exp(rates * (to_go - valves.closes)) / move.most[sampled]

    def fits(self, edges: Edges) -> bool:
        """Return whether the flow controls can make these switchings."""
        return any(edges) and all(
            b - a >= self._move.dwell_scans for of_flow in edges for a, b in pairwise(of_flow)
        )

    def shifted(self, edges: Edges, rng: np.random.Generator) -> Edges:
        """Return a copy with a few switchings at other scans."""
        all_switchings = [
            (flow, k) for flow, of_flow in enumerate(edges) for k in range(len(of_flow))
        ]
        new_edges = [list(of_flow) for of_flow in edges]
        count = min(len(all_switchings), int(rng.integers(2, 6)))
        for index in rng.choice(len(all_switchings), size=count, replace=False):
            flow, k = all_switchings[index]
            scan = new_edges[flow][k] + int(rng.integers(-_HOP, _HOP + 1))
            new_edges[flow][k] = min(max(scan, 0), self._scans)
        return tuple(tuple(of_flow) for of_flow in new_edges)

    def command(self, edges: Edges) -> FlowCommand:
        """Return the levels that these switchings make; the first scan is scan 0."""
        levels = np.zeros(self._scans)
        for flow, of_flow in zip(self._move.valves.flows, edges, strict=True):
            for a, b in zip(of_flow[::2], of_flow[1::2], strict=True):
                levels[a:b] += flow
        changes = np.flatnonzero(np.abs(np.diff(levels, prepend=0.0, append=0.0)) > 1e-9)
        kept_levels = np.append(levels, 0.0)[changes]
        return FlowCommand(tuple((changes - changes[0]).tolist()), tuple(kept_levels.tolist()))

    def within(self, command: FlowCommand) -> bool:
        """Return whether valves make a command, it covers the distance, and rings little enough.

        Its levels alone name the open flow controls: where two sets of them make one level, other
        flow controls than the searched ones may switch.
        """
        move = self._move
        covered = move.valves.covered(command.ticks, command.levels)
        far_enough = -SHORT - 1e-9 <= covered - move.on_scans <= OVER + 1e-9
        keeps_dwell = move.valves.apart(command.ticks, command.levels) >= move.dwell_scans
        return far_enough and keeps_dwell and move.quiet(command)

    def _cost(self, ringing: ComplexArray, covered: FloatArray) -> FloatArray:
        magnitude = np.abs(ringing)
        mean_square: FloatArray = np.mean(magnitude**2, axis=-1)
        excess_scans = covered - self._move.on_scans
        distance_error = np.maximum(np.maximum(-SHORT - excess_scans, excess_scans - OVER), 0.0)
        cost: FloatArray = (
            magnitude.max(axis=-1) + _MEAN_WEIGHT * np.sqrt(mean_square) + distance_error
        )
        # Mirrored shifts cost the same: rounding, not the processor, decides that they are equal.
        return np.round(cost, 9)

    def improved(self, edges: Edges) -> tuple[Edges, float]:
        """Apply the best shift of one switching or two until none is better.

        Returns
        -------
        tuple
            The switchings, and their worst ringing in units of the limit plus the scans by which
            they miss the distance.
        """
        valves, dwell = self._move.valves, self._move.dwell_scans
        scans_at = np.array([scan for of_flow in edges for scan in of_flow], dtype=np.int64)
        flow = np.repeat(np.arange(len(edges)), [len(of_flow) for of_flow in edges])
        opens = np.concatenate([np.arange(len(of_flow)) % 2 == 0 for of_flow in edges])
        heights = np.asarray(valves.flows)[flow] * np.where(opens, 1.0, -1.0)
        closing_distance = float(np.sum(-heights[~opens])) * valves.longer
        first_switching = np.flatnonzero(
            np.append(False, flow[1:] != flow[:-1]) | (np.arange(len(scans_at)) == 0)
        )
        last_switching = np.append(first_switching[1:], len(scans_at)) - 1
        # Switchings with a next one.
        with_next = np.setdiff1d(np.arange(len(scans_at)), last_switching)
        count = 2 * len(scans_at)
        pairs = np.repeat(np.arange(len(scans_at)), 2)[:, None] != np.repeat(
            np.arange(len(scans_at)), 2
        )

        def ringing_of(scans: IntArray) -> ComplexArray:
            step_ringing = np.where(
                opens[:, None, None], self._opening[scans], self._closing[scans]
            )
            scaled_ringing: ComplexArray = step_ringing * heights[:, None, None]
            return scaled_ringing

        ringing, covered = (
            ringing_of(scans_at[:, None]).sum(axis=(0, 1)),
            closing_distance - float(heights @ scans_at),
        )
        value = float(self._cost(ringing, np.array(covered)))
        for _ in range(_STEPS):
            shifted_scans = scans_at[:, None] + _BY_ONE
            before_next = np.full((len(scans_at), 2), True)
            after_previous = (shifted_scans >= 0) & (shifted_scans <= self._scans)
            before_next[with_next] = (
                shifted_scans[with_next] <= scans_at[with_next + 1, None] - dwell
            )
            within_command = after_previous.copy()
            after_previous[with_next + 1] &= (
                shifted_scans[with_next + 1] >= scans_at[with_next, None] + dwell
            )
            single_allowed = (before_next & after_previous).reshape(-1)
            ringing_change = (
                ringing_of(np.clip(shifted_scans, 0, self._scans)) - ringing_of(scans_at[:, None])
            ).reshape(count, -1)
            distance_change = -np.repeat(heights, 2) * np.tile(_BY_ONE, len(scans_at))
            pair_allowed: NDArray[np.bool_] = single_allowed[:, None] & single_allowed & pairs
            # Two neighbours that are shifted at once keep their distance from each other's place.
            neighbours_apart = (
                shifted_scans[with_next + 1, None, :] - shifted_scans[with_next, :, None] >= dwell
            )
            neighbours_apart &= (after_previous[with_next] & within_command[with_next])[:, :, None]
            neighbours_apart &= (before_next[with_next + 1] & within_command[with_next + 1])[
                :, None, :
            ]
            rows = 2 * with_next[:, None, None] + np.arange(2)[None, :, None]
            columns = 2 * (with_next + 1)[:, None, None] + np.arange(2)[None, None, :]
            pair_allowed[rows, columns] = neighbours_apart
            pair_allowed[columns, rows] = neighbours_apart
            single_costs = self._cost(ringing + ringing_change, covered + distance_change)
            pair_costs = self._cost(
                ringing + ringing_change[:, None] + ringing_change[None],
                covered + distance_change[:, None] + distance_change[None],
            )
            single_costs[~single_allowed] = np.inf
            pair_costs[~pair_allowed] = np.inf
            best_single, best_pair = (
                int(np.argmin(single_costs)),
                divmod(int(np.argmin(pair_costs)), count),
            )
            best_cost = float(min(single_costs[best_single], pair_costs[best_pair]))
            if not best_cost < value * (1.0 - 1e-9):
                break
            for shift in (
                (best_single,) if single_costs[best_single] <= pair_costs[best_pair] else best_pair
            ):
                scans_at[shift // 2] += _BY_ONE[shift % 2]
                ringing, covered = ringing + ringing_change[shift], covered + distance_change[shift]
            value = best_cost
        edges_found = tuple(tuple(scans_at[flow == k].tolist()) for k in range(len(edges)))
        distance_error = float(self._cost(0.0 * ringing, np.array(covered)))
        return edges_found, float(np.abs(ringing).max()) + distance_error


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
        instants, heights = self.valves.switchings(ticks, levels)
        rates = np.log(self.turns).astype(np.complex128)
        ringing: NDArray[np.complex128] = np.exp(np.outer(rates, ticks[-1] - instants)) @ heights
        return ringing

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
    directions: NDArray[np.complex128] = np.exp(2j * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS)
    return directions


def least_scans(move: FlowMove, most_scans: int, known_scans: int = 1) -> int | None:
    """Return the fewest scans, from ``known_scans`` on, of any command with levels free in [0, 1].

    It is a lower bound for all valves: the circle of permitted ringing is replaced by a polygon
    around it, and the band by some of its frequencies. None if even ``most_scans`` do not suffice.
    """
    directions = around_a_circle()
    sampled, longer = move.seen(), move.valves.longer
    least = max(math.ceil(move.on_scans - longer - SHORT), known_scans)
    for scans in range(least, most_scans + 1):
        # The flow lasts longer than the command by this, and need not begin with a scan.
        cells = scans if longer == 0.0 else math.ceil(_FINER * (scans + longer))
        to_go = np.linspace(scans + longer, 0.0, cells + 1)
        step_ringing = np.exp(np.log(move.turns[sampled])[:, None] * to_go)
        level_ringing = (step_ringing[:, :-1] - step_ringing[:, 1:]) / move.most[sampled, None]
        rows = (level_ringing[None] * directions[:, None, None]).real.reshape(-1, cells)
        distance = -np.diff(to_go)[None, :]
        upper_bounds = [*np.ones(len(rows)), move.on_scans + OVER, SHORT - move.on_scans]
        solution = solved(
            np.zeros(cells),
            below=(np.vstack((rows, distance, -distance)), upper_bounds),
            bounds=(0.0, 1.0),
        )
        if solution.status == 0:
            return scans
    return None
