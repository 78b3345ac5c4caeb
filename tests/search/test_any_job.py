"""Feed-forward, another machine, and tolerances in the search for the feed of any job."""

from __future__ import annotations

import io
import json
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from threadline.cli.main import main
from threadline.errors import LimitError
from threadline.jobs import read_job
from threadline.jobs.operations import Feed, FeedMode
from threadline.machine import load_machine
from threadline.machine.vary import off_tolerance
from threadline.proof.options import Options
from threadline.proof.pipeline import plan_job, prove_plan
from threadline.search import Fastest, Interval, by_pace, fastest_feed, least_limits, shaft
from threadline.search.fastest import Grid
from threadline.search.least_limits import ignores_limits
from threadline.search.paced import Question
from threadline.verdict import Verdict, load_spec

MACHINE = load_machine("lathe-winder")
AHEAD = Options(feed_forward_s=0.1)


def at(options: Options, feed_m_s: float) -> Options:
    return replace(options, feed=Feed(FeedMode.FASTEST_AXIS, feed_m_s))


def test_the_edge_with_feed_forward_is_where_the_verdict_turns(examples: Path) -> None:
    """The edge is right within 6 %: narrow intervals follow each other just above it."""
    job = read_job(examples / "x-180.prg", MACHINE)
    spec = load_spec(None, MACHINE)
    found = fastest_feed(
        Question(job=job, machine=MACHINE, spec=spec, options=AHEAD, low=0.02, high=0.3),
        Grid(near=0, points=4),
    )
    assert found.best is not None
    for feed, passes in ((found.best, True), (found.best * 1.06, False)):
        verdict = prove_plan(plan_job(job, MACHINE, at(AHEAD, feed)), spec).verdict
        assert verdict.passed is passes


def test_a_smoothed_motion_beyond_a_limit_is_out_of_spec_and_no_error(examples: Path) -> None:
    """A reversal from 0.5 m/s within 20 ms needs some 50 m/s^2; the limit is 10.5 m/s^2."""
    job = read_job(examples / "x-180.prg", MACHINE)
    sharp = Options(feed_forward_s=0.02)
    with pytest.raises(LimitError):
        plan_job(job, MACHINE, at(sharp, 0.5))
    spec = load_spec(None, MACHINE)
    found = fastest_feed(
        Question(job=job, machine=MACHINE, spec=spec, options=sharp, low=0.4, high=0.5),
        Grid(near=0, points=2),
    )
    assert found.best is None
    assert found.limited_by in {"acceleration", "jerk"}
    # Without feed-forward a plan that breaks a limit is still an error.
    axis = MACHINE.axes["X"]
    assert axis.travel is not None
    near = tuple(replace(end, si=si) for end, si in zip(axis.travel, (-1e-3, 1e-3), strict=True))
    small = replace(MACHINE, axes={**MACHINE.axes, "X": replace(axis, travel=near)})
    for options in (Options(interpolation="b-spline"), sharp):
        with pytest.raises(LimitError, match="travel"):
            fastest_feed(
                Question(job=job, machine=small, spec=spec, options=options, low=0.01, high=0.02),
                Grid(near=0, points=2),
            )


def test_another_machine_does_the_job_that_was_planned(examples: Path) -> None:
    """The plan is made for the file's machine; a heavier machine is out of spec sooner."""
    job = read_job(examples / "x-180.prg", MACHINE)
    spec = load_spec(None, MACHINE)
    other = off_tolerance(MACHINE, mass=8.0)
    options = Options(interpolation="linear")
    seen = [
        fastest_feed(
            Question(
                job=job,
                machine=MACHINE,
                spec=spec,
                options=options,
                low=0.01,
                high=0.1,
                actual=actual,
            ),
            Grid(near=0, points=6),
        ).best
        for actual in (None, other)
    ]
    assert seen[0] is not None
    assert seen[1] != seen[0]
    verdict = prove_plan(plan_job(job, MACHINE, at(options, seen[0])), spec, actual=other).verdict
    assert verdict.passed is (seen[1] is not None and seen[1] >= seen[0])


def test_a_share_of_the_limits_means_nothing_to_programmed_times(examples: Path) -> None:
    job = read_job(examples / "x-180.prg", MACHINE)
    assert ignores_limits(job, MACHINE, AHEAD)
    assert ignores_limits(job, MACHINE, replace(AHEAD, interpolation="linear"))
    assert not ignores_limits(job, MACHINE, replace(AHEAD, interpolation="quintic"))
    assert not ignores_limits(job, MACHINE, Options())


def canned(calls: list[Any]) -> Any:
    def search(asked: Question, *_: Any) -> Fastest:
        calls.append(asked)
        slower = 1.0 - 0.1 * len(calls)
        return Fastest(
            intervals=(Interval(low=0.01, high=0.05 * slower),),
            limited_by="contour_error",
            verdict=Verdict(results=(), simulated=True),
            tried=3,
        )

    return search


def test_tolerances_of_any_job(examples: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The plans are made for the file's machine, and nine machines run them."""
    calls: list[Any] = []
    monkeypatch.setattr(by_pace, "fastest_feed", canned(calls))
    job = read_job(examples / "x-180.prg", MACHINE)
    spec = load_spec(None, MACHINE)
    asked = Question(job=job, machine=MACHINE, spec=spec, options=AHEAD, high=0.2, mismatch=True)
    monkeypatch.setattr(least_limits, "fastest_feed", canned([]))
    cells = by_pace.answered(asked).mismatch
    ends = [(mass, stiffness) for mass in (-1, 0, 1) for stiffness in (-1, 0, 1)]
    assert [(c.mass, c.stiffness) for c in cells] == ends
    assert all(one.machine is MACHINE and one.options == AHEAD for one in calls)
    ran = [one.actual for one in calls]
    assert ran[4] == MACHINE
    # X of the winder is rigid: its load is the body of its drive, 3.606e-4 kg m^2 +- 5 %.
    assert ran[0].bodies["x"].inertia.si == pytest.approx(0.95 * 3.606e-4)
    assert ran[8].bodies["x"].inertia.si == pytest.approx(1.05 * 3.606e-4)
    assert {(one.low, one.high) for one in calls} == {(0.05, 0.2)}


def test_the_command_takes_them_for_a_design(
    examples: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nine frames sew with the tables of the file's frame; speeds are printed in stitches/min."""
    calls: list[Any] = []
    monkeypatch.setattr(shaft, "constant_speeds", canned([]))
    monkeypatch.setattr(by_pace, "constant_speeds", canned(calls))
    frame = load_machine("schiffli-frame")
    words = ["fastest", str(examples / "rosette.dst"), "-m", "schiffli-frame", "--mismatch"]
    words += ["--nominal"]  # no search for a bad day
    monkeypatch.setattr(shaft, "plan_job", lambda *_: SimpleNamespace(duration_s=1.0))
    monkeypatch.setattr(shaft, "fastest_schedule", lambda *_: None)
    out = io.StringIO()
    with redirect_stdout(out), redirect_stderr(io.StringIO()), pytest.raises(SystemExit) as left:
        main([*words, "--low", "0.01 stitch/s"])
    assert left.value.code == 0
    ran = [one.actual for one in calls]
    ends = [(mass, stiffness) for mass in (-1, 0, 1) for stiffness in (-1, 0, 1)]
    assert ran == [off_tolerance(frame, mass=m, stiffness=k) for m, k in ends]
    assert all(one.machine == frame for one in calls)
    # 0.05 stitch/s less a tenth on the first machine: 2.70 stitch/min.
    assert "fastest stitch/min" in out.getvalue()
    assert "2.70" in out.getvalue()
    # A tenth above the constant speed that is found for the file's machine.
    assert [one.high for one in calls] == pytest.approx([1.1 * 0.045] * 9)
    assert {one.low for one in calls} == {0.01}


def test_the_command_takes_them_for_any_job(
    examples: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    searched: list[Any] = []
    off: list[Any] = []
    monkeypatch.setattr(least_limits, "fastest_feed", canned(searched))
    monkeypatch.setattr(by_pace, "fastest_feed", canned(off))
    words = ["fastest", str(examples / "x-180.prg"), "-m", "lathe-winder", "--feed-forward"]
    words += ["--smoothing", "100 ms", "--mismatch", "--report", str(tmp_path / "r"), "--json"]
    out = io.StringIO()
    with redirect_stdout(out), redirect_stderr(io.StringIO()), pytest.raises(SystemExit) as left:
        main(words)
    assert left.value.code == 0
    content = json.loads(out.getvalue())
    assert len(content["mismatch"]) == 9
    assert content["mismatch"][1]["best"] == pytest.approx(0.04)
    assert "--feed-forward --smoothing '100 ms'" in content["command"]
    assert (tmp_path / "r" / "tolerances.svg").is_file()
    assert "mm/s" in (tmp_path / "r" / "tolerances.svg").read_text()
    assert all(one.options.feed_forward_s == pytest.approx(0.1) for one in searched + off)
