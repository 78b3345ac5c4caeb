"""The fibre of a simulated winder: where it lies, how fast it is drawn, and how it pulls.

The actual positions of the axes, the mounted mandrel, and the spool in the machine file determine
the fibre. It is laid tick by tick, as in ``winding.replay``. Its speed through the eye moves spool
and arm (``dynamics.spool``); their tension pulls at the eye and turns the mandrel back. No plan is
read.

Until the mandrel is commanded to turn, the fibre is only tied: under tension in the direction in
which the winding begins, if the mandrel gives that direction, else slack, with the arm on its lower
stop. If the place of the fibre is lost, no fibre is drawn until the place is found again.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.dynamics.spool import (
    TENSION,
    TORQUE,
    drawn,
    slack,
    spool_numbers,
    steps_in,
    unwind,
)
from threadline.dynamics.values import Values
from threadline.machine import Machine
from threadline.winding.laying import KNOWN_AFTER, Laid, Tables, first_look, lay, leads
from threadline.winding.replay import GUESSES, STATE, TURNED_M, eye_columns


class Unwinding:
    """The fibres of runs of one machine, side by side.

    Parameters
    ----------
    values
        Numbers of the runs.
    start
        (axes,) positions of the axes before the first tick, m or rad.

    Attributes
    ----------
    tension_n
        (runs,) tension at the eye.
    pulls
        (runs, axes) forces of the fibre on the axes, N or N m.

    Raises
    ------
    MachineError
        If spool and fibre are too fast for the ticks of the machine.
    """

    def __init__(self, machine: Machine, values: Values, start: FloatArray) -> None:
        mandrel, tool = machine.mounted, machine.tool
        assert mandrel is not None and tool is not None
        self._tool, self._axes, runs = tool, machine.axis_names, values.count
        self._mandrel = mandrel
        self._tick_s = float(machine.tick_clock.period_s)
        self._numbers = spool_numbers(machine, values)
        self._steps = steps_in(machine, self._numbers, self._tick_s)
        self._torque = self._numbers[:, TORQUE].copy()
        self._set_from = np.array([operation for operation, _ in mandrel.brakes], dtype=np.int64)
        self._set_to = np.array([factor for _, factor in mandrel.brakes])
        self._set_brake(0)
        self._tables = Tables(
            nodes=mandrel.nodes,
            x=mandrel.x,
            r=mandrel.r,
            payout=np.array([*tool.payout_m, *tool.roller_m, 0.0, 1.0, 0.0]),
            friction=mandrel.friction,
            convex=mandrel.convex,
        )
        tied = mandrel.tied_m
        self._tied = None if tied is None else np.array([tied])
        self._places = np.linspace(0.0, float(mandrel.nodes[-1]), GUESSES)
        self._least_turn = TURNED_M / float(mandrel.r[:, 0].max())
        self._laid, self._leads = np.zeros((runs, STATE)), np.zeros((runs, 6))
        self._begun, self._turns = np.zeros(runs, dtype=bool), False
        self._never = np.ones(runs, dtype=bool)
        self._waited = np.zeros((len(self._never), 2))
        self._eyes = self._eyes_at(np.repeat(start[None], runs, axis=0))
        self._rest = float(self._eyes[0, 0])
        if mandrel.leads is None:
            self._spools = slack(runs)
        else:
            self._spools = drawn(self._numbers)
            self._leads[:] = mandrel.leads
        # Axis and factor of each coordinate of the eye that an axis moves.
        self._moved = [
            (k, self._axes.index(part.axis), part.factor * (1.0 - mandrel.slip if k == 0 else 1.0))
            for k, part in enumerate(tool.parts)
            if part is not None and part.axis in self._axes
        ]
        self.tension_n: FloatArray
        self.pulls: FloatArray
        self._pull()

    def _eyes_at(self, positions: FloatArray) -> FloatArray:
        columns = eye_columns(self._tool, self._axes, positions)
        columns[:, 0] *= 1.0 - self._mandrel.slip
        columns[:, 1] -= self._mandrel.at_m
        return columns

    def _pull(self) -> None:
        """Set tension and pulls."""
        self.tension_n = self._spools[:, TENSION].copy()
        self.pulls = np.zeros((len(self._spools), len(self._axes)))
        for k, axis, factor in self._moved:
            self.pulls[:, axis] = -self.tension_n * factor * self._leads[:, k]

    def _set_brake(self, operation: int) -> None:
        """Set the brake to the tension of an operation of the job."""
        if len(self._set_to):
            row = int(np.searchsorted(self._set_from, operation, side="right")) - 1
            self._numbers[:, TORQUE] = self._torque * self._set_to[max(row, 0)]

    def advance(
        self, commanded: FloatArray, positions: FloatArray, rates: FloatArray, operation: int
    ) -> None:
        """Take positions and velocities of the axes at the next tick.

        Parameters
        ----------
        commanded
            (axes,) commanded positions before the tick.
        positions, rates
            (runs, axes) positions and velocities.
        operation
            Commanded operation of the job, which sets the brake.
        """
        self._set_brake(operation)
        eyes = self._eyes_at(positions)
        if not self._turns:
            turn = float(self._eyes_at(commanded[None])[0, 0])
            self._turns = abs(turn - self._rest) > self._least_turn
        self._waited[self._begun] = 0.0
        if self._turns and not self._begun.all():
            self._begin(eyes)
        speeds = np.zeros_like(eyes)
        for k, axis, factor in self._moved:
            speeds[:, k] = factor * rates[:, axis]
        if self._turns:
            fibre = self._begun, self._laid, self._leads
            spools = self._spools, self._numbers, self._steps
            _advance(self._eyes, eyes, speeds, self._tables, fibre, spools, self._tick_s)
        self._eyes = eyes
        self._pull()

    def _begin(self, eyes: FloatArray) -> None:
        """Look for the fibre in the runs where its place is unknown, as ``winding.replay`` does."""
        for run in np.flatnonzero(~self._begun):
            tied = self._tied if self._never[run] else None
            places = self._places if tied is None else tied
            chain = np.stack([self._eyes[run], eyes[run]])
            _, row, angle = first_look(chain, 0, self._tables, places, self._waited[run])
            if row < 0:
                continue
            state = np.zeros(STATE)
            state[0], state[1] = places[row], angle
            state[3] = 0.0 if tied is None else KNOWN_AFTER
            state[9], state[10] = np.inf, -np.inf
            self._laid[run], self._begun[run], self._never[run] = state, True, False


@njit(nogil=True)
def _advance(
    before: FloatArray, eyes: FloatArray, speeds: FloatArray, tables: Tables,
    fibre: tuple[NDArray[np.bool_], FloatArray, FloatArray],
    spools: tuple[FloatArray, FloatArray, IntArray], tick_s: float,
) -> None:  # fmt: skip
    """Lay the fibre of every run from (runs, 6) eyes to the next, and advance its spool.

    Parameters
    ----------
    speeds
        (runs, 6) speeds of the eyes' coordinates at the end of the tick.
    fibre
        (runs,) whether the place of the fibre is known; (runs, 12) states as in ``lay``; (runs, 6)
        fibre per coordinate as in ``leads``. All are updated.
    spools
        States, numbers and steps in a tick of the spools; see ``dynamics.spool``.
    """
    begun, states, found = fibre
    wound, numbers, steps = spools
    chain, work = np.empty((2, 6)), np.empty((2, 15))
    laid = Laid(np.zeros(1, dtype=np.int64), np.zeros((1, 10)), np.zeros((1, 3)))
    group = np.array([0, 1])
    for run in range(len(eyes)):
        used, speed = 0.0, 0.0
        if begun[run]:
            chain[0], chain[1] = before[run], eyes[run]
            begun[run] = lay(chain, group, tables, states[run], laid, 0) == 1
            found[run] = 0.0
        if begun[run]:
            used = laid.place[0, 8]
            leads(eyes[run], states[run], tables, work, found[run])
            for k in range(6):
                speed += found[run, k] * speeds[run, k]
        unwind(wound[run], numbers[run], used, speed, tick_s, steps[run])
