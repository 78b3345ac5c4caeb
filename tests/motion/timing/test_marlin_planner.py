"""Marlin's planner on random programs: ours beside its own ``planner.cpp``.

``COUNTED_S`` are the times of Marlin's own planner, of bugfix-2.1.x on the way to 2.1.3, compiled
by itself (``marlin_planner``) and kept full. The last test asks it anew, where
``THREADLINE_MARLIN`` names the folder ``Marlin`` of a checkout. ``COUNTED_BY_AXES_S`` are the
times of bugfix-2.1.x of September 2024, whose speed through a corner the acceleration of each axis
also bounds (``corner_axes``); where a time is in ``COUNTED_S`` alone, both are the same.

Moves are long and short, of X, Y and Z, and of a mandrel A beside and alone, at speeds from 2 to
200 mm/s; an axis may be slow.
Marlin computes with 24 bits: where a number of steps falls on the edge between two, one step more
at a slow end takes up to a tenth of a percent.
"""

from __future__ import annotations

import random
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import NO_FIRMWARE
from tests.motion.timing import marlin_planner
from threadline.base.arrays import FloatArray
from threadline.machine.motion_planner import MarlinPlanner
from threadline.machine.quantity import parse_machine_quantity
from threadline.motion.path.types import PieceBlock
from threadline.motion.timing.firmware import trapezoids
from threadline.motion.timing.firmware.rules import Rules
from threadline.readback import marlin_steps

AXES = ("X", "Y", "Z", "A")
SI = np.array([1e3, 1e3, 1e3, np.degrees(1.0)])
JUMPS = (10.0, 10.0, 0.3, 5.0)
DEVIATION = 0.013
RANDOM_PROGRAMS = 240


@dataclass(frozen=True, slots=True, eq=False)
class Program:
    """A program and its machine: mm, degrees, seconds."""

    steps: FloatArray
    rate: FloatArray
    most: FloatArray
    travel: float
    points: FloatArray
    speed: FloatArray


def made(seed: int) -> Program:
    """Return a random program of one of six kinds."""
    rng, kind = random.Random(seed), seed % 6
    steps = [80.0, 80.0, rng.choice([80.0, 400.0]), rng.choice([26.6667, 8.8889])]
    rate = [300.0, 300.0, rng.choice([5.0, 300.0]), rng.choice([60.0, 600.0])]
    most = [rng.choice(two) for two in ((500, 3000), (200, 3000), (100, 1000), (300, 3000))]
    travel = rng.choice([500, 1000, 3000])
    place, points, speeds, feed, way = np.zeros(4), [], [], rng.choice([10, 40, 100]), 0.0
    count = rng.choice([3, 20, 60, 150])
    for k in range(count):
        move = np.zeros(4)
        if rng.random() < 0.1:
            feed = rng.choice([2, 10, 40, 100, 200])
        if kind == 0:
            move[:2] = rng.uniform(-40, 50), rng.uniform(-40, 50)
        elif kind == 1 and k % 5 == 4:
            move[3] = rng.uniform(50, 300)
        elif kind == 1:
            move[0] = rng.uniform(20, 120) * (1 if k % 2 else -1)
            move[3] = rng.uniform(20, 400)
        elif kind == 2:
            move[:2] = rng.uniform(-2, 3), rng.uniform(-2, 3)
            move[3] = rng.uniform(0, 5) if rng.random() < 0.5 else 0.0
        elif kind == 3:
            way, size = way + rng.uniform(-0.5, 0.6), rng.uniform(0.2, 1.3)
            move[:2] = size * np.cos(way), size * np.sin(way)
        elif kind == 4:
            move[:2] = rng.uniform(-10, 12), rng.uniform(-10, 12)
            move[2] = rng.uniform(-3, 3) if rng.random() < 0.4 else 0.0
        else:
            move[0], move[3] = rng.uniform(-0.3, 0.4), rng.uniform(0, 3)
            move[1] = rng.uniform(-0.2, 0.2) if rng.random() < 0.3 else 0.0
        if k == count - 1:
            move[0] += 2.0  # Marlin keeps a last move of a few steps for itself
        place = place + move
        points.append(np.round(place, 4))
        speeds.append(float(feed))
    limits = (np.array(one, dtype=float) for one in (steps, rate, most))
    return Program(*limits, float(travel), np.array(points), np.array(speeds))


def planner(corners: str, travel: float, by_axes: bool) -> MarlinPlanner:
    def number(value: float, shown: str, unit: str):
        return parse_machine_quantity(f"{value} {shown} exact, assumed", (unit,))

    acceleration = number(travel, "mm/s^2", "m/s^2")
    if corners == "deviation":
        deviation = number(DEVIATION, "mm", "m")
        return MarlinPlanner(
            kind="marlin",
            junction_deviation=deviation,
            acceleration=acceleration,
            corner_axes=by_axes,
        )
    jump = {
        axis: number(v, "deg/s", "rad/s") if axis == "A" else number(v, "mm/s", "m/s")
        for axis, v in zip(AXES, JUMPS, strict=True)
    }
    return MarlinPlanner(kind="marlin", jump=jump, acceleration=acceleration)


def our_time(
    program: Program, corners: str, at_once: int = 1000, *, by_axes: bool = False
) -> float:
    """Return the time in s, with this number of moves read at once."""
    ends = np.vstack([np.zeros(4), program.points])
    way = np.diff(ends, axis=0)
    count = len(way)
    straight = np.linalg.norm(way[:, :3], axis=1)
    length = np.where(straight > 0.0, straight, np.abs(way[:, 3]))
    rest = np.zeros(count, dtype=int)
    rest[-1] = 1
    block = PieceBlock(
        coefficients=np.stack([ends[:-1], way], axis=1) / SI,
        operation=np.arange(count),
        nominal_s=length / program.speed,
        rest_after=rest,
        dwell_s=np.zeros(count),
        line=np.arange(count),
    )
    rules = Rules(
        planner(corners, program.travel, by_axes),
        AXES,
        SI,
        program.rate,
        program.most,
        program.steps,
    )
    moves, blocks = trapezoids.moves_of(rules), []
    for first in range(0, count, at_once):
        rows = slice(first, min(first + at_once, count))
        blocks += moves.extend(block, rows, is_last=rows.stop == count)
    last = blocks[-1].coefficients[-1].sum(axis=0)
    np.testing.assert_allclose(last * SI, program.points[-1], atol=1e-9)
    return float(sum(one.duration_s.sum() for one in blocks))


COUNTED_S: dict[tuple[int, str], float] = {
    (0, "deviation"): 8.563344,
    (1, "deviation"): 2216.884517,
    (2, "deviation"): 4.176244,
    (3, "deviation"): 1.002469,
    (4, "deviation"): 55.699362,
    (5, "deviation"): 0.717508,
    (6, "deviation"): 197.627811,
    (7, "deviation"): 8.783826,
    (8, "deviation"): 6.144120,
    (9, "deviation"): 2.607526,
    (10, "deviation"): 2.326786,
    (11, "deviation"): 1.832073,
    (12, "deviation"): 942.007076,
    (13, "deviation"): 71.085685,
    (14, "deviation"): 43.862021,
    (15, "deviation"): 0.989885,
    (16, "deviation"): 167.799888,
    (17, "deviation"): 5.335014,
    (0, "jumps"): 8.477650,
    (1, "jumps"): 2219.468366,
    (2, "jumps"): 4.275581,
    (3, "jumps"): 0.840232,
    (4, "jumps"): 55.898858,
    (5, "jumps"): 2.217584,
    (6, "jumps"): 196.390539,
    (7, "jumps"): 8.907798,
    (8, "jumps"): 6.274927,
    (9, "jumps"): 1.961423,
    (10, "jumps"): 2.322254,
    (11, "jumps"): 2.124350,
    (12, "jumps"): 938.641382,
    (13, "jumps"): 73.288101,
    (14, "jumps"): 44.706236,
    (15, "jumps"): 0.705129,
    (16, "jumps"): 167.652853,
    (17, "jumps"): 13.956733,
}

COUNTED_BY_AXES_S = {
    2: 4.178153,
    3: 1.048345,
    4: 55.809804,
    6: 197.859148,
    8: 6.149874,
    9: 2.742025,
    12: 942.270838,
    13: 71.096383,
    14: 44.035419,
    15: 1.010364,
    16: 167.844783,
    17: 5.374012,
}


@pytest.mark.parametrize(("seed", "corners"), COUNTED_S)
def test_marlin_takes_the_time_of_its_own_planner(seed: int, corners: str) -> None:
    assert our_time(made(seed), corners) == pytest.approx(COUNTED_S[seed, corners], rel=2e-3)


@pytest.mark.parametrize("seed", range(18))
def test_an_older_marlin_is_slower_in_the_corners_of_slow_axes(seed: int) -> None:
    counted_s = COUNTED_BY_AXES_S.get(seed, COUNTED_S[seed, "deviation"])
    assert our_time(made(seed), "deviation", by_axes=True) == pytest.approx(counted_s, rel=2e-3)


def test_most_of_these_times_are_the_same_to_24_bits() -> None:
    apart = [abs(our_time(made(seed), way) / s - 1.0) for (seed, way), s in COUNTED_S.items()]
    assert np.median(apart) < 1e-6


@pytest.mark.parametrize("seed", [5, 17])
def test_moves_of_a_few_steps_wait_for_the_next_however_they_are_read(seed: int) -> None:
    whole = our_time(made(seed), "jumps")
    assert our_time(made(seed), "jumps", at_once=1) == pytest.approx(whole, rel=1e-12)


def test_marlins_own_planner_takes_as_long(tmp_path: Path) -> None:
    """By both rules of corners; with S-curves the times are the same.

    The code of the checkout shows whether it is an older one.
    """
    marlin = marlin_planner.installed()
    if marlin is None:
        pytest.skip(f"{NO_FIRMWARE}THREADLINE_MARLIN names the folder Marlin of a checkout")
    by_axes = marlin_steps.bounds_axes_in_corners(marlin)
    apart = []
    for (corners, curved), own in marlin_planner.built(marlin, tmp_path).items():
        for seed in range(RANDOM_PROGRAMS):
            program = made(seed)
            settings = {
                "steps": program.steps,
                "rate": program.rate,
                "most": program.most,
                "travel": program.travel,
                "corner": DEVIATION if corners == "deviation" else np.array(JUMPS),
            }
            time_s = marlin_planner.time_on_marlin(own, settings, program.points, program.speed)
            ours_s = our_time(program, corners, by_axes=by_axes and corners == "deviation")
            apart.append(abs(ours_s / time_s - 1.0))
            assert apart[-1] < 2e-3, (seed, corners, curved)
    print(f"{len(apart)} runs: median {np.median(apart):.1e}, at most {max(apart):.1e}")
    assert np.median(apart) < 1e-6
