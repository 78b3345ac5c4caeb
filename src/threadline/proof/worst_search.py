"""The search for the worst machine within the tolerances, with a limited number of machines."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.workers import Done
from threadline.machine.vary import Days
from threadline.proof.worst_machine import WithinTolerances, row_shares, shares_of
from threadline.verdict import EachRun

SEARCHED, SEARCHED_SERIAL = 1200, 60
"""Largest number of machines that a search tries after both ends of each number: if machines are
simulated in batches, and if they are simulated one by one."""
_REPLAYED_TICKS = 50_000_000
"""Largest number of ticks, over all runs after the ends, of runs whose fibre is replayed: such a
tick takes about ten times as long as a tick without a product."""
_CORNERS, _LEAN = 400, 0.75
"""Number of drawn corners, half of them with equal probability and half by the slopes of one
criterion; and the probability with which a number of such a corner follows its slope. A search of
fewer than ``SEARCHED`` machines draws fewer corners in proportion."""
_CORNER_SEED = 1941
_NEAR, _ROWS = 0.7, 3
"""Climbs maximise criteria whose used share is at least this part of the worst used share; largest
number of such criteria."""
_STARTS, _APART, _AT_ONCE = 16, 2, 4
"""Number of machines from which climbs start; number of numbers in which any two of them differ at
least; number of climbs at the same time."""
_MOST_KICKS, _KICKED, _KICK = 40, 4, 4
"""Number of climbs that start from an ended climb; number of ended climbs that they start from; and
number of the machine's numbers that are changed at random before such a start."""
_INSIDE, _INNER = 0.2, 3
"""Share of the machines that is reserved for steps inside the tolerances; number of climbs that
take such steps."""
_CONTENDERS, _LEAST_CONTENDERS, _TELLS = 8, 2, 2
"""Number of machines that are judged on further days (in proportion fewer in a search of fewer than
``SEARCHED`` machines); their smallest number; and number of numbers in which any two of them differ
at least."""
_MATTERS = 1e-5
"""If the change of a number changes the used share of a limit by less, it has no effect on it."""
_SAME = 1e-9
_BETTER = 1e-7
"""Smallest gain of a used share that counts: rounding errors are smaller."""
_MOST_SHARE = 100.0


_Climb = tuple[int, int]
"""Number of the criterion's row, and number of the machine."""


def most_searched(within: WithinTolerances) -> int:
    """Return how many machines a search tries after both ends of each number."""
    if not within.together:
        return SEARCHED_SERIAL
    if not within.replayed:
        return SEARCHED
    return min(max(_REPLAYED_TICKS // max(within.ticks, 1), SEARCHED_SERIAL), SEARCHED)


class WorstSearch:
    """Searches for the worst machine, criterion by criterion, with a limited number of machines.

    Call ``begin``, then ``add`` or ``draw`` for drawn machines, then ``go_on``.

    1. Both ends of each number, with all other numbers nominal, give the slope of every criterion.
    2. Corners follow, in which every number with an effect is at one of its ends: by the signs of
       the slopes, by the signs of a linear fit to all machines, and next to the worst machines. If
       machines are simulated in batches, 400 corners are drawn as well, half of them mostly by the
       slopes of the criteria that are worst at the ends: the result may jump from corner to corner,
       and a few machines in a thousand may be far worse than all others.
    3. Therefore many short climbs find more than one long climb. Up to 16 climbs start from the
       worst machines of these criteria that differ clearly. A climb moves one number after the
       other to its other end, and then moves all numbers together whose move made the machine
       worse, as long as the machine becomes worse. A number that had no effect is left out until
       the climb ends, and is then tried once more.
    4. When all climbs have ended, further climbs start from the worst of their ends, with four
       numbers changed at random.
    5. A fifth of the machines is reserved for the last steps inside the tolerances, in which each
       number moves to its nominal value and half-way to it.

    Each round of all climbs is one batch. A gain below a ten-millionth of a limit does not count,
    so that rounding has no effect on the result.

    Parameters
    ----------
    within
        Judges the machines.
    most
        Largest number of machines that are tried after both ends of each number.
    corners
        Number of corners that are drawn, if machines are simulated in batches.
    hasty
        Whether the search ends as soon as a machine is out of specification.
    seed
        Seed of the drawn corners and of the random changes at which further climbs start.

    Attributes
    ----------
    done
        Called with the number of machines judged since the last call.
    searched
        Number of machines tried so far, without the drawn machines.
    drawn
        (k,) indices of the drawn machines in ``parts``.
    """

    def __init__(
        self,
        within: WithinTolerances,
        most: int | None = None,
        *,
        corners: int = _CORNERS,
        hasty: bool = False,
        done: Done | None = None,
        seed: int = _CORNER_SEED,
    ) -> None:
        self._random = np.random.default_rng(seed)
        self._corners = corners
        self._within, self._hasty, self.done = within, hasty, done
        self.most = most_searched(within) if most is None else most
        self._share = 1.0 if most is not None else self.most / SEARCHED
        self._parts: list[FloatArray] = []
        self._found: list[EachRun] = []
        self._known: dict[bytes, int] = {}
        self._shares = np.empty((0, 0))
        self._bad = np.zeros(0, dtype=np.bool_)
        self._slopes: FloatArray | None = None
        self._moving: IntArray = np.zeros(0, dtype=np.int64)
        self._left = self.most
        self._idle: dict[_Climb, frozenset[int]] = {}
        self.searched = 0
        self.drawn: IntArray = np.zeros(0, dtype=np.int64)

    @property
    def parts(self) -> FloatArray:
        """(k, n) parts of all judged machines in their order, drawn machines included."""
        return np.concatenate(self._parts)

    @property
    def found(self) -> EachRun:
        """The results of all judged machines."""
        return EachRun.joined(self._found)

    @property
    def failed(self) -> bool:
        """Whether a judged machine is out of specification."""
        return bool(self._bad.any())

    @property
    def is_over(self) -> bool:
        """Whether a hasty search may end, because a machine is out of specification."""
        return self._hasty and self.failed

    def add(self, parts: FloatArray, found: EachRun) -> None:
        """Add machines at (k, n) ``parts`` that were judged elsewhere."""
        shares = row_shares(found)
        first_index = len(self._bad)
        for k, machine in enumerate(parts):
            self._known.setdefault(_key(machine), first_index + k)
        self._parts.append(parts)
        self._found.append(found)
        self._shares = shares if not first_index else np.concatenate([self._shares, shares], axis=1)
        self._bad = np.concatenate([self._bad, ~found.passed])

    def draw(self, parts: FloatArray) -> None:
        """Judge drawn machines at (k, n) ``parts``."""
        first_index = len(self._bad)
        self.add(parts, self._within.judged(parts, self.done))
        self.drawn = np.concatenate([self.drawn, np.arange(first_index, len(self._bad))])

    def tried(self, parts: FloatArray) -> IntArray:
        """Judge the new machines among (k, n) ``parts``; return the (k,) indices of all of them."""
        new_parts: dict[bytes, FloatArray] = {}
        for machine in parts:
            if (key := _key(machine)) not in self._known:
                new_parts.setdefault(key, machine)
        if new_parts:
            to_judge = np.stack(list(new_parts.values()))
            self.searched += len(to_judge)
            self.add(to_judge, self._within.judged(to_judge, self.done))
        return np.array([self._known[_key(machine)] for machine in parts], dtype=np.int64)

    def worst(self) -> int:
        """Return the index of the worst machine; machines out of specification come first."""
        return int(self._in_order()[0])

    def worst_of_days(self, days: Days) -> int:
        """Return the index of the machine that is worst over several days.

        The phases of encoders may have a larger effect than a number of the machine: the static
        error of a controller with coarse output changes from day to day. If machines are simulated
        in batches, the worst machines that differ clearly are therefore judged on every day.
        """
        order = self._in_order()
        if not self._within.together or self.is_over:
            return int(order[0])
        contender_count = max(self._scaled(_CONTENDERS), _LEAST_CONTENDERS)
        contenders = self._tell_apart(order.tolist(), contender_count, _TELLS, self._moving)
        results = self._within.in_days(self.parts[contenders], days)
        if self.done is not None:
            self.done(results.runs)
        failed = ~results.passed.reshape(len(contenders), -1)
        failed_shares = np.where(failed, row_shares(results).max(axis=0).reshape(failed.shape), 0.0)
        worst_shares = np.maximum(failed_shares, shares_of(results)[0].reshape(failed.shape)).max(
            axis=1
        )
        return contenders[int(np.lexsort((-np.minimum(worst_shares, 1e9), ~failed.any(axis=1)))[0])]

    def _in_order(self) -> IntArray:
        """Return the indices of all machines, the worst first."""
        shares, _ = shares_of(self.found)
        ranked_shares = np.where(self._bad, self._shares.max(axis=0, initial=0.0), shares)
        return np.lexsort((-np.minimum(ranked_shares, 1e9), ~self._bad))

    def _tell_apart(
        self, order: Sequence[int], most: int, least: int, numbers: IntArray
    ) -> list[int]:
        """Return the first machines of ``order`` that differ clearly, at most ``most``.

        The signs of the parts of any two of them differ in at least ``least`` of ``numbers``.
        """
        signs = np.sign(self.parts[:, numbers] if len(numbers) else self.parts)
        chosen: list[int] = []
        for index in order:
            if all((signs[index] != signs[earlier]).sum() >= least for earlier in chosen):
                chosen.append(index)
                if len(chosen) >= most:
                    break
        return chosen

    def _scaled(self, count: int) -> int:
        """Return a number of machines, scaled down in proportion to the size of this search."""
        return round(count * self._share)

    def begin(self) -> None:
        """Try the ends of each number, the corners by the slopes, and the drawn corners."""
        self._ends()
        if self.is_over:
            return
        assert self._slopes is not None
        order = self._worst_rows()
        self._try_some(self._slopes[order] * self._within.ends)
        if self._within.together and not self.is_over:
            self._try_some(self._drawn_corners(order[:_ROWS]))

    def go_on(self) -> None:
        """Continue from all known machines, until none is worse or no more may be tried."""
        for step in (self._fitted_corners, self._climbs):
            if self.is_over:
                return
            step()

    def _worst_rows(self) -> IntArray:
        """Return the indices of all criterion rows, the rows closest to their limits first."""
        return np.argsort(-_clipped(self._shares).max(axis=1), kind="stable")

    def _near_rows(self) -> list[int]:
        """Return the indices of the rows whose share is near the worst share, the worst first."""
        rows = self._worst_rows()[:_ROWS]
        worst = _clipped(self._shares[rows]).max(axis=1)
        return [int(row) for row in rows[worst >= _NEAR * worst[0]]]

    def _ends(self) -> None:
        ends, singles = self._within.ends, self._within.singles
        indices = self.tried(np.concatenate([np.zeros((1, len(ends))), singles]))
        nominal, low, high = (
            _clipped(self._shares[:, k]) for k in (indices[:1], indices[1::2], indices[2::2])
        )
        effect = np.maximum(np.abs(low - nominal), np.abs(high - nominal))
        self._slopes = np.where(effect > _MATTERS, np.where(high >= low, 1.0, -1.0), 0.0)
        # A number without effect on a share may still have one at a corner: keep every number that
        # changes a value.
        values = np.stack([row.values for row in self.found.rows if not row.of_plan])[:, indices]
        values = np.nan_to_num(values, nan=-1.0, posinf=1e300)
        has_changed = np.abs(values[:, 1:] - values[:, :1]) > _SAME * (1.0 + np.abs(values[:, :1]))
        self._moving = np.flatnonzero(has_changed.any(axis=0).reshape(-1, 2).any(axis=1))

    def _fitted_corners(self) -> None:
        assert self._slopes is not None
        ends, slopes = self._within.ends, self._slopes
        has_effect = slopes != 0.0
        corner_tables = []
        parts, shares = self.parts, _clipped(self._shares)
        if len(parts) > 2 * parts.shape[1]:
            design = np.concatenate([np.ones((len(parts), 1)), parts], axis=1)
            fit = np.linalg.lstsq(design, shares.T, rcond=None)[0][1:].T
            signs = np.where(np.abs(fit) > _MATTERS, np.sign(fit), slopes)
            corner_tables.append(np.where(has_effect, signs, 0.0) * ends)
        if self._within.together:
            order_by_share = np.argsort(-shares, axis=1, kind="stable")
            for rank in range(min(2, len(parts))):
                worst_signs = np.where(parts[order_by_share[:, rank]] < 0.0, -1.0, 1.0)
                corner_tables.append(np.where(has_effect, worst_signs, 0.0) * ends)
        if corner_tables:
            order = self._worst_rows()
            self._try_some(np.concatenate([corner_table[order] for corner_table in corner_tables]))

    def _drawn_corners(self, rows: IntArray) -> FloatArray:
        """Return drawn corners; half of them mostly follow the slopes of ``rows``, in turn."""
        assert self._slopes is not None
        ends = self._within.ends
        random = self._random
        leaning_count = self._scaled(self._corners // 2)
        count = self._scaled(self._corners - self._corners // 2)
        even_corners = np.where(random.random((count, len(ends))) < 0.5, -1.0, 1.0)
        follows_slope = random.random((leaning_count, len(ends))) < _LEAN
        slopes_of_rows = self._slopes[np.resize(rows, leaning_count)]
        leaning = np.where(follows_slope, slopes_of_rows, -slopes_of_rows)
        random_signs = np.where(random.random(leaning.shape) < 0.5, -1.0, 1.0)
        leaning = np.where(leaning == 0.0, random_signs, leaning)
        # A number without any effect keeps the value of the file.
        return (
            np.concatenate([even_corners, leaning])
            * ends
            * np.isin(np.arange(len(ends)), self._moving)
        )

    def _try_some(self, parts: FloatArray) -> IntArray:
        """Judge as many of (k, n) ``parts`` as may still be tried; return their indices."""
        searched_before = self.searched
        indices = self.tried(parts[: max(self._left, 0)])
        self._left -= self.searched - searched_before
        return indices

    def _climbs(self) -> None:
        """Climb from many machines, from the ends of climbs, and at last inside the tolerances."""
        queue, kick_count = self._starts(), 0
        climbs: list[_Climb] = []
        finished: list[_Climb] = []
        reserved = int(_INSIDE * self.most) if self._within.together else 0
        while self._left > reserved and not self.is_over:
            while len(climbs) < _AT_ONCE and queue:
                climbs.append(queue.pop(0))
            if (
                len(climbs) < _AT_ONCE
                and finished
                and kick_count < _MOST_KICKS
                and self._within.together
            ):
                kicked = self._kicked(finished, _AT_ONCE - len(climbs))
                kick_count += len(kicked)
                climbs += kicked
            if not climbs:
                break
            with_idle = {climb for climb in climbs if self._idle.get(climb)}
            climbs, finished_now = self._round(climbs, self._flips)
            finished += [climb for climb in finished_now if climb not in with_idle]
            # A number without effect where a climb began may have one where the climb ends.
            restarted = [climb for climb in finished_now if climb in with_idle]
            self._idle.update(dict.fromkeys(restarted, frozenset()))
            climbs += restarted
        inner = self._best([*finished, *climbs])[:_INNER]
        while inner and self._left > 0 and not self.is_over:
            inner, _ = self._round(inner, self._inside)

    def _starts(self) -> list[_Climb]:
        """Return starts of climbs: the worst machine of each near row, then others, row by row.

        The machines of a row differ clearly.
        """
        assert self._slopes is not None
        if not self._within.together:
            row = int(self._worst_rows()[0])
            return [(row, int(np.argmax(_clipped(self._shares[row]))))]
        rows = self._near_rows()
        by_row = []
        for row in rows:
            order = np.argsort(-_clipped(self._shares[row]), kind="stable").tolist()
            # Machines that differ only in numbers without effect on this row lead to the same end.
            effective = np.flatnonzero(self._slopes[row])
            by_row.append(
                [(row, index) for index in self._tell_apart(order, _STARTS, _APART, effective)]
            )
        first, others = (
            [row_starts[0] for row_starts in by_row],
            [start for row_starts in by_row for start in row_starts[1:]],
        )
        return [*first, *others][:_STARTS]

    def _best(self, climbs: Sequence[_Climb]) -> list[_Climb]:
        """Return the distinct climbs, the climb at the largest share first."""
        distinct = list(dict.fromkeys(climbs))
        return sorted(distinct, key=lambda one: -float(_clipped(self._shares[one[0]])[one[1]]))

    def _kicked(self, finished: Sequence[_Climb], count: int) -> list[_Climb]:
        """Return climbs that start at the worst ends of climbs, with a few numbers changed."""
        best, parts = self._best(finished)[:_KICKED], []
        chosen = [best[int(k)] for k in self._random.integers(0, len(best), count)]
        for row, index in chosen:
            effective = np.array(
                sorted({*self._moving.tolist()} - self._idle.get((row, index), set()))
            )
            machine = self.parts[index].copy()
            if len(effective):
                changed = self._random.choice(effective, min(_KICK, len(effective)), replace=False)
                machine[changed] = (
                    np.where(machine[changed] > 0.0, -1.0, 1.0) * self._within.ends[changed]
                )
            parts.append(machine)
        indices = self._try_some(np.stack(parts)).tolist()
        return [(row, index) for (row, _), index in zip(chosen, indices, strict=False)]

    def _flips(self, climb: _Climb) -> list[FloatArray]:
        """Return the machines of a climb's next step: each has one number moved to another end."""
        machines, (_, index) = [], climb
        for k in self._still_tried(climb):
            farthest = self._within.ends[k]
            for end in (farthest, -farthest):
                machine = self.parts[index].copy()
                if machine[k] != end and (machine[k] != -end or abs(machine[k]) == farthest):
                    machine[k] = end
                    machines.append(machine)
        return machines

    def _inside(self, climb: _Climb) -> list[FloatArray]:
        """Return the machines with one number at its nominal value, or half-way to it."""
        machines, (_, index) = [], climb
        for k in self._still_tried(climb):
            for factor in (0.0, 0.5):
                machine = self.parts[index].copy()
                machine[k] *= factor
                machines.append(machine)
        return machines

    def _still_tried(self, climb: _Climb) -> list[int]:
        """Return the numbers that a climb still tries: those not known to have no effect."""
        idle = self._idle.get(climb, frozenset())
        return [k for k in self._moving.tolist() if k not in idle]

    def _round(
        self, climbs: Sequence[_Climb], moves: Callable[[_Climb], list[FloatArray]]
    ) -> tuple[list[_Climb], list[_Climb]]:
        """Take one step of every climb; return the climbs whose machine got worse, and the rest."""
        trial_parts = [moves(one) for one in climbs]
        count = len(climbs)
        per_climb = max(self._left // count, 1)
        trial_parts = [some_parts[:per_climb] for some_parts in trial_parts]
        all_parts = [one for some_parts in trial_parts for one in some_parts]
        if not all_parts:
            return [], []
        tried = iter(self._try_some(np.stack(all_parts)).tolist())
        sums_by_climb, better_sets = [], []
        for (row, index), some_parts in zip(climbs, trial_parts, strict=True):
            own_share = _clipped(self._shares[row])[index]
            judged_here = [(k, n) for k, n in zip(some_parts, tried, strict=False)]
            gains = sorted(
                ((float(_clipped(self._shares[row])[n]) - own_share, n) for _, n in judged_here),
                key=lambda one: (-round(one[0], 9), one[1]),
            )
            better = [n for gain, n in gains if gain > _BETTER]
            idle = self._without_effect(index, gains)
            self._idle[row, index] = self._idle.get((row, index), frozenset()) | idle
            better_sets.append(better)
            summed = []
            for change_count in dict.fromkeys((len(better), (len(better) + 1) // 2, 2)):
                if 1 < change_count <= len(better):
                    summed.append(self._summed(index, better[:change_count]))
            sums_by_climb.append(summed)
        all_parts = [one for summed in sums_by_climb for one in summed]
        tried = iter(
            self._try_some(np.stack(all_parts)).tolist() if all_parts and self._left > 0 else []
        )
        continued, finished = [], []
        for (row, index), better, summed in zip(climbs, better_sets, sums_by_climb, strict=True):
            end_indices = [*better, *(n for _, n in zip(summed, tried, strict=False))]
            if not better:
                finished.append((row, index))
                continue
            end_shares = np.round(_clipped(self._shares[row])[end_indices], 9)
            continued.append((row, end_indices[int(np.argmax(end_shares))]))
            self._idle.setdefault(continued[-1], self._idle[row, index])
        return list(dict.fromkeys(continued)), finished

    def _without_effect(self, start: int, gains: Sequence[tuple[float, int]]) -> frozenset[int]:
        """Return the numbers whose change at machine ``start`` had no effect on the criterion."""
        parts = self.parts
        idle: set[int] = set()
        effective: set[int] = set()
        for gain, n in gains:
            changed = np.flatnonzero(parts[n] != parts[start]).tolist()
            (idle if abs(gain) <= _MATTERS else effective).update(changed)
        return frozenset(idle - effective)

    def _summed(self, start: int, better: Sequence[int]) -> FloatArray:
        """Return a machine with the changes of several machines; the larger gain has precedence."""
        parts = self.parts
        summed: FloatArray = parts[start].copy()
        for index in reversed(better):
            changed = parts[index] != parts[start]
            summed[changed] = parts[index][changed]
        return summed


def _key(parts: FloatArray) -> bytes:
    return np.asarray(parts + 0.0, dtype=np.float64).tobytes()  # -0.0 is 0.0


def _clipped(shares: FloatArray) -> FloatArray:
    return np.asarray(np.round(np.minimum(shares, _MOST_SHARE), 9), dtype=np.float64)
