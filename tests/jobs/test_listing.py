"""Figure 9-1 exactly as printed, and the reversal test."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from threadline.jobs import FeedMode, Move, Stop, read_job
from threadline.machine import load_machine

# The increments of Figure 9-1 as printed, typed independently of the example file.
FIGURE_9_1 = [
    (10.13, 15.79, 0), (10.64, 18.01, 0), (9.79, 19.18, 0), (17.68, 42.61, 0), (13.03, 45.36, 0),
    (34.77, 119.56, 0), (18.10, 54.48, 25.70), (17.54, 9.39, 28.53), (18.98, 5.77, 17.57),
    (26.04, 1.21, 3.64), (25.89, -3.12, -9.45), (19.66, -7.55, -22.96), (16.58, -21.14, -43.03),
    (7.94, -31.35, 0), (8.98, -39.95, 0), (6.69, -30.29, 0), (7.88, -39.13, 0), (14.20, -58.98, 0),
    (22.65, -82.27, 0), (22.40, -79.75, 0), (57.27, -39.24, 22.44), (27.50, 7.43, -22.44),
    (22.46, 32.53, 0), (22.60, 30.82, 0), (11.47, 15.64, 0), (10.11, 14.99, 0),
]  # fmt: skip


def test_one_circuit_is_26_moves_that_sum_exactly(examples: Path) -> None:
    """X and Y come back to 0 exactly, A gains 480.98 degrees per circuit: no tolerance."""
    machine = load_machine("lathe-winder")
    moves = [
        op for op in read_job(examples / "cone-dome-cylinder.prg", machine) if isinstance(op, Move)
    ]

    assert machine.axis_names == ("A", "X", "Y")
    assert len(moves) == 3 * 26
    for circuit in (1, 2, 3):
        end = moves[26 * circuit - 1]
        # math.fsum-free: 480.98 * circuit is the nearest double of the decimal product.
        assert end.target == (math.radians(round(480.98 * circuit, 2)), 0.0, 0.0)
        assert end.source.passes == (circuit,)
        assert end.source.line == 27


def test_every_move_is_the_printed_one(examples: Path) -> None:
    """Each difference of the first circuit is the printed increment, to rounding (1e-12)."""
    machine = load_machine("lathe-winder")
    at = (0.0, 0.0, 0.0)
    moves = [
        op for op in read_job(examples / "cone-dome-cylinder.prg", machine) if isinstance(op, Move)
    ]
    for move, printed in zip(moves[:26], FIGURE_9_1, strict=True):
        a, x, y = (new - old for new, old in zip(move.target, at, strict=True))
        assert (math.degrees(a), 1e3 * x, 1e3 * y) == pytest.approx(printed, abs=1e-10)
        at = move.target


def test_the_listing_stops_and_ends(examples: Path) -> None:
    """M00 waits for the operator, M30 ends; F 12000 is 200 mm/s, too fast by a warning."""
    job = read_job(examples / "cone-dome-cylinder.prg", load_machine("lathe-winder"))
    operations = list(job)

    assert [op.final for op in operations[-2:] if isinstance(op, Stop)] == [False, True]
    feeds = {op.feed for op in operations if isinstance(op, Move)}
    assert [(f.mode, f.value) for f in feeds if f] == [(FeedMode.FASTEST_AXIS, 0.2)]
    assert job.capped[0].startswith("cone-dome-cylinder.prg:2: F 12000 is 200.0 mm/s")


def test_the_reversal_has_eight_points_each_way(examples: Path) -> None:
    """X 0 -> 180 -> 0 mm at 36 mm/s, which is just below 10 counts per tick: no warning."""
    job = read_job(examples / "x-180.prg", load_machine("lathe-winder"))
    moves = [op for op in job if isinstance(op, Move)]

    # Eight points with both ends are seven moves; programs have three decimals of a millimetre.
    expected = [180.0 * k / 7.0 for k in [*range(1, 8), *range(6, -1, -1)]]
    assert [1e3 * move.target[1] for move in moves] == pytest.approx(expected, abs=2e-3)
    assert moves[6].target[1] == pytest.approx(0.180, abs=1e-15)
    assert {move.feed.value for move in moves if move.feed} == {0.036}
    assert job.suspicions(own_feed=True) == ()
