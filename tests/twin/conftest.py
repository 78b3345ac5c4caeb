"""Shared helpers: tables of commands, and an integrator that is not ours."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from threadline.machine import Machine
from threadline.signals import Stream, TickBlock, TickTable


def make_table(machine: Machine, moves: dict[str, np.ndarray], block: int = 10**9) -> TickTable:
    """Return a table with the given counts per tick per axis."""
    rows = len(next(iter(moves.values())))
    counts = np.zeros((rows, len(machine.axes)), dtype=np.int64)
    for axis, column in moves.items():
        counts[:, machine.axis_names.index(axis)] = column
    blocks = [
        TickBlock(
            first_tick=at,
            counts=counts[at : at + block],
            operation=np.arange(rows)[at : at + block] // 50,
        )
        for at in range(0, rows, block)
    ]
    return TickTable(
        clock=machine.tick_clock,
        axes=machine.axis_names,
        counts_per_unit=machine.counts_per_unit,
        start_counts=np.zeros(len(machine.axes), dtype=np.int64),
        blocks=Stream.of(blocks),
        job_sha256="job",
        machine_sha256=machine.sha256,
    )


@pytest.fixture
def table() -> Callable[..., TickTable]:
    return make_table


@pytest.fixture
def there_and_back() -> Callable[[int, int], np.ndarray]:
    """Counts per tick of a linear move of ``distance`` counts out and back."""

    def move(feed: int, distance: int = 10_000) -> np.ndarray:
        out = np.full(distance // feed, feed)
        return np.concatenate((out, -out))

    return move
