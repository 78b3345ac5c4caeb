"""The speed of a shaft at each stitch, within the limits of its spindle.

The move of a turn must keep the limits of the axes and the step rate, and leave little swing of the
frame when the needle enters. The turn also needs time to load the next tables. In the window of a
move the speed of the shaft is constant, so that the move follows its motion law. Over the rest of
the turn the speed changes evenly.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np

from threadline.base.arrays import ComplexArray, FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.dynamics.without_loop import analyse_position_drive
from threadline.machine import Machine
from threadline.machine.shaft import Shaft, Tables
from threadline.machine.vary import DAMPING_OF_DAYS, vary
from threadline.motion.laws import Law
from threadline.motion.shaping import FlexibleMode
from threadline.motion.shaping.law_residual import lasting_windows_s, swing

Modes = dict[str, tuple[FlexibleMode, ...]]
"""Modes of each axis, the slowest first."""
_ROUNDS = 200
_SLOWER = 1.03  # factor on the turn per round
_MODES = 4  # modes of an axis: faster ones hardly swing
_BELOW = 1.0 - 1e-9
_EVEN_TURNS, _AT_FIRST = 97, 4096  # number of turn times to try, and of moves to check first
_ASIDE = (0.95, 1.0, 1.05)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Moves:
    """Moves of the frame turn by turn; n turns, A axes.

    Parameters
    ----------
    units
        (n, A) int: travel in units of the design.
    needle
        (n,) 1 where the needle enters in this turn.
    """

    units: IntArray
    needle: IntArray


class Pace:
    """The time of each turn of a design, on one machine with one law.

    Parameters
    ----------
    machine
        Machine with a shaft and tables.
    law
        Motion law of the tables.
    tolerance_m
        Largest swing of an axis allowed when the needle enters, m.
    """

    def __init__(self, machine: Machine, law: Law, tolerance_m: float) -> None:
        assert machine.shaft is not None and machine.tables is not None
        self.shaft: Shaft = machine.shaft
        self.tables: Tables = machine.tables
        self.law, self.tolerance_m = law, tolerance_m
        self.share = float(self.shaft.window_share)
        self.modes = _modes_of(machine)
        self.days = tuple(_modes_of(vary(machine, damping=factor)) for factor in DAMPING_OF_DAYS)
        """The modes, with the dampings that they may have on other days."""
        counts = np.arange(self.tables.longest_units + 1, dtype=np.float64)
        lengths: FloatArray = self.tables.unit.si * counts
        steps = np.array([axis.counts.si for axis in machine.axes.values()])
        velocity = np.minimum(machine.velocity_limit, self.tables.step_rate.si / steps)
        # (lengths, A) shortest windows within the limits of the axes and the step rate, s.
        self.rigid_s = np.stack(
            [
                np.maximum(
                    law.velocity * lengths / velocity[column],
                    np.sqrt(law.acceleration * lengths / machine.acceleration_limit[column]),
                )
                for column in range(len(machine.axes))
            ],
            axis=1,
        )
        longest_s = self.share * self.shaft.slowest_turn.si
        still = [
            [lasting_windows_s(law, mode, lengths, tolerance_m, longest_s) for mode in modes]
            for modes in self.modes.values()
        ]
        self.still_s = np.stack(
            [np.max([np.zeros(len(lengths)), *rows], axis=0) for rows in still], axis=1
        )
        """(lengths, A) shortest windows that leave a swing within the tolerance, s."""

    def rigid_windows_s(self, moves: Moves) -> FloatArray:
        """Return (n,) shortest windows within the limits of the axes and the step rate, s."""
        return _of_length(self.rigid_s, moves.units)

    def needed_turns_s(self, moves: Moves) -> FloatArray:
        """Return (n,) the time that each turn needs without swing from the turn before, s.

        While the needle is up, the frame may swing.
        """
        windows = self.rigid_windows_s(moves)
        still = _of_length(self.still_s, moves.units)
        windows = np.where(moves.needle == 1, np.maximum(windows, still), windows)
        return np.maximum(windows / self.share, self.loading_turns_s(moves))

    def loading_turns_s(self, moves: Moves) -> FloatArray:
        """Return (n,) turns long enough to load the tables of the next turn, s.

        No turn is shorter than the shortest turn of the shaft. The first tables are loaded before
        the shaft turns.
        """
        loads = np.count_nonzero(moves.units[1:], axis=1) * self.tables.fetch.si
        rest = np.append(loads, 0.0) / (1.0 - self.share)
        return np.maximum(rest, float(self.shaft.turn_s))

    def most_swings_m(self, moves: Moves, turns_s: FloatArray) -> FloatArray:
        """Return (n,) the largest ``swings_m`` over the dampings of the modes on different days."""
        found = self.swings_m(moves, turns_s)
        for modes in self.days:
            found = np.maximum(found, self.swings_m(moves, turns_s, modes))
        return found

    def swings_m(
        self, moves: Moves, turns_s: FloatArray, modes_of: Modes | None = None
    ) -> FloatArray:
        """Return (n,) the largest amplitude of an axis when the needle enters, m; 0 if it is up.

        Turn by turn, the swing of earlier moves decays, and the swing of this move is added.

        Parameters
        ----------
        modes_of
            Modes of each axis; None: the modes in the machine file.
        """
        windows, rests = self.share * turns_s, self.rests_s(turns_s)
        enters = (self.shaft.needle_enters.si - self.shaft.window.si) / (2.0 * pi)
        # The speed first changes after the window; the change until the needle enters is ignored.
        late = enters * turns_s
        worst = np.zeros(len(turns_s))
        for column, modes in enumerate((modes_of or self.modes).values()):
            ways = moves.units[:, column] * self.tables.unit.si
            total = np.zeros(len(turns_s))
            for mode in modes:
                omega = 2.0 * pi * mode.frequency_hz
                pole = omega * (mode.damping_ratio + 1j * np.sqrt(1.0 - mode.damping_ratio**2))
                fresh = np.zeros(len(turns_s), dtype=np.complex128)
                moved = np.flatnonzero(ways)
                which, of = np.unique(windows[moved], return_inverse=True)
                fresh[moved] = ways[moved] * swing(self.law, mode, which)[of]
                kept = np.exp(-pole * (windows + np.concatenate(([0.0], rests[:-1]))))
                total += np.abs(_carried(fresh, kept)) * np.exp(-pole.real * late)
            worst = np.maximum(worst, total)
        return np.where(moves.needle == 1, worst, 0.0)

    def rests_s(self, turns_s: FloatArray) -> FloatArray:
        """Return (n,) the rest of each turn after its window, with evenly changing speed, s."""
        speed = 1.0 / turns_s
        following = np.append(speed[1:], speed[-1])
        return np.asarray(2.0 * (1.0 - self.share) / (speed + following))

    def followed(self, turns_s: FloatArray) -> FloatArray:
        """Return (n,) turns, none shorter, whose speeds the spindle can follow, s.

        Between two windows the square of the speed changes by at most twice the acceleration times
        the angle. A forward pass limits speeding up, a backward pass limits slowing down.
        """
        assert self.shaft.acceleration is not None
        most = 2.0 * (1.0 - self.share) * self.shaft.acceleration.si / (2.0 * pi)
        return np.asarray(_within(turns_s**-2.0, most) ** -0.5)

    def scheduled(self, moves: Moves) -> FloatArray:
        """Return (n,) the shortest turns with each needle entering within the tolerance, s.

        Swing of earlier moves may make a turn need more time than it needs alone. Such a turn is
        slowed until the forecast of the swing is within the tolerance on any day, or the shaft
        turns at its slowest.
        """
        longest = self.shaft.slowest_turn.si
        wanted = np.minimum(self.needed_turns_s(moves), longest)
        turns = self.followed(wanted)
        for _ in range(_ROUNDS):
            over = self.most_swings_m(moves, turns) > self.tolerance_m
            over &= turns < longest * _BELOW
            if not over.any():
                break
            wanted = np.where(over, np.minimum(turns * _SLOWER, longest), wanted)
            turns = self.followed(wanted)
        even = self._even_turn_s(moves, float(turns.mean()))
        return turns if even is None else np.full(len(turns), even)

    def constant_turn_s(self, moves: Moves) -> float:
        """Return the shortest equal turn at which each needle enters within the tolerance, s.

        The forecast of the swing decides, on any day. If no turn suffices, the result is the
        slowest turn of the shaft.
        """
        longest = self.shaft.slowest_turn.si
        turn = min(float(self.needed_turns_s(moves).max()), longest)
        while turn < longest * _BELOW:
            if self.most_swings_m(moves, np.full(len(moves.needle), turn)).max() <= (
                self.tolerance_m
            ):
                break
            turn = min(turn * _SLOWER, longest)
        even = self._even_turn_s(moves, turn)
        return turn if even is None else even

    def _even_turn_s(self, moves: Moves, below_s: float) -> float | None:
        """Return the shortest sufficient time for all turns below ``below_s``, s; None if none is.

        A law made for a mode leaves no swing after one window, but may leave some after longer
        ones. At the returned time, each move alone also stays within the tolerance with its modes
        off by the factors ``_ASIDE``, so the result does not rely on the swings of two moves
        cancelling each other.
        """
        sewn = moves.units[moves.needle == 1]
        ways_m = np.abs(sewn).max(axis=0, initial=0) * self.tables.unit.si
        windows = self.rigid_windows_s(moves).max() / self.share
        shortest = max(float(self.loading_turns_s(moves).max()), float(windows))
        if shortest >= below_s * _BELOW:
            return None
        start = slice(0, _AT_FIRST)
        first = Moves(units=moves.units[start], needle=moves.needle[start])
        for turn in np.geomspace(shortest, below_s, _EVEN_TURNS)[:-1].tolist():
            window = np.array([self.share * turn])
            alone_m = [
                way * float(np.abs(swing(self.law, _aside(mode, ratio), window))[0])
                for way, modes in zip(ways_m.tolist(), self.modes.values(), strict=True)
                for mode in modes
                for ratio in _ASIDE
            ]
            if max(alone_m, default=0.0) > self.tolerance_m:
                continue
            if all(
                self.most_swings_m(some, np.full(len(some.needle), turn)).max() <= self.tolerance_m
                for some in (first, moves)
            ):
                return float(turn)
        return None


def _aside(mode: FlexibleMode, ratio: float) -> FlexibleMode:
    return FlexibleMode(mode.frequency_hz * ratio, mode.damping_ratio)


def _modes_of(machine: Machine) -> Modes:
    """Return the slowest modes of each axis with its motor held."""
    return {
        name: tuple(
            FlexibleMode(mode.frequency_hz, mode.damping)
            for mode in analyse_position_drive(machine, name).locked[:_MODES]
        )
        for name in machine.axes
    }


def _of_length(windows: FloatArray, units: IntArray) -> FloatArray:
    """Return (n,) the longest window over the axes, from a (lengths, A) table ``windows``."""
    columns = [windows[np.abs(units[:, k]), k] for k in range(units.shape[1])]
    return np.asarray(np.max(columns, axis=0))


def _held(squares: FloatArray, most: float) -> FloatArray:
    """Return (n,) squares of speeds that change by at most ``most`` from turn to turn."""
    out = squares.copy()
    for k in range(1, len(out)):
        out[k] = min(out[k], out[k - 1] + most)
    for k in range(len(out) - 2, -1, -1):
        out[k] = min(out[k], out[k + 1] + most)
    return out


def _gone_on(fresh: ComplexArray, kept: ComplexArray) -> ComplexArray:
    """Return (n,) ``z`` with ``z[k] = z[k-1] kept[k] + fresh[k]``."""
    out = fresh.copy()
    for k in range(1, len(out)):
        out[k] += out[k - 1] * kept[k]
    return out


_within = njit(nogil=True)(_held)
_carried = njit(nogil=True)(_gone_on)
