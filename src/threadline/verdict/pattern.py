"""The pattern that a fibre makes: the gaps between its bands, and how far it is from closing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.commands.plan import Plan
from threadline.verdict.finding import RunFindings, Worst
from threadline.verdict.replayed import Wound, WoundJob, wound_job
from threadline.winding.surface import Surface

if TYPE_CHECKING:
    from threadline.winding.raster import Raster

NEVER_KNOWN = "the fibre is never known"
_FEW = 0.01  # share of the laid fibre: a smaller share of unknown place is not mentioned
_OUTLINE = 8193  # points of the meridian among which the widest is searched


def raster_bytes(plan: Plan) -> int:
    """Return the memory, bytes, that the coverage of a run needs; 0 without coverage."""
    job = wound_job(plan)
    return 0 if job is None or job.product.covered is None else _raster_of(job).nbytes


def _raster_of(job: WoundJob) -> Raster:
    from threadline.winding.raster import Raster

    begin, end = job.product.covered or (0.0, 0.0)
    return Raster(job.surface, job.width_m, begin, end, counting=False)


class CoverageGap:
    """The largest gap between the bands of each run."""

    def __init__(self, jobs: Sequence[WoundJob], axes: int) -> None:
        self._worst = Worst(len(jobs), axes, note=NEVER_KNOWN)
        self._rasters = [_raster_of(job) for job in jobs]
        self._last = [np.nan for _ in jobs]
        self._laid = np.zeros((len(jobs), 2))  # m: all fibre, and fibre of unknown place

    def take(self, runs: Sequence[Wound]) -> None:
        """Lay the bands of the next samples of every run."""
        for run, (raster, samples) in enumerate(zip(self._rasters, runs, strict=True)):
            fibre = samples.fibre
            step = np.diff(fibre.length_m, prepend=self._last[run])
            step = np.where(step > 0.0, step, 0.0)
            self._laid[run] += step.sum(), step[~fibre.known].sum()
            self._last[run] = fibre.length_m[-1] if len(fibre) else self._last[run]
            operation = samples.operation
            lines = np.zeros(len(fibre), dtype=np.int64) if operation is None else operation
            raster.lay(fibre.u, fibre.angle, fibre.winding, fibre.known, lines)

    def found(self) -> RunFindings:
        """Return the largest gap of each run, with the operation that laid the band there."""
        gaps = [raster.gap() for raster in self._rasters]
        self._worst.offer(
            np.array([gap.width_m for gap in gaps]),
            operation=np.array([gap.operation for gap in gaps]),
            note=np.array(
                [
                    "; ".join(filter(None, (gap.words, self._unknown(run, gap.width_m))))
                    for run, gap in enumerate(gaps)
                ],
                dtype=object,
            ),
        )
        return self._worst.found()

    def _unknown(self, run: int, gap_m: float) -> str:
        """Return in words how much fibre is missing on the raster because its place is unknown.

        Such fibre covers nothing: it may lie in a gap. Without a gap the rest covers everything.
        """
        laid, unknown = self._laid[run]
        if not unknown > _FEW * laid:
            return ""
        text = "may lie in the gap" if gap_m > 0.0 else "counts as no cover: the rest leaves no gap"
        from threadline.winding.raster import in_percent

        share = in_percent(unknown / laid)
        return f"the place of {share} of the laid fibre is not known, and that fibre {text}"


def middle_of(surface: Surface) -> float:
    """Return the place u, m, in the middle of the widest part of a mandrel."""
    u = np.linspace(0.0, surface.length_m, _OUTLINE)
    r = surface.at(u)[1][:, 0]
    return float(np.median(u[r > r.max() * (1.0 - 1e-9)]))


class PatternClosure:
    """How far a pattern is from its closure: where one more circuit would lie beside the first.

    A circuit begins where the fibre crosses the middle of the widest part from left to right.
    """

    def __init__(self, jobs: Sequence[WoundJob], axes: int) -> None:
        self._worst = Worst(len(jobs), axes, note="fewer than two known circuits")
        self._width_m, self._radius_m, self._at_u = [], [], []
        for job in jobs:
            at = middle_of(job.surface)
            self._width_m.append(job.width_m)
            self._radius_m.append(float(job.surface.at(np.array([at]))[1][0, 0]))
            self._at_u.append(at)
        self._last = [np.full((1, 2), np.nan) for _ in jobs]
        # Angle, angle with the meridian and operation of each beginning.
        self._circuits: list[list[FloatArray]] = [[] for _ in jobs]

    def take(self, runs: Sequence[Wound]) -> None:
        """Look for circuits that begin in the next samples of every run."""
        for run, samples in enumerate(runs):
            fibre = samples.fibre
            if not len(fibre):
                continue
            rows = np.column_stack([fibre.u - self._at_u[run], fibre.angle])
            rows[~fibre.known] = np.nan
            chain = np.vstack([self._last[run], rows])
            self._last[run] = chain[-1:]
            at = np.flatnonzero((chain[:-1, 0] < 0.0) & (chain[1:, 0] >= 0.0))
            share = chain[at, 0] / (chain[at, 0] - chain[at + 1, 0])
            angle = chain[at, 1] + share * (chain[at + 1, 1] - chain[at, 1])
            none = np.full(len(fibre), -1)
            operation = none if samples.operation is None else samples.operation
            self._circuits[run].append(np.column_stack([angle, fibre.winding[at], operation[at]]))

    def circuits(self, run: int) -> FloatArray:
        """Return (n, 3) angle, angle with the meridian and operation where each circuit begins."""
        return np.vstack([np.empty((0, 3)), *self._circuits[run]])

    def radius_m(self, run: int) -> float:
        """Return the radius of the mandrel where circuits begin."""
        return self._radius_m[run]

    def found(self) -> RunFindings:
        """Return for each run the distance from closure across the bands, at the last circuit."""
        from threadline.winding.fit import turn_error

        values, operations, notes = [], [], []
        for run in range(len(self._circuits)):
            rows = self.circuits(run)
            if len(rows) < 2:
                values.append(np.nan)
                operations.append(-1)
                notes.append("")
                continue
            angle_off = 2.0 * rows[-1, 0] - rows[-2, 0] - rows[0, 0]
            unwrapped, angle_off = (
                angle_off,
                float(np.arctan2(np.sin(angle_off), np.cos(angle_off))),
            )
            distance_m = abs(angle_off) * self._radius_m[run] * abs(float(np.cos(rows[-1, 1])))
            values.append(distance_m)
            operations.append(int(rows[-1, 2]))
            bands = distance_m / self._width_m[run]
            notes.append(
                f"after {len(rows)} circuits the next would lie {bands:.2f} bands beside the first"
                + turn_error(angle_off, unwrapped, bands)
            )
        self._worst.offer(
            np.array(values),
            operation=np.array(operations),
            note=np.array(notes, dtype=object),
        )
        return self._worst.found()
