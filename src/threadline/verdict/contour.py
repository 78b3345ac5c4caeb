"""Contour error: how far the tool leaves the programmed path, wherever along it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.verdict.measure import Finding, Measure
from threadline.verdict.nearest import path_to_chords, vertices_to_path
from threadline.verdict.samples import Block, Setting
from threadline.verdict.window import PathWindow

_UNREACHED = "the recording ends before this point"
_NOTHING_M = 1e-9
"""A move that is no longer than this has no sample of its own, and no piece of a planned path."""


class Contour:
    """Both directions at once: path to chords, and programmed vertices to path.

    Lengths are at the tool, Euclidean over all axes, rotary ones times their radius. The chords
    and vertices of a sample are those that the command was or will be on within the lag before
    and after it: a path may cross or retrace itself without hiding an error, and trailing along
    the path by less than the lag costs nothing. A machine that trails by more is charged for it.

    The actual path is taken as straight between samples, and measured there too: an axis that
    accelerates by a bows out of it by at most a T^2 / 8 in a sample interval T.
    """

    def __init__(self, radius_m: FloatArray) -> None:
        self._radius_m = radius_m
        self._worst = Finding(value=None, note="the recording is empty")
        self._path: PathWindow | None = None
        # Vertices whose nearest approach is still open, as the last block's window had them.
        self._first = 0
        self._vertices: FloatArray = np.empty((0, len(radius_m)))
        self._operation: IntArray = np.empty(0, dtype=np.int64)
        self._line: IntArray = np.empty(0, dtype=np.int64)
        self._best: FloatArray = np.empty(0)  # m^2
        self._best_time_s: FloatArray = np.empty(0)
        self._last: tuple[FloatArray, float, int] | None = None  # point, time, first chord

    def feed(self, block: Block) -> None:
        """Take the next samples."""
        assert block.actual is not None
        points = np.ascontiguousarray(block.actual * self._radius_m)
        path, begin, end = block.window()
        last, last_s, chord = self._last or (
            points[0],
            float(block.time_s[0]),
            _from_rest(int(begin[0]), path) + path.first,
        )
        begins = np.concatenate([[max(chord - path.first, 1)], begin])
        ends = np.concatenate([end[:1], end])
        way = np.concatenate([last[None], points])
        times_s = np.concatenate([[last_s], block.time_s])
        squared, at, part, nearest = path_to_chords(way, begins, ends, path.vertices)
        sample = max(at - 1 + round(part), 0)
        self._offer(
            Finding(
                value=float(np.sqrt(squared)),
                time_s=float(np.interp(at + part, np.arange(len(times_s)), times_s)),
                operation=block.operation_at(sample),
                job_line=int(path.line[nearest]),
                position=block.position_at(sample),
            )
        )
        self._settle(path.first - self._first)
        self._hold(path)
        vertices_to_path(
            way,
            times_s,
            begins,
            ends,
            path.vertices,
            self._best,
            self._best_time_s,
        )
        self._last = (points[-1], float(block.time_s[-1]), int(begin[-1]) + path.first)

    def finish(self) -> Sequence[Finding]:
        """Return the worst of what was fed, and of the programmed points that it came to."""
        seen = self._worst
        if self._path is not None and self._last is not None:
            point, time_s, _ = self._last
            unreached = int(np.isinf(self._best).argmax()) if np.isinf(self._best).any() else None
            if unreached is not None:
                away = ((self._vertices[unreached:] - point) ** 2).sum(axis=1)
                self._best[unreached:] = away
                self._best_time_s[unreached:] = time_s
            self._settle(len(self._best) if unreached is None else unreached)
            self._settle(len(self._best), _UNREACHED)
            rest = self._path.remainder(point)
            if rest is not None:
                self._offer(
                    Finding(
                        value=rest.distance_m,
                        time_s=time_s,
                        operation=rest.operation,
                        job_line=rest.line,
                        position=rest.position,
                        note=_UNREACHED,
                    )
                )
        return [replace(self._worst, seen=seen)]

    def _hold(self, path: PathWindow) -> None:
        """Take over the window; its new vertices have not been approached yet."""
        grown = len(path) - len(self._best)
        self._path, self._first = path, path.first
        self._vertices, self._operation, self._line = path.vertices, path.operation, path.line
        self._best = np.concatenate([self._best, np.full(grown, np.inf)])
        self._best_time_s = np.concatenate([self._best_time_s, np.zeros(grown)])

    def _settle(self, count: int, note: str = "programmed point missed") -> None:
        """Judge the first ``count`` vertices, which no later sample can come nearer to."""
        count = min(count, len(self._best))  # a recording may begin in the middle of the path
        if count <= 0:
            return
        at = int(np.argmax(self._best[:count]))
        self._offer(
            Finding(
                value=float(np.sqrt(self._best[at])),
                time_s=float(self._best_time_s[at]),
                operation=int(self._operation[at]),
                job_line=int(self._line[at]),
                position=tuple((self._vertices[at] / self._radius_m).tolist()),
                note=note,
            )
        )
        self._best, self._best_time_s = self._best[count:], self._best_time_s[count:]
        self._vertices, self._operation = self._vertices[count:], self._operation[count:]
        self._line = self._line[count:]

    def _offer(self, finding: Finding) -> None:
        assert finding.value is not None
        if self._worst.value is None or finding.value > self._worst.value:
            self._worst = finding


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
    return Contour(setting.radius_m)
