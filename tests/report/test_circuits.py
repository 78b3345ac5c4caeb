"""Circuits, ticks and data points, counted by hand."""

from __future__ import annotations

from dataclasses import replace
from math import ceil
from types import SimpleNamespace

from tests.commands.makers import job_of, polynomials, winder
from threadline.commands.ticks import compile_ticks
from threadline.jobs import read_job
from threadline.jobs.operations import Feed, FeedMode, Move, Source
from threadline.proof.options import Options
from threadline.proof.pipeline import plan_job
from threadline.report.lines import count_circuits

FEED = Feed(FeedMode.RAPID, 0.0)


def plan_of(*moves: tuple[int, tuple[int, ...], int], operator: bool = True):
    """Return moves of (ticks, passes, line), alternating between two points."""
    machine = winder()
    if not operator:
        machine = replace(machine, operator=None)
    operations, pieces = [], []
    for k, (ticks, passes, line) in enumerate(moves):
        target = 0.01 * ((k + 1) % 2)
        operations.append(Move((target,), FEED, Source("made.prg", line, passes)))
        pieces.append((ticks * 0.005, [[0.01 - target], [2 * target - 0.01]], k))
    job = job_of(operations)
    commands = compile_ticks(polynomials(pieces), machine, job)
    return SimpleNamespace(job=job, machine=machine, commands=commands)


def test_the_cone_dome_cylinder_has_three_circuits_of_26_moves(examples) -> None:
    """Section 9.5: a move takes as many whole ticks as its largest displacement at 10 counts."""
    machine = winder()
    plan = plan_job(
        read_job(examples / "cone-dome-cylinder.prg", machine),
        machine,
        Options(interpolation="linear", feed=Feed(FeedMode.COUNT_PER_TICK, 10.0)),
    )
    found = count_circuits(plan)

    moves = [op for op in plan.job if isinstance(op, Move)][:26]
    at = [0.0, 0.0, 0.0]
    ticks = 0
    for move in moves:
        steps = [abs(t - a) for t, a in zip(move.target, at, strict=True)]
        counts = max(s * c for s, c in zip(steps, machine.counts_per_unit, strict=True))
        ticks += ceil(counts / 10 - 1e-9)
        at = list(move.target)
    assert found.circuits == 3
    assert (found.ticks, found.shortest_ticks, found.longest_ticks) == (3 * ticks, ticks, ticks)
    assert found.data_points == found.ticks // 20 + 1


def test_passes_are_circuits_and_the_rest_is_not() -> None:
    found = count_circuits(
        plan_of(
            (30, (), 1), (100, (1,), 2), (50, (1,), 3), (110, (2,), 2), (50, (2,), 3), (9, (), 9)
        )
    )
    assert found.ticks == 349
    assert found.circuits == 2
    assert (found.shortest_ticks, found.longest_ticks) == (150, 160)
    assert found.data_points == 18  # ticks 0, 20, ..., 340
    assert found.lines() == [
        "Ticks per circuit:    150 to 160 (a tick is 5 ms)",
        "Circuits:             2",
        "Ticks in all:         349 (1.745 s)",
        "Data points recorded: 18 (every 20 ticks)",
    ]


def test_inner_passes_belong_to_the_outer_circuit() -> None:
    found = count_circuits(
        plan_of((10, (1, 1), 5), (10, (1, 2), 5), (10, (2, 1), 5), (10, (2, 2), 5))
    )
    assert (found.circuits, found.shortest_ticks, found.longest_ticks) == (2, 20, 20)


def test_two_calls_of_one_pass_are_two_circuits() -> None:
    found = count_circuits(plan_of((10, (1,), 2), (10, (1,), 3), (15, (1,), 2), (15, (1,), 3)))
    assert (found.circuits, found.shortest_ticks, found.longest_ticks) == (2, 20, 30)


def test_a_program_without_subroutines_is_one_circuit() -> None:
    found = count_circuits(plan_of((10, (), 1), (30, (), 2)))
    assert (found.circuits, found.shortest_ticks, found.longest_ticks) == (1, 40, 40)


def test_the_limit_of_the_old_plot_file_is_told() -> None:
    found = count_circuits(plan_of((120_000, (), 1)))
    assert (found.record_every, found.data_points) == (20, 6001)
    assert "the 1994 plot file held 5000" in found.lines()[3]


def test_a_machine_without_the_controller_of_1994_has_none_of_its_words() -> None:
    found = count_circuits(plan_of((6000, (), 1), operator=False))
    assert (found.record_every, found.data_points) == (None, 6001)
    assert found.lines() == ["Ticks in all:         6000 (30 s; a tick is 5 ms)"]
    twice = count_circuits(plan_of((10, (1,), 2), (10, (2,), 2), operator=False)).lines()
    assert [line.split(":")[0] for line in twice] == [
        "Ticks per circuit",
        "Circuits",
        "Ticks in all",
    ]
