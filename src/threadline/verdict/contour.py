"""Contour error: how far the tool leaves the programmed path, wherever along it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.verdict.finding import Found, Worst
from threadline.verdict.largest import raise_to_largest
from threadline.verdict.measure import Measure
from threadline.verdict.nearest import between, vertices_to_path
from threadline.verdict.samples import Block, Setting
from threadline.verdict.window import PathWindow

_UNREACHED = "the recording ends before this point"
_EMPTY = "the recording is empty"
_NOTHING_M = 1e-9
"""A move that is no longer than this has no sample of its own, and no piece of a planned path."""


@dataclass(slots=True)
class _Last:
    """The sample before the next block: of each run its point and nearest chord, and its window.

    Chords are counted from the start of the path.
    """

    point: FloatArray  # (axes, runs)
    chord: IntArray  # (runs,)
    time_s: float
    begin: int
    end: int


class Contour:
    """Both directions at once: path to chords, and programmed vertices to path.

    Lengths are at the tool, Euclidean over all axes, rotary ones times their radius: of a mandrel
    with a profile that which it has where the tool, or a programmed vertex, is. The chords
    and vertices of a sample are those that the command was or will be on within the lag before
    and after it: a path may cross or retrace itself without hiding an error, and trailing along
    the path by less than the lag costs nothing. A machine that trails by more is charged for it.

    The actual path is taken as straight between samples, and measured there too: an axis that
    accelerates by a bows out of it by at most a T^2 / 8 in a sample interval T.
    """

    def __init__(self, radius_m: FloatArray, runs: int = 1) -> None:
        self._radius_m, self._runs = radius_m, runs
        self._worst = Worst(runs, len(radius_m), note=_EMPTY)
        self._squared: FloatArray = np.full(runs, -np.inf)  # m^2, from samples to chords
        self._path: PathWindow | None = None
        # Vertices whose nearest approach is still open, as the last block's window had them.
        self._first = 0
        self._vertices: FloatArray = np.empty((0, len(radius_m)))
        self._operation: IntArray = np.empty(0, dtype=np.int64)
        self._line: IntArray = np.empty(0, dtype=np.int64)
        self._best: FloatArray = np.empty((0, runs))  # m^2
        self._best_time_s: FloatArray = np.empty((0, runs))
        self._last: _Last | None = None

    def feed(self, block: Block) -> None:
        """Take the next samples."""
        points = block.at_tool
        path, begin, end = block.window()
        squared, chord = block.nearest_on_surface
        last = self._last or _Last(
            points[0],
            chord[0] + path.first,
            float(block.time_s[0]),
            _from_rest(int(begin[0]), path) + path.first,
            int(end[0]) + path.first,
        )
        begins = np.concatenate([[max(last.begin - path.first, 1)], begin])
        ends = np.concatenate([[max(last.end - path.first, int(begins[0]))], end])
        times_s = np.concatenate([[last.time_s], block.time_s])
        # What is no larger than before is of no interest, wherever blocks begin.
        worst, at = self._squared, np.zeros(self._runs, dtype=np.int64)
        raise_to_largest(squared, worst, at)
        part, nearest = np.ones(self._runs), chord[at, np.arange(self._runs)]
        between(
            points,
            last.point,
            chord,
            last.chord - path.first,
            begins,
            ends,
            path.vertices,
            block.shares,
            worst,
            at,
            part,
            nearest,
        )
        sample = np.maximum(np.where(part <= 0.5, at - 1, at), 0)
        self._worst.offer(
            np.sqrt(worst),
            time_s=times_s[at] + part * (times_s[at + 1] - times_s[at]),
            operation=block.operations_at(sample),
            line=path.line[nearest],
            position=block.positions_at(sample),
        )
        self._settle(path.first - self._first)
        self._hold(path)
        vertices_to_path(
            points,
            last.point,
            times_s,
            begins,
            ends,
            path.vertices,
            self._best,
            self._best_time_s,
            path.shares,
        )
        self._last = _Last(
            points[-1],
            chord[-1] + path.first,
            float(block.time_s[-1]),
            int(begin[-1]) + path.first,
            int(end[-1]) + path.first,
        )

    def finish(self) -> Sequence[Found]:
        """Return the worst of what was fed, and of the programmed points that it came to."""
        seen = self._worst.copy()
        if self._path is not None and self._last is not None:
            point, time_s = self._last.point, self._last.time_s
            # Which vertices a window held is the same for all runs.
            open_ = np.isinf(self._best).any(axis=1)
            reached = int(open_.argmax()) if open_.any() else len(self._best)
            rest = self._vertices[reached:, :, None] - point
            self._best[reached:] = (rest**2).sum(axis=1)
            self._best_time_s[reached:] = time_s
            self._settle(reached)
            self._settle(len(self._best), _UNREACHED)
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
        return [self._worst.found(seen)]

    def _hold(self, path: PathWindow) -> None:
        """Take over the window; its new vertices have not been approached yet."""
        grown = len(path) - len(self._best)
        self._path, self._first = path, path.first
        self._vertices, self._operation, self._line = path.vertices, path.operation, path.line
        self._best = np.concatenate([self._best, np.full((grown, self._runs), np.inf)])
        fresh = np.zeros((grown, self._runs))
        self._best_time_s = np.concatenate([self._best_time_s, fresh])

    def _settle(self, count: int, note: str = "programmed point missed") -> None:
        """Judge the first ``count`` vertices, which no later sample can come nearer to."""
        count = min(count, len(self._best))  # a recording may begin in the middle of the path
        if count <= 0:
            return
        at, runs = np.argmax(self._best[:count], axis=0), np.arange(self._runs)
        self._worst.offer(
            np.sqrt(self._best[at, runs]),
            time_s=self._best_time_s[at, runs],
            operation=self._operation[at],
            line=self._line[at],
            position=self._vertices[at] / self._radius_m,
            note=note,
        )
        self._best, self._best_time_s = self._best[count:], self._best_time_s[count:]
        self._vertices, self._operation = self._vertices[count:], self._operation[count:]
        self._line = self._line[count:]


def _from_rest(chord: int, path: PathWindow) -> int:
    """Return the first of the chords without length before ``chord``.

    A job may begin with a move to where the machine is, but for a rounding of a drawing: it takes
    no time and has no sample.
    """
    while (
        chord > 1
        and np.abs(path.vertices[chord - 2] - path.vertices[chord - 1]).max() <= _NOTHING_M
    ):
        chord -= 1
    return chord


def start_contour(setting: Setting, options: Mapping[str, float]) -> Measure:  # noqa: ARG001
    """Begin measuring the contour error."""
    return Contour(setting.radius_m, setting.runs)
