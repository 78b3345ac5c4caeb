"""Decisions by the box of all runs equal the decisions for each run, to the bit.

The reference computes everything from each run: distances by the formula of a point and a segment,
progress and turnings without boxes.
"""

from __future__ import annotations

import numpy as np
import pytest

from threadline.verdict import boxes, turning
from threadline.verdict.bow import NO_BOWS
from threadline.verdict.boxes import NO_BOXES, Boxes
from threadline.verdict.nearest import (
    Candidates,
    Closest,
    Nearest,
    Track,
    chord_vectors,
    chords_of,
    nearest_chords,
)
from threadline.verdict.places import Command, ProgressPart, move_on

AXES, SAMPLES = 3, 400
EACH = (0,) * AXES
LAG = 6


def cloud(runs: int, spread: float, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return vertices, (n, axes) commands along them, and (n, axes, runs) runs that trail them."""
    random = np.random.default_rng(seed)
    vertices = np.cumsum(random.normal(0.0, 0.03, (12, AXES)), axis=0)
    at = np.clip(np.linspace(-0.5, 11.5, SAMPLES), 0.0, 11.0)
    at[200:220] = at[200]  # a rest
    at[260:275] = at[260:275][::-1]  # a reversal
    command = np.stack([np.interp(at, np.arange(12), vertices[:, a]) for a in range(AXES)], axis=1)
    command[:, 2] = 0.0  # an axis at rest
    vertices[:, 2] = 0.0
    points = np.concatenate([command[:1]] * 3 + [command[:-3]])[:, :, None]
    points = points + spread * random.normal(0.0, 1.0, (AXES, runs))
    points += 0.2 * spread * random.normal(0.0, 1.0, (SAMPLES, AXES, runs))
    points[:, 2] = 0.0
    return vertices, command, np.ascontiguousarray(points)


def boxes_of(points: np.ndarray) -> Boxes:
    runs = points.shape[2]
    rows = np.concatenate([points[:1], points])
    found = Boxes(True, *np.empty((2, len(rows), AXES)), np.empty(runs), np.empty(runs))
    boxes.enclose(rows, found)
    assert (found.least == rows.min(axis=2)).all()
    assert (found.most == rows.max(axis=2)).all()
    return found


CLOUDS = pytest.mark.parametrize(
    ("runs", "spread"), [(8, 1e-5), (67, 1e-3), (64, 0.02), (33, 0.0)], ids=str
)


@CLOUDS
def test_the_nearest_chords_are_those_of_a_search_through_all_of_them(runs, spread) -> None:
    vertices, _, points = cloud(runs, spread, seed=1)
    begin = np.clip(np.arange(SAMPLES) * 11 // SAMPLES, 1, 11)
    end = np.minimum(begin + np.arange(SAMPLES) % 3, 11)
    squared, chord = np.empty((SAMPLES, runs)), np.full((SAMPLES, runs), -7)
    common = np.full(SAMPLES, -7)
    found = Nearest(squared, chord, common)
    boxes.nearest_in_boxes(points, Candidates(begin, end), chords_of(vertices), EACH, found)
    expected, nearest = nearest_chords(points, begin, end, vertices)
    assert (squared == expected).all()
    assert (np.where(common[:, None] >= 0, common[:, None], chord) == nearest).all()
    assert 0.2 < (common >= 0).mean() < 0.8


@CLOUDS
def test_vertices_that_can_be_the_worst_are_as_near_as_the_nearest_segment(runs, spread) -> None:
    vertices, _, points = cloud(runs, spread, seed=2)
    begin = np.clip(np.arange(SAMPLES + 1) * 11 // SAMPLES - 1, 1, 11)
    end = np.minimum(begin + 3, 11)
    time_s = np.arange(SAMPLES + 1) * 1e-3
    worst = np.full(runs, spread**2)
    best, at_s = np.full((12, runs), np.inf), np.zeros((12, runs))
    track = Track(np.concatenate([points[:1], points]), time_s, begin, end, 0)
    boxes.vertices_to_path(
        track, NO_BOWS, boxes_of(points), vertices, EACH, None, worst,
        Closest(best, at_s),
    )  # fmt: skip
    for v in range(12):
        there = np.flatnonzero((begin[:-1] - 1 <= v) & (v <= end[1:]))
        start, way = points[np.maximum(there - 1, 0)], points[there]
        way = way - start
        length = (way**2).sum(axis=1)
        along = ((vertices[v, :, None] - start) * way).sum(axis=1)
        part = np.clip(along / np.where(length > 0.0, length, 1.0), 0.0, 1.0)
        away = ((vertices[v, :, None] - start - part[:, None] * way) ** 2).sum(axis=1)
        least = away.min(axis=0)
        counts = least > worst
        assert best[v, counts] == pytest.approx(least[counts], rel=1e-12)
        first = there[away.argmin(axis=0)] + part[away.argmin(axis=0), np.arange(runs)]
        assert at_s[v, counts] == pytest.approx(1e-3 * first[counts], abs=1e-9)
        assert (best[v, ~counts] <= worst[~counts] * (1.0 + 1e-12)).all()


@CLOUDS
@pytest.mark.parametrize("at_once", [1, 7, SAMPLES])
def test_the_progress_is_that_of_every_place_of_every_run(runs, spread, at_once) -> None:
    vertices, command, points = cloud(runs, spread, seed=3)
    off, _ = nearest_chords(points, np.full(SAMPLES, 1), np.full(SAMPLES, 11), vertices)
    way, length = chord_vectors(command)
    found = []
    for known in (True, False):
        part = ProgressPart(
            command=Command(
                command, way, 1.0 / length, length=np.sqrt((way**2).sum(axis=1)), heading=way
            ),
            first=0, number=0, lag=LAG,
            places=np.array([0, -1]), value=np.full((LAG + 2, runs), np.inf),
            worst=np.full(runs, -np.inf), at=np.zeros(runs, dtype=np.int64), side=np.zeros(runs),
            ceiling=np.full(1, (way**2).sum(axis=1).max() if known else np.inf),
            dropped=np.full(runs, np.inf),
        )  # fmt: skip
        for low in range(0, SAMPLES, at_once):
            own, boxes = points[low : low + at_once], NO_BOXES
            if known:
                boxes = boxes_of(own)
            axes_each = (0,) * points.shape[1]
            move_on(own, boxes, off[low : low + at_once], low, axes_each, part)
        found.append(part)
    boxed, every = found
    sure = boxed.dropped > boxed.worst  # an uncertain result is read again
    assert sure.mean() > 0.9
    assert (boxed.worst <= every.worst).all() or not sure.all()
    for name in ("worst", "at", "side"):
        assert (getattr(boxed, name)[sure] == getattr(every, name)[sure]).all()
    assert np.isinf(every.dropped).all()


@CLOUDS
@pytest.mark.parametrize("at_once", [1, 7, SAMPLES])
def test_turnings_are_those_of_a_look_at_every_run(runs, spread, at_once) -> None:
    _, command, points = cloud(runs, spread, seed=4)
    time_s, chord = np.arange(SAMPLES) * 1e-3, np.arange(SAMPLES) // 20
    x = command[:, 0]
    turns = np.flatnonzero(np.diff(np.sign(np.diff(x))) != 0) + 1
    found = []
    for known in (True, False):
        part = turning.TurningPart(
            chord=chord, first=0, lag=LAG, values=x[turns], leaves=turns // 20,
            starts=np.array([0, len(turns), len(turns), len(turns)]),
            whole=np.array([[1, -1], [-1, -1], [1, -1]]),
            real=np.full((AXES, 4, runs), -np.inf), errors=np.zeros((len(turns), runs)),
            times_s=np.zeros((len(turns), runs)), closed=np.zeros(AXES, dtype=np.int64),
        )  # fmt: skip
        for low in range(0, SAMPLES, at_once):
            own = points[low : low + at_once]
            there = boxes_of(own) if known else NO_BOXES
            turning.follow_turnings(own, there, time_s[low : low + at_once], low, part)
        found.append(part)
    assert found[0].closed[0] > 3
    for name in ("real", "errors", "times_s", "closed", "whole"):
        assert (getattr(found[0], name) == getattr(found[1], name)).all()
