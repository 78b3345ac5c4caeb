"""Contour error: distance of the tool from the programmed path, regardless of lag along it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.verdict.bow import NO_VELOCITY, bows
from threadline.verdict.finding import Finding, RunFindings, Worst, sure_of
from threadline.verdict.measure import Measure, SweptMeasure
from threadline.verdict.nearest import Closest, Farthest, Nearest
from threadline.verdict.samples import Block, Setting, lanes
from threadline.verdict.window import PathWindow

_UNREACHED = "the recording ends before this point"
_EMPTY = "the recording is empty"
_UNKNOWN = np.empty((0, 0, 0))
_NOTHING_M = 1e-9
"""Length up to which a move has no sample of its own, and no piece of a planned path."""

POINT_MISSED = "programmed point missed"
"""Note of a deviation that was measured at a programmed point."""


class ContourPart(NamedTuple):
    """Arrays that a sweep over a block reads and updates for the contour error.

    ``begin``, ``end`` and ``time_s``, (n + 1,), are the candidate chords and the instants of the
    samples; row 0 is the sample before the block. ``point``, (axes, runs), ``chord``, (runs,),
    ``off``, (runs,) squared, and ``tangent``, (axes, runs), belong to that sample; the sweep leaves
    the last sample's in them. ``fresh`` says that there is no such sample. ``velocity``,
    (n, axes, runs), is empty if unknown, and ``scale``, (axes,), makes Hermite tangents of it.
    """

    begin: IntArray
    end: IntArray
    time_s: FloatArray
    point: FloatArray
    chord: IntArray
    fresh: bool
    farthest: Farthest
    closest: Closest
    velocity: FloatArray
    scale: FloatArray
    off: FloatArray
    tangent: FloatArray


def _raise(nearest: Nearest, low: int, farthest: Farthest) -> None:
    """Raise the farthest places to (n, runs) samples, the first of them ``low``.

    The first of equal values stays.
    """
    squared, chord, common = nearest
    worst, at, part, worst_chord = farthest
    samples, runs = squared.shape
    for i in range(samples):
        larger = 0
        for r in range(runs):
            larger += squared[i, r] > worst[r]
        if larger:  # seldom, after the first few samples
            for r in range(runs):
                if squared[i, r] > worst[r]:
                    worst[r], at[r], part[r] = squared[i, r], low + i, 1.0
                    worst_chord[r] = common[i] if common[i] >= 0 else chord[i, r]


raise_to_samples = njit(nogil=True)(_raise)


class _Left(NamedTuple):
    """Vertices behind the window of all later samples, and each run's closest approach to them."""

    closest: Closest
    vertices: FloatArray
    operation: IntArray
    line: IntArray


class Contour(SweptMeasure):
    """The larger of two distances: actual path to chords, and programmed vertices to actual path.

    Lengths are at the tool, Euclidean over all axes, rotary ones times their radius (on a profiled
    mandrel the radius at the tool or vertex). A sample is compared with the chords and vertices
    that the command visits within the lag before and after it. So a path may cross or retrace
    itself without hiding an error, and trailing along the path by less than the lag costs nothing.
    A machine that trails by more is charged for it.

    The actual path is also measured between samples: there it is a cubic Hermite interpolant
    (``bow``). Without velocities it is taken as straight.

    Parameters
    ----------
    interval_s
        Time between samples if each has velocities, else 0.
    coarse
        Whether samples are further apart than ticks: then only the samples themselves are certain.
    """

    def __init__(
        self,
        radius_m: FloatArray,
        runs: int = 1,
        interval_s: float = 0.0,
        *,
        coarse: bool = False,
    ) -> None:
        self._radius_m, self._runs = radius_m, runs
        self._coarse, self._sure = coarse, np.zeros(runs)
        self._scale = interval_s * radius_m
        self._off: FloatArray = np.zeros(runs)  # m^2, of the last sample
        self._tangent: FloatArray = np.zeros((len(radius_m), runs))
        self._incomplete = False  # whether velocities end before positions do
        self._worst = Worst(runs, len(radius_m), note=_EMPTY)
        self._squared: FloatArray = np.full(runs, -np.inf)  # m^2, from samples to chords
        self._path: PathWindow | None = None
        # Vertices that a later sample may still approach, as in the last block's window.
        self._first = 0
        self._vertices: FloatArray = np.empty((0, len(radius_m)))
        self._operation: IntArray = np.empty(0, dtype=np.int64)
        self._line: IntArray = np.empty(0, dtype=np.int64)
        self._best: FloatArray = np.empty((0, runs))  # m^2
        self._best_time_s: FloatArray = np.empty((0, runs))
        # The last sample, with its nearest chord and its window counted from the path's start.
        self._point: FloatArray = np.empty((len(radius_m), runs))
        self._chord: IntArray = np.zeros(runs, dtype=np.int64)
        self._window: tuple[int, int] | None = None
        self._time_s = 0.0
        self._part: ContourPart | None = None
        self._left: _Left | None = None
        # The end of the last operation's chord, if later moves on the same chord lead to it.
        self._on_its_way: int | None = None

    def part(self, block: Block) -> ContourPart:
        """Return the arrays for the sweep; vertices behind the window are put aside."""
        path, begin, end = block.window()
        fresh = self._window is None
        if self._window is None:
            first, last, time_s = _from_rest(int(begin[0]), path), int(end[0]), block.time_s[0]
        else:
            first = max(self._window[0] - path.first, 1)
            last, time_s = max(self._window[1] - path.first, first), self._time_s
        self._window = int(begin[-1]) + path.first, int(end[-1]) + path.first
        self._time_s = float(block.time_s[-1])
        self._left = self._leave(path.first - self._first)
        self._chord -= path.first
        self._hold(path)
        self._part = ContourPart(
            begin=np.concatenate([[first], begin]),
            end=np.concatenate([[last], end]),
            time_s=np.concatenate([[time_s], block.time_s]),
            point=self._point,
            chord=self._chord,
            fresh=fresh,
            farthest=Farthest(
                squared=self._squared,
                at=np.zeros(self._runs, dtype=np.int64),
                part=np.ones(self._runs),
                chord=np.zeros(self._runs, dtype=np.int64),
            ),
            closest=Closest(self._best, self._best_time_s),
            velocity=self._velocity(block),
            scale=self._scale,
            off=self._off,
            tangent=self._tangent,
        )
        return self._part

    def feed(self, block: Block) -> None:
        """Take the sweep's results; only larger values than before matter."""
        found, path = self._part, block.path
        assert found is not None and path is not None and self._left is not None
        distance_m = np.sqrt(self._squared)
        if self._coarse:
            self._sure = np.maximum(self._sure, np.sqrt(block.nearest[0].max(axis=0)))
        if self._worst.is_beaten(distance_m):
            (_, at, part, chord), time_s = found.farthest, found.time_s
            sample = np.maximum(np.where(part <= 0.5, at - 1, at), 0)
            self._worst.offer(
                distance_m,
                time_s=time_s[at] + part * (time_s[at + 1] - time_s[at]),
                operation=block.operations_at(sample),
                line=path.lines_at(chord, block.at_tool[at].diagonal(axis1=0, axis2=2).T),
                position=block.positions_at(sample),
            )
        self._settle(self._left)
        self._chord += path.first
        assert block.end is not None
        self._on_its_way = None
        if block.operation is not None and path.is_on_its_way(int(block.operation[-1])):
            self._on_its_way = int(block.end[-1])

    def finish(self) -> Sequence[RunFindings]:
        """Return the worst place of the path and the worst programmed point of every run."""
        if self._incomplete:
            return [RunFindings.alike(Finding(value=None, note=NO_VELOCITY), self._runs)]
        seen = self._worst.copy()
        if self._path is not None:
            point, time_s = self._point, self._time_s
            # The vertices in a window are the same for all runs.
            open_ = np.isinf(self._best).any(axis=1)
            reached = int(open_.argmax()) if open_.any() else len(self._best)
            rest = self._vertices[reached:, :, None] - point
            self._best[reached:] = (rest**2).sum(axis=1)
            self._best_time_s[reached:] = time_s
            if self._on_its_way is not None:
                reached = min(reached, max(self._on_its_way - self._first, 0))
                self._best_time_s[reached:] = time_s
            self._settle(self._leave(reached))
            self._settle(self._leave(len(self._best)), _UNREACHED)
            left = self._path.remainder(point)
            if left is not None:
                self._worst.offer(
                    left.distance_m,
                    time_s=time_s,
                    operation=left.operation,
                    line=left.line,
                    position=left.position,
                    note=_UNREACHED,
                )
        found = self._worst.found(seen)
        return [sure_of(found, self._sure, unless=_UNREACHED) if self._coarse else found]

    def _velocity(self, block: Block) -> FloatArray:
        """Return the (n, axes, runs) velocities of a block; empty if they are unknown."""
        if block.velocity is None or not self._scale.any():
            return _UNKNOWN
        velocity = lanes(block.velocity)
        # After the last velocity, all are NaN.
        self._incomplete = self._incomplete or not np.isfinite(velocity[-1]).all()
        return velocity

    def _hold(self, path: PathWindow) -> None:
        """Take over the window; its new vertices have not been approached yet."""
        grown = len(path) - len(self._best)
        self._path, self._first = path, path.first
        self._vertices, self._operation, self._line = path.vertices, path.operation, path.line
        self._best = np.concatenate([self._best, np.full((grown, self._runs), np.inf)])
        fresh = np.zeros((grown, self._runs))
        self._best_time_s = np.concatenate([self._best_time_s, fresh])

    def _leave(self, count: int) -> _Left:
        """Put the first ``count`` vertices aside."""
        count = max(min(count, len(self._best)), 0)  # a recording may begin in the middle
        left = _Left(
            Closest(self._best[:count], self._best_time_s[:count]),
            self._vertices[:count],
            self._operation[:count],
            self._line[:count],
        )
        self._best, self._best_time_s = self._best[count:], self._best_time_s[count:]
        self._vertices, self._operation = self._vertices[count:], self._operation[count:]
        self._line = self._line[count:]
        return left

    def _settle(self, left: _Left, note: str = POINT_MISSED) -> None:
        """Judge vertices that no later sample can come nearer to."""
        best, time_s = left.closest
        if not len(best):
            return
        at, runs = np.argmax(best, axis=0), np.arange(self._runs)
        self._worst.offer(
            np.sqrt(best[at, runs]),
            time_s=time_s[at, runs],
            operation=left.operation[at],
            line=left.line[at],
            position=left.vertices[at] / self._radius_m,
            note=note,
        )


def _from_rest(chord: int, path: PathWindow) -> int:
    """Return the first of the zero-length chords before ``chord``.

    A job may begin with a move to where the machine already is, up to the rounding of a drawing.
    Such a move takes no time and has no sample.
    """
    while (
        chord > 1
        and np.abs(path.vertices[chord - 2] - path.vertices[chord - 1]).max() <= _NOTHING_M
    ):
        chord -= 1
    return chord


def start_contour(setting: Setting, options: Mapping[str, float]) -> Measure:  # noqa: ARG001
    """Begin measuring the contour error."""
    between_s = setting.interval_s if bows(setting) else 0.0
    return Contour(setting.radius_m, setting.runs, between_s, coarse=setting.coarse)
