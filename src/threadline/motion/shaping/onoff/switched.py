"""On/off commands on a controller's tick: levels -1, 0 and 1 only.

Which levels a robust command uses is an integer program. The command is taken antisymmetric about
its middle, u(T - t) = -u(t), as undamped optima are: its final speed is 0, the ringing has one
quadrature, and half of the unknowns remain. Every returned command is checked on a dense sweep with
the machine's own damping; a search that ends without one proves nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.errors import OptionError
from threadline.motion.shaping.onoff.body_and_modes import (
    Command,
    PerMode,
    RestToRest,
    per_mode,
    ringing_rows,
    rings_within,
    travel_rows,
    worst_ringing,
)
from threadline.motion.shaping.onoff.robust import least_ringing

DEFAULT_NODES = 3000
_MORE_NODES = 4  # times as many if changes must keep a distance: twice as many unknowns
_SWEEP = 11
_ROUNDS = 4


@dataclass(frozen=True, slots=True)
class FrontPoint:
    """Least worst ringing for one duration on the tick.

    Parameters
    ----------
    duration_s
        A whole number of ticks.
    free
        Worst ringing over the band with levels free in [-1, 1] (the global least), as a
        fraction of one full step's; None if the distance cannot be covered.
    switched
        Worst ringing of the on/off command found within the tolerance; None without one.
    command
        That command.
    """

    duration_s: float
    free: float | None
    switched: float | None
    command: Command | None = None


def switched_command(
    move: RestToRest,
    *,
    relative: PerMode,
    tolerance: PerMode,
    tick_s: float,
    ticks: int,
    dwell_ticks: int = 1,
    nodes: int = DEFAULT_NODES,
) -> Command | None:
    """On/off command of ``ticks`` whole ticks that rings at most ``tolerance`` over the band.

    Parameters
    ----------
    move, relative, tolerance
        As for :func:`threadline.motion.shaping.onoff.robust.robust_optimum`.
    tick_s, ticks
        The controller's tick, s, and the duration in ticks. The distance is met to 1e-9 of it,
        so it must be a whole number of half acceleration x tick^2; else there is none.
    dwell_ticks
        Fewest ticks between two changes of the level, as the valves need.
    nodes
        Most nodes of each integer program's tree: unlike a time limit, independent of the
        computer and its load.

    Returns
    -------
    Command or None
        None if none was found within these nodes; that does not prove that there is none.
    """
    from scipy.optimize import Bounds, LinearConstraint, milp

    half_widths, allowed = per_mode(relative, move.modes), per_mode(tolerance, move.modes)
    if ticks < 2 or not tick_s > 0.0 or not min(allowed) > 0.0:
        raise OptionError(
            f"on/off command: ticks {ticks!r}, tick_s {tick_s!r} and tolerance {tolerance!r} "
            "must be positive, and at least 2 ticks"
        )
    edges = np.arange(ticks + 1, dtype=np.float64) * tick_s
    half_ticks = ticks // 2
    # Row of the first half minus its mirror image.
    distance = travel_rows(edges)[1]
    reach = (distance[:half_ticks] - distance[::-1][:half_ticks]) / tick_s**2
    target = move.distance_m / (move.acceleration_m_s2 * tick_s**2)
    share = 0.995
    for _ in range(_ROUNDS):
        rows = []
        for mode, half_width, most_ringing in zip(move.modes, half_widths, allowed, strict=True):
            f = mode.frequency_hz * np.linspace(1.0 - half_width, 1.0 + half_width, _SWEEP)
            centred_rows = ringing_rows(edges, f, 0.0) * np.exp(1j * np.pi * f * edges[-1])[:, None]
            half_rows = (
                centred_rows[:, :half_ticks] - centred_rows[:, ::-1][:, :half_ticks]
            ) / most_ringing
            rows += [half_rows.real, half_rows.imag]
        band = np.vstack(rows)
        band = band[np.abs(band).max(axis=1) * min(allowed) > 1e-9]
        dwell_rows, unknown_count = _apart(half_ticks, ticks, dwell_ticks)
        no_effect = np.zeros((len(band), unknown_count - half_ticks))
        solution = milp(
            np.zeros(unknown_count),
            constraints=[
                LinearConstraint(np.hstack((band, no_effect)), -share, share),
                LinearConstraint(
                    np.pad(reach[None, :], ((0, 0), (0, unknown_count - half_ticks))),
                    target,
                    target,
                ),
                *(
                    []
                    if dwell_rows is None
                    else [LinearConstraint(dwell_rows[0], -np.inf, dwell_rows[1])]
                ),
            ],
            integrality=np.ones(unknown_count, dtype=np.int64),
            bounds=Bounds(
                np.repeat([-1.0, 0.0], [half_ticks, unknown_count - half_ticks]),
                np.ones(unknown_count),
            ),
            options={"node_limit": nodes},
        )
        if solution.x is None:
            return None
        first_half = np.rint(solution.x[:half_ticks])
        middle = np.zeros(ticks % 2)
        command = Command(edges, np.concatenate((first_half, middle, -first_half[::-1])))
        reached_m = float(distance @ command.levels) * move.acceleration_m_s2
        rings_little = rings_within(command, move.modes, relative, tolerance)
        if rings_little and abs(reached_m - move.distance_m) <= 1e-9 * move.distance_m:
            return command
        # Between the swept frequencies, or through damping, it rings more: require less.
        share *= 0.93
    return None


def _apart(half: int, ticks: int, dwell: int) -> tuple[tuple[FloatArray, FloatArray] | None, int]:
    """Return rows and bounds that keep changes of the level apart, and the number of unknowns.

    Besides the levels of the first half there is an unknown for each edge, from the first to the
    one after the last level: whether the level changes there. Of ``dwell`` consecutive edges one
    may; near the middle, where the command meets its mirror image, an edge and its image count as
    two.
    """
    if dwell <= 1:
        return None, half
    unknown_count = 2 * half + 1
    steps = np.zeros((half + 1, unknown_count))
    steps[:half, :half] = np.eye(half) - np.eye(half, k=-1)
    steps[half, half - 1] = 1.0  # to the mirror image, or to the 0 in the middle
    marks = np.hstack((np.zeros((half + 1, half)), 2.0 * np.eye(half + 1)))
    rows = [steps - marks, -steps - marks]
    bounds = [np.zeros(2 * (half + 1))]
    for first_edge in range(half + 1):
        window = np.zeros((1, unknown_count))
        window[0, half + first_edge : half + min(first_edge + dwell, half + 1)] = 1.0
        rows.append(window)
        bounds.append(np.ones(1))
    for edges_back in range(half + 1):
        # Its image is as far after the middle; an odd command has a tick of 0 there.
        ticks_between = 2 * edges_back + ticks % 2
        if 0 < ticks_between < dwell:
            middle_row = np.zeros((1, unknown_count))
            middle_row[0, unknown_count - 1 - edges_back] = 1.0
            rows.append(middle_row)
            bounds.append(np.zeros(1))
    return (np.vstack(rows), np.concatenate(bounds)), unknown_count


def residual_front(
    move: RestToRest,
    *,
    relative: PerMode,
    tolerance: PerMode,
    tick_s: float,
    ticks: Sequence[int],
    dwell_ticks: int = 1,
    nodes: int = DEFAULT_NODES,
) -> list[FrontPoint]:
    """Residual against time: for each duration the free least and an on/off command, if found."""
    points = []
    for count in ticks:
        free = least_ringing(
            move, relative=relative, tick_s=tick_s, ticks=count, tolerance=tolerance
        )
        # Free levels bound the on/off ones from below: skip the search if they fail.
        command = None
        if free is not None and free[0] <= max(per_mode(tolerance, move.modes)):
            command = switched_command(
                move,
                relative=relative,
                tolerance=tolerance,
                tick_s=tick_s,
                ticks=count,
                dwell_ticks=dwell_ticks,
                nodes=nodes if dwell_ticks <= 1 else _MORE_NODES * nodes,
            )
        points.append(
            FrontPoint(
                count * tick_s,
                None if free is None else free[0],
                None if command is None else worst_ringing(command, move.modes, relative),
                command,
            )
        )
    return points


@dataclass(frozen=True, slots=True, kw_only=True)
class Valves:
    """The flow controls of one direction.

    Parameters
    ----------
    flows
        Contribution of each to the level, together 1.
    opens, closes
        Delay from a command to the flow, in scans; a common delay may be omitted.
    """

    flows: tuple[float, ...]
    opens: float = 0.0
    closes: float = 0.0

    @property
    def longer(self) -> float:
        """Number of scans by which each stretch of flow is longer than its command."""
        return self.closes - self.opens

    @property
    def at_once(self) -> bool:
        """Whether the flow follows each command without delay."""
        return self.opens == self.closes == 0.0

    def switchings(
        self, ticks: tuple[int, ...], levels: tuple[float, ...]
    ) -> tuple[FloatArray, FloatArray]:
        """Return when the level changes, in scans, and by how much, for each flow control.

        Parameters
        ----------
        ticks, levels
            Level from each scan on, the last 0.
        """
        if self.at_once:
            return np.asarray(ticks, dtype=np.float64), np.diff(levels, prepend=0.0)
        changes = self._changes(levels)
        row, flow = np.nonzero(changes)
        height = changes[row, flow] * np.asarray(self.flows)[flow]
        delays = np.where(height > 0.0, self.opens, self.closes)
        return np.asarray(ticks, dtype=np.float64)[row] + delays, height

    def _changes(self, levels: tuple[float, ...]) -> FloatArray:
        """Return by how much each flow control opens at each level, (levels, flows)."""
        opened = np.array([self._opened(level) for level in levels], dtype=np.float64)
        changes: FloatArray = np.diff(opened, axis=0, prepend=np.zeros((1, len(self.flows))))
        return changes

    def apart(self, ticks: tuple[int, ...], levels: tuple[float, ...]) -> int:
        """Return the fewest scans between two switchings of one flow control."""
        tick_array = np.asarray(ticks)
        switched_ticks = (tick_array[changes != 0.0] for changes in self._changes(levels).T)
        return min(
            (int(np.diff(own_ticks).min()) for own_ticks in switched_ticks if len(own_ticks) > 1),
            default=tick_array[-1],
        )

    def _opened(self, level: float) -> tuple[bool, ...]:
        """Return which of them are open for a level: the set that comes closest, the smaller."""
        places = range(len(self.flows))
        sets = [
            open_flows
            for count in range(len(self.flows) + 1)
            for open_flows in combinations(places, count)
        ]
        best_set = min(
            sets, key=lambda open_flows: abs(sum(self.flows[i] for i in open_flows) - level)
        )
        return tuple(i in best_set for i in places)

    def covered(self, ticks: tuple[int, ...], levels: tuple[float, ...]) -> float:
        """Return the distance of a command, in scans of level 1."""
        instants, height = self.switchings(ticks, levels)
        return float(-np.dot(instants, height))
