"""Equal circuits of layers as positions of the axes, and the moves that they become.

Positions are whole parts of a mm and a degree, so that every circuit has the same words.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.jobs.operations import Dwell, Feed, FeedMode, Move, MoveRun, Operation, Source
from threadline.jobs.tensions import TAG

_APPROACH_M_S = 0.02  # speed of the eye to the first point
_REST_S = 0.5
_RAMP_S, _RAMP_FROM = 1.0, 0.3  # the ramp is as long as 1 s at full speed, and begins at 0.3 of it
_STOP_S, _STEP_S = 0.5, 0.02  # duration of a stop from full speed, and of its longest step
_STOP_GRID = 10_001
_UNITS = 1e9  # parts of a mm or deg: in 1000 circuits rounding adds up to 5e-7 deg
_COARSE = 10_000  # units between the points of a circuit, so that its words are short


@dataclass(frozen=True, slots=True, eq=False)
class Laps:
    """Equal circuits of one layer as positions of the axes.

    Parameters
    ----------
    points
        (m, axes) positions of the first circuit, its first point included.
    further
        (axes,) increase of the positions from each circuit to the next.
    seconds
        (m - 1,) duration of every move.
    count
        Number of circuits.
    line
        Line of the layer in the file.
    tension_n
        Tension of the fibre in the layer, N; None: the file gives none.
    """

    points: FloatArray
    further: FloatArray
    seconds: FloatArray
    count: int
    line: int
    tension_n: float | None = None


def _from_rest(seconds: FloatArray) -> FloatArray:
    """Return the durations of the moves of a circuit that begins at a rest, s.

    Axes that start at full speed lag behind unequally at first, and the fibre would slip.
    """
    middle = np.cumsum(seconds) - 0.5 * seconds
    return np.asarray(seconds / np.clip(middle / _RAMP_S, _RAMP_FROM, 1.0))


def _nominal_s(left_s: FloatArray) -> FloatArray:
    """Return the time in which full speed covers the way that is left ``left_s`` before a stop.

    Over the last ``_STOP_S`` the speed falls as half a cosine: its share of the full speed is
    ``(1 - cos(pi t / T)) / 2`` at the time t before the rest.
    """
    slow_s = np.minimum(left_s, _STOP_S)
    turn = math.pi / _STOP_S
    return np.asarray(0.5 * (slow_s - np.sin(turn * slow_s) / turn) + (left_s - slow_s))


def _left_s(nominal_s: FloatArray) -> FloatArray:
    """Return the time to a rest: the inverse of ``_nominal_s``."""
    grid = np.linspace(0.0, _STOP_S, _STOP_GRID)
    nominal_grid_s = _nominal_s(grid)
    slow_s = np.interp(nominal_s, nominal_grid_s, grid)
    return np.asarray(slow_s + np.maximum(nominal_s - nominal_grid_s[-1], 0.0))


def _to_rest(
    units: IntArray, seconds: FloatArray, least: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Return the points of a circuit that ends at a rest, and the durations of its moves, s.

    A mandrel that stops from full speed swings back on its drive and lifts the fibre. Moves are
    divided so that the speed falls in small steps. The last move is ``least`` units long on one
    axis at least: Marlin skips moves of fewer than six steps, and makes up for them at the speed of
    the next move.
    """
    left_s = float(seconds.sum()) - np.concatenate([[0.0], np.cumsum(seconds)])
    left_s[-1] = 0.0
    between_s = _nominal_s(np.asarray(_STEP_S * np.arange(1.0, round(_STOP_S / _STEP_S))))
    between_s = between_s[between_s < left_s[0]]
    # A new point beside an old one would only make a short word.
    apart_s = np.abs(_left_s(between_s)[:, None] - _left_s(left_s)[None]).min(axis=1)
    all_left_s = np.concatenate([left_s, between_s[apart_s > 0.5 * _STEP_S]])
    order = np.argsort(-all_left_s, kind="stable")
    places = np.column_stack([np.interp(-all_left_s, -left_s, column) for column in units.T])
    points = _COARSE * np.rint(places / _COARSE).astype(np.int64)
    points[: len(left_s)] = units
    points, rest_s = points[order], _left_s(all_left_s[order])
    is_kept = (np.abs(points - points[-1]) >= least).any(axis=1)
    is_kept[-1] = True
    return points[is_kept], -np.diff(rest_s[is_kept])


def _feeds(seconds: FloatArray) -> tuple[tuple[int, Feed | None], ...]:
    """Return the feeds of moves from their durations."""
    return tuple(
        (k, Feed(FeedMode.INVERSE_TIME, feed)) for k, feed in enumerate((1.0 / seconds).tolist())
    )


class Grid:
    """Positions as whole parts of a mm or a degree, in which equal circuits are equal to the digit.

    Parameters
    ----------
    linear
        (axes,) whether each axis is linear.
    """

    def __init__(self, linear: Sequence[bool]) -> None:
        self._linear = np.array(linear)

    def units(self, places: FloatArray) -> IntArray:
        """Return whole units of (..., axes) positions, m or rad."""
        written = np.where(self._linear, 1e3 * places, np.degrees(places))
        return np.rint(written * _UNITS).astype(np.int64)

    def places(self, units: IntArray) -> FloatArray:
        """Return positions, m or rad, as a reader computes them from the decimals."""
        return np.where(self._linear, units / (1e3 * _UNITS), np.radians(units / _UNITS))


def on_grid(one: Laps, grid: Grid) -> Laps:
    """Return laps between whole units; the last point of a circuit begins the next one."""
    points = grid.units(one.points)
    points = _COARSE * np.rint(points / _COARSE).astype(np.int64)
    further = grid.units(one.further)
    if one.count > 1:
        points[-1] = points[0] + further
    return replace(one, points=grid.places(points), further=grid.places(further))


def moves_of(
    laps: tuple[Laps, ...],
    file: str,
    axes: tuple[str, ...],
    order: tuple[tuple[str, ...], tuple[bool, ...], tuple[float, ...]],
) -> Iterator[Operation | MoveRun]:
    """Yield the moves: to the first point, axis by axis, then every circuit.

    ``order`` has the axes that move to the first point one by one, which axes are linear, and the
    least way of the last move before a rest, m or rad.
    """
    approach, grid = order[0], Grid(order[1])
    least = grid.units(np.array(order[2])).astype(float)
    first = grid.units(laps[0].points[0])
    position = np.zeros(len(axes), dtype=np.int64)
    turn_columns = [index for index, name in enumerate(axes) if name not in approach]
    for name in approach:
        column = axes.index(name)
        if first[column]:
            position[column] = first[column]
            feed = Feed(
                FeedMode.INVERSE_TIME, _APPROACH_M_S / abs(float(laps[0].points[0, column]))
            )
            yield Move(tuple(grid.places(position).tolist()), feed, Source(file, laps[0].line))
            # A plan would round the corners, and the fibre would start beside its place.
            yield Dwell(_REST_S, Source(file, laps[0].line))
    number = 0
    placed_units, rests_before = _placed(laps, grid, turn_columns, position)
    for k, (laps_of_layer, units) in enumerate(zip(laps, placed_units, strict=True)):
        further = grid.units(laps_of_layer.further)
        if rests_before[k]:
            feed = Feed(FeedMode.INVERSE_TIME, 1.0 / float(laps_of_layer.seconds[0]))
            yield Move(
                tuple(grid.places(units[0]).tolist()), feed, Source(file, laps_of_layer.line)
            )
        for lap in range(laps_of_layer.count):
            number += 1
            points, seconds = units, laps_of_layer.seconds
            if lap == 0 and (k == 0 or rests_before[k]):
                seconds = _from_rest(seconds)
            if lap == laps_of_layer.count - 1 and rests_before[k + 1]:
                points, seconds = _to_rest(points, seconds, least)
            count = len(seconds)
            yield MoveRun(
                targets=grid.places(points[1:] + lap * further),
                line=np.full(count, laps_of_layer.line, dtype=np.int64),
                feeds=_feeds(seconds),
                file=file,
                passes=(number,),
                columns=_tagged(laps_of_layer.tension_n, count),
            )


def _tagged(tension_n: float | None, count: int) -> dict[str, FloatArray]:
    """Return the tag of the tension at the first move of a circuit; the others keep it."""
    if tension_n is None:
        return {}
    column = np.full(count, np.nan)
    column[0] = tension_n
    return {TAG: column}


def _placed(
    laps: tuple[Laps, ...], grid: Grid, turn_columns: Sequence[int], position: IntArray
) -> tuple[list[IntArray], list[bool]]:
    """Return the points of every circuit in units, and where the mandrel rests before it.

    The mandrel goes on from where it is; between two surfaces the eye moves outwards alone. One
    more entry stands for the end.
    """
    placed, rests_before = [], []
    for laps_of_layer in laps:
        units = grid.units(laps_of_layer.points)
        units[:, turn_columns] += position[turn_columns] - units[0, turn_columns]
        rests_before.append(bool(np.abs(units[0] - position).max() > _COARSE))
        placed.append(units)
        position = units[-1] + (laps_of_layer.count - 1) * grid.units(laps_of_layer.further)
    return placed, [*rests_before, True]
