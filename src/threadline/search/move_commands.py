"""Possible commands for a cylinder's move, and the ringing after each, in closed form.

Open flow controls set a speed, so each change of the level by h rings independently:
``h exp(pole (t - t_i))`` in units of one full step. Only the sum of these terms at the last
switching matters for the moves that follow. Every command here covers the same distance as the
unshaped one, because level times duration is the same.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.commands.intents import ScheduledMove
from threadline.commands.schedule_moves import Levels, valves_of
from threadline.errors import PlanError
from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.motion.shaping.onoff.switched import Valves
from threadline.proof.options import Options
from threadline.proof.pipeline import plan_job
from threadline.search.move_list import with_choices

_LONGEST_PERIODS = 1.6
"""Longest first stretch of a command of three levels, in periods."""
_INTERVALS = 800


@dataclass(frozen=True, slots=True)
class LevelCommand:
    """A command of one move.

    Parameters
    ----------
    name
        A shaper's text, or ``levels``.
    ticks, levels
        Scans at which the level changes, and the level from each scan on; the last level is 0.
    left
        Complex ringing at the last switching, in units of one full step.
    """

    name: str
    ticks: tuple[int, ...]
    levels: tuple[float, ...]
    left: complex

    @property
    def scans(self) -> int:
        """Duration in scans."""
        return self.ticks[-1]

    def on(self, turn: complex, valves: Valves) -> LevelCommand:
        """Return the same command with its ringing on a machine with another mode."""
        return replace(self, left=residual_ringing(self.ticks, self.levels, turn, valves))


def residual_ringing(
    ticks: tuple[int, ...], levels: tuple[float, ...], turn: complex, valves: Valves
) -> complex:
    """Return the complex ringing after a command at its last switching, in full steps.

    Parameters
    ----------
    ticks, levels
        (n,) scans, and the level from each scan on.
    turn
        Factor on the complex ringing in one scan: ``exp(pole * scan_s)``.
    """
    times, heights = valves.switchings(ticks, levels)
    return complex(np.sum(heights * np.exp(np.log(turn) * (ticks[-1] - times))))


def gapped(
    on_scans: float,
    dwell: int,
    turn: complex,
    most: float,
    total: int,
    valves: Valves,
    step: int = 1,
) -> list[LevelCommand]:
    """Return on/off commands with one or two gaps whose ringing is at most ``most``.

    The flow lasts ``on_scans`` scans in all, and the gaps last ``total`` scans. Each stretch and
    each gap takes at least ``dwell`` scans. Places and sizes of gaps are tried every ``step``
    scans.
    """
    log = np.log(turn)
    on_scans_one_gap, on_scans_two_gaps = (
        round(on_scans - count * valves.longer) for count in (2, 3)
    )
    tables = [
        *_one_gap(on_scans_one_gap, dwell, total, step),
        *_two_gaps(on_scans_two_gaps, dwell, total, step),
    ]
    commands = []
    for edges in tables:
        delays = np.tile([valves.opens, valves.closes], edges.shape[1] // 2)
        heights = np.tile([1.0, -1.0], edges.shape[1] // 2)
        left = np.exp(log * (edges[:, -1:] - edges - delays)) @ heights
        for row in np.flatnonzero(np.abs(left) <= most):
            ticks = edges[row].tolist()
            levels = tuple(float(v) for v in np.tile([1.0, 0.0], len(ticks) // 2))
            commands.append(LevelCommand("levels", tuple(ticks), levels, complex(left[row])))
    return commands


def _one_gap(on: int, dwell: int, total: int, step: int) -> Iterator[IntArray]:
    """Yield (n, 4) switchings of commands with one gap of ``total`` scans, if there are any."""
    first_stretch = np.arange(dwell, on - dwell + 1, step)
    if len(first_stretch):
        zero = np.zeros_like(first_stretch)
        yield np.column_stack((zero, first_stretch, first_stretch + total, zero + on + total))


def _two_gaps(on: int, dwell: int, total: int, step: int) -> Iterator[IntArray]:
    """Yield (n, 6) switchings of commands with two gaps of ``total`` scans together."""
    stretches = np.arange(dwell, on - dwell + 1, step)
    gaps = np.arange(dwell, total - dwell + 1, step)
    if not len(stretches) or not len(gaps):
        return
    a, b, gap = (v.ravel() for v in np.meshgrid(stretches, stretches, gaps, indexing="ij"))
    fits = a + b <= on - stretches[0]
    a, b, gap = a[fits], b[fits], gap[fits]
    begin, end = np.zeros_like(a), on + total
    second = a + gap
    yield np.column_stack((begin, a, second, second + b, second + b + total - gap, begin + end))


def stepped(
    on_scans: float,
    dwell: int,
    turn: complex,
    most: float,
    pairs: Sequence[tuple[float, float]],
    valves: Valves,
) -> list[LevelCommand]:
    """Return commands of three levels, ``pairs`` at the ends, that ring at most ``most``.

    The flow of the unshaped command has level 1 for ``on_scans`` scans. The first and the last
    stretch are equally long, at least ``dwell`` scans. The two levels of a pair add up to 1, so the
    distance stays the same.
    """
    commands = []
    longest = int(_LONGEST_PERIODS * period_scans(turn))
    for begin, end in pairs:
        levels = (begin, 1.0, end, 0.0)
        nominal = round(on_scans)
        covered_scans = valves.covered((0, 1, nominal, nominal + 1), levels)
        on_end = nominal + round(on_scans - covered_scans)
        for first_stretch in range(dwell, min(on_end - dwell, longest) + 1):
            ticks = (0, first_stretch, on_end, on_end + first_stretch)
            left = residual_ringing(ticks, levels, turn, valves)
            if abs(left) <= most:
                commands.append(LevelCommand("levels", ticks, levels, left))
    return commands


def period_scans(turn: complex) -> float:
    """Return the period of the ringing, in scans."""
    return float(2.0 * np.pi / np.angle(turn))


@lru_cache(maxsize=256)  # each call solves some fifteen programs; searches repeat calls
def time_optimal_s(on_s: float, pole: complex) -> float:
    """Return the shortest duration of any command that leaves no ringing, s.

    Levels are free in [0, 1] and add up to ``on_s`` seconds of level 1. On a grid of the duration,
    a linear program decides whether such a command exists. If it exists for one duration, it exists
    for every longer one, so bisection finds the shortest.
    """
    from scipy.optimize import linprog

    period_s = float(2.0 * np.pi / pole.imag)

    def reachable(duration_s: float) -> bool:
        edges: FloatArray = np.linspace(0.0, duration_s, _INTERVALS + 1)
        exponentials = np.exp(pole * (duration_s - edges))
        ringing = exponentials[:-1] - exponentials[1:]
        rows = np.vstack((ringing.real, ringing.imag, np.diff(edges) / on_s))
        solution = linprog(np.zeros(_INTERVALS), A_eq=rows, b_eq=[0.0, 0.0, 1.0], bounds=(0.0, 1.0))
        return bool(solution.status == 0)

    low, high = on_s, on_s + period_s
    if reachable(low):
        return low
    while high - low > 1e-4 * period_s:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if reachable(middle) else (middle, high)
    return high


SHAPERS = ("none", "zv", "um-zv", "um-zvd")
"""Shapers tried for every move; others take longer than gaps or levels made for the move."""
_LEAST_LEFT, _OTHERS = 8, 12  # number of kept commands of each duration: least ringing, others
_ENOUGH = 12
_STEPS = 34  # number of steps in a period; finer steps save no time
_OVER = 2.0  # a command may ring at twice the limit: earlier ringing may cancel the excess


class MoveCommands:
    """The commands of the moves of one job; every shaper is planned once for each cylinder.

    Parameters
    ----------
    scan_s
        Scan of the PLC, s.
    turn
        Per cylinder, the factor on its complex ringing in one scan.
    """

    def __init__(
        self, job: Job, machine: Machine, scan_s: float, turn: Mapping[str, complex]
    ) -> None:
        self._job, self._machine, self._scan_s, self._turn = job, machine, scan_s, turn
        self._plans: dict[tuple[str, str], Mapping[int, Levels]] = {}

    def of(self, move: ScheduledMove, limit: float) -> list[LevelCommand]:
        """Return commands of a move that ring at most twice the limit, the shortest first.

        Parameters
        ----------
        limit
            Allowed ringing after the move, in units of a full step.
        """
        assert self._machine.plc is not None
        turn = self._turn[move.axis]
        cylinder = self._machine.cylinders[move.axis]
        way = cylinder.way(move.forward)
        valves = valves_of(way, self._scan_s)
        on_scans = move.levels.wanted_m / (cylinder.speed.si * self._scan_s)
        most_ringing = min(_OVER * limit, 1e6)
        hold_s = way.least_hold_s(self._machine.plc)
        dwell = max(int(np.ceil(hold_s / self._scan_s - 1e-9)), 1)
        commands = self._shaped(move, turn, most_ringing, valves)
        if np.isfinite(limit):
            step = step_scans(turn)
            for total in range(dwell, int(np.ceil(period_scans(turn))) + 1, step):
                commands += gapped(on_scans, dwell, turn, most_ringing, total, valves, step)
                # Enough commands ring little, so that any earlier ringing is covered; longer ones
                # are not needed.
                if sum(abs(c.left) <= 0.5 * limit for c in commands) >= _ENOUGH:
                    break
            middle_levels = sorted({v for v in way.levels().values() if 0.0 < v < 1.0 - 1e-9})
            pairs = [
                (a, b) for a in middle_levels for b in middle_levels if abs(a + b - 1.0) < 1e-9
            ]
            commands += stepped(on_scans, dwell, turn, most_ringing, pairs, valves)
        return _thinned(commands)

    def _shaped(
        self, move: ScheduledMove, turn: complex, most_ringing: float, valves: Valves
    ) -> list[LevelCommand]:
        commands = []
        for name in SHAPERS:
            levels = self._plan_with(move.axis, name).get(move.operation)
            if levels is None:
                continue  # the cylinder's valves cannot make this command
            left = residual_ringing(levels.ticks, levels.levels, turn, valves)
            if abs(left) <= most_ringing:
                commands.append(LevelCommand(name, levels.ticks, levels.levels, left))
        return commands

    def _plan_with(self, axis: str, name: str) -> Mapping[int, Levels]:
        """Return the levels of a cylinder's moves with one shaper, by operation; may be empty."""
        if (axis, name) not in self._plans:
            texts = ", ".join(f"{a}={name if a == axis else 'none'}" for a in self._machine.moving)
            try:
                plain_job = with_choices(self._job, {}, {})
                shaped_moves = plan_job(
                    plain_job, self._machine, Options(shaper=texts)
                ).scheduled.one_cycle.moves
            except PlanError:
                shaped_moves = ()
            self._plans[axis, name] = {
                m.operation: m.levels for m in shaped_moves if m.axis == axis
            }
        return self._plans[axis, name]


def step_scans(turn: complex) -> int:
    """Return the spacing of tried switchings in scans: 34 in a period are enough."""
    return max(int(period_scans(turn) // _STEPS), 1)


def _thinned(commands: list[LevelCommand]) -> list[LevelCommand]:
    """Return fewer commands: for each duration the ones that ring least, and some others."""
    thinned: list[LevelCommand] = []
    by_scans: dict[int, list[LevelCommand]] = {}
    for command in sorted(commands, key=lambda c: (c.scans, abs(c.left))):
        by_scans.setdefault(command.scans, []).append(command)
    for equally_long in by_scans.values():
        least_ringing = equally_long[:_LEAST_LEFT]
        remaining = equally_long[_LEAST_LEFT:]
        thinned += least_ringing + remaining[:: max(1, -(-len(remaining) // _OTHERS))]
    return thinned
