"""Chords at programmed times whose legs have their speed at once, in the middle of their run-ups.

A leg that starts from rest takes longer for its first stitches, as its run-up asks for, but along
chords at programmed times every stitch has one mean speed, which steps at its ends. Here the leg
rests for as long as the run-up costs, and then has its speed; a stop is the same backwards. What
smooths the motion gives the one step its shape. Times, places and the way of the whole leg stay.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threadline.arrays import FloatArray
from threadline.signals import Stream
from threadline.trajectory.types import Trajectory, TrajectoryBlock

_ALIKE = 1e-9
_MOST = 4  # pieces in which a leg comes to its speed
_AROUND = _MOST + 1  # pieces before and after one that say to which group it belongs


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Leads:
    """How long legs rest at their ends in place of their run-ups: the least and the most, s."""

    starts_s: tuple[float, float]
    stops_s: tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Group:
    """Slower pieces ``first`` to ``end`` at one end of a leg of the velocity ``full``."""

    first: int
    end: int
    full: FloatArray
    rest_s: float
    stop: bool


def with_steps(planned: Trajectory) -> Trajectory:
    """Return ``planned`` with one step of speed where its legs come to their speed, and leave it.

    Only straight pieces are changed: up to four at either end of a leg, each faster than the one
    before it (after it, at a stop) and slower than the leg. A leg goes from rest to rest: there is
    an operation between two moves, or it is at rest.
    """
    return Trajectory(
        axes=planned.axes,
        historical=planned.historical,
        blocks=Stream(_stepped, planned),
    )


def leads_of(planned: Trajectory) -> Leads:
    """Return how long the legs of ``planned`` rest in :func:`with_steps`, 0 where they do not."""
    found: dict[bool, list[float]] = {False: [], True: []}
    for whole, done, ready in _windows(planned):
        for group in _groups(whole):
            if done <= group.first < ready:
                found[group.stop].append(group.rest_s)
    starts, stops = ((min(rests, default=0.0), max(rests, default=0.0)) for rests in found.values())
    return Leads(starts_s=starts, stops_s=stops)


def _windows(planned: Trajectory) -> Iterator[tuple[TrajectoryBlock, int, int]]:
    """Yield pieces ``done`` to ``ready`` of blocks, with enough around them."""
    whole: TrajectoryBlock | None = None
    done = 0
    for block in planned:
        if not len(block):
            continue
        whole = block if whole is None else _joined(whole, block)
        ready = len(whole) - _AROUND
        if ready > done:
            yield whole, done, ready
            kept = max(ready - _AROUND, 0)
            whole, done = _rows(whole, kept), ready - kept
    if whole is not None:
        yield whole, done, len(whole)


def _groups(whole: TrajectoryBlock) -> list[_Group]:
    velocity = _velocity(whole)
    speed = np.linalg.norm(velocity, axis=1)
    on = np.zeros(len(whole) + 1, dtype=np.bool_)  # a leg goes on from the piece before
    on[1:-1] = _alike(velocity[:-1], velocity[1:])
    # Between moves that follow each other the motion does not rest, even where it turns.
    rests = np.ones(len(whole) + 1, dtype=np.bool_)
    rests[1:-1] = (np.diff(whole.operation) > 1) | (speed[:-1] == 0.0) | (speed[1:] == 0.0)
    found = []
    for stop in (False, True):
        step = -1 if stop else 1
        ends = np.flatnonzero((speed > 0.0) & (rests[1:] if stop else rests[:-1]))
        for end in ends.tolist():
            at = end
            while (
                abs(at - end) <= _MOST
                and on[at if stop else at + 1]
                and not rests[at if stop else at + 1]
                and speed[at + step] > speed[at] * (1.0 + _ALIKE)
            ):
                at += step
            if not 0 < abs(at - end) <= _MOST:
                continue
            first, after = (at + 1, end + 1) if stop else (end, at)
            part = slice(first, after)
            lasts_s = whole.duration_s[part]
            rest_s = float(lasts_s.sum() - speed[part] @ lasts_s / speed[at])
            found.append(
                _Group(first=first, end=after, full=velocity[at], rest_s=rest_s, stop=stop)
            )
    return found


def _stepped(planned: Trajectory) -> Iterator[TrajectoryBlock]:
    for whole, done, ready in _windows(planned):
        parts: list[TrajectoryBlock] = []
        at = done
        for group in sorted(_groups(whole), key=lambda group: group.first):
            first, end = max(group.first, at), min(group.end, ready)
            if first >= end:
                continue
            parts += [_rows(whole, at, first), _changed(whole, group, first, end)]
            at = end
        parts.append(_rows(whole, at, ready))
        yield from (part for part in parts if len(part))


def _changed(whole: TrajectoryBlock, group: _Group, first: int, end: int) -> TrajectoryBlock:
    """Return pieces ``first`` to ``end`` of a group: still, at full speed, or cut into both."""
    last = group.end - 1
    if group.stop:
        step_s = float(whole.start_s[last] + whole.duration_s[last]) - group.rest_s
        origin, from_s = whole.coefficients[group.first, 0], float(whole.start_s[group.first])
    else:
        step_s = float(whole.start_s[group.first]) + group.rest_s
        origin, from_s = whole.coefficients[group.first, 0], step_s
    rows: list[tuple[float, float, int]] = []
    for k in range(first, end):
        begin, lasts = float(whole.start_s[k]), float(whole.duration_s[k])
        cut = min(max(step_s - begin, 0.0), lasts)
        label = int(whole.operation[k])
        for at, span in ((begin, cut), (begin + cut, lasts - cut)):
            if span > _ALIKE * lasts:
                rows.append((at, span, label))
    start = np.array([row[0] for row in rows])
    duration = np.array([row[1] for row in rows])
    moves = (start + 0.5 * duration < step_s) == group.stop
    coefficients = np.zeros((len(rows), max(whole.coefficients.shape[1], 2), len(origin)))
    ran_s = np.minimum(start, step_s) - from_s if group.stop else np.maximum(start - from_s, 0.0)
    coefficients[:, 0] = origin + ran_s[:, None] * group.full
    coefficients[moves, 1] = duration[moves, None] * group.full
    return TrajectoryBlock(
        start_s=start,
        duration_s=duration,
        coefficients=coefficients,
        operation=np.array([row[2] for row in rows], dtype=np.int64),
    )


def _rows(block: TrajectoryBlock, first: int, end: int | None = None) -> TrajectoryBlock:
    part = slice(first, end)
    return TrajectoryBlock(
        start_s=block.start_s[part],
        duration_s=block.duration_s[part],
        coefficients=block.coefficients[part],
        operation=block.operation[part],
    )


def _joined(one: TrajectoryBlock, other: TrajectoryBlock) -> TrajectoryBlock:
    size = max(one.coefficients.shape[1], other.coefficients.shape[1])
    padded = [
        np.pad(block.coefficients, ((0, 0), (0, size - block.coefficients.shape[1]), (0, 0)))
        for block in (one, other)
    ]
    return TrajectoryBlock(
        start_s=np.concatenate([one.start_s, other.start_s]),
        duration_s=np.concatenate([one.duration_s, other.duration_s]),
        coefficients=np.concatenate(padded),
        operation=np.concatenate([one.operation, other.operation]),
    )


def _velocity(block: TrajectoryBlock) -> FloatArray:
    """Return the (n, axes) velocity of straight pieces, and 0 of others."""
    straight = (block.coefficients[:, 2:] == 0.0).all(axis=(1, 2))
    if block.coefficients.shape[1] < 2:
        return np.zeros((len(block), block.coefficients.shape[2]))
    return np.where(straight[:, None], block.coefficients[:, 1] / block.duration_s[:, None], 0.0)


def _alike(first: FloatArray, second: FloatArray) -> NDArray[np.bool_]:
    """Say where two velocities, neither of them 0, have one direction."""
    size = np.linalg.norm(first, axis=1) * np.linalg.norm(second, axis=1)
    return np.asarray((size > 0.0) & (np.sum(first * second, axis=1) >= (1.0 - _ALIKE) * size))
