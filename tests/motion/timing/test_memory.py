"""Slow and long motions are streamed in blocks of bounded size, or refused before they begin."""

from __future__ import annotations

import tracemalloc
from itertools import islice, pairwise
from pathlib import Path

import pytest

from threadline.errors import BudgetError
from threadline.jobs import read_job
from threadline.jobs.operations import Feed, FeedMode
from threadline.machine import load_machine
from threadline.motion.timing.path_to_trajectory import SAMPLES
from threadline.proof.options import Options
from threadline.proof.pipeline import plan_job

SLOW = Feed(FeedMode.FASTEST_AXIS, 1e-4)  # m/s: 50 s for 5 mm


@pytest.mark.parametrize("interpolation", ["cubic", "quintic", "parabolic", "linear", "auto"])
def test_a_slow_piece_does_not_fill_memory(interpolation: str, tmp_path: Path) -> None:
    """Its samples come in blocks without a gap, and end at its end."""
    file = tmp_path / "slow.prg"
    file.write_text("%\nO 1;\nN 10 G91 G01 X 5 F 2160;\nN 20 M30;\n%\n")
    machine = load_machine("lathe-winder")
    options = Options(interpolation=interpolation, feed=SLOW)
    trajectory = plan_job(read_job(file, machine), machine, options).motion.trajectory
    blocks = list(trajectory)
    assert max(map(len, blocks)) <= SAMPLES
    for before, after in pairwise(blocks):
        assert after.start_s[0] == pytest.approx(before.end_s, abs=1e-9)
    last = blocks[-1].coefficients[-1].sum(axis=0)
    assert last[machine.axis_names.index("X")] == pytest.approx(5e-3, abs=1e-12)


def test_a_piece_of_a_billion_samples_begins_at_once(tmp_path: Path) -> None:
    """An axis takes months for a degree: once, 3 GB of numbers came before its first blocks."""
    file = tmp_path / "m.toml"
    file.write_text('base = "lathe-winder"\naxes.A.acceleration = "1e-12 rad/s^2 exact, assumed"\n')
    machine = load_machine(str(file))
    job = tmp_path / "slow.prg"
    job.write_text("%\nO 1;\nN 10 G91 G01 A 3 F 2160;\nN 20 M30;\n%\n")
    options = Options(interpolation="cubic")
    trajectory = plan_job(read_job(job, machine), machine, options).motion.trajectory
    tracemalloc.start()
    try:
        first = list(islice(iter(trajectory), 3))
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert max(map(len, first)) <= SAMPLES
    assert most < 50e6


def test_a_limit_that_takes_longer_than_the_budget_is_told_at_once(tmp_path: Path) -> None:
    """5 mm at 1e-12 m/s are 5e9 s; the budget of 5e8 ticks of 5 ms is 2.5e6 s."""
    file = tmp_path / "m.toml"
    file.write_text('base = "lathe-winder"\naxes.X.velocity = "1e-12 m/s exact, assumed"\n')
    machine = load_machine(str(file))
    job = tmp_path / "slow.prg"
    job.write_text("%\nO 1;\nN 10 G91 G01 X 5 F 2160;\nN 20 M30;\n%\n")
    message = r"more than 1e\+12 ticks of 5 ms at its feeds and velocity limits"
    with pytest.raises(BudgetError, match=message):
        plan_job(read_job(job, machine), machine, Options())
    named = r"line 3 of the job alone takes 5e\+09 s by the velocity limit of axis X"
    with pytest.raises(BudgetError, match=named):
        plan_job(read_job(job, machine), machine, Options(interpolation="optimal"))


@pytest.mark.parametrize("words", ["G01 X 5 F 0.000001", "G04 P 9000000"])
def test_the_block_that_is_too_long_is_named(words: str, tmp_path: Path) -> None:
    """A feed far too low, and a dwell: each names its own line, with ``optimal`` and ``auto``."""
    machine = load_machine("lathe-winder")
    job = tmp_path / "slow.prg"
    job.write_text(f"%\nO 1;\nN 10 G91 G01 X 1 F 2160;\nN 20 {words};\nN 30 M30;\n%\n")
    for interpolation in ("optimal", "auto"):
        with pytest.raises(BudgetError, match="the job takes more than") as caught:
            plan_job(read_job(job, machine), machine, Options(interpolation=interpolation))
        assert "slow.prg:4" in str(caught.value)
