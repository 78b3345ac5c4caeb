"""Options of the pipeline: their text is read strictly and survives a round trip."""

from __future__ import annotations

from pathlib import Path

import pytest

from threadline.errors import OptionError, PlanError
from threadline.jobs import read_job
from threadline.jobs.operations import Feed, FeedMode
from threadline.machine import load_machine
from threadline.proof.kinds import kind as watched
from threadline.proof.option_words import LEAST_SHARE, parse_feed, parse_share, parse_tolerance_m
from threadline.proof.options import Options, describe, options_from
from threadline.proof.pipeline import Trials, check_loops, plan_job, prove_plan
from threadline.verdict import load_spec

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


@pytest.mark.parametrize(
    ("text", "feed"),
    [
        ("10 count/tick", Feed(FeedMode.COUNT_PER_TICK, 10.0)),
        ("80count/tick", Feed(FeedMode.COUNT_PER_TICK, 80.0)),
        ("36 mm/s", Feed(FeedMode.FASTEST_AXIS, 0.036)),
        ("600 mm/min", Feed(FeedMode.FASTEST_AXIS, 0.01)),
        ("7.5 in/s", Feed(FeedMode.FASTEST_AXIS, 0.1905)),
    ],
)
def test_feeds(text: str, feed: Feed) -> None:
    parsed = parse_feed(text)
    assert parsed.mode is feed.mode
    assert parsed.value == pytest.approx(feed.value, rel=1e-12)


@pytest.mark.parametrize(
    "text", ["10", "0 mm/s", "-3 mm/s", "fast", "3 deg", "1e400 mm/s", "", "3 mm", "nan mm/s"]
)
def test_bad_feeds_name_the_text(text: str) -> None:
    with pytest.raises(OptionError, match="feed"):
        parse_feed(text)


@pytest.mark.parametrize("text", ["0 mm", "-1 mm", "0.1", "0.1 deg", "x"])
def test_bad_tolerances(text: str) -> None:
    with pytest.raises(OptionError, match="tolerance"):
        parse_tolerance_m(text)


@pytest.mark.parametrize("text", ["1e-300 %", "0.09 %", "0 %", "-5 %", "101 %", "5", "5 mm"])
def test_bad_shares_of_the_limits(text: str) -> None:
    """With 1e-300 % a trajectory of 1e150 s was searched, without a message."""
    with pytest.raises(OptionError, match="limits"):
        parse_share(text)
    assert parse_share("0.1 %") == LEAST_SHARE


def test_a_mode_above_half_the_rate_of_the_ticks_is_refused(examples: Path) -> None:
    """Before anything is planned; a tick of 5 ms carries nothing above 100 Hz."""
    machine = load_machine("lathe-winder")
    job = read_job(examples / "x-180.prg", machine)
    for text in ("zv:1e9Hz:0", "X=zv:12Hz*zv:100.1Hz"):
        with pytest.raises(OptionError, match=r"mode of .* is above 100 Hz.* tick of 5 ms"):
            plan_job(job, machine, Options(shaper=text, interpolation="no such"))
    with pytest.raises(OptionError, match="no such"):
        plan_job(job, machine, Options(shaper="zv:100Hz", interpolation="no such"))


@pytest.mark.parametrize("feed", [None, "10 count/tick", "123.456 mm/s"])
def test_a_recording_carries_its_options(feed: str | None, examples: Path) -> None:
    machine = load_machine("lathe-winder+physical")
    job = read_job(examples / "x-180.prg", machine)
    options = Options(
        interpolation="linear",
        feed=None if feed is None else parse_feed(feed),
        tolerance_m=parse_tolerance_m("0.25 mm"),
    )
    text = describe(job, machine, options)

    assert options_from(text) == options
    assert load_machine(text["machine"]).sha256 == machine.sha256


def test_missing_options_are_named() -> None:
    with pytest.raises(OptionError, match="does not name the feed"):
        options_from({"interpolation": "linear", "tolerance": "0.1 mm"})


def test_an_unstable_loop_is_refused_before_any_planning(examples: Path) -> None:
    """Feedback from the stitcher's head becomes unstable at a critical gain, as in its thesis."""
    with pytest.raises(PlanError, match=r"axis X: the loop is UNSTABLE.*0\.6\d+ times the gain"):
        check_loops(load_machine("stitcher+head-feedback"))
    check_loops(load_machine("lathe-winder"))


def test_the_share_of_all_runs_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """It grows from run to run, and is 1 only at the end of the last run."""
    monkeypatch.setattr(watched, "LONG_S", -1.0)
    machine = load_machine("letter-placer")
    plan = plan_job(read_job(EXAMPLES / "letter-cycle.toml", machine), machine, Options())
    reports: list[float] = []
    trials = Trials(repeats=3)
    prove_plan(plan, load_spec(None, machine), lambda _, share: reports.append(share), trials)
    assert reports == sorted(reports)
    assert reports[-1] == 1.0
    assert sum(1 for share in reports if share < 0.34) > 1
