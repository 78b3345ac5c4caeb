"""A feed in percent: every F keeps its ratio to the others, typed by hand or found by a search.

Times are compared with the same program in which every F is multiplied by hand.
"""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import threadline as tl
from tests.jobs.made_machines import made_machine
from threadline.cli.fastest_output import FeedOutput
from threadline.cli.main import main
from threadline.commands.plan import Plan
from threadline.errors import OptionError, PlanError
from threadline.jobs import Job, read_job
from threadline.jobs.operations import Feed, FeedMode
from threadline.machine import Machine, load_machine
from threadline.proof.option_form import Door
from threadline.proof.option_words import feed_words, parse_feed
from threadline.proof.options import Options, options_of
from threadline.proof.pipeline import plan_job, write
from threadline.proof.request import Words
from threadline.search import by_pace
from threadline.search.allowance import Candidate, FastestJob
from threadline.search.by_pace import answered
from threadline.search.fastest import Fastest
from threadline.search.feed import search_range, searched_by
from threadline.search.feed_ranges import Interval
from threadline.search.least_limits import fastest_job
from threadline.search.paced import Question
from threadline.search.question import question_of
from threadline.verdict import Result, Status, Verdict

VESSEL = Path(tl.__file__).parent / "cli" / "projects" / "winding" / "vessel.wind.toml"
PLUNGE = "G21 G90\nG0 X10 Y10\nG1 Y8 F333\nG1 X60 F1000\nG1 Y12 F333\nG93\nX50 F30\nG0 X0 Y0\nM2\n"


HOOP = """
name = "hoop"
[mandrel]
at = "100 mm"
[[part]]
kind = "cylinder"
radius = "50 mm"
length = "60 mm"
[band]
width = "8 mm"
tex = 2400
material = "e-glass/epoxy"
fibre_volume = "60 %"
[friction]
value = 0.25
[fibre]
speed = "200 mm/s"
[[layer]]
kind = "hoop"
"""


def winding_of(name: str, folder: Path) -> Path:
    """Return a product: the vessel with 1910 moves, or a hoop layer with 32."""
    if name == "vessel":
        return VESSEL
    (folder / "hoop.wind.toml").write_text(HOOP)
    return folder / "hoop.wind.toml"


@pytest.fixture
def mill(tmp_path: Path) -> Machine:
    """A machine with two axes of 30 m/min."""
    return made_machine(tmp_path, "XY", "", '[programs]\ndialect = "linuxcnc"\n')


def job_of(folder: Path, machine: Machine, text: str) -> Job:
    path = folder / f"{len(list(folder.iterdir()))}.ngc"
    path.write_text(text)
    return read_job(path, machine)


def nominal_s(job: Job, machine: Machine, feed: str | None) -> np.ndarray:
    options = Options(feed=None if feed is None else parse_feed(feed))
    blocks = plan_job(job, machine, options).motion.programmed
    return np.concatenate([block.nominal_s for block in blocks])


def times(text: str, factor: float) -> str:
    """Multiply every F of a program by hand, inverse times as well."""
    return re.sub(r"F([\d.]+)", lambda word: f"F{float(word[1]) * factor:.6f}", text)


def test_a_winding_from_its_product_is_searched_by_the_override(examples: Path) -> None:
    """The moves of a product have their own times; its written program has the operator's F."""
    winder = load_machine("lathe-winder")
    job = read_job(examples / "vessel.wind.toml", winder)
    assert searched_by(job, winder) is FeedMode.OVERRIDE
    low, high = search_range(job, winder, FeedMode.OVERRIDE)
    assert low < 1.0 < high
    written = read_job(examples / "vessel-circuit.prg", winder)
    assert searched_by(written, winder) is FeedMode.FASTEST_AXIS


@pytest.mark.parametrize("percent", ["50 %", "120%", "137.5 %", "1000 %"])
def test_an_override_multiplies_every_f(tmp_path: Path, mill: Machine, percent: str) -> None:
    factor = float(percent.rstrip(" %")) / 100.0
    asked = nominal_s(job_of(tmp_path, mill, PLUNGE), mill, percent)
    by_hand = nominal_s(job_of(tmp_path, mill, times(PLUNGE, factor)), mill, None)
    assert asked == pytest.approx(by_hand, rel=1e-9)
    assert (asked > 0.0).sum() == 4  # rapid moves keep their speed


def test_the_normal_feed_of_an_operator_is_multiplied_as_well(tmp_path: Path) -> None:
    """The normal feed of the printed winder is F 12000: 100 % keeps it, 200 % doubles it."""
    winder = load_machine("lathe-winder")
    job = job_of(tmp_path, winder, "G1 X90 F12000\nX80 F60\nM30\n")
    single, same, twice = (nominal_s(job, winder, feed) for feed in (None, "100 %", "200 %"))
    uncapped = nominal_s(job, replace(winder, operator=None), None)
    assert same == pytest.approx(single, rel=1e-12) and twice == pytest.approx(single / 2.0)
    assert single[1] > 2.0 * uncapped[1] and single[2] == uncapped[2]


def test_percent_is_read_and_written_to_the_last_bit() -> None:
    for percent in (120.0, 137.0, 33.3333333, 1e3 / 7.0, 110.00000000000001):
        feed = Feed(FeedMode.OVERRIDE, percent / 100.0)
        assert parse_feed(feed_words(feed)) == feed
    assert feed_words(parse_feed(" 137 % ")) == "137 %"
    for wrong in ("0 %", "-5 %", "x %", "F 120 %", "nan %"):
        with pytest.raises(OptionError):
            parse_feed(wrong)
    assert options_of("auto", "120 %", "0.1 mm", feed_mode="path").feed == parse_feed("120 %")


def test_a_program_has_its_feeds_times_the_override(tmp_path: Path, mill: Machine) -> None:
    """Written for LinuxCNC: the plunge at 333 and the cut at 1000 mm/min, both times 1.2."""
    text = "G0 X10 Y10\nG1 Y-20 F333\nX60 F1000\nY10 F333\nG0 X0 Y0\nM2\n"
    plan = plan_job(job_of(tmp_path, mill, text), mill, Options(feed=parse_feed("120 %")))
    # A recording states the feed of its plan.
    write(replace(plan, options={"feed": "120 %"}), "linuxcnc", tmp_path / "out.ngc")
    speeds = [float(f) for f in re.findall(r"F([\d.]+)", (tmp_path / "out.ngc").read_text())]
    assert max(speeds) == pytest.approx(1200.0, rel=1e-3)
    assert min(abs(speed - 399.6) for speed in speeds) < 0.5


def test_override_of_a_job_without_feeds_is_refused(examples: Path) -> None:
    with pytest.raises(OptionError, match=r"feed 120 %: .* has no feeds to multiply"):
        tl.prove(examples / "strap.seam.toml", "stitcher", feed="120 %", level="nominal")
    with pytest.raises((OptionError, PlanError)):
        tl.prove(examples / "letter-cycle.toml", "letter-placer", feed="120 %", level="nominal")


def test_the_face_takes_it(tmp_path: Path, mill: Machine) -> None:
    job = tmp_path / "plunge.ngc"
    job.write_text(PLUNGE)
    spec = tmp_path / "spec.toml"
    spec.write_text('name = "made"\n[[criteria]]\nname = "velocity"\nlimit = "machine"\n')
    usual, faster = (
        tl.prove(job, mill, spec=spec, level="nominal", feed=feed) for feed in (None, "150 %")
    )
    assert usual.passed and faster.passed
    assert faster.plan.duration_s < 0.9 * usual.plan.duration_s


def test_programs_with_feeds_that_differ_are_searched_by_their_override(
    tmp_path: Path, mill: Machine
) -> None:
    """The search ends where the fastest F is as fast as its axes: 30 m/min for F 1000."""
    several = job_of(tmp_path, mill, "G1 X5 F333\nX60 F1000\nM2\n")
    single = job_of(tmp_path, mill, "G0 X5\nG1 X60 F1000\nM2\n")
    assert searched_by(several, mill) is FeedMode.OVERRIDE
    assert searched_by(single, mill) is FeedMode.F_WORD
    winder = load_machine("lathe-winder")  # on these machines the operator sets one feed
    assert (
        searched_by(job_of(tmp_path, winder, "G1 X5 F60\nX9 F90\nM2\n"), winder) == "fastest-axis"
    )
    _, high = search_range(several, mill, FeedMode.OVERRIDE)
    assert high == pytest.approx(30.0, rel=1e-5)
    beyond = job_of(tmp_path, mill, "G1 X5 F333\nX60 F90000\nM2\n")
    assert search_range(beyond, mill, FeedMode.OVERRIDE)[1] == 1.0


def test_a_lift_that_a_slow_axis_holds_back_is_no_end_of_the_search(
    tmp_path: Path, mill: Machine
) -> None:
    """Slicers lift at the F of travel moves, which Z never reaches; X can be 30 times faster."""
    head, y, rest = Path(mill.reference).read_text().partition("[axes.Y]")
    file = tmp_path / "slow.toml"
    file.write_text(head + y + rest.replace('"0.5 m/s exact', '"10 mm/s exact', 1))
    slow_y = load_machine(file)
    lifted = job_of(tmp_path, slow_y, "G1 X5 F333\nY40 F1200\nX60 F1000\nM2\n")
    assert search_range(lifted, slow_y, FeedMode.OVERRIDE)[1] == pytest.approx(30.0, rel=1e-5)


@pytest.mark.long(but="hoop-linear")
@pytest.mark.parametrize(
    ("winding", "interpolation"), [("hoop", "linear"), ("vessel", "linear"), ("vessel", "auto")]
)
def test_a_winding_is_searched_from_above(
    winding: str, interpolation: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The slow feeds of a winding take longest to judge, and are never the answer."""
    tried: list[float] = []
    runs: list[int] = []

    def judged(question: Question, plan: Plan) -> Verdict:
        runs.append(question.trials.repeats)
        tried.append(float(plan.options["feed"].removesuffix(" %")))
        passed = tried[-1] < 1000.0
        result = Result(
            name="contour_error", axis="", measured=1e-3 if passed else 3e-3, limit=2e-3, unit="m",
            status=Status.PASSED if passed else Status.FAILED,
        )  # fmt: skip
        return Verdict(results=(result,), simulated=True)

    monkeypatch.setattr(Question, "judged", judged)
    words = Words.of("fastest", Door.PYTHON, {"interpolation": interpolation})
    asked = question_of(words, winding_of(winding, tmp_path), "lathe-winder")
    found = fastest_job(asked)
    assert found.by is FeedMode.OVERRIDE and found.best.found.best is not None
    assert 980.0 < 100.0 * found.best.found.best < 1000.0
    assert min(tried) > 100.0
    # Each feed is searched in one run; the whole job at the answer is judged in all runs.
    assert asked.trials.repeats == 20 and runs[-1] == 20 and set(runs[:-1]) == {1}
    assert found.whole


def _judged_by(
    monkeypatch: pytest.MonkeyPatch, error_m: Callable[[Question, float], float]
) -> list[tuple[int, float]]:
    """Make the error depend on question and percentage; return tried machines and percentages."""
    tried: list[tuple[int, float]] = []

    def judged(question: Question, plan: Plan) -> Verdict:
        percent = float(plan.options["feed"].removesuffix(" %"))
        tried.append((question.trials.machines, percent))
        measured = error_m(question, percent)
        result = Result(
            name="contour_error", axis="", measured=measured, limit=2e-3, unit="m",
            status=Status.PASSED if measured <= 2e-3 else Status.FAILED,
        )  # fmt: skip
        return Verdict(results=(result,), simulated=True)

    monkeypatch.setattr(Question, "judged", judged)
    return tried


def _over_tolerances(job: Path) -> Question:
    words = Words.of(
        "fastest", Door.PYTHON, {"interpolation": "linear", "level": "over tolerances"}
    )
    return question_of(words, job, "lathe-winder")


@pytest.mark.long(but="hoop")
@pytest.mark.parametrize("winding", ["hoop", "vessel"])
def test_a_winding_is_searched_in_one_run_and_judged_over_the_tolerances(
    winding: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Other machines are judged only near the answer: a passing feed takes hundreds of them."""
    tried = _judged_by(
        monkeypatch, lambda q, percent: percent * (3e-6 if q.trials.machines else 2e-6)
    )
    found = fastest_job(_over_tolerances(winding_of(winding, tmp_path)))
    assert found.whole and found.in_one_run
    best = found.best.found.best
    assert best is not None and 0.93 * 666.7 < 100.0 * best <= 666.7
    over = [percent for machines, percent in tried if machines]
    assert len(over) <= 8 and over[0] == pytest.approx(1000.0, rel=0.02)
    assert over == sorted(over, reverse=True) and over[-2] == over[-1] <= 666.7


@pytest.mark.parametrize(
    ("whole", "message"), [(True, "at the level asked for"), (False, "prove it")]
)
def test_the_output_says_which_feeds_were_judged_in_one_run(
    whole: bool, message: str, examples: Path,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    result = Result(
        name="contour_error", axis="", measured=1e-3, limit=2e-3, unit="m", status=Status.PASSED
    )
    verdict = Verdict(results=(result,), simulated=True)
    found = Fastest(
        intervals=(Interval(low=0.1, high=0.5),), limited_by="x", verdict=verdict, tried=3
    )
    candidate = Candidate(share=0.25, found=found, duration_s=1.0)
    job = FastestJob(best=candidate, candidates=(candidate,), in_one_run=True, whole=whole)
    monkeypatch.setattr(by_pace, "fastest_job", lambda _: job)
    given = Words.of("fastest", Door.PYTHON, {})
    answer = answered(question_of(given, examples / "x-180.prg", "lathe-winder"))
    FeedOutput(answer, "job").show(None, None)
    lines = capsys.readouterr().out.splitlines()
    (line,) = [one for one in lines if one.startswith("the feeds of the table pass in one run")]
    assert "in one run of each plan" in line and message in line


@pytest.mark.long(but="hoop")
@pytest.mark.parametrize("winding", ["hoop", "vessel"])
def test_an_error_over_the_tolerances_that_no_feed_mends_ends_the_search(
    winding: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """An error in the steps per degree, for example, is the same at a third of the feed."""
    tried = _judged_by(
        monkeypatch, lambda q, percent: 3e-3 if q.trials.machines else percent * 2e-6
    )
    found = fastest_job(_over_tolerances(winding_of(winding, tmp_path)))
    assert found.best.found.best is None and found.best.found.fixed == "contour_error"
    over = [percent for machines, percent in tried if machines]
    assert found.whole and len(over) <= 8 and over[-1] < over[0] / 3.0


@pytest.mark.long(shown_by="test_programs_with_feeds_that_differ_are_searched_by_their_override")
def test_printed_override_gives_the_printed_time(
    tmp_path: Path, mill: Machine, capsys: pytest.CaptureFixture[str]
) -> None:
    """The printed command has a feed in percent, is in spec, and takes the printed time.

    Plunge and cut keep their ratio: at the best override no programmed feed exceeds its axis.
    """
    job, spec = tmp_path / "plunge.ngc", tmp_path / "spec.toml"
    job.write_text("G1 Y-2 F900\nX60 F3000\nY2 F900\nM2\n")
    spec.write_text('name = "made"\n[[criteria]]\nname = "velocity"\nlimit = "machine"\n')
    asked = ["fastest", str(job), "-m", str(mill.reference), "-s", str(spec), "--nominal"]
    with pytest.raises(SystemExit) as stopped:
        main([*asked, "--json", "--high", "400 %"])
    answer = json.loads(capsys.readouterr().out)
    assert not stopped.value.code and answer["unit"] == "" and answer["feed"] == "override"
    assert answer["best"] == 4.0
    command = shlex.split(answer["command"])
    assert command[command.index("--feed") + 1] == "400 %"
    with pytest.raises(SystemExit) as stopped:
        main([*command[1:], "--json"])
    proved = json.loads(capsys.readouterr().out)
    assert not stopped.value.code
    assert proved["duration_s"] == pytest.approx(answer["duration_s"], rel=1e-9)


@pytest.mark.parametrize(
    ("typed", "message"),
    [
        ("0 %", "must be greater than zero"),
        ("-5 %", "must be greater than zero"),
        ("abc %", "is not a number"),
        ("nan %", "is not a number"),
        ("5 mm %", "'mm %' does not measure the same quantity as '%'"),
        ("1e400 %", "finite"),
    ],
)
def test_a_wrong_percentage_is_named(typed: str, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        parse_feed(typed)


def test_a_percentage_is_a_number_as_any_other() -> None:
    for typed in ("120 %", "120%", "+120 %", "1.2e2 %"):
        assert parse_feed(typed) == parse_feed("120 %")
        assert feed_words(parse_feed(typed)) == "120 %"
