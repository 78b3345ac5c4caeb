"""One sweep over the samples of a block for all measures that read every sample.

The samples of many runs exceed the processor's cache. A measure that loops over a whole block by
itself waits for memory at each sample. A sweep loads a few samples at a time, and every measure
uses them while they are in the cache.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple, TypeVar

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.verdict.bow import NO_BETWEEN, NO_BOWS, Bows, bound_bows, charge_ways, raise_to_bows
from threadline.verdict.boxes import (
    COMPANY,
    NO_BOXES,
    Boxes,
    enclose,
    nearest_in_boxes,
    vertices_to_path,
)
from threadline.verdict.contour import ContourPart, raise_to_samples
from threadline.verdict.electrical import DacPart, PeakPart, RmsPart
from threadline.verdict.finding import add_squares, count_beyond, raise_to_farthest
from threadline.verdict.measure import Measure, SweptMeasure
from threadline.verdict.nearest import between, charge_trailing, chord_vectors, nearest_chords_each
from threadline.verdict.places import ProgressPart, move_on
from threadline.verdict.samples import Block, lanes
from threadline.verdict.single_run import contour_of_one, nearest_of_one, progress_of_one
from threadline.verdict.tracking import TrackingPart
from threadline.verdict.turning import TurningPart, follow_turnings

PartT = TypeVar("PartT", bound=NamedTuple)

_OF_DRIVES = {PeakPart, RmsPart, DacPart}
AT_ONCE = 1 << 14
"""Samples times runs that are loaded together: more miss the cache, fewer cost more calls."""


class _Chords(NamedTuple):
    """The programmed path around a block: (m, axes) vertices, chord vectors, squared lengths.

    ``begin`` and ``end``, (n,), are the first and the last candidate chord for each sample;
    ``left``, (n,), is the share of the first that the command had left by the lag before.
    ``axes`` is a tuple with one entry per axis.
    """

    begin: IntArray
    end: IntArray
    left: FloatArray
    vertices: FloatArray
    way: FloatArray
    length: FloatArray
    radius_m: FloatArray
    axes: tuple[int, ...]


def _scale(actual: FloatArray, radius_m: FloatArray, points: FloatArray) -> None:
    """Fill in the lengths at the tool of (n, axes, runs) positions."""
    samples, axes, runs = actual.shape
    for i in range(samples):
        for a in range(axes):
            for r in range(runs):
                points[i, a, r] = actual[i, a, r] * radius_m[a]


_scale_fast = njit(nogil=True)(_scale)


def _sweep(  # noqa: PLR0915 - one loop over parts of a block, whose arrays all measures share
    actual: FloatArray,
    share: FloatArray,
    vertex_share: FloatArray,
    time_s: FloatArray,
    chords: _Chords,
    contour: ContourPart,
    progress: ProgressPart,
    turning: TurningPart,
    tracking: TrackingPart,
    at_once: int,
) -> None:
    """Let every measure take the (n, axes, runs) samples; an argument without runs is unused.

    It is not compiled: its calls cost little compared with their work, and a compiled one would
    compile all called functions again for each number of axes.
    """
    samples, axes, runs = actual.shape
    at_once = max(min(at_once, samples), 1)
    follows = len(turning.closed) > 0
    moves, leaves = len(progress.worst) > 0, len(contour.worst) > 0
    path, weighed = (chords.vertices, chords.way, chords.length, chords.axes), len(share) > 0
    of_place = share[:0]
    # The row before the first is the previous sample.
    points, chord = np.empty((at_once + 1, axes, runs)), np.empty((at_once + 1, runs), np.int64)
    squared, only = np.empty((at_once + 1, runs)), np.full(at_once + 1, -1)
    least, most = np.empty((at_once + 1, axes)), np.empty((at_once + 1, axes))
    boxes = Boxes(runs >= COMPANY, least, most, np.empty(runs), np.empty(runs))
    if leaves:
        points[0], chord[0], squared[0] = contour.point, contour.chord, contour.off
    bows, bowed = NO_BOWS, leaves and len(contour.speed) > 0
    if bowed:
        bows = Bows(True, np.empty((at_once + 1, axes, runs)), np.empty((at_once, 1, runs)))
        bows.pace[0] = contour.pace
    for low in range(0, samples, at_once):
        high = min(low + at_once, samples)
        count = high - low
        here, near, away = points[1 : count + 1], chord[1 : count + 1], squared[1 : count + 1]
        begin, end = chords.begin[low:high], chords.end[low:high]
        if tracking.at.size:
            command = tracking.command[low:high]
            raise_to_farthest(actual[low:high], command, tracking.size, tracking.at, low)
        if not (follows or moves or leaves):
            continue
        _scale_fast(actual[low:high], chords.radius_m, here)
        if low == 0 and contour.fresh:
            points[0] = points[1]
        if boxes.known:
            enclose(points[: count + 1], boxes)
        if follows:
            follow_turnings(here, boxes, time_s[low:high], low, turning)
        if not weighed and (leaves or moves):
            nearest_in_boxes(here, begin, end, *path, away, near, only[1:])
        if moves:
            if weighed:
                nearest_chords_each(here, begin, end, *path, share[:0], away, near)
            move_on(here, boxes, away, low, progress)
            if len(progress.between.speed):
                charge_ways(here, low, progress.between, progress.charge)
        if leaves:
            if weighed:
                of_place = share[low:high]
                nearest_chords_each(here, begin, end, *path, of_place, away, near)
            if low == 0 and contour.fresh:
                chord[0], only[0] = chord[1], only[1]
            charge_trailing(
                here, begin, end, chords.left[low:high], chords.vertices, of_place, away, near,
                only[1:],
            )  # fmt: skip
            begin, end = contour.begin[low : high + 1], contour.end[low : high + 1]
            found = contour.worst, contour.at, contour.part, contour.nearest
            raise_to_samples(away, near, only[1:], low, *found)
            between(
                here, points[0], near, chord[0], only, begin, end, chords.vertices, of_place,
                *found, low,
            )  # fmt: skip
            if bowed:
                _scale_fast(contour.speed[low:high], contour.reach, bows.pace[1 : count + 1])
                if low == 0 and contour.fresh:
                    squared[0], bows.pace[0] = squared[1], bows.pace[1]
                bound_bows(here, points[0], of_place, bows)
                raise_to_bows(
                    here, points[0], squared, near, chord[0], only, begin, end, chords.vertices,
                    chords.axes, of_place, bows, *found, low,
                )  # fmt: skip
            vertices_to_path(
                here, points[0], contour.time_s[low : high + 1], begin, end, chords.vertices,
                chords.axes, vertex_share, boxes, bows, contour.worst, contour.best,
                contour.best_time_s,
            )  # fmt: skip
            points[0], chord[0], only[0] = points[count], chord[count], only[count]
            squared[0] = squared[count]
            if bowed:
                bows.pace[0] = bows.pace[count]
    if leaves:
        contour.off[:] = squared[0]
        if bowed:
            contour.pace[:] = bows.pace[0]
        contour.point[:] = points[0]
        contour.chord[:] = chord[0] if only[0] < 0 else only[0]


def _sweep_drives(peak: PeakPart, rms: RmsPart, dac: DacPart, at_once: int) -> None:
    """Let every measure of drives take its samples; an argument without samples is unused."""
    samples = max(len(peak.current), len(rms.current), len(dac.voltage))
    for low in range(0, samples, at_once):
        own = slice(low, low + at_once)
        if len(peak.current):
            zero = peak.zero[own]
            raise_to_farthest(peak.current[own], zero, peak.size[0], peak.at[0], low)
            if len(peak.between):
                raise_to_farthest(peak.between[own], zero, peak.size[1], peak.at[1], low)
        if len(rms.current):
            fresh = rms.fresh and low == 0
            add_squares(rms.current[own], rms.before, fresh, rms.total)
        if len(dac.voltage):
            count_beyond(dac.voltage[own], dac.limit, dac.beyond, dac.first, dac.begin + low)


_sweep_drives_fast = njit(nogil=True)(_sweep_drives)


_NONE, _NO_NUMBERS = np.empty(0), np.empty(0, dtype=np.int64)
_NO_ROWS, _NO_ROWS_OF_NUMBERS = np.empty((0, 0)), np.empty((0, 0), dtype=np.int64)
_NO_CONTOUR = ContourPart(
    begin=_NO_NUMBERS, end=_NO_NUMBERS, time_s=_NONE, point=_NO_ROWS, chord=_NO_NUMBERS,
    fresh=True, worst=_NONE, at=_NO_NUMBERS, part=_NONE, nearest=_NO_NUMBERS, best=_NO_ROWS,
    best_time_s=_NO_ROWS, speed=np.empty((0, 0, 0)), reach=_NONE, off=_NONE, pace=_NO_ROWS,
)  # fmt: skip
_NO_PROGRESS = ProgressPart(
    command=_NO_ROWS, way=_NO_ROWS, inverse=_NONE, length=_NONE, heading=_NO_ROWS, first=0,
    number=0, lag=0, places=_NO_NUMBERS, value=_NO_ROWS, worst=_NONE, at=_NO_NUMBERS,
    side=_NONE, ceiling=_NONE, dropped=_NONE, between=NO_BETWEEN, charge=_NONE,
)  # fmt: skip
_NO_TURNING = TurningPart(
    chord=_NO_NUMBERS, first=0, lag=0, values=_NONE, leaves=_NO_NUMBERS, starts=_NO_NUMBERS,
    whole=_NO_ROWS_OF_NUMBERS, real=np.empty((0, 0, 0)), errors=_NO_ROWS, times_s=_NO_ROWS,
    closed=_NO_NUMBERS,
)  # fmt: skip
_NO_TRACKING = TrackingPart(command=_NO_ROWS, size=_NO_ROWS, at=_NO_ROWS_OF_NUMBERS)
_NO_SAMPLES = np.empty((0, 0, 0))
_NO_PEAK = PeakPart(
    current=_NO_SAMPLES, between=_NO_SAMPLES, zero=_NO_ROWS, size=_NO_SAMPLES,
    at=np.empty((0, 0, 0), dtype=np.int64),
)  # fmt: skip
_NO_RMS = RmsPart(current=_NO_SAMPLES, before=_NO_ROWS, fresh=True, total=_NO_ROWS)
_NO_DAC = DacPart(
    voltage=_NO_SAMPLES, limit=_NONE, beyond=_NO_ROWS_OF_NUMBERS, first=_NO_ROWS_OF_NUMBERS, begin=0
)
"""Empty arrays for absent measures: compiled code is the same with and without them."""


def _that(parts: Mapping[type, NamedTuple], none: PartT) -> PartT:
    """Return the part of the same type as ``none``, else ``none`` itself."""
    found = parts.get(type(none), none)
    assert isinstance(found, type(none))
    return found


def _over(block: Block, parts: Mapping[type, NamedTuple]) -> None:
    """Sweep over a block with at most one part of each type."""
    at_once = max(AT_ONCE // block.runs, 1)
    if not parts.keys().isdisjoint(_OF_DRIVES):
        peak, rms, dac = _that(parts, _NO_PEAK), _that(parts, _NO_RMS), _that(parts, _NO_DAC)
        _sweep_drives_fast(peak, rms, dac, at_once)
    if parts.keys() <= _OF_DRIVES:
        return
    if block.runs == 1:
        _over_places_of_one(block, parts)
    else:
        _over_places(block, parts, at_once)


def _over_places_of_one(block: Block, parts: Mapping[type, NamedTuple]) -> None:
    """Process the places of a block of a single run, measure by measure."""
    assert block.actual is not None
    contour, progress = _that(parts, _NO_CONTOUR), _that(parts, _NO_PROGRESS)
    turning, tracking = _that(parts, _NO_TURNING), _that(parts, _NO_TRACKING)
    if tracking.at.size:
        raise_to_farthest(lanes(block.actual), tracking.command, tracking.size, tracking.at, 0)
    if block.path is None:
        return
    points = block.at_tool[:, :, 0]
    if len(turning.closed):
        follow_turnings(block.at_tool, NO_BOXES, block.time_s, 0, turning)
    if not (len(contour.worst) or len(progress.worst)):
        return
    path, begin, end = block.window()
    way, length = chord_vectors(path.vertices)
    none = np.empty((0, points.shape[1]))
    squared, chord = np.empty(len(points)), np.empty(len(points), dtype=np.int64)
    shares = block.shares
    if shares is None or len(progress.worst):
        nearest_of_one(points, begin, end, path.vertices, way, length, none, squared, chord)
    if len(progress.worst):
        progress_of_one(points, squared, progress)
        if len(progress.between.speed):
            charge_ways(block.at_tool, 0, progress.between, progress.charge)
    if not len(contour.worst):
        return
    share = vertex_share = none
    if shares is not None and path.shares is not None:
        share, vertex_share = shares[:, :, 0], path.shares
        nearest_of_one(points, begin, end, path.vertices, way, length, share, squared, chord)
    if block.left is not None:
        charge_trailing(
            block.at_tool, begin, end, block.left, path.vertices,
            none[:, :, None] if shares is None else shares, squared[:, None], chord[:, None],
            np.full(len(points), -1),
        )  # fmt: skip
    bows = NO_BOWS
    if len(contour.speed):
        samples, axes = points.shape
        bows = Bows(True, np.empty((samples + 1, axes, 1)), np.empty((samples, 1, 1)))
        _scale_fast(contour.speed, contour.reach, bows.pace[1:])
        bows.pace[0] = bows.pace[1] if contour.fresh else contour.pace
        before = block.at_tool[0] if contour.fresh else contour.point
        bound_bows(block.at_tool, before, none[:, :, None] if shares is None else shares, bows)
    contour_of_one(points, squared, chord, path.vertices, share, vertex_share, bows, contour)


def _over_places(block: Block, parts: Mapping[type, NamedTuple], at_once: int) -> None:
    """Sweep over the places of a block."""
    assert block.actual is not None
    actual = lanes(block.actual)
    axes = (0,) * actual.shape[1]
    path, shares = block.path, None
    vertex_share: FloatArray | None = None
    if path is None:  # without operations no measure of the place on the path takes part
        nowhere = np.empty((0, len(axes)))
        chords = _Chords(
            _NO_NUMBERS, _NO_NUMBERS, _NONE, nowhere, nowhere, _NONE, np.ones(len(axes)), axes
        )
    else:
        _, begin, end = block.window()
        way, length = chord_vectors(path.vertices)
        left = np.zeros(len(block)) if block.left is None else block.left
        chords = _Chords(begin, end, left, path.vertices, way, length, path.radius_m, axes)
        shares, vertex_share = block.shares, path.shares
    _sweep(
        actual,
        np.empty((0, len(axes), block.runs)) if shares is None else shares,
        np.empty((0, len(axes))) if vertex_share is None else vertex_share,
        block.time_s,
        chords,
        _that(parts, _NO_CONTOUR),
        _that(parts, _NO_PROGRESS),
        _that(parts, _NO_TURNING),
        _that(parts, _NO_TRACKING),
        at_once,
    )


def feed(measures: Sequence[Measure], block: Block) -> None:
    """Feed measures with a block; swept measures after a common sweep."""
    swept = (one for one in measures if isinstance(one, SweptMeasure))
    waiting = [part for one in swept if (part := one.part(block)) is not None]
    while waiting:  # two measures of a type need two sweeps
        parts = {type(part): part for part in reversed(waiting)}
        _over(block, parts)
        waiting = [part for part in waiting if parts[type(part)] is not part]
    for one in measures:
        one.feed(block)
