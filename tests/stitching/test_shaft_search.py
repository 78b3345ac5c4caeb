"""The fastest way to sew a design: runs that the search leaves out do not change its answer."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from threadline.base.progress import TrialShares
from threadline.cli.main import main
from threadline.jobs import Job, read_job
from threadline.machine import load_machine
from threadline.proof.option_words import parse_feed
from threadline.proof.options import Options
from threadline.proof.pipeline import REPEATED, Trials, plan_job, prove_plan
from threadline.search import paced, shaft
from threadline.search.fastest import Grid, find_fastest
from threadline.search.paced import Question
from threadline.verdict import Verdict, load_spec

MACHINE = load_machine("schiffli-frame")
SPEC = load_spec(None, MACHINE)


@pytest.fixture
def design(tmp_path: Path) -> Path:
    """Write an EXP design of ten stitches of 0.5 to 8 mm; a record is two signed bytes."""
    random = np.random.default_rng(4)
    ways = random.integers(5, 81, (10, 2)) * random.choice([-1, 1], (10, 2))
    file = tmp_path / "ten.exp"
    # 0x80 would be a command; it is -128, and no move here is that long.
    file.write_bytes(ways.astype(np.int8).tobytes())
    return file


@pytest.fixture
def job(design: Path) -> Job:
    return read_job(design, MACHINE)


@pytest.mark.long(shown_by="test_one_run_is_enough_only_where_it_and_the_forecast_are_far_within")
def test_speeds_that_are_far_within_are_not_judged_by_all_runs(
    job: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The search finds the intervals of all runs at every speed, with 60 % of the runs at most."""
    counted: list[int] = []
    eight = Trials(repeats=8)
    original = paced.try_plan

    def counting(plan, spec, trials, *more, **named):  # type: ignore[no-untyped-def]
        counted.append(trials.repeats)
        return original(plan, spec, trials, *more, **named)

    monkeypatch.setattr(paced, "try_plan", counting)
    found = []
    for share in (0.8, 0.0):
        counted.clear()
        monkeypatch.setattr(shaft, "_FAR", share)
        one = shaft.constant_speeds(
            Question(
                job=job,
                machine=MACHINE,
                spec=SPEC,
                options=Options(),
                low=0.8,
                high=1.2,
                trials=eight,
            ),
            Grid(points=4, near=1, edge=5e-3),
        )
        found.append((one.intervals, one.limited_by, sum(counted)))
        assert one.best is not None
        assert one.verdict.runs == eight.repeats
    assert found[0][:2] == found[1][:2]
    assert found[0][2] < 0.6 * found[1][2]


@pytest.mark.parametrize(
    ("residual_m", "force", "by_all"),
    [
        (1e-3, 1.0, False),  # everything is far within
        (5.1e-5, 1.0, True),  # one run is far within, but other days use 85 % of the limit
        (1e-3, 0.0159, True),  # other days are far within, but the run uses 90 % of the force
    ],
)
def test_one_run_is_enough_only_where_it_and_the_forecast_are_far_within(
    residual_m: float, force: float, by_all: bool, job: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    """This holds for speeds inside an interval; all runs always judge its ends."""
    limits = {"stitch_residual": residual_m, "servo_force": force}
    criteria = tuple(replace(c, limit=limits.get(c.name, c.limit)) for c in SPEC.criteria)
    runs: dict[float, int] = {}
    original = paced.try_plan

    def counting(plan, spec, trials, *more, **named):  # type: ignore[no-untyped-def]
        proof = original(plan, spec, trials, *more, **named)
        assert proof.verdict.passed
        runs[plan.duration_s] = max(runs.get(plan.duration_s, 0), trials.repeats)
        return proof

    monkeypatch.setattr(paced, "try_plan", counting)
    shaft.constant_speeds(
        Question(
            job=job,
            machine=MACHINE,
            spec=replace(SPEC, criteria=criteria),
            options=Options(),
            low=0.998,
            high=1.002,
            trials=Trials(repeats=4),
        ),
        Grid(points=3, near=0, edge=5e-3),
    )
    inner = [runs[duration] for duration in sorted(runs)[1:-1]]
    assert inner and all(count == (4 if by_all else 1) for count in inner)


def test_an_end_that_more_runs_refuse_is_searched_again_with_all(
    job: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One run finds every speed far within the limits; the answer still passes twenty runs."""
    monkeypatch.setattr(shaft, "_far_within", lambda *_: True)
    found = shaft.constant_speeds(
        Question(job=job, machine=MACHINE, spec=SPEC, options=Options(), trials=Trials(repeats=20)),
        Grid(points=6, near=0, edge=5e-3),
    )
    for interval in found.intervals:
        for end in (interval.low, interval.high):
            options = replace(Options(), feed=parse_feed(f"{end!r} stitch/s"))
            plan = plan_job(job, MACHINE, options)
            assert prove_plan(plan, SPEC, trials=REPEATED).verdict.passed


def test_how_far_a_search_is_never_falls_and_never_ends_before_it() -> None:
    """Here every other hundredth of the speed passes, so the search has much to find on its way."""
    reports: list[float] = []

    def judged(feed: float) -> Verdict:
        return Verdict(results=(), simulated=True, incomplete="" if int(100 * feed) % 2 else "no")

    found = find_fastest(
        judged,
        0.1,
        1.0,
        Grid(points=24, near=3, edge=5e-3),
        trials=TrialShares(lambda _, share: reports.append(share), "searching", 0.0),
    )
    assert len(reports) == found.tried
    assert all(after >= before for before, after in pairwise(reports))
    assert reports[-1] < 0.99


@pytest.mark.long(shown_by="test_one_run_is_enough_only_where_it_and_the_forecast_are_far_within")
@pytest.mark.usefixtures("coarse_search")
def test_the_tolerance_that_was_found_is_typed_back_in_millimetres(
    design: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The printed command plans the same motion, to the last bit of its duration."""
    words = ["fastest", str(design), "-m", "schiffli-frame", "--nominal"]
    with pytest.raises(SystemExit):
        main([*words, "--json", "--low", "60 stitch/min", "--high", "70 stitch/min"])
    content = json.loads(capsys.readouterr().out)
    assert " mm'" in content["command"]
    tolerance = content["command"].split("--tolerance '")[1].split("'")[0]
    with pytest.raises(SystemExit):
        main(["prove", *words[1:], "--json", "--tolerance", tolerance])
    proved = json.loads(capsys.readouterr().out)
    assert proved["duration_s"] == content["schedule"]["duration_s"] == content["best"]
    assert proved["passed"]
