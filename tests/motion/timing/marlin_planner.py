"""Marlin's own planner: the moves planned by its ``planner.cpp``, compiled by itself.

``marlin_steps`` compiles it from the folder that ``THREADLINE_MARLIN`` names.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.readback import marlin_steps

CORNERS = {"deviation": False, "jumps": True}
"""Whether each of its rules of corners is that of jumps of speed."""


def installed() -> Path | None:
    """Return the folder of Marlin; None if it is not named."""
    named = os.environ.get(marlin_steps.FOLDER)
    return None if named is None else Path(named)


def built(marlin: Path, folder: Path) -> dict[tuple[str, bool], Path]:
    """Return the programs by rule of corners and whether speeds follow S-curves."""
    return {
        (corners, curved): marlin_steps.compiled(marlin, folder, jumps=jumps, curved=curved)
        for corners, jumps in CORNERS.items()
        for curved in (False, True)
    }


def time_on_marlin(
    program: Path,
    settings: dict[str, FloatArray | float],
    points: FloatArray,
    speed: FloatArray,
) -> float:
    """Return the time in s that moves from 0 through (n, 4) points take at (n,) speeds."""
    words = [f"{name} {' '.join(map(str, np.ravel(value)))}" for name, value in settings.items()]
    moves = [
        " ".join(f"{value:.4f}" for value in (*point, feed)) + " 0 0"
        for point, feed in zip(points, speed, strict=True)
    ]
    rows = marlin_steps.run(program, words, moves)
    assert rows is not None
    return sum(row[-1] for row in rows)
