"""Using less of the limits can finish the job sooner; the search must find that out."""

from __future__ import annotations

from pathlib import Path

from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.options import Options
from threadline.search import fastest_feed, fastest_job
from threadline.verdict import load_spec


def test_part_of_the_limits_beats_all_of_them(examples: Path) -> None:
    """On the reversal test all of the limits stay in spec only at a crawl."""
    machine = load_machine("lathe-winder")
    job = read_job(examples / "x-180.prg", machine)
    spec = load_spec(None, machine)
    result = fastest_job(job, machine, spec, Options(), low=0.05, high=0.5)
    all_limits = next(rung for rung in result.rungs if rung.share == 1.0)

    assert all_limits.found.best is None or all_limits.duration_s is not None
    assert result.best.share < 1.0
    assert result.best.duration_s is not None
    assert result.best.duration_s < 1.2

    assert result.best.found.verdict.passed


def test_historical_interpolations_are_searched_by_feed_alone(examples: Path) -> None:
    machine = load_machine("lathe-winder")
    job = read_job(examples / "x-180.prg", machine)
    spec = load_spec(None, machine)
    options = Options(interpolation="linear")
    result = fastest_job(job, machine, spec, options, low=0.02, high=0.1)

    assert [rung.share for rung in result.rungs] == [1.0]
    alone = fastest_feed(job, machine, spec, options, low=0.02, high=0.1)
    assert result.best.found.best == alone.best
    # The 1994 controller: 100 mm/s linear over an unprinted path; 0.5 mm of turning point at
    # 38 mm/s on the facts sheet's reversal test (0.47 mm at 36 mm/s, in proportion).
    assert alone.best is not None
    assert 0.036 < alone.best < 0.040
