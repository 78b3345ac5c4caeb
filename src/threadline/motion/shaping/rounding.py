"""A train on whole ticks that keeps the robustness of its exact design.

A kind of shaper is chosen for the band of frequency in which V stays within its tolerance. So the
search looks for the train on the grid with the smallest largest V over that band. Among equal
trains it prefers the least mean square, which distinguishes a zero or a flat minimum of V from a
hump. The search starts from the nearest ticks. For short trains it also starts from the best choice
of the ticks on either side, and from the train compressed by a few ticks. It moves single impulses
and pairs by one or two ticks, and makes no train more than two ticks longer than its design. Of
short trains, all trains within a few ticks are tried. If V at the modelled frequency is slightly
above the tolerance, the train has no band at all, so the best trains without such a hump are kept,
too.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import ComplexArray, FloatArray, IntArray
from threadline.motion.shaping.response import pole
from threadline.motion.shaping.types import FlexibleMode

_SHIFTS = np.array([-2, -1, 1, 2])
_MOST_EXCHANGES = 60
_MEAN_WEIGHTS = (0.2, 1.0)
"""Weights of the root mean square added to the worst V; each weight leads to other trains."""
_EITHER_SIDE = 11  # largest number of impulses for this start: 2**10 choices of left or right ticks
_STARTS = 8
_PAIRS_OF = 40  # largest number of impulses for moves in pairs; longer trains move one at a time
_LONGER = 2  # largest number of ticks by which a train may be longer than designed
_SHORTER = 6  # largest number of ticks by which a start is compressed
_MOST_CANDIDATES = 40
_EVERY = 20000  # largest number of trains around the start that are all tried
_FARTHEST = 8  # largest distance from the start, in ticks, for trains of two or three impulses
_AT_ONCE = 2000
_FEWEST, _MOST = 17, 257
_PER_RIPPLE = 16


@dataclass(frozen=True, slots=True)
class Band:
    """The design band of a mode, Hz, at its damping ratio, and the largest permitted V."""

    mode: FlexibleMode
    low_hz: float
    high_hz: float
    tolerance: float

    def samples_hz(self, duration_s: float, finer: int = 1) -> FloatArray:
        """Return (n,) frequencies over the band, Hz, finer than any ripple of V.

        The ripple is as fine as a train of ``duration_s`` allows.
        """
        width = self.high_hz - self.low_hz
        if width <= 0.0:
            return np.array([self.mode.frequency_hz])
        ripple_samples = int(np.ceil(_PER_RIPPLE * width * duration_s))
        count = finer * min(max(ripple_samples, _FEWEST), _MOST)
        return np.linspace(self.low_hz, self.high_hz, count)


class TickGrid:
    """Computes V over the bands, for trains with impulses on whole ticks.

    If the tolerances of the bands differ, V of each mode is scaled to the largest tolerance.

    Parameters
    ----------
    bands
        At least one band.
    tick_s
        Tick of the controller, s.
    last
        Approximate last tick of the trains; decays are counted back from it, to avoid overflow.
    """

    def __init__(self, bands: Sequence[Band], tick_s: float, last: int) -> None:
        duration_s = last * tick_s
        samples = [band.samples_hz(duration_s) for band in bands]
        self.frequency_hz = np.concatenate(samples)
        self.damping_ratio = np.concatenate(
            [np.full(len(f), b.mode.damping_ratio) for f, b in zip(samples, bands, strict=True)]
        )
        poles = np.concatenate(
            [
                np.full(len(f), pole(b.mode.damping_ratio))
                for f, b in zip(samples, bands, strict=True)
            ]
        )
        self._turn: ComplexArray = np.asarray(poles * self.frequency_hz * tick_s, np.complex128)
        self._last = last
        largest_tolerance = max(band.tolerance for band in bands)
        self._share = np.concatenate(
            [
                np.full(len(f), b.tolerance / largest_tolerance)
                for f, b in zip(samples, bands, strict=True)
            ]
        )

        # The index of the sample nearest to the modelled frequency in each band, and the tolerance.
        begins = np.cumsum([0, *(len(f) for f in samples)])
        self._own = np.array(
            [
                begin + int(np.argmin(np.abs(f - band.mode.frequency_hz)))
                for begin, f, band in zip(begins[:-1], samples, bands, strict=True)
            ]
        )
        self._allowed = largest_tolerance

    def keeps_its_mode(self, vibration: FloatArray) -> NDArray[np.bool_]:
        """Return whether V (..., frequencies) is in tolerance at the modelled frequencies."""
        keeps: NDArray[np.bool_] = np.all(vibration[..., self._own] <= self._allowed, axis=-1)
        return keeps

    def impulses(self, ticks: IntArray) -> ComplexArray:
        """Return (..., frequencies) responses to a unit impulse at each of the ``ticks`` (...,)."""
        responses: ComplexArray = np.exp(self._turn * (np.asarray(ticks)[..., None] - self._last))
        return responses

    def vibration(self, response: ComplexArray, last: IntArray) -> FloatArray:
        """Return V (..., frequencies) from sums of impulses, for trains that end at ``last``."""
        decay = np.exp(-self._turn.real * (np.asarray(last)[..., None] - self._last))
        scaled_vibration: FloatArray = np.abs(response) * decay / self._share
        return scaled_vibration


def seconds(ticks: IntArray, tick_s: float) -> FloatArray:
    """Return the times of whole ticks, s."""
    return ticks.astype(np.float64) * tick_s


def cost(vibration: FloatArray, mean_weight: float = _MEAN_WEIGHTS[0]) -> FloatArray:
    """Return (...,) the largest V over the frequencies plus a share of its root mean square."""
    mean_square = np.mean(vibration**2, axis=-1)
    costs: FloatArray = vibration.max(axis=-1) + mean_weight * np.sqrt(mean_square)
    return costs


def on_ticks(
    amplitudes: FloatArray, start: IntArray, exact: FloatArray, gap: int, grid: TickGrid
) -> list[IntArray]:
    """Return the ticks of trains with given amplitudes, the train with the least cost first.

    Parameters
    ----------
    amplitudes
        (n,) amplitudes of the impulses.
    start
        (n,) ticks from which the search starts, at least ``gap`` apart.
    exact
        (n,) designed times, in ticks.
    gap
        Fewest ticks between two impulses.
    """
    seen: dict[tuple[int, ...], None] = {}
    for weight in _MEAN_WEIGHTS:
        latest_tick = max(int(start[-1]), int(np.ceil(exact[-1] - 1e-9)) + _LONGER)
        search = _Search(amplitudes, gap, grid, weight, latest_tick)
        for start_ticks in itertools.chain(
            [start], search.either_side(exact), search.shrunk(exact)
        ):
            search.improve(start_ticks)
        search.every_one_about(start)
        ranked = sorted(search.seen.items(), key=lambda pair: (pair[1], pair[0]))
        seen |= dict.fromkeys(ticks for ticks, _ in ranked[:_MOST_CANDIDATES])
        without_hump = (ticks for ticks, _ in ranked if ticks in search.sound)
        seen |= dict.fromkeys(itertools.islice(without_hump, _MOST_CANDIDATES))
    return [np.array(ticks, dtype=np.int64) for ticks in seen]


class _Search:
    """Improves trains from several starts; ``seen`` collects the trains with their costs.

    ``sound`` holds the trains with V in tolerance at the modelled frequencies.
    """

    def __init__(
        self, amplitudes: FloatArray, gap: int, grid: TickGrid, mean_weight: float, latest: int
    ) -> None:
        self._amplitudes, self._gap, self._grid = amplitudes, gap, grid
        self._weight, self._latest = mean_weight, latest
        self.seen: dict[tuple[int, ...], float] = {}
        self.sound: set[tuple[int, ...]] = set()

    def every_one_about(self, start: IntArray) -> None:
        """Try every train with each impulse within a few ticks of its start."""
        free_impulses = len(start) - 1
        if not free_impulses:  # a train of one impulse stays at time 0
            return
        reach_ticks = (
            _FARTHEST
            if free_impulses == 1
            else min(int((_EVERY ** (1.0 / free_impulses) - 1.0) / 2.0), _FARTHEST)
        )
        if reach_ticks < 1:
            return
        shifts = np.array(
            list(itertools.product(range(-reach_ticks, reach_ticks + 1), repeat=free_impulses))
        )
        trains = start + np.pad(shifts, ((0, 0), (1, 0)))
        fits = np.all(np.diff(trains, axis=1) >= self._gap, axis=1)
        trains = trains[fits & (trains[:, -1] <= self._latest)]
        best_trains: list[tuple[float, bool, tuple[int, ...]]] = []
        for batch in np.array_split(trains, max(1, len(trains) // _AT_ONCE)):
            response = np.zeros((len(batch), len(self._grid.frequency_hz)), dtype=np.complex128)
            for amplitude, impulse_ticks in zip(self._amplitudes, batch.T, strict=True):
                distinct_ticks, tick_index = np.unique(impulse_ticks, return_inverse=True)
                response += (amplitude * self._grid.impulses(distinct_ticks))[tick_index]
            vibration = self._grid.vibration(response, batch[:, -1])
            values, keeps = cost(vibration, self._weight), self._grid.keeps_its_mode(vibration)
            for mask in (keeps, ~keeps):
                indices = np.flatnonzero(mask)
                for k in indices[np.argsort(values[indices], kind="stable")[:_MOST_CANDIDATES]]:
                    best_trains.append((float(values[k]), bool(keeps[k]), tuple(batch[k].tolist())))
        for value, keeps_its_mode, ticks in best_trains:
            self.seen.setdefault(ticks, value)
            if keeps_its_mode:
                self.sound.add(ticks)

    def _cost(self, response: ComplexArray, last: IntArray) -> FloatArray:
        return cost(self._grid.vibration(response, last), self._weight)

    def either_side(self, exact: FloatArray) -> Iterator[IntArray]:
        """Yield the best trains with every impulse at the tick before or after its time."""
        n = len(exact)
        if n > _EITHER_SIDE:
            return
        lower_ticks = np.floor(exact).astype(np.int64)
        choices = lower_ticks + np.array([(0, *c) for c in itertools.product((0, 1), repeat=n - 1)])
        choices = choices[np.all(np.diff(choices, axis=1) >= self._gap, axis=1)]
        if not len(choices):
            return
        response = np.einsum("i,cif->cf", self._amplitudes, self._grid.impulses(choices))
        values = self._cost(response, choices[:, -1])
        yield from choices[np.argsort(values, kind="stable")[:_STARTS]]

    def shrunk(self, exact: FloatArray) -> Iterator[IntArray]:
        """Yield the designed train compressed by a few ticks, which often has a smaller V."""
        n = len(exact)
        if not 1 < n <= _EITHER_SIDE:
            return
        end = int(np.rint(exact[-1]))
        for last in range(end - 1, max(end - _SHORTER, (n - 1) * self._gap - 1), -1):
            ticks = np.rint(exact * (last / exact[-1])).astype(np.int64)
            if np.diff(ticks).min() >= self._gap:
                yield ticks

    def improve(self, start: IntArray) -> None:
        """Apply the best shift of one impulse or of two, until no shift reduces the cost."""
        response = self._amplitudes @ self._grid.impulses(start)
        ticks, value = start, float(self._cost(response, start[-1]))
        self._note(ticks, value)
        for _ in range(_MOST_EXCHANGES):
            better = self._one_by_one(ticks, value)
            if better is None and len(ticks) <= _PAIRS_OF:
                better = self._pair(ticks, value)
            if better is None:
                return
            ticks, value = better
            self._note(ticks, value)

    def _note(self, ticks: IntArray, value: float) -> None:
        self.seen[tuple(ticks.tolist())] = value

    def _shifted(self, ticks: IntArray, index: int) -> ComplexArray:
        """Return the change of the response for each shift of an impulse, (4, frequencies)."""
        response_change = self._grid.impulses(ticks[index] + _SHIFTS) - self._grid.impulses(
            ticks[index]
        )
        weighted_change: ComplexArray = self._amplitudes[index] * response_change
        return weighted_change

    def _one_by_one(self, ticks: IntArray, value: float) -> tuple[IntArray, float] | None:
        """Move each impulse once to its best tick; return train and cost, None if all stay."""
        new_ticks, best_cost = ticks.copy(), value
        response = self._amplitudes @ self._grid.impulses(new_ticks)
        for i in range(1, len(new_ticks)):
            changes = self._shifted(new_ticks, i)
            last = new_ticks[-1] + (_SHIFTS if i == len(new_ticks) - 1 else 0 * _SHIFTS)
            values = self._cost(response + changes, last)
            values[~self._fits(new_ticks, i)] = np.inf
            k = int(np.argmin(values))
            if values[k] < best_cost * (1.0 - 1e-12):
                new_ticks[i] += _SHIFTS[k]
                response, best_cost = response + changes[k], float(values[k])
                self._note(new_ticks, best_cost)
        return None if best_cost == value else (new_ticks, best_cost)

    def _fits(self, ticks: IntArray, i: int) -> NDArray[np.bool_]:
        shifted_ticks = ticks[i] + _SHIFTS
        fits: NDArray[np.bool_] = (shifted_ticks - ticks[i - 1] >= self._gap) & (
            shifted_ticks <= self._latest
        )
        if i + 1 < len(ticks):
            fits &= ticks[i + 1] - shifted_ticks >= self._gap
        return fits

    def _pair(self, ticks: IntArray, value: float) -> tuple[IntArray, float] | None:
        """Return train and cost after the best shift of two impulses; None if not better."""
        n = len(ticks)
        changes = np.array([self._shifted(ticks, i) for i in range(1, n)])  # (n - 1, 4, f)
        response = self._amplitudes @ self._grid.impulses(ticks)
        best_cost, best_ticks = value * (1.0 - 1e-12), None
        for i in range(1, n - 1):
            responses = (
                response + changes[i - 1][:, None, None, :] + changes[None, i:]
            )  # (4, rest, 4, f)
            last = np.full(responses.shape[:-1], ticks[-1])
            last[:, -1, :] += _SHIFTS
            values = self._cost(responses, last)
            for flat in np.argsort(values, axis=None)[:64]:
                a, rest, b = np.unravel_index(int(flat), values.shape)
                if values[a, rest, b] >= best_cost:
                    break
                trial = ticks.copy()
                trial[i] += _SHIFTS[a]
                trial[i + 1 + rest] += _SHIFTS[b]
                if np.diff(trial).min() >= self._gap and trial[-1] <= self._latest:
                    best_cost, best_ticks = float(values[a, rest, b]), trial
                    self._note(trial, best_cost)
                    break
        return None if best_ticks is None else (best_ticks, best_cost)


_MOST_AMPLITUDE_STEPS = 40
_SILENCE_WEIGHT, _SUM_WEIGHT = 1e4, 1e7


def with_amplitudes(
    starts: Sequence[IntArray],
    gap: int,
    grid: TickGrid,
    silent: Sequence[FlexibleMode],
    tick_s: float,
    *,
    positive: bool,
) -> tuple[FloatArray, IntArray]:
    """Return (n,) amplitudes, solved again, and (n,) ticks of the best train found.

    Parameters
    ----------
    starts
        Trains to start from, (n,) ticks each; the best one is improved.
    gap
        Fewest ticks between two impulses.
    silent
        Modes without residual vibration in the design; they keep this with enough impulses.
    positive
        Whether every amplitude must be 0 or more.
    """

    def fit(ticks: IntArray) -> FloatArray:
        return _amplitudes(seconds(ticks, tick_s), grid, silent, positive=positive)

    def value(ticks: IntArray) -> float:
        response = fit(ticks) @ grid.impulses(ticks)
        return float(cost(grid.vibration(response, ticks[-1])))

    ticks = _descend(min(starts, key=value), gap, value)
    return fit(ticks), ticks


def _descend(ticks: IntArray, gap: int, value: Callable[[IntArray], float]) -> IntArray:
    best_ticks, least_cost = ticks, value(ticks)
    singles = [(i,) for i in range(1, len(ticks))]
    pairs = list(itertools.pairwise(range(1, len(ticks))))
    for _ in range(_MOST_AMPLITUDE_STEPS):
        best_trial = None
        for moved_impulses in [*singles, *pairs]:
            for shift in itertools.product((-2, -1, 1, 2), repeat=len(moved_impulses)):
                trial = best_ticks.copy()
                trial[list(moved_impulses)] += shift
                if np.diff(trial).min() < gap:
                    continue
                trial_cost = value(trial)
                if trial_cost < least_cost * (1.0 - 1e-12):
                    best_trial, least_cost = trial, trial_cost
        if best_trial is None:
            break
        best_ticks = best_trial
    return best_ticks


def _amplitudes(
    times_s: FloatArray, grid: TickGrid, silent: Sequence[FlexibleMode], *, positive: bool
) -> FloatArray:
    """Return (n,) amplitudes of sum 1 with the least sum of V^2 over the bands, for (n,) times."""
    from scipy.optimize import lsq_linear

    delay = times_s - times_s[-1]
    f = np.append(grid.frequency_hz, [m.frequency_hz for m in silent])
    z = np.append(grid.damping_ratio, [m.damping_ratio for m in silent])
    rows = np.array([np.exp(pole(b) * a * delay) for a, b in zip(f, z, strict=True)])
    rows[len(grid.frequency_hz) :] *= _SILENCE_WEIGHT
    matrix = np.vstack((rows.real, rows.imag, _SUM_WEIGHT * np.ones((1, len(times_s)))))
    target = np.append(np.zeros(2 * len(rows)), _SUM_WEIGHT)
    if positive:
        solution = lsq_linear(matrix, target, bounds=(0.0, np.inf), method="bvls").x
    else:
        solution = np.linalg.lstsq(matrix, target, rcond=None)[0]
    amplitudes: FloatArray = solution / solution.sum()
    return amplitudes
