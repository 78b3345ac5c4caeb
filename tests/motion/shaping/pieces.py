"""Short trajectories to shape, with a mode and a machine."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from tests.made import Made
from threadline.machine import load_machine
from threadline.motion.shaping import FlexibleMode
from threadline.motion.timing import Trajectory, TrajectoryBlock

MODE = FlexibleMode(12.0, 0.02)
MACHINE = load_machine("lathe-winder")


def made(
    durations: list[float],
    coefficients: np.ndarray,
    operation: list[int] | None = None,
    cuts: list[int] | None = None,
    axes: tuple[str, ...] = ("X", "Y"),
) -> Trajectory:
    """Return pieces as a trajectory in blocks that end at ``cuts``."""
    d = np.array(durations)
    start = np.concatenate([[0.0], np.cumsum(d)[:-1]])
    label = np.arange(len(d)) if operation is None else np.array(operation)
    edges = [0, *(cuts or []), len(d)]

    def blocks() -> Iterator[TrajectoryBlock]:
        for a, b in itertools.pairwise(edges):
            if b > a:
                yield TrajectoryBlock(
                    start_s=start[a:b],
                    duration_s=d[a:b],
                    coefficients=coefficients[a:b],
                    operation=label[a:b],
                )

    return Trajectory(axes=axes, blocks=Made(blocks))


def random_pieces(rng: np.random.Generator, n: int) -> tuple[list[float], np.ndarray]:
    """Continuous quintic pieces of two axes."""
    c = rng.normal(size=(n, 6, 2)) * 0.01
    for i in range(1, n):
        c[i, 0] = c[i - 1].sum(axis=0)
    return rng.uniform(0.003, 0.3, n).tolist(), c


def rest_to_rest(way: float = 0.1, duration: float = 0.25, axes: int = 2) -> Trajectory:
    """A quintic from rest to rest along all axes."""
    c = np.zeros((1, 6, axes))
    c[0, 3:] = np.outer([10.0, -15.0, 6.0], np.arange(1, axes + 1)) * way
    return made([duration], c, axes=("X", "Y")[:axes])
