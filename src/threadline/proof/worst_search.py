"""The search for the worst machine within the tolerances, in a stated number of machines."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.workers import Done
from threadline.machine.vary import Days
from threadline.proof.worst_machine import WithinTolerances, row_shares, shares_of
from threadline.verdict import EachRun

SEARCHED, SEARCHED_ALONE = 1200, 60
"""Most machines that a search tries after both ends of each number, where machines are simulated in
batches, and where they are simulated one by one."""
_REPLAYED_TICKS = 50_000_000
"""Ticks of runs whose fibre is replayed that a search tries at most, after the ends: a tick costs
some ten times as much as without a product."""
_CORNERS, _LEANING, _LEAN = 200, 200, 0.75
"""Corners that are drawn, all alike; that lean to the slopes of one criterion; and the share of the
numbers that follow them. Fewer in a search of fewer than ``SEARCHED`` machines."""
_CORNER_SEED = 1941
_NEAR, _ROWS = 0.7, 3
"""Criteria that are climbed use at least this part of the worst share; the most of them."""
_STARTS, _APART, _AT_ONCE = 16, 2, 4
"""Machines from which climbs start, least numbers that tell two of them apart, climbs at once."""
_MOST_KICKS, _KICKED, _KICK = 40, 4, 4
"""Climbs that start from an ended one; ended climbs that they start from; numbers changed first."""
_INSIDE, _INNER = 0.2, 3
"""Part of the machines kept for steps inside the tolerances; climbs that go on inside."""
_CONTENDERS, _LEAST_CONTENDERS, _TELLS = 8, 2, 2
"""Machines that are judged on further days, fewer in a search of fewer than ``SEARCHED`` machines;
the least of them; and least numbers that tell two of them apart."""
_MATTERS = 1e-5
"""Change of a share of a limit below which a number has no influence on it."""
_SAME = 1e-9
_BETTER = 1e-7
"""Least gain of a share, so that rounding decides nothing."""
_MOST_SHARE = 100.0


_Climb = tuple[int, int]
"""Number of the criterion's row, and number of the machine."""


def most_searched(within: WithinTolerances) -> int:
    """Return how many machines a search tries after both ends of each number."""
    if not within.together:
        return SEARCHED_ALONE
    if not within.replayed:
        return SEARCHED
    return min(max(_REPLAYED_TICKS // max(within.ticks, 1), SEARCHED_ALONE), SEARCHED)


class WorstSearch:
    """Searches the worst machine, criterion by criterion, within a number of machines.

    ``begin``, then ``add`` machines that were drawn, then ``go_on``.

    Both ends of each number alone give the slopes of every criterion. Then come the corners of the
    numbers that matter: by the signs of the slopes, by the signs of a linear fit to all machines,
    and next to the worst ones. Where machines are simulated in batches, 400 corners are drawn, half
    of them mostly by the slopes of the criteria that are worst at the ends: the result of a machine
    may jump from corner to corner, and a few machines in a thousand may be far worse than all
    others. So many short climbs find more than one long one: up to 16 start from the worst machines
    of these criteria that differ clearly. One number after the other goes to its other end, then
    all that make it worse together, as long as that helps. Numbers that changed nothing are left
    out until a climb ends, and are tried then. When all have ended, further climbs start from the
    worst of their ends with four numbers changed at random. A fifth of the machines is kept for the
    last steps: each number goes to the middle and half-way there. Each round is one batch.

    No gain below a ten-millionth of a limit counts, so that rounding decides nothing.

    Parameters
    ----------
    within
        Judges the machines.
    most
        Most machines that are tried after both ends of each number.
    hasty
        Whether the search ends as soon as a machine is out of specification.
    seed
        Seed of the corners, and of the changes from which further climbs start.

    Attributes
    ----------
    done
        Called with the number of judged machines.
    searched
        Number of machines tried so far, without the drawn machines.
    drawn
        Numbers of the drawn machines.
    """

    def __init__(
        self,
        within: WithinTolerances,
        most: int | None = None,
        *,
        hasty: bool = False,
        done: Done | None = None,
        seed: int = _CORNER_SEED,
    ) -> None:
        self._random = np.random.default_rng(seed)
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
    def ended(self) -> bool:
        """Whether the search may end, for a machine failed and no worse one is wanted."""
        return self._hasty and self.failed

    def add(self, parts: FloatArray, found: EachRun) -> None:
        """Take machines that were judged elsewhere, at (k, n) ``parts``."""
        shares = row_shares(found)
        at = len(self._bad)
        for k, one in enumerate(parts):
            self._known.setdefault(_key(one), at + k)
        self._parts.append(parts)
        self._found.append(found)
        self._shares = shares if not at else np.concatenate([self._shares, shares], axis=1)
        self._bad = np.concatenate([self._bad, ~found.passed])

    def draw(self, parts: FloatArray) -> None:
        """Judge machines that were drawn, at (k, n) ``parts``."""
        at = len(self._bad)
        self.add(parts, self._within.judged(parts, self.done))
        self.drawn = np.concatenate([self.drawn, np.arange(at, len(self._bad))])

    def tried(self, parts: FloatArray) -> IntArray:
        """Judge (k, n) ``parts`` that are not known yet; return the (k,) numbers of all."""
        fresh: dict[bytes, FloatArray] = {}
        for one in parts:
            if (key := _key(one)) not in self._known:
                fresh.setdefault(key, one)
        if fresh:
            some = np.stack(list(fresh.values()))
            self.searched += len(some)
            self.add(some, self._within.judged(some, self.done))
        return np.array([self._known[_key(one)] for one in parts], dtype=np.int64)

    def worst(self) -> int:
        """Return the number of the worst machine: out of specification, then by its share."""
        return int(self._in_order()[0])

    def worst_of_days(self, days: Days) -> int:
        """Return the number of the machine that is worst over several days.

        The rounding of encoders may matter more than a number of the machine: the remaining error
        of a coarse controller changes from day to day. So the worst machines that differ clearly
        are judged on every day, where machines are simulated in batches.
        """
        order = self._in_order()
        if not self._within.together or self.ended:
            return int(order[0])
        most = max(self._scaled(_CONTENDERS), _LEAST_CONTENDERS)
        some = self._tell_apart(order.tolist(), most, _TELLS, self._moving)
        found = self._within.in_days(self.parts[some], days)
        if self.done is not None:
            self.done(found.runs)
        bad = ~found.passed.reshape(len(some), -1)
        hard = np.where(bad, row_shares(found).max(axis=0).reshape(bad.shape), 0.0)
        worst = np.maximum(hard, shares_of(found)[0].reshape(bad.shape)).max(axis=1)
        return some[int(np.lexsort((-np.minimum(worst, 1e9), ~bad.any(axis=1)))[0])]

    def _in_order(self) -> IntArray:
        """Return the numbers of all machines, the worst first."""
        shares, _ = shares_of(self.found)
        hard = np.where(self._bad, self._shares.max(axis=0, initial=0.0), shares)
        return np.lexsort((-np.minimum(hard, 1e9), ~self._bad))

    def _tell_apart(
        self, order: Sequence[int], most: int, least: int, numbers: IntArray
    ) -> list[int]:
        """Return the first of ``order``, such that any two differ in ``least`` of ``numbers``."""
        signs = np.sign(self.parts[:, numbers] if len(numbers) else self.parts)
        found: list[int] = []
        for at in order:
            if all((signs[at] != signs[known]).sum() >= least for known in found):
                found.append(at)
                if len(found) >= most:
                    break
        return found

    def _scaled(self, count: int) -> int:
        """Return a number of machines of a whole search, for this one."""
        return round(count * self._share)

    def begin(self) -> None:
        """Try the ends of each number, and the corners: by the slopes, and from a fixed seed."""
        self._ends()
        if self.ended:
            return
        assert self._slopes is not None
        order = self._worst_rows()
        self._try_some(self._slopes[order] * self._within.ends)
        if self._within.together and not self.ended:
            self._try_some(self._drawn_corners(order[:_ROWS]))

    def go_on(self) -> None:
        """Search on from all machines that are known, until no machine is worse or none is left."""
        for step in (self._fitted_corners, self._climbs):
            if self.ended:
                return
            step()

    def _worst_rows(self) -> IntArray:
        """Return the numbers of all rows, the rows closest to their limits first."""
        return np.argsort(-_clipped(self._shares).max(axis=1), kind="stable")

    def _near_rows(self) -> list[int]:
        """Return the numbers of the rows that come near the worst share, the worst first."""
        rows = self._worst_rows()[:_ROWS]
        worst = _clipped(self._shares[rows]).max(axis=1)
        return [int(row) for row in rows[worst >= _NEAR * worst[0]]]

    def _ends(self) -> None:
        ends, single = self._within.ends, self._within.singles
        at = self.tried(np.concatenate([np.zeros((1, len(ends))), single]))
        own, low, high = (_clipped(self._shares[:, k]) for k in (at[:1], at[1::2], at[2::2]))
        effect = np.maximum(np.abs(low - own), np.abs(high - own))
        self._slopes = np.where(effect > _MATTERS, np.where(high >= low, 1.0, -1.0), 0.0)
        # At a corner a number may matter that does not matter alone.
        values = np.stack([row.values for row in self.found.rows if not row.of_plan])[:, at]
        values = np.nan_to_num(values, nan=-1.0, posinf=1e300)
        moved = np.abs(values[:, 1:] - values[:, :1]) > _SAME * (1.0 + np.abs(values[:, :1]))
        self._moving = np.flatnonzero(moved.any(axis=0).reshape(-1, 2).any(axis=1))

    def _fitted_corners(self) -> None:
        assert self._slopes is not None
        ends, slopes = self._within.ends, self._slopes
        matter = slopes != 0.0
        tables = []
        parts, shares = self.parts, _clipped(self._shares)
        if len(parts) > 2 * parts.shape[1]:
            design = np.concatenate([np.ones((len(parts), 1)), parts], axis=1)
            fit = np.linalg.lstsq(design, shares.T, rcond=None)[0][1:].T
            signs = np.where(np.abs(fit) > _MATTERS, np.sign(fit), slopes)
            tables.append(np.where(matter, signs, 0.0) * ends)
        if self._within.together:
            worst = np.argsort(-shares, axis=1, kind="stable")
            for place in range(min(2, len(parts))):
                near = np.where(parts[worst[:, place]] < 0.0, -1.0, 1.0)
                tables.append(np.where(matter, near, 0.0) * ends)
        if tables:
            order = self._worst_rows()
            self._try_some(np.concatenate([table[order] for table in tables]))

    def _drawn_corners(self, rows: IntArray) -> FloatArray:
        """Return random corners, half of them leaning to the slopes of ``rows`` by turns."""
        assert self._slopes is not None
        ends = self._within.ends
        random = self._random
        count, lean = self._scaled(_CORNERS), self._scaled(_LEANING)
        alike = np.where(random.random((count, len(ends))) < 0.5, -1.0, 1.0)
        follow = random.random((lean, len(ends))) < _LEAN
        of_rows = self._slopes[np.resize(rows, lean)]
        leaning = np.where(follow, of_rows, -of_rows)
        other = np.where(random.random(leaning.shape) < 0.5, -1.0, 1.0)
        leaning = np.where(leaning == 0.0, other, leaning)
        # A number that changes nothing stays as the file has it.
        return np.concatenate([alike, leaning]) * ends * np.isin(np.arange(len(ends)), self._moving)

    def _try_some(self, parts: FloatArray) -> IntArray:
        """Judge as many of (k, n) ``parts`` as may still be tried; return their numbers."""
        before = self.searched
        at = self.tried(parts[: max(self._left, 0)])
        self._left -= self.searched - before
        return at

    def _climbs(self) -> None:
        """Climb from many machines, from the ends of climbs, and at last inside the tolerances."""
        queue, kicks = self._starts(), 0
        climbs: list[_Climb] = []
        ended: list[_Climb] = []
        kept = int(_INSIDE * self.most) if self._within.together else 0
        while self._left > kept and not self.ended:
            while len(climbs) < _AT_ONCE and queue:
                climbs.append(queue.pop(0))
            if len(climbs) < _AT_ONCE and ended and kicks < _MOST_KICKS and self._within.together:
                more = self._kicked(ended, _AT_ONCE - len(climbs))
                kicks += len(more)
                climbs += more
            if not climbs:
                break
            short = {one for one in climbs if self._idle.get(one)}
            climbs, stuck = self._round(climbs, self._flips)
            ended += [one for one in stuck if one not in short]
            # What changed nothing where a climb began may matter where it ends.
            again = [one for one in stuck if one in short]
            self._idle.update(dict.fromkeys(again, frozenset()))
            climbs += again
        inner = self._best([*ended, *climbs])[:_INNER]
        while inner and self._left > 0 and not self.ended:
            inner, _ = self._round(inner, self._inside)

    def _starts(self) -> list[_Climb]:
        """Return the worst machine of each near row, then others that are apart, row by row."""
        assert self._slopes is not None
        if not self._within.together:
            row = int(self._worst_rows()[0])
            return [(row, int(np.argmax(_clipped(self._shares[row]))))]
        rows = self._near_rows()
        of_rows = []
        for row in rows:
            order = np.argsort(-_clipped(self._shares[row]), kind="stable").tolist()
            # Machines that differ in numbers of other criteria alone lead to the same end.
            own = np.flatnonzero(self._slopes[row])
            of_rows.append([(row, at) for at in self._tell_apart(order, _STARTS, _APART, own)])
        first, others = [some[0] for some in of_rows], [one for some in of_rows for one in some[1:]]
        return [*first, *others][:_STARTS]

    def _best(self, climbs: Sequence[_Climb]) -> list[_Climb]:
        """Return distinct climbs, those at the largest shares first."""
        distinct = list(dict.fromkeys(climbs))
        return sorted(distinct, key=lambda one: -float(_clipped(self._shares[one[0]])[one[1]]))

    def _kicked(self, ended: Sequence[_Climb], count: int) -> list[_Climb]:
        """Return climbs from the best ends of climbs, each with a few numbers changed."""
        best, parts = self._best(ended)[:_KICKED], []
        chosen = [best[int(k)] for k in self._random.integers(0, len(best), count)]
        for row, at in chosen:
            matter = np.array(sorted({*self._moving.tolist()} - self._idle.get((row, at), set())))
            one = self.parts[at].copy()
            if len(matter):
                some = self._random.choice(matter, min(_KICK, len(matter)), replace=False)
                one[some] = np.where(one[some] > 0.0, -1.0, 1.0) * self._within.ends[some]
            parts.append(one)
        numbers = self._try_some(np.stack(parts)).tolist()
        return [(row, at) for (row, _), at in zip(chosen, numbers, strict=False)]

    def _flips(self, climb: _Climb) -> list[FloatArray]:
        """Return the machines with one number at another end."""
        found, (_, at) = [], climb
        for k in self._told(climb):
            far = self._within.ends[k]
            for end in (far, -far):
                one = self.parts[at].copy()
                if one[k] != end and (one[k] != -end or abs(one[k]) == far):
                    one[k] = end
                    found.append(one)
        return found

    def _inside(self, climb: _Climb) -> list[FloatArray]:
        """Return the machines with one number in the middle, or half-way there."""
        found, (_, at) = [], climb
        for k in self._told(climb):
            for part in (0.0, 0.5):
                one = self.parts[at].copy()
                one[k] *= part
                found.append(one)
        return found

    def _told(self, climb: _Climb) -> list[int]:
        """Return the numbers that changed the criterion where the climb came from."""
        idle = self._idle.get(climb, frozenset())
        return [k for k in self._moving.tolist() if k not in idle]

    def _round(
        self, climbs: Sequence[_Climb], moves: Callable[[_Climb], list[FloatArray]]
    ) -> tuple[list[_Climb], list[_Climb]]:
        """Take one step of every climb; return the climbs that got worse, and the others."""
        tried = [moves(one) for one in climbs]
        count = len(climbs)
        share = max(self._left // count, 1)
        tried = [some[:share] for some in tried]
        flat = [one for some in tried for one in some]
        if not flat:
            return [], []
        numbers = iter(self._try_some(np.stack(flat)).tolist())
        together, worse = [], []
        for (row, at), some in zip(climbs, tried, strict=True):
            own = _clipped(self._shares[row])[at]
            got = [(k, n) for k, n in zip(some, numbers, strict=False)]
            gains = sorted(
                ((float(_clipped(self._shares[row])[n]) - own, n) for _, n in got),
                key=lambda one: (-round(one[0], 9), one[1]),
            )
            better = [n for gain, n in gains if gain > _BETTER]
            idle = self._without_effect(at, gains)
            self._idle[row, at] = self._idle.get((row, at), frozenset()) | idle
            worse.append(better)
            sums = []
            for most in dict.fromkeys((len(better), (len(better) + 1) // 2, 2)):
                if 1 < most <= len(better):
                    sums.append(self._summed(at, better[:most]))
            together.append(sums)
        flat = [one for sums in together for one in sums]
        numbers = iter(self._try_some(np.stack(flat)).tolist() if flat and self._left > 0 else [])
        on, stuck = [], []
        for (row, at), better, sums in zip(climbs, worse, together, strict=True):
            ends = [*better, *(n for _, n in zip(sums, numbers, strict=False))]
            if not better:
                stuck.append((row, at))
                continue
            values = np.round(_clipped(self._shares[row])[ends], 9)
            on.append((row, ends[int(np.argmax(values))]))
            self._idle.setdefault(on[-1], self._idle[row, at])
        return list(dict.fromkeys(on)), stuck

    def _without_effect(self, at: int, gains: Sequence[tuple[float, int]]) -> frozenset[int]:
        """Return the numbers whose change at machine ``at`` did not change the criterion."""
        parts = self.parts
        idle: set[int] = set()
        matter: set[int] = set()
        for gain, n in gains:
            changed = np.flatnonzero(parts[n] != parts[at]).tolist()
            (idle if abs(gain) <= _MATTERS else matter).update(changed)
        return frozenset(idle - matter)

    def _summed(self, at: int, better: Sequence[int]) -> FloatArray:
        """Return a machine with the changes of several others, the largest gain of each number."""
        parts = self.parts
        found: FloatArray = parts[at].copy()
        for number in reversed(better):
            changed = parts[number] != parts[at]
            found[changed] = parts[number][changed]
        return found


def _key(parts: FloatArray) -> bytes:
    return np.asarray(parts + 0.0, dtype=np.float64).tobytes()  # -0.0 is 0.0


def _clipped(shares: FloatArray) -> FloatArray:
    return np.asarray(np.round(np.minimum(shares, _MOST_SHARE), 9), dtype=np.float64)
