"""The speed of a shaft at each stitch, within the limits of its spindle.

The move of a turn must keep the limits of the axes and the step rate, and leave little swing of the
frame when the needle enters. The turn also needs time to load the next tables. In the window of a
move the speed of the shaft is constant, so that the move follows its motion law. Over the rest of
the turn the speed changes evenly.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, pi

import numpy as np

from threadline.base.arrays import ComplexArray, FloatArray, IntArray, Recent
from threadline.base.compiled import njit
from threadline.commands.stitch_search import WIDER, FastestTurns, fastest_turns
from threadline.commands.stitch_shorten import shortest_turns
from threadline.commands.stitch_speeds import Speeds, Swings, TurnMoves
from threadline.commands.stitch_swings import Limits, Swung
from threadline.dynamics.without_loop import analyse_position_drive
from threadline.machine import Machine
from threadline.machine.shaft import Shaft, Tables
from threadline.machine.vary import DAMPING_OF_DAYS, off_tolerance, vary
from threadline.motion.laws import Law
from threadline.motion.shaping import FlexibleMode
from threadline.motion.shaping.law_residual import lasting_windows_s, swing

Modes = dict[str, tuple[FlexibleMode, ...]]
"""Modes of each axis, the slowest first."""
_SLOWER = 1.03  # factor on one turn for all, per trial
_ROUNDS = 4  # searches, each with a smaller tolerance
_LESS = 0.997  # factor on the tolerance that the forecast of a round asks for
_SEARCHED, _CHECKED, _CLOSELY = 0.01, 0.004, 0.001  # relative steps of modes over a band
_AS_FAR = 1.3  # end of the fine grid of speeds, in turns that the slowest move needs alone
_STEPS = (0.0053, 0.01)  # relative steps of turn times, for exact modes and for a band
_HOPELESS = 0.05  # share of turns beyond the tolerance at which no wider search helps
_EXCESS = 1.0 + 1e-6
_MODES = 4  # modes of an axis: faster ones hardly swing
_BELOW = 1.0 - 1e-9
_EVEN_TURNS, _AT_FIRST = 97, 4096  # number of turn times to try, and of moves to check first
_ASIDE = (0.95, 1.0, 1.05)
_WIDE = (0.015, 0.1)  # half width of bands for which linear programs shorten the turns
_SLOWEST = 1.2  # longest turn of linear programs, as a factor on the longest found turn
_FINE = 1e-3  # relative step of the turn times between which the swing of a move is interpolated


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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Schedule:
    """Turns with a speed each; n turns.

    Parameters
    ----------
    turn_s
        (n,) time of each turn, s.
    bound_s
        No schedule on the grid of speeds takes less time, s.
    """

    turn_s: FloatArray
    bound_s: float


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
    robust_share
        Share of the tolerances of loads and springs for which the tolerance is kept.
    """

    def __init__(
        self, machine: Machine, law: Law, tolerance_m: float, robust_share: float = 0.0
    ) -> None:
        assert machine.shaft is not None and machine.tables is not None
        self.shaft: Shaft = machine.shaft
        self.tables: Tables = machine.tables
        self.law, self.tolerance_m = law, tolerance_m
        self.share = float(self.shaft.window_share)
        self.modes = _modes_of(machine)
        self.days = tuple(_modes_of(vary(machine, damping=factor)) for factor in DAMPING_OF_DAYS)
        """The modes, with the dampings that they may have on other days."""
        self.robust_share = robust_share
        self.bands = _bands_of(machine, self.modes, robust_share)
        """Lowest and highest factor on the frequency of the slowest mode of each axis."""
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
        self._schedules: Recent[Moves, Schedule] = Recent(4, _alike)

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

    def robust_swings_m(
        self, moves: Moves, turns_s: FloatArray, apart: float = _CHECKED
    ) -> FloatArray:
        """Return (n,) the largest swing over the dampings of days and the band of the modes, m.

        Neighbouring modes are at most ``apart`` apart, as a share of the frequency.
        """
        found = self.most_swings_m(moves, turns_s)
        for modes in self._over_band(apart, (DAMPING_OF_DAYS[0], 1.0, DAMPING_OF_DAYS[1])):
            found = np.maximum(found, self.swings_m(moves, turns_s, modes))
        return found

    def _over_band(self, distance: float, dampings: tuple[float, ...]) -> list[Modes]:
        """Return the modes of machines all over the band, the ends first, without the nominal."""
        widest = max((max(1.0 - low, high - 1.0) for low, high in self.bands.values()), default=0.0)
        if widest <= 0.0:
            return []
        half = max(1, ceil(widest / distance))
        parts = np.arange(-half, half + 1) / half
        parts = parts[np.argsort(-np.abs(parts), kind="stable")]
        return [
            {
                name: tuple(
                    FlexibleMode(
                        mode.frequency_hz * _within(low, high, part),
                        mode.damping_ratio * damping,
                    )
                    for mode in self.modes[name]
                )
                for name, (low, high) in self.bands.items()
            }
            for part in parts.tolist()
            if part != 0.0
            for damping in dampings
        ]

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
            travels = moves.units[:, column] * self.tables.unit.si
            total = np.zeros(len(turns_s))
            for mode in modes:
                pole = _pole(mode)
                fresh = np.zeros(len(turns_s), dtype=np.complex128)
                moved = np.flatnonzero(travels)
                which, of = np.unique(windows[moved], return_inverse=True)
                fresh[moved] = travels[moved] * swing(self.law, mode, which)[of]
                decay = np.exp(-pole * (windows + np.concatenate(([0.0], rests[:-1]))))
                total += np.abs(_carried(fresh, decay)) * np.exp(-pole.real * late)
            worst = np.maximum(worst, total)
        return np.where(moves.needle == 1, worst, 0.0)

    def rests_s(self, turns_s: FloatArray) -> FloatArray:
        """Return (n,) the rest of each turn after its window, with evenly changing speed, s."""
        speed = 1.0 / turns_s
        following = np.append(speed[1:], speed[-1])
        return np.asarray(2.0 * (1.0 - self.share) / (speed + following))

    def scheduled(self, moves: Moves) -> Schedule:
        """Return the shortest turns with each needle entering within the tolerance.

        A beam search over speed and swing finds them, on machines with the dampings of other days
        and with modes all over the band. The forecast then checks modes that are closer together;
        if it is over the tolerance, the search is repeated with a smaller tolerance. One time for
        all turns is used if it is shorter. The schedules of the last designs are kept.
        """
        return self._schedules.of(moves, lambda: self._search(moves))

    def _search(self, moves: Moves) -> Schedule:
        travels_m: FloatArray = np.asarray(moves.units * self.tables.unit.si, dtype=np.float64)
        rigid = self.rigid_windows_s(moves) / self.share
        shortest_s: FloatArray = np.minimum(
            np.maximum(rigid, self.loading_turns_s(moves)), self.shaft.slowest_turn.si
        )
        speeds, tolerance_m = self._speeds(moves, shortest_s), self.tolerance_m
        swings = self.swings_of(speeds)
        best: tuple[float, FastestTurns] | None = None
        bound_s: float | None = None
        problem = TurnMoves(travels_m=travels_m, needle=moves.needle, shortest_s=shortest_s)
        for _ in range(_ROUNDS):
            found = fastest_turns(speeds, swings, problem, tolerance_m, self.share)
            if 0.0 < found.missed.mean() < _HOPELESS:
                found = fastest_turns(speeds, swings, problem, tolerance_m, self.share, WIDER)
            # Later rounds have smaller tolerances: their bounds do not hold for this tolerance.
            bound_s = found.bound_s if bound_s is None else bound_s
            most_m = float(self.robust_swings_m(moves, found.turn_s).max())
            if best is None or most_m < best[0]:
                best = most_m, found
            if most_m <= self.tolerance_m * _EXCESS or found.missed.any():
                break
            tolerance_m *= _LESS * self.tolerance_m / most_m
        assert best is not None and bound_s is not None
        most_m, found = best
        slowest = np.full(len(moves.needle), self.shaft.slowest_turn.si)
        if most_m > self.tolerance_m * _EXCESS and (
            self.robust_swings_m(moves, slowest).max() < most_m
        ):
            return Schedule(turn_s=slowest, bound_s=bound_s)
        turn_s = self._shortened(problem, moves, found.turn_s)
        even = self._even_turn_s(moves, float(turn_s.mean()))
        if even is not None:
            count = len(moves.needle)
            return Schedule(turn_s=np.full(count, even), bound_s=min(bound_s, even * count))
        return Schedule(turn_s=turn_s, bound_s=bound_s)

    def _shortened(self, problem: TurnMoves, moves: Moves, found_s: FloatArray) -> FloatArray:
        """Return the shortest turns within the tolerance, s; for a narrow band the found turns."""
        widest = max((max(1.0 - low, high - 1.0) for low, high in self.bands.values()), default=0.0)
        if not _WIDE[0] <= widest <= _WIDE[1]:
            return found_s
        assert self.shaft.acceleration is not None
        travels_m, needle, shortest_s = problem
        limits = Limits(
            travels_m=travels_m,
            needle=np.asarray(needle, dtype=np.int64),
            shortest_s=shortest_s,
            slowest_s=min(_SLOWEST * float(found_s.max()), self.shaft.slowest_turn.si),
            share=self.share,
            change=2.0 * (1.0 - self.share) * self.shaft.acceleration.si / (2.0 * pi),
            tolerance_m=self.tolerance_m,
        )
        swung = self._swung((float(shortest_s.min()), limits.slowest_s))

        def most_m(turn_s: FloatArray) -> float:
            return float(self.robust_swings_m(moves, turn_s, _CLOSELY).max())

        return shortest_turns(found_s, (limits, swung), most_m)

    def _swung(self, ends_s: tuple[float, float]) -> Swung:
        """Return the modes of machines all over the band, for turn times between ``ends_s``."""
        count = 2 + ceil(np.log(ends_s[1] / ends_s[0]) / _FINE)
        log_s = np.linspace(np.log(ends_s[0]), np.log(ends_s[1]), count)
        windows = self.share * np.exp(log_s)
        poles: list[complex] = []
        fresh: list[ComplexArray] = []
        axis: list[int] = []
        begin, row = [0], list[int]()
        dampings = DAMPING_OF_DAYS[0], 1.0, DAMPING_OF_DAYS[1]
        for column, (name, (low, high)) in enumerate(self.bands.items()):
            half = max(1, ceil(max(1.0 - low, high - 1.0) / _CHECKED))
            for number, damping in enumerate(dampings):
                for part in (np.arange(-half, half + 1) / half).tolist():
                    for mode in self.modes[name]:
                        off = FlexibleMode(
                            mode.frequency_hz * _within(low, high, part),
                            mode.damping_ratio * damping,
                        )
                        poles.append(_pole(off))
                        fresh.append(swing(self.law, off, windows))
                        axis.append(column)
                    begin.append(len(poles))
                    row.append(3 * column + number)
        return Swung(
            poles=np.array(poles),
            axis=np.array(axis, dtype=np.int64),
            begin=np.array(begin, dtype=np.int64),
            row=np.array(row, dtype=np.int64),
            log_s=np.array([log_s[0], log_s[1] - log_s[0]]),
            fresh=np.ascontiguousarray(np.stack(fresh, axis=1)),
            late=(self.shaft.needle_enters.si - self.shaft.window.si) / (2.0 * pi),
        )

    def _speeds(self, moves: Moves, shortest_s: FloatArray) -> Speeds:
        """Return the grid of turn times: fine as far as moves need it, coarse beyond."""
        assert self.shaft.acceleration is not None
        most = 2.0 * (1.0 - self.share) * self.shaft.acceleration.si / (2.0 * pi)
        slower = max((1.0 / low for low, _ in self.bands.values()), default=1.0)
        needed = float(self.needed_turns_s(moves).max()) * slower
        longest = self.shaft.slowest_turn.si
        ends_s = (float(shortest_s.min()), min(_AS_FAR * needed, longest), longest)
        banded = any(low < high for low, high in self.bands.values())
        return Speeds.between(ends_s, _STEPS[banded], self.share, most)

    def swings_of(self, speeds: Speeds) -> Swings:
        """Return the effect of each turn time on the swing of every mode on every machine."""
        machines = self._over_band(_SEARCHED, DAMPING_OF_DAYS)
        nominal = len(machines)
        machines += [self.modes, *self.days]
        enters = (self.shaft.needle_enters.si - self.shaft.window.si) / (2.0 * pi)
        poles: list[complex] = []
        fresh: list[ComplexArray] = []
        axis: list[int] = []
        last: list[bool] = []
        named = np.zeros(len(self.modes), dtype=np.int64)
        for number, modes_of in enumerate(machines):
            for column, modes in enumerate(modes_of.values()):
                for k, mode in enumerate(modes):
                    if number == nominal and k == 0:
                        named[column] = len(poles)
                    poles.append(_pole(mode))
                    fresh.append(swing(self.law, mode, self.share * speeds.turn_s))
                    axis.append(column)
                    last.append(k == len(modes) - 1)
        pole = np.array(poles)
        return Swings(
            poles=pole,
            fresh=np.ascontiguousarray(np.stack(fresh, axis=1)),
            late=np.exp(-enters * np.outer(speeds.turn_s, pole.real)),
            axis=np.array(axis, dtype=np.int64),
            last=np.array(last, dtype=np.int64),
            named=named,
        )

    def constant_turn_s(self, moves: Moves) -> float:
        """Return the shortest equal turn at which each needle enters within the tolerance, s.

        The forecast of the swing decides, on any day. If no turn suffices, the result is the
        slowest turn of the shaft.
        """
        longest = self.shaft.slowest_turn.si
        turn = min(float(self.needed_turns_s(moves).max()), longest)
        while turn < longest * _BELOW:
            if self._within_tolerance(moves, turn):
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
        travels_m = np.abs(sewn).max(axis=0, initial=0) * self.tables.unit.si
        windows = self.rigid_windows_s(moves).max() / self.share
        shortest = max(float(self.loading_turns_s(moves).max()), float(windows))
        if shortest >= below_s * _BELOW:
            return None
        start = slice(0, _AT_FIRST)
        first = Moves(units=moves.units[start], needle=moves.needle[start])
        for turn in np.geomspace(shortest, below_s, _EVEN_TURNS)[:-1].tolist():
            window = np.array([self.share * turn])
            swings_m = [
                way * float(np.abs(swing(self.law, _aside(mode, ratio), window))[0])
                for way, modes in zip(travels_m.tolist(), self.modes.values(), strict=True)
                for mode in modes
                for ratio in _ASIDE
            ]
            if max(swings_m, default=0.0) > self.tolerance_m:
                continue
            if self._within_tolerance(first, turn) and self._within_tolerance(moves, turn):
                return float(turn)
        return None

    def _within_tolerance(self, moves: Moves, turn_s: float) -> bool:
        """Return whether equal turns keep the tolerance on any day, for every mode of the band."""
        turns = np.full(len(moves.needle), turn_s)
        if self.most_swings_m(moves, turns).max() > self.tolerance_m:
            return False
        return bool(self.robust_swings_m(moves, turns).max() <= self.tolerance_m)


def _alike(one: Moves, other: Moves) -> bool:
    return np.array_equal(one.units, other.units) and np.array_equal(one.needle, other.needle)


def _aside(mode: FlexibleMode, ratio: float) -> FlexibleMode:
    return FlexibleMode(mode.frequency_hz * ratio, mode.damping_ratio)


def _pole(mode: FlexibleMode) -> complex:
    omega = 2.0 * pi * mode.frequency_hz
    return complex(omega * (mode.damping_ratio + 1j * np.sqrt(1.0 - mode.damping_ratio**2)))


def _within(low: float, high: float, part: float) -> float:
    """Return the factor at a part of a band, from -1 at its low end to 1 at its high end."""
    return 1.0 + part * (1.0 - low if part < 0.0 else high - 1.0)


def _bands_of(machine: Machine, modes: Modes, share: float) -> dict[str, tuple[float, float]]:
    """Return the factors on the slowest mode of each axis at the ends of the tolerances."""
    ends = [
        _modes_of(off_tolerance(machine, mass=sign * share, stiffness=-sign * share))
        for sign in (1.0, -1.0)
    ]
    factors = {}
    for name, of in modes.items():
        if of:
            low, high = (end[name][0].frequency_hz / of[0].frequency_hz for end in ends)
            factors[name] = (min(low, 1.0), max(high, 1.0))
        else:
            factors[name] = (1.0, 1.0)
    return factors


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


@njit(nogil=True)
def _carried(fresh: ComplexArray, decay: ComplexArray) -> ComplexArray:
    """Return (n,) ``z`` with ``z[k] = z[k-1] kept[k] + fresh[k]``."""
    out = fresh.copy()
    for k in range(1, len(out)):
        out[k] += out[k - 1] * decay[k]
    return out
