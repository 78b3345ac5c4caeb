"""Chords at programmed times with the run-ups that their times were made of.

A leg that starts from rest and comes to its speed within its first stitch takes as long for that
stitch as the run-up asks for, but along chords at programmed times the stitch has one mean speed,
which steps at both of its ends. Here it has the even acceleration from rest, and then the speed of
the leg; a stop is the same backwards. Ends of pieces, their times and the path stay as they were.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from threadline.arrays import FloatArray
from threadline.signals import Stream
from threadline.trajectory.types import Trajectory, TrajectoryBlock

_ALIKE = 1e-9


def with_run_ups(planned: Trajectory) -> Trajectory:
    """Return ``planned`` with run-ups in place of slower first and last pieces of its legs.

    Only straight pieces are changed that lie between a rest or a corner and a faster piece ahead in
    the same direction, and that have at least half of its speed.
    """
    return Trajectory(
        axes=planned.axes,
        historical=planned.historical,
        blocks=Stream(_eased, planned),
    )


def _eased(planned: Trajectory) -> Iterator[TrajectoryBlock]:
    before: TrajectoryBlock | None = None  # the last piece of the block before ``waiting``
    waiting: TrajectoryBlock | None = None
    for block in planned:
        if not len(block):
            continue
        if waiting is not None:
            yield _ease(before, waiting, block)
            before = waiting
        waiting = block
    if waiting is not None:
        yield _ease(before, waiting, None)


def _ease(
    before: TrajectoryBlock | None, block: TrajectoryBlock, after: TrajectoryBlock | None
) -> TrajectoryBlock:
    speed = _velocity(block)
    still = np.zeros((1, speed.shape[1]))
    ahead = np.concatenate([speed[1:], still if after is None else _velocity(after)[:1]])
    behind = np.concatenate([still if before is None else _velocity(before)[-1:], speed[:-1]])
    up = _alike(speed, ahead) & ~_alike(behind, speed)
    down = _alike(speed, behind) & ~_alike(speed, ahead)
    full = np.where(up[:, None], ahead, behind)
    share = _size(speed) / np.maximum(_size(full), np.finfo(np.float64).tiny)
    ramped = (up != down) & (share >= 0.5) & (share < 1.0 - _ALIKE)
    if not ramped.any():
        return block
    parts: list[tuple[float, float, FloatArray, int]] = []
    size = max(block.coefficients.shape[1], 3)
    for k in range(len(block)):
        start, duration = float(block.start_s[k]), float(block.duration_s[k])
        label = int(block.operation[k])
        coefficients = np.zeros((size, speed.shape[1]))
        coefficients[: block.coefficients.shape[1]] = block.coefficients[k]
        if not ramped[k]:
            parts.append((start, duration, coefficients, label))
            continue
        ramp = 2.0 * duration * (1.0 - float(share[k]))
        even = duration - ramp
        here = block.coefficients[k, 0]
        bent, straight = np.zeros_like(coefficients), np.zeros_like(coefficients)
        straight[1] = full[k] * even
        if up[k]:
            bent[0], bent[2] = here, 0.5 * full[k] * ramp
            straight[0] = here + bent[2]
            order = [(start, ramp, bent), (start + ramp, even, straight)]
        else:
            straight[0] = here
            bent[0], bent[1], bent[2] = here + straight[1], full[k] * ramp, -0.5 * full[k] * ramp
            order = [(start, even, straight), (start + even, ramp, bent)]
        parts += [(s, d, c, label) for s, d, c in order if d > _ALIKE * duration]
    return TrajectoryBlock(
        start_s=np.array([part[0] for part in parts]),
        duration_s=np.array([part[1] for part in parts]),
        coefficients=np.stack([part[2] for part in parts]),
        operation=np.array([part[3] for part in parts], dtype=np.int64),
    )


def _velocity(block: TrajectoryBlock) -> FloatArray:
    """Return the (n, axes) velocity of straight pieces, and 0 of others."""
    straight = (block.coefficients[:, 2:] == 0.0).all(axis=(1, 2))
    if block.coefficients.shape[1] < 2:
        return np.zeros((len(block), block.coefficients.shape[2]))
    return np.where(straight[:, None], block.coefficients[:, 1] / block.duration_s[:, None], 0.0)


def _size(velocity: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(velocity, axis=1))


def _alike(first: FloatArray, second: FloatArray) -> NDArray[np.bool_]:
    """Say where two velocities, neither of them 0, have one direction."""
    size = _size(first) * _size(second)
    return np.asarray((size > 0.0) & (np.sum(first * second, axis=1) >= (1.0 - _ALIKE) * size))
