"""Tick tables, compared with the definition in exact fractions and in plain loops."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from threadline.commands.ticks import compile_ticks
from threadline.errors import BudgetError, LimitError, PlanError
from threadline.files import Stream
from threadline.jobs.operations import (
    Dwell,
    Feed,
    FeedMode,
    Move,
    SetOutput,
    Stop,
    ToolEvent,
    WaitInput,
)
from threadline.machine.quantity import Provenance, Quantity
from threadline.motion.timing.types import Trajectory

from .makers import HERE, job_of, lines, polynomials, winder

FEED = Feed(FeedMode.RAPID, 0.0)
WHOLE_COUNTS = winder(X=50_000.0)


def rows_of(table, *axes):
    column = [table.axes.index(axis) for axis in axes or ("X",)]
    return np.concatenate([block.counts[:, column] for block in table])


def operations_of(table):
    return np.concatenate([block.operation for block in table])


def events_of(table):
    return [event for block in table for event in block.events]


def test_constant_speed_gives_constant_rows() -> None:
    """36 mm/s at 50 count/mm and 5 ms is 9 counts per tick: 0.1 m in 10 s is 5000 in 2000 rows."""
    table = compile_ticks(lines([[0.0], [0.18]], [5.0]), WHOLE_COUNTS)

    assert table.clock.period_s == Fraction(1, 200)
    assert table.axes == ("A", "X", "Y")
    assert not rows_of(table, "A", "Y").any()
    assert rows_of(table).tolist() == [[9]] * 1000


@given(
    scale=st.fractions(min_value=1, max_value=10**6, max_denominator=997),
    per_tick=st.fractions(min_value=Fraction(-40), max_value=Fraction(40), max_denominator=9973),
)
def test_the_remainder_is_carried(scale: Fraction, per_tick: Fraction) -> None:
    """Every prefix sum is within half a count (plus float noise) of the exact way."""
    ticks = 3000
    way_m = per_tick / scale * ticks
    machine = winder(X=float(scale))
    trajectory = lines([[0.0], [float(way_m)]], [ticks * 0.005], historical=True)

    rows = rows_of(compile_ticks(trajectory, machine, rows=701))[:, 0]

    assert len(rows) == ticks
    exact = [float(per_tick * k) for k in range(1, ticks + 1)]
    assert np.abs(np.cumsum(rows) - exact).max() <= 0.5 + 1e-6
    assert np.ptp(rows) <= 1  # a constant speed is spread evenly


@pytest.mark.parametrize("scale", [55_358.0, 62_294.0 / 3.0, 2015.7566394, 1e5 / 7.0])
def test_a_million_ticks_lose_nothing(scale: float) -> None:
    """Forth and back a hundred times over 1 000 000 ticks ends at the start, to the count."""
    ends = [0.0, 0.3137931]
    points = [[ends[k % 2]] for k in range(101)]
    machine = winder(X=scale)
    trajectory = lines(points, [50.0] * 100, historical=True, per_block=7)
    table = compile_ticks(trajectory, machine)

    sums = np.cumsum(rows_of(table)[:, 0])

    assert len(sums) == 1_000_000
    turns = sums[9999::10_000]
    assert (turns[0::2] == round(ends[1] * scale)).all()
    assert (turns[1::2] == 0).all()
    assert table.end_counts().tolist() == [0, 0, 0]


def test_the_start_is_rounded_once() -> None:
    """Start and rows are rounded together, wherever the trajectory starts."""
    trajectory = lines([[-0.123456], [0.2]], [5.0], historical=True)
    table = compile_ticks(trajectory, winder())

    assert table.start_counts.tolist() == [0, round(-0.123456 * 55_358), 0]
    assert table.end_counts().tolist() == [0, round(0.2 * 55_358), 0]


@given(
    seed=st.integers(0, 10**6),
    rows=st.integers(15, 400),
    per_block=st.integers(1, 40),
)
def test_block_sizes_change_nothing(seed: int, rows: int, per_block: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.1, 0.1, (30, 3)).tolist()
    durations = rng.uniform(0.0003, 0.2, 29).tolist()
    axes = ("A", "X", "Y")

    whole = compile_ticks(lines(points, durations, axes=axes, historical=True), winder())
    split = compile_ticks(
        lines(points, durations, axes=axes, historical=True, per_block=per_block),
        winder(),
        rows=rows,
    )

    assert np.array_equal(rows_of(whole, *axes), rows_of(split, *axes))
    assert np.array_equal(operations_of(whole), operations_of(split))
    blocks = list(split)
    assert [b.first_tick for b in blocks] == [rows * k for k in range(len(blocks))]
    assert all(len(b) == rows for b in blocks[:-1])


def test_rows_agree_with_the_definition_on_cubics() -> None:
    """A loop over ticks in exact fractions, for two cubic pieces with unequal durations."""
    first = ([0.0], [0.01], [0.03], [-0.02])
    second = ([0.02], [-0.01], [0.0], [0.04])
    trajectory = polynomials([(0.2512, first, 0), (0.3333, second, 1)], historical=True)
    table = compile_ticks(trajectory, winder())

    def position(time_s: Fraction) -> Fraction:
        split = Fraction(0.2512)
        coefficients, u = first, time_s / split
        if time_s >= split:
            coefficients, u = second, min(Fraction(1), (time_s - split) / Fraction(0.3333))
        return sum((Fraction(c[0]) * u**k for k, c in enumerate(coefficients)), Fraction(0))

    ticks = [round(position(Fraction(k, 200)) * 55_358) for k in range(118)]
    assert rows_of(table)[:, 0].tolist() == np.diff(ticks).tolist()  # 0.5845 s: 117 rows
    assert operations_of(table).tolist() == [int((k + 0.5) / 200 > 0.2512) for k in range(117)]


@pytest.mark.parametrize(
    ("duration_s", "ticks"),
    [(0.1, 20), (0.1 + 1e-10, 20), (0.1 - 1e-10, 20), (0.1001, 21), (0.0999, 20), (1e-6, 1)],
)
@pytest.mark.parametrize("tail_s", [0.0, 1e-10])
def test_the_end_is_reached_in_the_last_row(duration_s: float, ticks: int, tail_s: float) -> None:
    """Whole ticks or not, and with a last piece shorter than rounding."""
    pieces = [(duration_s, ([0.0], [0.05]), 0)]
    if tail_s:
        pieces.append((tail_s, ([0.05], [0.001]), 1))
    trajectory = polynomials(pieces, historical=True, per_block=1)
    table = compile_ticks(trajectory, winder())

    assert table.tick_count() == ticks
    end_m = 0.051 if tail_s else 0.05
    assert table.end_counts().tolist() == [0, round(end_m * 55_358), 0]


def test_events_stand_where_the_motion_rests() -> None:
    """Dwell, output and wait around moves; times from the durations, by hand."""
    operations = [
        WaitInput("door", 1, 5.0, HERE),  # 0 at tick 0
        Dwell(0.5, HERE),  # 1 at tick 0
        Move((0.18,), FEED, HERE),  # 2 from 0.5 s to 5.5 s
        SetOutput("valve", 1, HERE),  # 3 at 5.5 s
        Dwell(1.0, HERE),  # 4 at 5.5 s
        ToolEvent("tension", 6.5, HERE),  # 5 at 6.5 s
        Dwell(0.25, HERE),  # 6 at 6.5 s
        Stop(False, HERE),  # 7 at 6.75 s
        Move((0.0,), FEED, HERE),  # 8 to 11.7512 s
        Stop(True, HERE),  # 9
    ]
    pieces = [
        (0.5, [[0.0]], 0),
        (5.0, [[0.0], [0.18]], 2),
        (1.25, [[0.18]], 2),
        (5.0012, [[0.18], [-0.18]], 8),
    ]
    expected = [
        (0, "wait", 0, "door", 1),
        (0, "dwell", 1, "", 0.5),
        (1100, "output", 3, "valve", 1),
        (1100, "dwell", 4, "", 1.0),
        (1300, "tool", 5, "tension", 6.5),
        (1300, "dwell", 6, "", 0.25),
        (1350, "stop", 7, "", 0.0),
        (2351, "end", 9, "", 0.0),
    ]
    for rows in (1, 7, 1100, 100_000):
        table = compile_ticks(
            polynomials(pieces, per_block=1), WHOLE_COUNTS, job_of(operations), rows=rows
        )
        found = [(e.tick, e.kind, e.operation, e.name, e.value) for e in events_of(table)]
        assert found == expected, rows
        blocks = list(table)
        for block in blocks[:-1]:
            end = block.first_tick + len(block)
            assert all(block.first_tick <= e.tick < end for e in block.events)
        assert blocks[-1].events[-1].kind == "end"


def test_a_dwell_that_the_trajectory_shortened_is_counted_back_from_the_next_move() -> None:
    operations = [Move((0.1,), FEED, HERE), Dwell(1.0, HERE), Move((0.0,), FEED, HERE)]
    pieces = [(2.1, [[0.0], [0.1]], 0), (0.9, [[0.1]], 0), (2.0, [[0.1], [-0.1]], 2)]
    table = compile_ticks(polynomials(pieces), WHOLE_COUNTS, job_of(operations))
    assert [e.tick for e in events_of(table)] == [400]


def test_a_job_without_motion_keeps_its_events() -> None:
    trajectory = Trajectory(axes=("X",), blocks=polynomials([(1.0, [[0.0]], 0)]).blocks)
    empty = replace(trajectory, blocks=type(trajectory.blocks).of([]))
    table = compile_ticks(empty, winder(), job_of([SetOutput("valve", 1, HERE), Stop(True, HERE)]))
    assert table.tick_count() == 0
    assert [(e.tick, e.kind) for e in events_of(table)] == [(0, "output"), (0, "end")]


def test_without_motion_the_table_starts_where_the_job_does() -> None:
    """12 and -7 mm at 62.294 and 55.358 counts a millimetre, in the machine's order of axes."""
    job = replace(job_of([], axes=("Y", "X")), start=(0.012, -0.007))
    still = Trajectory(axes=("Y", "X"), blocks=Stream.of([]))
    table = compile_ticks(still, winder(), job)
    assert table.start_counts.tolist() == [0, round(-7 * 55.358), round(12 * 62.294)]
    assert list(table) == []


def test_hashes_and_axes_come_from_job_and_machine() -> None:
    machine = winder()
    trajectory = lines([[0.0, 0.0], [0.01, 0.02]], [1.0], axes=("Y", "X"))
    table = compile_ticks(trajectory, machine, job_of([Move((0.0,), FEED, HERE)], ("Y", "X")))
    assert table.axes == ("A", "X", "Y")
    assert table.job_sha256 == "ab" * 32
    assert table.machine_sha256 == machine.sha256
    assert table.end_counts().tolist() == [0, round(0.02 * 55_358), round(0.01 * 62_294)]
    assert compile_ticks(trajectory, machine).job_sha256 == ""


def test_rows_over_the_velocity_limit_are_refused_with_their_line() -> None:
    """1 m/s is 276.79 counts per tick; 277.79 is rounding, 278 is not, unless historical."""
    job = job_of([Move((0.5,), FEED, HERE)])
    allowed = lines([[0.0], [0.5]], [0.5])  # exactly 1 m/s
    assert rows_of(compile_ticks(allowed, winder(), job)).max() == 277
    fast = lines([[0.0], [0.503]], [0.5])
    with pytest.raises(LimitError) as caught:
        list(compile_ticks(fast, winder(), job))
    error = caught.value
    assert (error.axis, error.quantity, error.limit_si) == ("X", "velocity", 1.0)
    assert error.value_si == pytest.approx(278 / 55_358 * 200)
    assert "made.prg:7" in str(error)
    assert "278 counts in tick" in str(error)
    historical = lines([[0.0], [0.6]], [0.5], historical=True)
    assert compile_ticks(historical, winder(), job).end_counts()[1] == round(0.6 * 55_358)


def test_the_budget_is_checked_before_the_work() -> None:
    """A day in one piece is refused at once by a budget of an hour."""
    budget = Quantity(720_000.0, "tick", 0.0, Provenance.ASSUMED)
    machine = replace(winder(), tick_budget=budget)
    with pytest.raises(BudgetError, match=r"1.73e\+07 ticks of 5 ms.*allows 7.2e\+05.*tick_budget"):
        next(iter(compile_ticks(lines([[0.0], [0.1]], [86_400.0]), machine)))
    exact = lines([[0.0], [0.1]], [3600.0])
    assert compile_ticks(exact, machine).tick_count() == 720_000


def test_an_unknown_axis_and_an_absurd_position_are_refused() -> None:
    with pytest.raises(PlanError, match="axis Q is not an axis of machine 'lathe-winder'"):
        compile_ticks(lines([[0.0], [0.1]], [1.0], axes=("Q",)), winder())
    with pytest.raises(PlanError, match="axis X goes beyond"):
        list(compile_ticks(lines([[0.0], [1e13]], [1.0], historical=True), winder()))


def test_the_table_can_be_read_again() -> None:
    table = compile_ticks(lines([[0.0], [0.1]], [1.0], per_block=1), winder(), rows=16)
    assert np.array_equal(rows_of(table), rows_of(table))


def test_a_tick_beyond_the_budget_is_refused() -> None:
    budget = Quantity(200.0, "tick", 0.0, Provenance.ASSUMED)
    machine = replace(winder(), tick_budget=budget)
    assert compile_ticks(lines([[0.0], [0.1]], [1.0]), machine).tick_count() == 200
    with pytest.raises(BudgetError, match="allows 200"):
        compile_ticks(lines([[0.0], [0.1]], [1.005]), machine).tick_count()
