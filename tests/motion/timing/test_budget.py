"""The budget is checked before the work starts; folded passes equal unrolled ones."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from threadline.errors import BudgetError
from threadline.jobs import read_job
from threadline.jobs.operations import Feed, FeedMode, Job, Move, MoveRun, Operation
from threadline.machine import load_machine
from threadline.motion.timing import check_budget

MACHINE = load_machine("lathe-winder")
FEED = Feed(FeedMode.COUNT_PER_TICK, 10.0)

BLOCKS = st.lists(
    st.sampled_from(
        [
            "G91",
            "G90",
            "X1",
            "X-1",
            "X2 Y.5",
            "A30",
            "G20",
            "G21",
            "G0",
            "G1",
            "F100",
            "G4 P1",
            "Y0",
        ]
    ),
    min_size=1,
    max_size=6,
)


def program(tmp_path: Path, text: str) -> Job:
    file = tmp_path / "a.nc"
    file.write_text(text)
    return read_job(file, MACHINE)


def way_by_line(items: Iterator[tuple[Operation | MoveRun, int]]) -> dict[int, float]:
    """Return the sum of the way over all axes by line, each times its number of passes."""
    way: dict[int, float] = {}
    position = np.zeros(3)
    for item, times in items:
        for move in [item] if isinstance(item, Move) else item if isinstance(item, MoveRun) else []:
            step = float(np.abs(np.array(move.target) - position).sum())
            if times:
                way[move.source.line] = way.get(move.source.line, 0.0) + times * step
            position = np.array(move.target)
    return way


@given(bodies=st.lists(BLOCKS, min_size=3, max_size=3), passes=st.tuples(*[st.integers(1, 5)] * 3))
def test_folded_passes_travel_as_far(
    tmp_path_factory: pytest.TempPathFactory, bodies: list[list[str]], passes: tuple[int, int, int]
) -> None:
    """Absolute or not, nested, with modes set in a pass: the same way on every line.

    1e-9 m is the rounding of floats over some hundred moves.
    """
    outer, inner, last = ["\n".join(body) for body in bodies]
    text = (
        f"O1\nG1 F60 G91 X.5\nM98 P2 L{passes[0]}\n{last}\nM98 P3 L{passes[2]}\nX1\nM30\n"
        f"O2\n{outer}\nM98 P3 L{passes[1]}\nM99\nO3\n{inner}\nM99\n"
    )
    job = program(tmp_path_factory.mktemp("p"), text)
    unrolled = way_by_line((item, 1) for item in job.runs())
    folded = way_by_line((item, times) for item, times, _ in job.folded())
    assert folded == pytest.approx(unrolled, abs=1e-9)


def test_refused_at_the_call_without_unrolling(tmp_path: Path) -> None:
    """10^8 passes of a move of 55.358 counts at 10 a tick alone are 5.54e8 ticks, above 5e8."""
    text = "O1\nG91 G1 X1 F2000\nX-1\nM99\nO2\nG1 F5 X1\nM98 P1 L2\nM98 P1 L100000000\nM30\n"
    job = program(tmp_path, text)
    with pytest.raises(BudgetError, match=r"a\.nc:8: .*more than 5\.54e\+08 ticks.*Lower L"):
        check_budget(job, MACHINE, FEED)
    assert len(list(islice(job.folded(), 100))) < 20


def test_a_dwell_and_a_slow_feed_are_refused_at_their_lines(tmp_path: Path) -> None:
    """A dwell of 10^9 s is 2e11 ticks; 1 mm at 10^-9 mm/min takes 6e10 s."""
    dwell = program(tmp_path, "G91 G1 F5 X1\nG4 P1000000000\nX-1\nM30\n")
    with pytest.raises(BudgetError, match=r"a\.nc:2: .*2e\+11 ticks"):
        check_budget(dwell, MACHINE)
    slow = program(tmp_path, "G91 G1 F5 X1\nF.000000001\nX-1\nM30\n")
    with pytest.raises(BudgetError, match=r"a\.nc:3: .*1\.2e\+13 ticks"):
        check_budget(slow, MACHINE)


def test_job_within_the_tick_budget_passes(tmp_path: Path) -> None:
    """The budget comes from the machine file: with half of it the same job is refused."""
    job = program(tmp_path, "O1\nG91 G1 X1 F2000\nX-1\nM99\nO2\nM98 P1 L1000000\nM30\n")
    check_budget(job, MACHINE, FEED)  # 1.1e7 ticks
    small = replace(MACHINE, tick_budget=replace(MACHINE.tick_budget, si=1e7))
    with pytest.raises(BudgetError):
        check_budget(job, small, FEED)
