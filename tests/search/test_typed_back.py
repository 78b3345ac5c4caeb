"""Printed answers of a search can be typed back: every end and every place inside passes."""

from __future__ import annotations

import json
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from threadline.cli.main import main
from threadline.cli.search_text import typed
from threadline.jobs import read_job
from threadline.jobs.operations import FeedMode
from threadline.machine import Machine, load_machine
from threadline.machine.vary import off_tolerance
from threadline.motion.laws import law, write_law
from threadline.proof import worst_search
from threadline.proof.option_words import parse_feed
from threadline.proof.options import Options, options_of
from threadline.proof.pipeline import (
    NOMINAL,
    REPEATED,
    Trials,
    open_job,
    plan_job,
    prove_plan,
)
from threadline.search import fastest_needle, mismatch, shaft
from threadline.search.by_pace import speeds
from threadline.search.fastest import COARSE, Grid, find_fastest
from threadline.search.feed import fastest_feed
from threadline.search.paced import Effort, Question, searching_with
from threadline.verdict import Result, Status, Verdict, load_spec

EXAMPLES = Path(__file__).parents[2] / "examples"
X180 = EXAMPLES / "x-180.prg"
SEVERAL = Trials(repeats=3)
FEW = Trials(repeats=2, machines=6)
"""Fewer runs, and over the tolerances fewer machines, than a level has: a search and what is typed
back have the same."""


@pytest.fixture
def few_searched(monkeypatch: pytest.MonkeyPatch) -> None:
    """Search the worst machine among few, in the search and when its answer is typed back."""
    monkeypatch.setattr(worst_search, "SEARCHED", 10)
    monkeypatch.setattr(worst_search, "SEARCHED_SERIAL", 2)


def drawn(low: float, high: float) -> list[float]:
    """Return both ends and ten places between them, from a fixed seed; one if they are equal."""
    inside = np.random.default_rng(7).uniform(low, high, 10).tolist()
    return list(dict.fromkeys((low, high, *inside)))


def _turn(folder: Path) -> Path:
    """Return the reversal test with two of its seven moves on either side of its corner."""
    job = folder / "turn.prg"
    moves = "".join(f"G1 X{mm}\n" for mm in (25.716, 25.714, -25.714, -25.716))
    job.write_text(f"G91 F2160\n{moves}M30\n", encoding="utf-8")
    return job


@pytest.fixture
def stitcher(tmp_path: Path) -> Machine:
    """The machine as built with exact dead times, because each drawn dead time needs a kernel."""
    file = tmp_path / "stitcher.toml"
    delay = 'delay = "3 ms exact, printed"\n'
    text = f'base = "stitcher"\nname = "stitcher"\n[drives.x]\n{delay}[drives.y]\n{delay}'
    file.write_text(text, encoding="utf-8")
    return load_machine(str(file))


@pytest.mark.long(but="nominal")
@pytest.mark.parametrize(
    ("trials", "low", "high"),
    [
        (NOMINAL, 29.2, 29.4),
        (SEVERAL, 29.1, 29.3),
        (FEW, 22.2, 23.3),
    ],
    ids=("nominal", "several", "few"),
)
@pytest.mark.usefixtures("few_searched")
def test_needle_speeds_of_the_stitcher_pass_as_they_are_printed(
    stitcher: Machine, tmp_path: Path, trials: Trials, low: float, high: float
) -> None:
    """Intervals have gaps at speeds that do not suit whole ticks; printed lists once covered them.

    Every level is checked on the first corner of the test path with 10 of 25 stitches on either
    side: its intervals are the intervals of the whole path.
    """
    whole = (EXAMPLES / "stitcher-test-path.seam.toml").read_text(encoding="utf-8")
    corner = whole.replace("[[0, 0], [2.5, 0], [2.5, 2.5], [5, 2.5]]", "[[0, 0], [1, 0], [1, 1]]")
    assert corner != whole
    seam = tmp_path / "corner.seam.toml"
    seam.write_text(corner, encoding="utf-8")
    spec = load_spec(EXAMPLES / "stitcher-place.spec.toml", stitcher)
    points, near = (3, 1) if trials.machines else (5, 1 if trials == SEVERAL else 2)
    found = fastest_needle(
        Question(
            job=open_job(seam, stitcher, Options()),
            machine=stitcher,
            spec=spec,
            options=Options(),
            low=low,
            high=high,
            trials=trials,
        ),
        Grid(near=near, points=points),
    )
    assert len(found.intervals) > 1
    for interval in found.intervals:
        # Over tolerances the worst machine differs from speed to speed: only the ends are judged
        # on it.
        ends = (interval.low, interval.high)
        for speed in ends if trials.machines else drawn(*ends):
            job = read_job(seam, stitcher, needle_speed=f"{typed(speed)} stitch/s")
            plan = plan_job(job, stitcher, Options())
            assert prove_plan(plan, spec, trials=trials).verdict.passed, speed


@pytest.mark.long(
    only=(
        "linear-1.0-0.03-0.045-trials1",
        "linear-1.0-0.028-0.033-trials2",
        "b-spline-pulled-1.0-0.235-0.265-trials5",
        "b-spline-pulled-1.0-0.43-0.47-trials3",
        "b-spline-pulled-1.0-0.43-0.47-trials4",
        "auto-0.42-0.59-0.64-trials7",
        "auto-0.136-1.0-4.9-trials8",
    )
)
@pytest.mark.parametrize(
    ("interpolation", "share", "low", "high", "trials"),
    [
        ("linear", 1.0, 0.030, 0.045, NOMINAL),
        ("linear", 1.0, 0.030, 0.045, SEVERAL),
        ("linear", 1.0, 0.028, 0.033, FEW),
        ("b-spline-pulled", 1.0, 0.430, 0.470, NOMINAL),
        ("b-spline-pulled", 1.0, 0.430, 0.470, SEVERAL),
        ("b-spline-pulled", 1.0, 0.235, 0.265, FEW),
        ("auto", 0.42, 0.590, 0.640, NOMINAL),
        ("auto", 0.42, 0.590, 0.640, REPEATED),
        ("auto", 0.136, 1.0, 4.9, FEW),
    ],
)
@pytest.mark.usefixtures("few_searched")
def test_feeds_of_the_winder_pass_as_they_are_printed(
    tmp_path: Path, interpolation: str, share: float, low: float, high: float, trials: Trials
) -> None:
    """At every level, up to the edge, for rough, smooth and timed moves."""
    machine = load_machine("lathe-winder")
    spec = load_spec(None, machine)
    options = replace(options_of(interpolation, None, "0.1 mm"), limit_share=share)
    job = read_job(_turn(tmp_path) if share == 1.0 else X180, machine)
    found = fastest_feed(
        Question(
            job=job, machine=machine, spec=spec, options=options, low=low, high=high, trials=trials
        ),
        # The printed answer has 16 tried feeds beside each edge.
        Grid(near=1, points=3)
        if trials == FEW
        else Grid(near=4 if trials == NOMINAL else 2, points=6),
    )
    assert found.intervals
    for interval in found.intervals:
        for feed in drawn(interval.low * 1e3, interval.high * 1e3):
            typed_options = replace(options, feed=parse_feed(f"{typed(feed)} mm/s"))
            proof = prove_plan(plan_job(job, machine, typed_options), spec, trials=trials)
            assert proof.verdict.passed and proof.verdict.level == trials.level, feed


@pytest.mark.long(but="trials1")
@pytest.mark.usefixtures("few_searched")
@pytest.mark.parametrize("trials", [NOMINAL, SEVERAL, FEW])
def test_speeds_of_a_shaft_pass_as_they_are_printed(tmp_path: Path, trials: Trials) -> None:
    """For a frame with step tables; one run far from the limits proves no other machine."""
    machine = load_machine("schiffli-frame")
    spec = load_spec(None, machine)
    moves = np.random.default_rng(4).integers(5, 81, (8, 2)) * np.array([1, -1])
    design = tmp_path / "eight.exp"
    design.write_bytes(moves.astype(np.int8).tobytes())
    job = read_job(design, machine)
    found = shaft.constant_speeds(
        Question(
            job=job, machine=machine, spec=spec, options=Options(), low=0.7, high=1.2, trials=trials
        ),
        Grid(points=4, near=1, edge=5e-3),
    )
    assert found.intervals
    for interval in found.intervals:
        for speed in drawn(interval.low, interval.high):
            typed_options = Options(feed=parse_feed(f"{typed(60.0 * speed)} stitch/min"))
            proof = prove_plan(plan_job(job, machine, typed_options), spec, trials=trials)
            assert proof.verdict.passed, speed


@pytest.mark.long(shown_by="test_feeds_of_the_winder_pass_as_they_are_printed")
def test_feeds_over_the_tolerances_pass_on_the_machines_that_they_are_of(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """``--mismatch``: plans for the file's machine, run by machines with light and heavy masses."""
    monkeypatch.setattr(mismatch, "ENDS", (-1.0, 1.0))
    machine = load_machine("lathe-winder+springy")
    spec = load_spec(None, machine)
    options = options_of("linear", None, "0.1 mm")
    job = read_job(EXAMPLES / "x-180.prg", machine)
    asked = Question(
        job=job, machine=machine, spec=spec, options=options, low=0.020, high=0.045,
        by=FeedMode.FASTEST_AXIS,
    )  # fmt: skip
    cells = mismatch.at_tolerance_ends(asked, lambda one: speeds(fastest_feed(one, COARSE)))
    assert len(cells) == 4 and all(cell.intervals for cell in cells)
    for cell in cells:
        actual = off_tolerance(machine, mass=cell.mass, stiffness=cell.stiffness)
        for interval in cell.intervals:
            for feed in drawn(interval.low * 1e3, interval.high * 1e3):
                typed_options = replace(options, feed=parse_feed(f"{typed(feed)} mm/s"))
                proof = prove_plan(plan_job(job, machine, typed_options), spec, actual=actual)
                assert proof.verdict.passed, (cell.mass, cell.stiffness, feed)


def test_fastest_and_prove_name_the_same_failing_criterion(tmp_path: Path) -> None:
    """A snail whose stitches are too short at all tried speeds; no machine limit is broken."""
    turn = np.linspace(0.0, 6.0 * np.pi, 200)
    radius = 25.0 - 24.2 * turn / turn[-1]
    points = np.stack([60.0 + radius * np.cos(turn), radius * np.sin(turn)], axis=1)
    seam = tmp_path / "snail.seam.toml"
    seam.write_text(
        '[stitching]\nstitch_length = "2.5 mm"\nneedle_speed = "10 stitch/s"\n'
        f'[[contour]]\nunit = "mm"\npoints = {points.round(4).tolist()}\n'
    )
    machine = load_machine("stitcher")
    spec = load_spec(EXAMPLES / "stitcher-place.spec.toml", machine)
    found = fastest_needle(
        Question(
            job=open_job(seam, machine, Options()),
            machine=machine,
            spec=spec,
            options=Options(),
            low=32.0,
            high=40.0,
        ),
        Grid(near=1, points=3),
    )
    assert found.best is None and not found.intervals
    for speed in (32.0, 40.0):
        job = read_job(seam, machine, needle_speed=f"{speed} stitch/s")
        verdict = prove_plan(plan_job(job, machine, Options()), spec).verdict
        failed = {result.name for result in verdict.results if result.status is Status.FAILED}
        assert failed == {found.limited_by} == {"stitch_length_error"}


def test_an_interval_is_cut_about_each_feed_that_fails() -> None:
    """The failing stretches between points of the scan are at least a ninth of the interval wide.

    Sixteen places spread by the golden ratio leave no gap above a tenth of the interval.
    """
    holes = ((2.05, 2.45), (3.05, 3.45))

    def judged(feed: float) -> Verdict:
        good = feed < 4.0 and not any(low < feed < high for low, high in holes)
        status = Status.PASSED if good else Status.FAILED
        result = Result(
            name="a", axis="", measured=0.5 if good else 2.0, limit=1.0, unit="m", status=status
        )
        return Verdict(results=(result,), simulated=True)

    found = find_fastest(judged, 1.0, 8.0, Grid(points=7, near=2))
    assert 3.99 < found.intervals[0].high < 4.0
    for interval in found.intervals:
        assert interval.low <= interval.high
        assert all(judged(feed).passed for feed in (interval.low, interval.high))
        assert not any(interval.low < low and high < interval.high for low, high in holes)
    assert len(found.intervals) == 3


@pytest.mark.parametrize("phase", [0.0, 0.5, 1.0, 2.0, 2.5, 3.0, 5.5])
def test_interval_ends_early_if_the_used_share_jumps_between_feeds(phase: float) -> None:
    """The used share jumps by up to 2 % between feeds 0.05 % apart, as with ``auto``.

    Over the tolerances ``auto`` jumps like this. A search that did not try feeds beside the
    tightest ones ended as high as 4.029: more than half of the feeds just below it fail, and one of
    ten sets of ten drawn feeds had a failing feed.
    """

    def used(feed: float) -> float:
        turns = 2.0 * np.pi * np.log(feed)
        jump = 0.5 * np.sin(turns / 5.3e-4 + phase) + 0.5 * np.sin(turns / 1.37e-3 + 2.0 * phase)
        return float(feed / 4.0 * (1.0 + 0.02 * jump))

    def judged(feed: float) -> Verdict:
        measured = used(feed)
        status = Status.PASSED if measured <= 1.0 else Status.FAILED
        result = Result(name="a", axis="", measured=measured, limit=1.0, unit="m", status=status)
        return Verdict(results=(result,), simulated=True)

    found = find_fastest(judged, 1.0, 8.0, Grid(points=7, near=2))
    best = found.fastest
    assert best is not None and not best.isolated and 3.92 <= best.high < 3.99
    random = np.random.default_rng(3)
    high = random.uniform(0.99 * best.high, best.high, 1000)
    assert np.mean([used(feed) > 1.0 for feed in high]) < 0.2
    sets = random.uniform(best.low, best.high, (100, 10))
    assert sum(any(used(feed) > 1.0 for feed in ten) for ten in sets) <= 3


def test_a_law_is_typed_back(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The search and its proof name the law that they ran with; here it is a user's table."""
    file = tmp_path / "my.law.csv"
    write_law(law("cycloidal"), file)
    job = tmp_path / "short.prg"
    job.write_text("G91\nG1 X5 F1000\nG1 X-5\nM30\n", encoding="utf-8")
    asked = ["--law", str(file), "--low", "20 mm/s", "--high", "40 mm/s", "--nominal"]
    few = Effort(shares=(1.0,), finest=Grid(points=2, near=1))
    with searching_with(few), pytest.raises(SystemExit) as left:
        main(["fastest", str(job), "-m", "lathe-winder", *asked])
    out = capsys.readouterr().out
    assert left.value.code == 0
    again = shlex.split(next(line for line in out.splitlines() if "To prove it:" in line))[5:]
    assert again[again.index("--law") + 1] == str(file)
    with pytest.raises(SystemExit) as left:
        main(["prove", *again, "--json"])
    assert left.value.code == 0
    assert json.loads(capsys.readouterr().out)["interpolation"] == f"law:{file}"
