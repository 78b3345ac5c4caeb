"""Variation of the tension of a fibre, layer by layer, from the channel ``tension`` of a run."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.jobs.tensions import tensions_of
from threadline.verdict.finding import Finding, RunFindings
from threadline.verdict.measure import Measure, Option
from threadline.verdict.replayed import Wound, shared_replays
from threadline.verdict.samples import Block, Setting

_NO_PRODUCT = "no product: give --product NAME.wind.toml"
_NEVER = "less fibre is drawn, where its place is known, than is left out (option after)"
_LOST = "the channel tension has no samples for part of the winding,"
_UNTOLD = "the job asks for several tensions, and the recording has no operations"
_AT_REST_M_S = 1e-4  # speed of the fibre below which it rests: no winding is as slow


@dataclass(frozen=True, slots=True)
class _Place:
    """An extreme of the tension: N, s, the operation and the commanded position."""

    tension_n: float
    time_s: float = math.nan
    operation: int = -1
    position: tuple[float, ...] | None = None


@dataclass(slots=True)
class _Sums:
    """Samples of the tension of one run: number, sum, smallest and largest.

    ``lost_s`` is the instant of the first missing sample; infinite if none is missing.
    """

    count: int = 0
    total: float = 0.0
    least: _Place = field(default_factory=lambda: _Place(math.inf))
    most: _Place = field(default_factory=lambda: _Place(-math.inf))
    lost_s: float = math.inf

    def add(self, other: _Sums) -> None:
        """Add later samples; of equal extremes the first stays."""
        self.count += other.count
        self.total += other.total
        self.lost_s = min(self.lost_s, other.lost_s)
        if other.least.tension_n < self.least.tension_n:
            self.least = other.least
        if other.most.tension_n > self.most.tension_n:
            self.most = other.most


def _sums(block: Block, tension: FloatArray, rows: IntArray) -> _Sums:
    """Return the sums of some samples of a run."""
    known = np.isfinite(tension[rows])
    lost_s = math.inf if known.all() else float(block.time_s[rows[known.argmin()]])
    rows = rows[known]
    if not len(rows):
        return _Sums(lost_s=lost_s)
    own = tension[rows]
    ends = []
    for at in (rows[own.argmin()], rows[own.argmax()]):
        position = None if block.commanded is None else tuple(block.commanded[at].tolist())
        operation = -1 if block.operation is None else int(block.operation[at])
        ends.append(_Place(float(tension[at]), float(block.time_s[at]), operation, position))
    least, most = ends
    return _Sums(len(own), float(own.sum()), least, most, lost_s)


class _Variation:
    """The largest deviation of the tension from its mean, over the mean, of each run.

    If the job asks for several tensions, each part of the job with one tension has its own mean. A
    part counts as soon as the place of the fibre is known and the length ``after`` has been drawn
    since the part began, up to the last fibre drawn: a rest in between counts, the rest at the end
    does not.
    """

    def __init__(self, setting: Setting, after_m: float) -> None:
        self._after_m, self._length_m = after_m, np.zeros(setting.runs)
        self._shared, runs = shared_replays(setting), setting.runs
        self._asked = tensions_of(setting.plan.job) or ((0, math.nan),)
        self._begins = np.array([operation for operation, _ in self._asked[1:]], dtype=np.int64)
        parts = len(self._asked)
        self._from_s = np.full((runs, parts), np.inf)
        self._began_m = np.full((runs, parts), np.inf)
        self._drawn_s = np.full(runs, -np.inf)
        self._sums = [[_Sums() for _ in range(parts)] for _ in range(runs)]
        # Samples since the fibre was last known to be drawn.
        self._still = [[_Sums() for _ in range(parts)] for _ in range(runs)]
        self._untold = False

    def _parts(self, operation: IntArray | None, count: int) -> IntArray:
        """Return the part of the job of each of ``count`` samples."""
        if operation is None:
            self._untold |= len(self._asked) > 1
            return np.zeros(count, dtype=np.int64)
        return np.searchsorted(self._begins, operation, side="right")

    def feed(self, block: Block) -> None:
        """Take the next samples."""
        self._note_fibre(self._shared.samples(block))
        if block.tension is None:
            return
        part = self._parts(block.operation, len(block.time_s))
        for run, sums in enumerate(self._sums):
            tension = block.tension[:, run]
            counts = block.time_s >= self._from_s[run][part]
            drawn = block.time_s <= self._drawn_s[run]
            for k in np.unique(part).tolist():
                own = counts & (part == k)
                if (own & drawn).any():
                    self._join(run, k)
                sums[k].add(_sums(block, tension, np.flatnonzero(own & drawn)))
                self._still[run][k].add(_sums(block, tension, np.flatnonzero(own & ~drawn)))

    def _join(self, run: int, last: int) -> None:
        """Count the samples of rests that later drawing has followed, up to a part."""
        for k in range(last + 1):
            self._sums[run][k].add(self._still[run][k])
            self._still[run][k] = _Sums()

    def _note_fibre(self, runs: Sequence[Wound]) -> None:
        """Note the instants from which on the fibre is known, and until which it is drawn."""
        for run, samples in enumerate(runs):
            drawn_m = np.where(np.isfinite(samples.fibre.used_m), samples.fibre.used_m, 0.0)
            length_m = self._length_m[run] + np.cumsum(drawn_m)
            if len(length_m):
                self._length_m[run] = length_m[-1]
            part = self._parts(samples.operation, len(length_m))
            began_m = self._began_m[run]
            for k in np.unique(part).tolist():
                if began_m[k] == np.inf:
                    began_m[k] = length_m[(part == k).argmax()] if k else 0.0
            known = samples.fibre.known & (length_m >= began_m[part] + self._after_m)
            if not known.any():
                continue
            for k in np.unique(part[known]).tolist():
                first = float(samples.time_s[(known & (part == k)).argmax()])
                self._from_s[run, k] = min(self._from_s[run, k], first)
            step_s = np.diff(samples.time_s, prepend=samples.before_s)
            with np.errstate(invalid="ignore", divide="ignore"):
                moving = known & (samples.fibre.used_m / step_s > _AT_REST_M_S)
            if moving.any():
                self._drawn_s[run] = samples.time_s[len(moving) - 1 - moving[::-1].argmax()]

    def finish(self) -> Sequence[RunFindings]:
        """Return the variation of every run."""
        if self._untold:
            return [RunFindings.alike(Finding(value=None, note=_UNTOLD), len(self._sums))]
        tensions_n = [tension_n for _, tension_n in self._asked]
        return [RunFindings.made([_of_run(sums, tensions_n) for sums in self._sums])]


def _of_run(parts: Sequence[_Sums], tensions_n: Sequence[float]) -> Finding:
    """Return the finding of the part that varies most, with the tension set there.

    Parts without samples do not count: their fibre is shorter than ``after``.
    """
    lost_s = min(sums.lost_s for sums in parts)
    if lost_s < math.inf:
        return Finding(value=None, note=f"{_LOST} from {lost_s:.4g} s on")
    found = []
    for sums, tension_n in zip(parts, tensions_n, strict=True):
        if not sums.count:
            continue
        own = _finding(sums)
        if own.value is None:
            return own
        if math.isfinite(tension_n):
            own = replace(own, note=f"{own.note}, asked {tension_n:.4g} N")
        found.append(own)
    if not found:
        return Finding(value=None, note=_NEVER)
    return max(found, key=lambda own: own.value or 0.0)


def _finding(sums: _Sums) -> Finding:
    """Return the variation of the samples of one part."""
    if not sums.total > 0.0:
        return Finding(value=None, note="the fibre is slack")
    mean = sums.total / sums.count
    low, high = mean - sums.least.tension_n, sums.most.tension_n - mean
    worst = sums.least if low >= high else sums.most
    found = Finding(
        value=max(low, high, 0.0) / mean,
        time_s=None if math.isnan(worst.time_s) else worst.time_s,
        operation=None if worst.operation < 0 else worst.operation,
        position=worst.position,
        note=f"mean {mean:.4g} N, least {sums.least.tension_n:.4g} N, most "
        f"{sums.most.tension_n:.4g} N",
    )
    return found if sums.least.tension_n > 0.0 else replace(found, note=f"{found.note}: slack")


class _Absent:
    """The measure of runs without a product."""

    def __init__(self, runs: int) -> None:
        self._runs = runs

    def feed(self, block: Block) -> None:
        """Do nothing."""

    def finish(self) -> Sequence[RunFindings]:
        """Return the reason for every run."""
        return [RunFindings.alike(Finding(value=None, note=_NO_PRODUCT), self._runs)]


OPTIONS = {"after": Option(unit="m", default=0.2)}


def start_variation(setting: Setting, options: Mapping[str, float]) -> Measure:
    """Return the measure ``tension_variation``."""
    if any(job is None for job in shared_replays(setting).jobs):
        return _Absent(setting.runs)
    return _Variation(setting, options["after"])
