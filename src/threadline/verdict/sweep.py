"""One sweep over the samples of a block for all measures that read every sample.

The samples of many runs exceed the processor's cache. A measure that loops over a whole block by
itself waits for memory at each sample. A sweep loads a few samples at a time, and every measure
uses them while they are in the cache.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple, TypeVar

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.base.compiled import njit
from threadline.verdict.bow import NO_BETWEEN, NO_BOWS, Bows, bound_bows, charge_bows, raise_to_bows
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
from threadline.verdict.nearest import (
    Candidates,
    Chords,
    Closest,
    Farthest,
    Nearest,
    Shares,
    Track,
    charge_trailing,
    chords_of,
    nearest_chords_each,
    raise_to_segments,
)
from threadline.verdict.places import Command, ProgressPart, move_on
from threadline.verdict.samples import Block, lanes
from threadline.verdict.single_run import contour_of_one, nearest_of_one, progress_of_one
from threadline.verdict.tracking import TrackingPart
from threadline.verdict.turning import TurningPart, follow_turnings

PartT = TypeVar("PartT", bound=NamedTuple)

_OF_DRIVES = {PeakPart, RmsPart, DacPart}
AT_ONCE = 1 << 14
"""Samples times runs that are loaded together: more miss the cache, fewer cost more calls."""


class _Path(NamedTuple):
    """The programmed path around a block of n samples.

    ``left``, (n,), is the share of the first candidate chord that the command had left by the lag
    before. ``axes`` is a tuple with one entry per axis.
    """

    candidates: Candidates
    left: FloatArray
    chords: Chords
    radius_m: FloatArray
    axes: tuple[int, ...]


class _Parts(NamedTuple):
    """The arrays of all measures that read every position; absent measures have empty arrays."""

    contour: ContourPart
    progress: ProgressPart
    turning: TurningPart
    tracking: TrackingPart


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
    time_s: FloatArray,
    shares: tuple[FloatArray | None, FloatArray | None],
    path: _Path,
    parts: _Parts,
    at_once: int,
) -> None:
    """Let every measure take the (n, axes, runs) samples; an argument without runs is unused.

    The function is not compiled: its calls cost little compared with their work, and compiling it
    would compile all called functions again for each number of axes.
    """
    contour, progress, turning, tracking = parts
    share, vertex_share = shares
    chords, axes_each = path.chords, path.axes
    samples, axes, runs = actual.shape
    at_once = max(min(at_once, samples), 1)
    follows = len(turning.closed) > 0
    moves, leaves = len(progress.worst) > 0, len(contour.farthest.squared) > 0
    own_share: FloatArray | None = None
    # Row 0 is the sample before.
    points, chord = np.empty((at_once + 1, axes, runs)), np.empty((at_once + 1, runs), np.int64)
    squared, common = np.empty((at_once + 1, runs)), np.full(at_once + 1, -1)
    least, most = np.empty((at_once + 1, axes)), np.empty((at_once + 1, axes))
    boxes = Boxes(runs >= COMPANY, least, most, np.empty(runs), np.empty(runs))
    if leaves:
        points[0], chord[0], squared[0] = contour.point, contour.chord, contour.off
    bows, bowed = NO_BOWS, leaves and len(contour.velocity) > 0
    if bowed:
        bows = Bows(True, np.empty((at_once + 1, axes, runs)), np.empty((at_once, 1, runs)))
        bows.tangents[0] = contour.tangent
    for low in range(0, samples, at_once):
        high = min(low + at_once, samples)
        rows = high - low + 1
        here, near, away = points[1:rows], chord[1:rows], squared[1:rows]
        candidates = Candidates(path.candidates.begin[low:high], path.candidates.end[low:high])
        nearest = Nearest(away, near, common[1:])
        if tracking.at.size:
            command = tracking.command[low:high]
            raise_to_farthest(actual[low:high], command, tracking.size, tracking.at, low)
        if not (follows or moves or leaves):
            continue
        _scale_fast(actual[low:high], path.radius_m, here)
        if low == 0 and contour.fresh:
            points[0] = points[1]
        if boxes.known:
            enclose(points[:rows], boxes)
        if follows:
            follow_turnings(here, boxes, time_s[low:high], low, turning)
        if share is None and (leaves or moves):
            nearest_in_boxes(here, candidates, chords, axes_each, nearest)
        if moves:
            if share is not None:
                nearest_chords_each(here, candidates, chords, axes_each, None, away, near)
            move_on(here, boxes, away, low, axes_each, progress)
            if len(progress.between.velocity):
                charge_bows(here, low, progress.between, progress.charge)
        if leaves:
            if share is not None:
                own_share = share[low:high]
                nearest_chords_each(here, candidates, chords, axes_each, own_share, away, near)
            if low == 0 and contour.fresh:
                chord[0], common[0] = chord[1], common[1]
            vertices = chords.vertices
            charge_trailing(here, candidates, path.left[low:high], vertices, own_share, nearest)
            raise_to_samples(nearest, low, contour.farthest)
            begin, end = contour.begin[low : high + 1], contour.end[low : high + 1]
            track = Track(points[:rows], contour.time_s[low : high + 1], begin, end, low)
            with_before = Nearest(squared[:rows], chord[:rows], common[:rows])
            raise_to_segments(track, with_before, vertices, own_share, contour.farthest)
            if bowed:
                _scale_fast(contour.velocity[low:high], contour.scale, bows.tangents[1:rows])
                if low == 0 and contour.fresh:
                    squared[0], bows.tangents[0] = squared[1], bows.tangents[1]
                bound_bows(points[:rows], own_share, bows)
                raise_to_bows(
                    track, bows, with_before, vertices, axes_each, own_share, contour.farthest
                )
            vertices_to_path(
                track, bows, boxes, vertices, axes_each, vertex_share, contour.farthest.squared,
                contour.closest,
            )  # fmt: skip
            points[0], chord[0], common[0] = points[rows - 1], chord[rows - 1], common[rows - 1]
            squared[0] = squared[rows - 1]
            if bowed:
                bows.tangents[0] = bows.tangents[rows - 1]
    if leaves:
        contour.off[:] = squared[0]
        if bowed:
            contour.tangent[:] = bows.tangents[0]
        contour.point[:] = points[0]
        contour.chord[:] = chord[0] if common[0] < 0 else common[0]


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
    fresh=True, farthest=Farthest(_NONE, _NO_NUMBERS, _NONE, _NO_NUMBERS),
    closest=Closest(_NO_ROWS, _NO_ROWS), velocity=np.empty((0, 0, 0)), scale=_NONE, off=_NONE,
    tangent=_NO_ROWS,
)  # fmt: skip
_NO_PROGRESS = ProgressPart(
    command=Command(_NO_ROWS, _NO_ROWS, _NONE, _NONE, _NO_ROWS), first=0, number=0, lag=0,
    places=_NO_NUMBERS, value=_NO_ROWS, worst=_NONE, at=_NO_NUMBERS, side=_NONE, ceiling=_NONE,
    dropped=_NONE, between=NO_BETWEEN, charge=_NONE,
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


def _part_of(parts: Mapping[type, NamedTuple], none: PartT) -> PartT:
    """Return the part of the same type as ``none``, or ``none`` itself if there is no such part."""
    found = parts.get(type(none), none)
    assert isinstance(found, type(none))
    return found


def loops_of_one_run_serve() -> bool:
    """Return whether a single run is judged by its own loops, not by the loops of many runs.

    Its own are faster, and find the same. A process that has compiled only the loops of many runs,
    and judges the planned path beside the program, does not compile the others as well.
    """
    return bool(contour_of_one.signatures) or not vertices_to_path.signatures


def _over(block: Block, parts: Mapping[type, NamedTuple]) -> None:
    """Sweep over a block with at most one part of each type."""
    at_once = max(AT_ONCE // block.runs, 1)
    if not parts.keys().isdisjoint(_OF_DRIVES):
        peak, rms, dac = (
            _part_of(parts, _NO_PEAK),
            _part_of(parts, _NO_RMS),
            _part_of(parts, _NO_DAC),
        )
        _sweep_drives_fast(peak, rms, dac, at_once)
    if parts.keys() <= _OF_DRIVES:
        return
    if block.runs == 1 and loops_of_one_run_serve():
        _over_positions_of_one(block, parts)
    else:
        _over_positions(block, parts, at_once)


def _over_positions_of_one(block: Block, parts: Mapping[type, NamedTuple]) -> None:
    """Process the positions of a block of a single run, measure by measure."""
    assert block.actual is not None
    contour, progress = _part_of(parts, _NO_CONTOUR), _part_of(parts, _NO_PROGRESS)
    turning, tracking = _part_of(parts, _NO_TURNING), _part_of(parts, _NO_TRACKING)
    if tracking.at.size:
        raise_to_farthest(lanes(block.actual), tracking.command, tracking.size, tracking.at, 0)
    if block.path is None:
        return
    points = block.at_tool[:, :, 0]
    if len(turning.closed):
        follow_turnings(block.at_tool, NO_BOXES, block.time_s, 0, turning)
    leaves = len(contour.farthest.squared) > 0
    if not (leaves or len(progress.worst)):
        return
    path, begin, end = block.window()
    candidates, chords = Candidates(begin, end), chords_of(path.vertices)
    none = np.empty((0, points.shape[1]))
    squared, chord = np.empty(len(points)), np.empty(len(points), dtype=np.int64)
    shares = block.shares
    if shares is None or len(progress.worst):
        nearest_of_one(points, candidates, chords, none, squared, chord)
    if len(progress.worst):
        progress_of_one(points, squared, progress)
        if len(progress.between.velocity):
            charge_bows(block.at_tool, 0, progress.between, progress.charge)
    if not leaves:
        return
    weights = Shares(none, none)
    if shares is not None and path.shares is not None:
        weights = Shares(shares[:, :, 0], path.shares)
        nearest_of_one(points, candidates, chords, weights.samples, squared, chord)
    if block.left is not None:
        nearest = Nearest(squared[:, None], chord[:, None], np.full(len(points), -1))
        charge_trailing(block.at_tool, candidates, block.left, path.vertices, shares, nearest)
    bows = NO_BOWS
    if len(contour.velocity):
        samples, axes = points.shape
        bows = Bows(True, np.empty((samples + 1, axes, 1)), np.empty((samples, 1, 1)))
        _scale_fast(contour.velocity, contour.scale, bows.tangents[1:])
        bows.tangents[0] = bows.tangents[1] if contour.fresh else contour.tangent
        before = block.at_tool[0] if contour.fresh else contour.point
        bound_bows(np.concatenate([before[None], block.at_tool]), shares, bows)
    contour_of_one(points, squared, chord, path.vertices, weights, bows, contour)


def _over_positions(block: Block, parts: Mapping[type, NamedTuple], at_once: int) -> None:
    """Sweep over the positions of a block."""
    assert block.actual is not None
    actual = lanes(block.actual)
    axes = (0,) * actual.shape[1]
    path, shares = block.path, None
    vertex_share: FloatArray | None = None
    if path is None:  # without operations no measure of the position on the path takes part
        nowhere = np.empty((0, len(axes)))
        candidates, chords = Candidates(_NO_NUMBERS, _NO_NUMBERS), Chords(nowhere, nowhere, _NONE)
        around = _Path(candidates, _NONE, chords, np.ones(len(axes)), axes)
    else:
        _, begin, end = block.window()
        left = np.zeros(len(block)) if block.left is None else block.left
        around = _Path(Candidates(begin, end), left, chords_of(path.vertices), path.radius_m, axes)
        shares, vertex_share = block.shares, path.shares
    _sweep(
        actual,
        block.time_s,
        (shares, vertex_share),
        around,
        _Parts(
            _part_of(parts, _NO_CONTOUR),
            _part_of(parts, _NO_PROGRESS),
            _part_of(parts, _NO_TURNING),
            _part_of(parts, _NO_TRACKING),
        ),
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
