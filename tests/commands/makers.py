"""Trajectories and jobs in few words, for the tests of targets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from threadline.files import Stream
from threadline.jobs.operations import Job, Operation, Source
from threadline.machine import Machine, load_machine
from threadline.machine.quantity import Provenance, Quantity
from threadline.motion.timing.types import Trajectory, TrajectoryBlock

HERE = Source("made.prg", 7)


def winder(**counts_per_unit: float) -> Machine:
    """Return the winder with other scales."""
    machine = load_machine("lathe-winder")
    axes = dict(machine.axes)
    for name, scale in counts_per_unit.items():
        axis = axes[name]
        counts = Quantity(scale, axis.counts.unit, 0.0, Provenance.ASSUMED)
        axes[name] = replace(axis, counts=counts)
    return replace(machine, axes=axes)


def polynomials(
    pieces: Sequence[tuple[float, Sequence[Sequence[float]], int]],
    *,
    axes: tuple[str, ...] = ("X",),
    per_block: int = 10**9,
    historical: bool = False,
) -> Trajectory:
    """Return a trajectory of (duration, coefficients (order, axes), operation), in blocks."""
    durations = np.array([p[0] for p in pieces])
    start = np.concatenate([[0.0], np.cumsum(durations)[:-1]])
    order = max(len(p[1]) for p in pieces)
    coefficients = np.zeros((len(pieces), order, len(axes)))
    for i, (_, c, _) in enumerate(pieces):
        coefficients[i, : len(c)] = c
    operation = np.array([p[2] for p in pieces])
    blocks = [
        TrajectoryBlock(
            start_s=start[i : i + per_block],
            duration_s=durations[i : i + per_block],
            coefficients=coefficients[i : i + per_block],
            operation=operation[i : i + per_block],
        )
        for i in range(0, len(pieces), per_block)
    ]
    return Trajectory(axes=axes, blocks=Stream.of(blocks), historical=historical)


def lines(
    points: Sequence[Sequence[float]], durations: Sequence[float], **options: object
) -> Trajectory:
    """Return straight lines between ``points``, each an operation."""
    pieces = [
        (d, [list(a), [q - p for p, q in zip(a, b, strict=True)]], i)
        for i, (a, b, d) in enumerate(zip(points, points[1:], durations, strict=False))
    ]
    return polynomials(pieces, **options)  # type: ignore[arg-type]


def job_of(operations: Sequence[Operation], axes: tuple[str, ...] = ("X",)) -> Job:
    """Return a job that exists in memory only."""
    return Job(
        name="made",
        file="made.prg",
        sha256="ab" * 32,
        axes=axes,
        start=(0.0,) * len(axes),
        operations=Stream.of(operations),
    )
