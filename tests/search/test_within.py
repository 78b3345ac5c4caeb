"""``--within`` and Ctrl-C: every search answers with the best so far, for every pace of a job."""

from __future__ import annotations

import json
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

import threadline as tl
from threadline.cli.main import main
from threadline.errors import OptionError
from threadline.machine import load_machine
from threadline.motion.path.interpolations import OPTIMAL
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job
from threadline.search import shaft as shaft_search
from threadline.search.cycle import fastest_cycle
from threadline.search.cycle_robust import robust_cycle
from threadline.search.deadline import INTERRUPTED, OUT_OF_TIME, Deadline, HaltError, until_deadline
from threadline.search.fastest import Grid, find_fastest
from threadline.search.feed import fastest_needle
from threadline.search.least_limits import fastest_job
from threadline.search.paced import Effort, Question
from threadline.search.shaft import fastest_shaft
from threadline.verdict import Criterion, Verdict, load_spec

EXAMPLES = Path(__file__).parents[2] / "examples"


class After(Deadline):
    """Ends the time, or interrupts, when a number of plans were requested."""

    def __init__(self, plans: int, *, interrupts: bool = False) -> None:
        super().__init__()
        self.left, self.interrupts = plans, interrupts

    def over(self) -> bool:
        self.left -= 1
        if self.left < 0 and self.interrupts and not self.ended:
            raise KeyboardInterrupt
        self.ended = self.ended or (OUT_OF_TIME if self.left < 0 else "")
        return bool(self.ended)


def needle(until: Deadline) -> tuple[float | None, int]:
    machine = load_machine("stitcher-rigid")
    spec = load_spec(None, machine)
    seam = EXAMPLES / "strap.seam.toml"
    found = fastest_needle(
        Question(
            job=open_job(seam, machine, Options()),
            machine=machine,
            spec=spec,
            options=Options(),
            low=1.0,
            high=200.0,
            until=until,
        )
    )
    return found.best, found.tried


def shaft(until: Deadline) -> tuple[float | None, int]:
    machine = load_machine("table-embroiderer")
    job = open_job(EXAMPLES / "rosette.dst", machine, Options())
    found = fastest_shaft(
        Question(
            job=job, machine=machine, spec=load_spec(None, machine), options=Options(), until=until
        )
    )
    assert found.schedule is None
    return found.constant.best, found.constant.tried


def optimal(until: Deadline) -> tuple[float | None, int]:
    machine = load_machine("lathe-winder")
    options = Options(interpolation=OPTIMAL)
    job = open_job(EXAMPLES / "x-180.prg", machine, options)
    found = fastest_job(
        Question(
            job=job, machine=machine, spec=load_spec(None, machine), options=options, until=until
        )
    )
    assert found.ended == until.ended
    return found.best.found.best, len(found.candidates)


SEARCHES: dict[str, Callable[[Deadline], tuple[float | None, int]]] = {
    "needle": needle,
    "shaft": shaft,
    "optimal": optimal,
}


@pytest.mark.long(only="True-optimal")
@pytest.mark.parametrize("name", SEARCHES)
@pytest.mark.parametrize("interrupts", [False, True])
def test_a_search_that_is_ended_answers_with_what_it_tried(name: str, interrupts: bool) -> None:
    until = After(3, interrupts=interrupts)
    _, tried = SEARCHES[name](until)
    assert tried == 3
    assert until.ended == (INTERRUPTED if interrupts else OUT_OF_TIME)


def test_a_plan_that_outlasts_the_time_is_broken_off() -> None:
    """The second plan would take a day; the answer comes from the plans before it."""
    until = Deadline.within(1000.0)
    slow: list[float] = []

    def judged(feed: float) -> Verdict:
        if slow:
            until.end_s = time.monotonic()  # the time is over now
            signal.setitimer(signal.ITIMER_REAL, 1e-3)
            time.sleep(86_400.0)
        slow.append(feed)
        return Verdict(results=(), simulated=True)

    found = find_fastest(judged, 1.0, 2.0, until=until)
    assert slow and found.tried == 1 and not found.complete
    assert until.ended == OUT_OF_TIME
    assert signal.getitimer(signal.ITIMER_REAL)[0] == 0.0


def test_an_end_that_passed_breaks_off_at_once() -> None:
    until = Deadline.within(1e-6)
    with pytest.raises(HaltError), until.interrupting():
        time.sleep(86_400.0)
    assert until.ended == OUT_OF_TIME
    with until_deadline(until, lambda: True), pytest.raises(HaltError):
        until.check()


@pytest.mark.parametrize("signal_raises", [HaltError, KeyboardInterrupt])
def test_a_signal_during_machine_code_ends_a_search_as_any_other(
    signal_raises: type[BaseException],
) -> None:
    """Compiled code that hands over its arguments then fails with other errors as well."""
    until = Deadline.within(1000.0)
    with until_deadline(until, lambda: True):
        try:
            try:
                raise signal_raises
            except BaseException as error:
                raise SystemError("_unpickle returned a result with an exception set") from error
        except SystemError as error:
            raise SystemError("a kernel returned a result with an exception set") from error
    assert (until.ended == INTERRUPTED) is (signal_raises is KeyboardInterrupt)
    with pytest.raises(SystemError, match="alone"), until_deadline(until, lambda: True):
        raise SystemError("alone")


def test_outside_the_main_thread_a_search_goes_on() -> None:
    """Another thread gets no signals; the search ends between two plans."""
    done = []

    def search() -> None:
        with Deadline.within(1e-6).interrupting():
            done.append(True)

    thread = threading.Thread(target=search)
    thread.start()
    thread.join()
    assert done == [True]


@pytest.mark.parametrize("name", SEARCHES)
def test_a_search_that_judged_nothing_has_no_answer(name: str) -> None:
    with pytest.raises(HaltError):
        SEARCHES[name](After(0))
    with pytest.raises(KeyboardInterrupt):
        SEARCHES[name](After(0, interrupts=True))


@pytest.mark.long(shown_by="test_a_cycle_for_a_band_ends_with_the_one_that_is_tried")
def test_schedules_of_a_shaft_end_with_the_best_so_far(monkeypatch: pytest.MonkeyPatch) -> None:
    """The speeds are searched to the end, with few trials; one of seven schedules is tried."""
    few = partial(shaft_search.constant_speeds, grid=Grid(points=4, near=1, edge=5e-3))
    monkeypatch.setattr(shaft_search, "constant_speeds", few)
    machine = load_machine("schiffli-frame")
    job = open_job(EXAMPLES / "rosette.dst", machine, Options())
    spec = load_spec(None, machine)
    whole = After(10**6)
    span = {"low": 1.9, "high": 2.0}
    found = fastest_shaft(
        Question(job=job, machine=machine, spec=spec, options=Options(), until=whole, **span)
    )
    used = 10**6 - whole.left
    short = After(used - 6)
    ended = fastest_shaft(
        Question(job=job, machine=machine, spec=spec, options=Options(), until=short, **span)
    )
    assert found.schedule is not None and ended.schedule is not None
    assert ended.constant.intervals == found.constant.intervals
    assert short.ended == OUT_OF_TIME and whole.ended == ""
    assert ended.schedule.plan.duration_s > found.schedule.plan.duration_s


@pytest.mark.long(but="False")
@pytest.mark.parametrize("interrupts", [False, True])
def test_cycles_end_with_the_best_so_far(interrupts: bool) -> None:
    machine = load_machine("letter-placer")
    job = open_job(EXAMPLES / "letter-cycle.toml", machine, Options())
    spec = load_spec(None, machine)
    until = After(1, interrupts=interrupts)
    assert fastest_cycle(Question(job=job, machine=machine, spec=spec, until=until)).tried == 2
    assert until.ended == (INTERRUPTED if interrupts else OUT_OF_TIME)


def test_a_cycle_for_a_band_ends_with_the_one_that_is_tried(tmp_path: Path) -> None:
    """No cycle is as short as this limit: without an end of the time ten cycles are tried.

    One command of the move is searched, in place of one for each of five shares of the limit.
    """
    machine = load_machine("letter-placer")
    file = tmp_path / "across.toml"
    file.write_text(
        '[[operation]]\nvalve = "main_air"\n[[operation]]\nmove = { X = "200 mm" }\n',
        encoding="utf-8",
    )
    job = open_job(file, machine, Options())
    spec = load_spec(None, machine)
    strict = replace(
        spec, criteria=(*spec.criteria, Criterion(name="cycle_time", limit=1e-3, required=True))
    )
    until = After(0)
    one = Effort(command_shares=(0.9,))
    asked = Question(job=job, machine=machine, spec=strict, until=until, effort=one)
    found = robust_cycle(asked, 0.1)
    assert (found.job, found.tried, until.ended) == (None, 1, OUT_OF_TIME)


QUESTIONS = {
    "strap.seam.toml": ("stitcher-rigid", []),
    "rosette.dst": ("table-embroiderer", []),
    "x-180.prg": ("lathe-winder", ["--interpolation", "optimal"]),
    "letter-cycle.toml": ("letter-placer", []),
}


@pytest.mark.parametrize("name", QUESTIONS)
def test_the_command_takes_a_time_for_every_kind(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """With no time most searches have no plan at all; the cycle as listed is always judged."""
    machine, more = QUESTIONS[name]
    words = ["fastest", str(EXAMPLES / name), "-m", machine, "--nominal", "--json", *more]
    with pytest.raises(SystemExit) as end:
        main([*words, "--within", "1 ns"])
    captured = capsys.readouterr()
    if name == "letter-cycle.toml":
        answer: dict[str, Any] = json.loads(captured.out)
        assert (end.value.code, answer["tried"], answer["ended"]) == (1, 1, OUT_OF_TIME)
    else:
        assert end.value.code == 2
        assert "no plan could be judged in that time" in captured.err


def test_python_says_that_a_search_ended_early_as_the_command_line_does(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without a cycle in spec, the reason is the time, and no feed can be lowered."""
    monkeypatch.setattr(Deadline, "within", classmethod(lambda _, __: After(0)))
    cycle = EXAMPLES / "letter-cycle.toml"
    found = tl.fastest(cycle, "letter-placer", within="5 s", level="nominal")
    assert (found.best, found.ended) == (None, OUT_OF_TIME)
    assert repr(found) == (
        "no plan in spec was found so far (out of time), limited by residual_vibration"
    )
    with pytest.raises(OptionError, match="Give within= a longer time") as refused:
        found.prove()
    assert "search stopped (out of time)" in str(refused.value)
    assert "feed" not in str(refused.value)
    with pytest.raises(OptionError, match="Let it search to its end"):
        replace(found, ended=INTERRUPTED).prove()
    with pytest.raises(OptionError, match="Give wider limits, or another move list or machine"):
        replace(found, ended="").prove()
    words = ["fastest", str(cycle), "-m", "letter-placer", "--within", "5 s", "--nominal", "--json"]
    with pytest.raises(SystemExit):
        main(words)
    assert json.loads(capsys.readouterr().out)["ended"] == found.ended


def test_python_says_that_the_best_feed_is_the_best_so_far(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A complete search says nothing of the kind, and one for a needle names no feed."""
    job = EXAMPLES / "x-180.prg"
    whole = tl.fastest(job, "lathe-winder", interpolation="linear", level="nominal")
    assert whole.ended == "" and repr(whole).startswith("fastest: ")
    monkeypatch.setattr(Deadline, "within", classmethod(lambda _, __: After(50)))
    found = tl.fastest(job, "lathe-winder", interpolation="linear", level="nominal", within="5 s")
    assert found.ended == OUT_OF_TIME and found.best is not None
    assert repr(found).startswith("fastest so far (out of time): ")
    sewn = tl.fastest(EXAMPLES / "strap.seam.toml", "stitcher-rigid", level="nominal")
    with pytest.raises(OptionError, match="Prove with a lower needle speed, or with wider limits"):
        replace(sewn, best=None, best_options=None).prove()
