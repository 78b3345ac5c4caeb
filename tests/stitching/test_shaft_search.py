"""The fastest way to sew a design: runs that the search leaves out do not change its answer."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from threadline.base.progress import TrialShares
from threadline.cli.main import main
from threadline.jobs import Job, read_job
from threadline.machine import load_machine
from threadline.proof.option_words import parse_feed
from threadline.proof.options import Options
from threadline.proof.pipeline import NOMINAL, REPEATED, Trials, plan_job, prove_plan
from threadline.search import paced, shaft
from threadline.search.fastest import Grid, find_fastest
from threadline.search.paced import Question
from threadline.verdict import Result, Status, Verdict, load_spec

MACHINE = load_machine("schiffli-frame")
SPEC = load_spec(None, MACHINE)


@pytest.fixture
def design(tmp_path: Path) -> Path:
    """Write an EXP design of ten stitches of 0.5 to 8 mm; a record is two signed bytes."""
    random = np.random.default_rng(4)
    moves = random.integers(5, 81, (10, 2)) * random.choice([-1, 1], (10, 2))
    file = tmp_path / "ten.exp"
    # 0x80 would be a command; it is -128, and no move here is that long.
    file.write_bytes(moves.astype(np.int8).tobytes())
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
            far=share,
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


@pytest.mark.parametrize("other", ["drawn machines", "a given machine"])
def test_the_forecast_of_this_machine_spares_no_run_of_other_machines(
    other: str, job: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Everything is far within, and still every speed is judged in all runs, the inner ones too."""
    drawn = other == "drawn machines"
    expected = Trials(repeats=4, machines=2 if drawn else 0)
    criteria = tuple(
        replace(c, limit=1e-3) if c.name == "stitch_residual" else c for c in SPEC.criteria
    )
    asked: dict[float, set[Trials]] = {}
    original = paced.try_plan

    def in_one_run(plan, spec, trials, *more, **named):  # type: ignore[no-untyped-def]
        asked.setdefault(plan.duration_s, set()).add(trials)
        return original(plan, spec, NOMINAL, *more, **named)

    monkeypatch.setattr(paced, "try_plan", in_one_run)
    shaft.constant_speeds(
        Question(
            job=job,
            machine=MACHINE,
            spec=replace(SPEC, criteria=criteria),
            options=Options(),
            low=0.998,
            high=1.002,
            trials=expected,
            actual=None if drawn else MACHINE,
        ),
        Grid(points=3, near=0, edge=5e-3),
    )
    assert len(asked) > 2
    assert all(expected in trials for trials in asked.values())


@dataclass(frozen=True)
class _Tried:
    """A plan that is known by its tolerance alone, and its verdict."""

    plan: float
    verdict: Verdict


@pytest.mark.parametrize("share", [0.61, 1.13, 1.5])
def test_the_schedule_has_the_largest_tolerance_that_passes(
    share: float, job: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To a 64th of the searched range, which ends at 1.5 times the limit of the residual."""
    limit_m = next(c.limit for c in SPEC.criteria if c.name == "stitch_residual")
    assert limit_m is not None
    most_m = share * limit_m

    def tried(tolerance_m: float, *_: object) -> _Tried:
        failed = "" if tolerance_m <= most_m else "it swings"
        return _Tried(tolerance_m, Verdict(results=(), simulated=True, incomplete=failed))

    monkeypatch.setattr(shaft, "plan_job", lambda _job, _machine, options: options.tolerance_m)
    monkeypatch.setattr(shaft, "try_plan", tried)
    found = shaft.fastest_schedule(Question(job=job, machine=MACHINE, spec=SPEC, options=Options()))
    assert isinstance(found, _Tried)
    assert most_m - 1.2 * limit_m / 64 <= found.plan <= most_m


@pytest.mark.parametrize("schedule_s", [8.0, 12.0])
def test_the_answer_is_the_faster_of_constant_speed_and_schedule(
    schedule_s: float, job: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    constant: Any = SimpleNamespace(complete=True, best=1.0, verdict="of the constant speed")
    pace = SimpleNamespace(tolerance_m=2e-5)
    plan = SimpleNamespace(duration_s=schedule_s, stitched=SimpleNamespace(pace=pace))
    schedule: Any = SimpleNamespace(plan=plan, verdict="of the schedule")
    monkeypatch.setattr(shaft, "constant_speeds", lambda _: constant)
    monkeypatch.setattr(shaft, "at_speed", lambda *_: SimpleNamespace(duration_s=10.0))
    monkeypatch.setattr(shaft, "fastest_schedule", lambda _: schedule)
    found: Any = shaft.fastest_shaft(
        Question(job=job, machine=MACHINE, spec=SPEC, options=Options())
    )
    assert (found.duration_s, found.constant_s) == (min(schedule_s, 10.0), 10.0)
    faster = schedule_s < 10.0
    assert found.by_schedule == faster
    assert found.verdict == ("of the schedule" if faster else "of the constant speed")


def test_a_search_without_a_lowest_speed_begins_at_half_the_speed_of_the_slowest_stitch(
    job: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And at no lower one: slow speeds take longest to simulate."""
    ranges: list[tuple[float, float]] = []

    def none_passes(_question: Question, asked: paced.Paced, _grid: Grid) -> Any:
        ranges.append((asked.low, asked.high))
        return SimpleNamespace(intervals=(), complete=True, best=None)

    monkeypatch.setattr(shaft, "fastest_paced", none_passes)
    question = Question(job=job, machine=MACHINE, spec=SPEC, options=Options())
    shaft.constant_speeds(question)
    lowest, highest = shaft.speed_range_hz(MACHINE)
    fastest = shaft.at_speed(question, highest).stitched
    half = 0.5 * len(fastest.turns) / fastest.slowest_s
    assert half > lowest
    assert ranges == [(pytest.approx(half), highest)]


def test_an_end_that_more_runs_refuse_is_searched_again_with_all(job: Job) -> None:
    """One run finds every speed far within the limits; the answer still passes twenty runs."""
    found = shaft.constant_speeds(
        Question(job=job, machine=MACHINE, spec=SPEC, options=Options(), trials=Trials(repeats=20)),
        Grid(points=6, near=0, edge=5e-3),
        far=math.inf,
    )
    for interval in found.intervals:
        for end in (interval.low, interval.high):
            options = replace(Options(), feed=parse_feed(f"{end!r} stitch/s"))
            plan = plan_job(job, MACHINE, options)
            assert prove_plan(plan, SPEC, trials=REPEATED).verdict.passed


def test_one_end_that_more_runs_refuse_is_enough_to_search_again_with_all(
    job: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One run passes everywhere, all runs up to 1 stitch/s: the lower end stands, the upper not."""

    def tried(plan: Any, _spec: object, trials: Trials, *_: object, **__: object) -> Any:
        failed = "" if trials.repeats == 1 or plan.speed_hz <= 1.0 else "it swings"
        residual = Result(
            name="stitch_residual", axis="", measured=1e-9, limit=1.0, unit="m",
            status=Status.PASSED,
        )  # fmt: skip
        return SimpleNamespace(
            verdict=Verdict(results=(residual,), simulated=True, incomplete=failed)
        )

    pace = SimpleNamespace(most_swings_m=lambda *_: np.zeros(1))
    stitched = SimpleNamespace(pace=pace, turns=SimpleNamespace(moves=None, turn_s=None))
    monkeypatch.setattr(
        shaft, "at_speed",
        lambda _question, speed_hz: SimpleNamespace(speed_hz=speed_hz, stitched=stitched),
    )  # fmt: skip
    monkeypatch.setattr(paced, "try_plan", tried)
    found = shaft.constant_speeds(
        Question(
            job=job,
            machine=MACHINE,
            spec=SPEC,
            options=Options(),
            low=0.9,
            high=1.1,
            trials=Trials(repeats=4),
        ),
        Grid(points=5, near=0, edge=5e-3),
    )
    assert found.best is not None and 0.99 < found.best <= 1.0
    assert all(one.high <= 1.0 for one in found.intervals)


def test_progress_of_a_shaft_search_never_falls_and_ends_with_the_search() -> None:
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
