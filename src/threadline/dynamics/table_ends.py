"""Tables of references that begin and end with the motion, without lead and tail of the inverse.

The references of an inverse begin before the load moves and continue after it stops, until the
controller's filter has forgotten its last voltages. A table may be shorter. Its references are then
the rest position before its first row and after its last row, and the references next to an end are
chosen to minimise the deviation of the load. A linear program over the loop, tick by tick, finds
these references within the limits of voltage and current. If the DAC loses the tick after a
reversal, each voltage keeps the sign that it has in the inverse, so that the same ticks are lost;
one more tick may be lost after the last row, where the filter discharges. The result is then
simulated with every tick that the DAC really loses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.linear_programs import solved
from threadline.dynamics.loop_ticks import InverseOutput, LoopTicks, acting, acts_after
from threadline.dynamics.preview import AxisPreview
from threadline.machine import Machine

CHOSEN = 24
"""Number of optimised references next to an end of a table."""
EARLIEST = 8
"""Largest number of ticks by which a table may end before its loads are at rest."""
_MM = 1e3  # the linear program has lengths in mm, for good scaling
_NOISE_COUNTS = 2.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TableEnd:
    """References next to an end of a table.

    Parameters
    ----------
    more_si
        (k,) changes of the references, m or rad.
    off_si
        Largest deviation of the load from its motion, m or rad.
    volts, current_a
        Largest magnitudes of voltage and current at these ticks.
    """

    more_si: FloatArray
    off_si: float
    volts: float
    current_a: float


class AxisEnds:
    """The two ends of the table of one axis.

    Parameters
    ----------
    preview
        Preview of the axis. Its controller takes a reference at every tick.
    reserve
        Shares of voltage and of current that are reserved for the control loop. If the motion
        itself needs more than the remainder, its need is the limit.
    """

    def __init__(
        self, machine: Machine, axis: str, preview: AxisPreview, reserve: tuple[float, float]
    ) -> None:
        self._loop = LoopTicks(machine, axis, preview.inverse)
        controller = machine.controller_of(axis)
        limit = machine.drive_of(axis).amplifier.current_limit
        self._skips = controller.dac.zero_on_reversal
        self._volts = (1.0 - reserve[0]) * controller.dac.range.si
        self._amperes = np.inf if limit is None else (1.0 - reserve[1]) * limit.si
        loop = preview.inverse.loop
        numerator = loop.filters[loop.index].numerator
        self._band = _NOISE_COUNTS * float(np.abs(numerator).sum())

    @property
    def memory(self) -> int:
        """Number of ticks until the response to a change of the references has settled."""
        return self._loop.memory

    def first_references(
        self, output: InverseOutput, count: int, rest_si: float
    ) -> TableEnd | None:
        """Return the first references of a table that has ``rest_si`` before its first row.

        The result is None if the limits of voltage or current do not allow such a table.

        Parameters
        ----------
        output
            Output of the inverse from the first tick of the table, whose reference is the rest
            position.
        count
            Number of references after that tick to optimise.
        """
        forced = np.zeros(len(output))
        forced[0] = rest_si - output.references_si[0]
        return self._best(output, forced, np.arange(1, 1 + count), None)

    def last_references(self, output: InverseOutput, count: int, rest_si: float) -> TableEnd | None:
        """Return the last references of a table that has ``rest_si`` from a tick on.

        The result is None if the limits of voltage or current do not allow such a table.

        Parameters
        ----------
        output
            Output of the inverse at ticks before and after the end.
        count
            Number of ticks in ``output`` before the end; their references are optimised.
        """
        forced = np.zeros(len(output))
        forced[count:] = rest_si - output.references_si[count:]
        return self._best(output, forced, np.arange(count), count)

    def _best(
        self, output: InverseOutput, forced: FloatArray, chosen: IntArray, held: int | None
    ) -> TableEnd | None:
        if not forced.any():
            return TableEnd(more_si=forced, off_si=0.0, volts=0.0, current_a=0.0)
        lost_ticks = [None, held] if self._skips and held is not None else [None]
        ends = [self._chosen(output, forced, chosen, held, lost) for lost in lost_ticks]
        return min((end for end in ends if end), key=lambda end: end.off_si, default=None)

    def _chosen(
        self,
        output: InverseOutput,
        forced: FloatArray,
        chosen: IntArray,
        held: int | None,
        lost: int | None,
    ) -> TableEnd | None:
        """Return the best end if the DAC loses the tick ``lost`` besides those of the inverse."""
        acts = acting(output.levels) if self._skips else output.levels
        is_lost = acts != output.levels
        if lost is not None:
            is_lost[lost] = True
        size, n = len(output), len(chosen)
        changes = np.zeros((size, n + 1))
        changes[chosen, np.arange(n)] = 1.0
        changes[:, n] = forced

        def effect(tick: int, levels: FloatArray) -> FloatArray:
            return np.append(np.zeros(n), -acts[tick]) if is_lost[tick] else levels

        answer = self._loop.changed(changes, effect)
        current = self._loop.current_a(acts, output.counts)
        volts = max(self._volts, float(np.abs(output.levels).max()))
        amperes = max(self._amperes, float(np.abs(current).max()))
        signs = self._signs(output.levels, acts, chosen, held, lost, volts)
        if signs is None:
            return None
        low, high = signs
        load, levels, amps = answer.load_si * _MM, answer.levels, answer.current_a
        rows = [load, -load, levels, -levels]
        zeros = np.zeros(size)
        upper_bounds = [zeros, zeros, high - output.levels, output.levels - low]
        slack = [zeros - 1.0, zeros - 1.0, zeros, zeros]
        if np.isfinite(amperes):
            rows += [amps, -amps]
            upper_bounds += [amperes - current, amperes + current]
            slack += [zeros, zeros]
        matrix = np.vstack(rows)
        solution = solved(
            np.append(np.zeros(n), 1.0),
            below=(
                np.column_stack([matrix[:, :n] / _MM, np.concatenate(slack)]),
                np.concatenate(upper_bounds) - matrix[:, n],
            ),
            bounds=[(None, None)] * n + [(0.0, None)],
        )
        if solution.status != 0 or solution.x is None:
            return None
        added_si = forced.copy()
        added_si[chosen] += solution.x[:n] / _MM
        return self._followed(added_si, output.levels, acts, current)

    def _signs(
        self,
        levels: FloatArray,
        acts: FloatArray,
        chosen: IntArray,
        held: int | None,
        lost: int | None,
        volts: float,
    ) -> tuple[FloatArray, FloatArray] | None:
        """Return the (k,) smallest and largest levels; None if the tick ``lost`` cannot be lost."""
        low, high = np.full(len(levels), -volts), np.full(len(levels), volts)
        if not self._skips:
            return low, high
        signed_ticks = slice(int(chosen[0]), len(levels) if held is None else held)
        least_level = np.minimum(np.abs(levels), self._band)
        low[signed_ticks] = np.where(levels > 0.0, least_level, low)[signed_ticks]
        high[signed_ticks] = np.where(levels < 0.0, -least_level, high)[signed_ticks]
        if lost is not None:
            level_before = acts[lost - 1]
            if level_before == 0.0:
                return None
            if level_before < 0.0:
                low[lost] = self._band
            else:
                high[lost] = -self._band
        return low, high

    def _followed(
        self, added_si: FloatArray, levels: FloatArray, acts: FloatArray, current: FloatArray
    ) -> TableEnd:
        """Return the simulated result of changed references, with every tick that the DAC loses."""
        last_output = 0.0

        def effect(tick: int, change: FloatArray) -> FloatArray:
            nonlocal last_output
            level = float(levels[tick] + change[0])
            last_output = acts_after(last_output, level) if self._skips else level
            return np.array([last_output - acts[tick]])

        answer = self._loop.changed(added_si[:, None], effect)
        return TableEnd(
            more_si=added_si,
            off_si=float(np.abs(answer.load_si).max()),
            volts=float(np.abs(levels + answer.levels[:, 0]).max()),
            current_a=float(np.abs(current + answer.current_a[:, 0]).max()),
        )
