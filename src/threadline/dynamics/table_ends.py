"""Tables of references that begin and end with the motion, in place of the rests of an inverse.

The references of an inverse begin before the load moves, and go on after it stands until the
filter of the controller has forgotten its last voltages. A table may be shorter: it tells the
place of rest before its first row and after its last, and the references next to these are chosen
so that the load leaves its motion as little as possible. A linear program over the loop as it is,
tick by tick, asks for them. Voltage and current keep their limits. Where a DAC loses the tick after
a reversal, each voltage keeps the sign that the inverse gave it, so that the same ticks are lost;
behind the last row one tick more may be, that in which the filter takes its memory back. What comes
of it is then followed with every tick that the DAC really loses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.linear_programs import solved
from threadline.dynamics.loop_ticks import LoopTicks, Told, acting, acts_after
from threadline.dynamics.preview import AxisPreview
from threadline.machine import Machine

CHOSEN = 24
"""Number of references next to an end of a table that are chosen anew."""
EARLIEST = 8
"""Number of ticks before its loads stand at which a table ends at the earliest."""
_MM = 1e3  # lengths in mm: the program is scaled so
_NOISE_COUNTS = 2.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TableEnd:
    """References next to an end of a table.

    Parameters
    ----------
    more_si
        (k,) what is added to the references, m or rad.
    off_si
        By how much the load leaves its motion at most, m or rad.
    volts, current_a
        Largest magnitudes at these ticks.
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
        Of the axis. Its controller takes a reference at each of its ticks.
    reserve
        Share of voltage and current that is kept for the loop; where the motion itself asks for
        more than is left, so much may be asked for.
    """

    def __init__(self, machine: Machine, axis: str, preview: AxisPreview, reserve: float) -> None:
        self._loop = LoopTicks(machine, axis, preview.inverse)
        controller = machine.controller_of(axis)
        limit = machine.drive_of(axis).amplifier.current_limit
        self._skips = controller.dac.zero_on_reversal
        self._volts = (1.0 - reserve) * controller.dac.range.si
        self._amperes = np.inf if limit is None else (1.0 - reserve) * limit.si
        loop = preview.inverse.loop
        numerator = loop.filters[loop.index].numerator
        self._band = _NOISE_COUNTS * float(np.abs(numerator).sum())

    @property
    def memory(self) -> int:
        """Number of ticks after which a change of the references is settled."""
        return self._loop.memory

    def begun(self, told: Told, count: int, rest_si: float) -> TableEnd | None:
        """Return the first references of a table that tells ``rest_si`` before its first row.

        None where voltage or current have no room for it.

        Parameters
        ----------
        told
            From the tick on at which the table begins: this tick tells the place of rest.
        count
            Number of references behind it that are chosen anew.
        """
        forced = np.zeros(len(told))
        forced[0] = rest_si - told.references_si[0]
        return self._best(told, forced, np.arange(1, 1 + count), None)

    def ended(self, told: Told, count: int, rest_si: float) -> TableEnd | None:
        """Return the last references of a table that tells ``rest_si`` from a tick on.

        None where voltage or current have no room for it.

        Parameters
        ----------
        told
            Ticks before the end and after it.
        count
            Number of ticks in ``told`` before that one; their references are chosen anew.
        """
        forced = np.zeros(len(told))
        forced[count:] = rest_si - told.references_si[count:]
        return self._best(told, forced, np.arange(count), count)

    def _best(
        self, told: Told, forced: FloatArray, chosen: IntArray, held: int | None
    ) -> TableEnd | None:
        if not forced.any():
            return TableEnd(more_si=forced, off_si=0.0, volts=0.0, current_a=0.0)
        ways = [None, held] if self._skips and held is not None else [None]
        found = [self._chosen(told, forced, chosen, held, lost) for lost in ways]
        return min((end for end in found if end), key=lambda end: end.off_si, default=None)

    def _chosen(
        self,
        told: Told,
        forced: FloatArray,
        chosen: IntArray,
        held: int | None,
        lost: int | None,
    ) -> TableEnd | None:
        """Return the best end with which the DAC loses ``lost`` and what it lost before."""
        acts = acting(told.levels) if self._skips else told.levels
        gone = acts != told.levels
        if lost is not None:
            gone[lost] = True
        size, n = len(told), len(chosen)
        more = np.zeros((size, n + 1))
        more[chosen, np.arange(n)] = 1.0
        more[:, n] = forced

        def effect(tick: int, levels: FloatArray) -> FloatArray:
            return np.append(np.zeros(n), -acts[tick]) if gone[tick] else levels

        answer = self._loop.changed(more, effect)
        current = self._loop.current_a(acts, told.counts)
        volts = max(self._volts, float(np.abs(told.levels).max()))
        amperes = max(self._amperes, float(np.abs(current).max()))
        signs = self._signs(told.levels, acts, chosen, held, lost, volts)
        if signs is None:
            return None
        low, high = signs
        load, levels, amps = answer.load_si * _MM, answer.levels, answer.current_a
        rows = [load, -load, levels, -levels]
        zero = np.zeros(size)
        most = [zero, zero, high - told.levels, told.levels - low]
        slack = [zero - 1.0, zero - 1.0, zero, zero]
        if np.isfinite(amperes):
            rows += [amps, -amps]
            most += [amperes - current, amperes + current]
            slack += [zero, zero]
        matrix = np.vstack(rows)
        found = solved(
            np.append(np.zeros(n), 1.0),
            below=(
                np.column_stack([matrix[:, :n] / _MM, np.concatenate(slack)]),
                np.concatenate(most) - matrix[:, n],
            ),
            bounds=[(None, None)] * n + [(0.0, None)],
        )
        if found.status != 0 or found.x is None:
            return None
        added = forced.copy()
        added[chosen] += found.x[:n] / _MM
        return self._followed(added, told.levels, acts, current)

    def _signs(
        self,
        levels: FloatArray,
        acts: FloatArray,
        chosen: IntArray,
        held: int | None,
        lost: int | None,
        volts: float,
    ) -> tuple[FloatArray, FloatArray] | None:
        """Return the (k,) least and largest level of each tick; None where none can be lost."""
        low, high = np.full(len(levels), -volts), np.full(len(levels), volts)
        if not self._skips:
            return low, high
        before = slice(int(chosen[0]), len(levels) if held is None else held)
        sure = np.minimum(np.abs(levels), self._band)
        low[before] = np.where(levels > 0.0, sure, low)[before]
        high[before] = np.where(levels < 0.0, -sure, high)[before]
        if lost is not None:
            last = acts[lost - 1]
            if last == 0.0:
                return None
            if last < 0.0:
                low[lost] = self._band
            else:
                high[lost] = -self._band
        return low, high

    def _followed(
        self, added: FloatArray, levels: FloatArray, acts: FloatArray, current: FloatArray
    ) -> TableEnd:
        """Return what comes of references with every tick that the DAC loses."""
        before = 0.0

        def effect(tick: int, change: FloatArray) -> FloatArray:
            nonlocal before
            level = float(levels[tick] + change[0])
            before = acts_after(before, level) if self._skips else level
            return np.array([before - acts[tick]])

        answer = self._loop.changed(added[:, None], effect)
        return TableEnd(
            more_si=added,
            off_si=float(np.abs(answer.load_si).max()),
            volts=float(np.abs(levels + answer.levels[:, 0]).max()),
            current_a=float(np.abs(current + answer.current_a[:, 0]).max()),
        )
