"""The commands that one move of a cylinder may have: shapers, gaps, and levels of its own."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from threadline.errors import PlanError
from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.options import Options
from threadline.pipeline import plan_job
from threadline.search.levels import LevelCommand, gapped, left_ringing, period_scans, stepped
from threadline.search.move_list import with_choices
from threadline.shaping.onoff.valves import Valves
from threadline.targets.schedule import ScheduledMove
from threadline.targets.schedule_moves import Levels, valves_of

SHAPERS = ("none", "zv", "um-zv", "um-zvd")
"""Shapers that are tried for every move; others take longer than gaps or levels made for it."""
_LEAST_LEFT, _OTHERS = 8, 12  # commands that are kept of each duration
_ENOUGH = 12
_STEPS = 34  # of a period: finer ones gain no time
_OVER = 2.0  # what rings before may cancel as much again as the limit


class MoveCommands:
    """The commands of the moves of one job; every shaper is planned once for each cylinder.

    Parameters
    ----------
    scan_s
        Scan of the PLC, s.
    turn
        Per cylinder the factor on its complex ringing in one scan.
    """

    def __init__(
        self, job: Job, machine: Machine, scan_s: float, turn: Mapping[str, complex]
    ) -> None:
        self._job, self._machine, self._scan_s, self._turn = job, machine, scan_s, turn
        self._plans: dict[tuple[str, str], Mapping[int, Levels]] = {}

    def of(self, move: ScheduledMove, limit: float) -> list[LevelCommand]:
        """Return commands of a move, the shortest first, that can be within twice the limit.

        Parameters
        ----------
        limit
            How much may ring after the move, in units of a full step.
        """
        assert self._machine.plc is not None
        turn = self._turn[move.axis]
        cylinder = self._machine.cylinders[move.axis]
        way = cylinder.way(move.forward)
        valves = valves_of(way, self._scan_s)
        on_scans = move.levels.wanted_m / (cylinder.speed.si * self._scan_s)
        most = min(_OVER * limit, 1e6)
        hold_s = way.least_hold_s(self._machine.plc)
        dwell = max(int(np.ceil(hold_s / self._scan_s - 1e-9)), 1)
        found = self._shaped(move, turn, most, valves)
        if np.isfinite(limit):
            step = step_scans(turn)
            for total in range(dwell, int(np.ceil(period_scans(turn))) + 1, step):
                found += gapped(on_scans, dwell, turn, most, total, valves, step)
                # These suffice whatever rang before: longer ones gain nothing.
                if sum(abs(c.left) <= 0.5 * limit for c in found) >= _ENOUGH:
                    break
            between = sorted({v for v in way.levels().values() if 0.0 < v < 1.0 - 1e-9})
            pairs = [(a, b) for a in between for b in between if abs(a + b - 1.0) < 1e-9]
            found += stepped(on_scans, dwell, turn, most, pairs, valves)
        return _thinned(found)

    def _shaped(
        self, move: ScheduledMove, turn: complex, most: float, valves: Valves
    ) -> list[LevelCommand]:
        found = []
        for name in SHAPERS:
            own = self._plan_with(move.axis, name).get(move.operation)
            if own is None:
                continue  # its valves cannot make that command
            left = left_ringing(own.ticks, own.levels, turn, valves)
            if abs(left) <= most:
                found.append(LevelCommand(name, own.ticks, own.levels, left))
        return found

    def _plan_with(self, axis: str, name: str) -> Mapping[int, Levels]:
        """Return the levels of every move of a cylinder that is shaped so, by operation."""
        if (axis, name) not in self._plans:
            texts = ", ".join(f"{a}={name if a == axis else 'none'}" for a in self._machine.moving)
            try:
                plain = with_choices(self._job, {}, {})
                made = plan_job(plain, self._machine, Options(shaper=texts)).scheduled.moves
            except PlanError:
                made = ()
            self._plans[axis, name] = {m.operation: m.levels for m in made if m.axis == axis}
        return self._plans[axis, name]


def step_scans(turn: complex) -> int:
    """Return the spacing, in scans, of switchings that are tried: 34 of a period are enough."""
    return max(int(period_scans(turn) // _STEPS), 1)


def _thinned(commands: list[LevelCommand]) -> list[LevelCommand]:
    """Return some of the commands: of each duration those that leave least, and some others."""
    kept: list[LevelCommand] = []
    by_scans: dict[int, list[LevelCommand]] = {}
    for command in sorted(commands, key=lambda c: (c.scans, abs(c.left))):
        by_scans.setdefault(command.scans, []).append(command)
    for same in by_scans.values():
        few = same[:_LEAST_LEFT]
        others = same[_LEAST_LEFT:]
        kept += few + others[:: max(1, -(-len(others) // _OTHERS))]
    return kept
