"""Searches over long jobs: repeated stretches are judged once; a stopped search answers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tools import long_winding

from tests.jobs.made_machines import made_machine
from tests.search.test_fastest import verdict
from threadline.cli.main import main
from threadline.cli.search_text import settings_words
from threadline.commands.plan import Plan
from threadline.jobs import Job, own_product, read_job
from threadline.jobs.operations import Feed, FeedMode, Move
from threadline.machine import Machine, load_machine
from threadline.machine.motion_planner import GrblPlanner
from threadline.machine.quantity import parse_machine_quantity
from threadline.proof.options import Options, options_of
from threadline.proof.pipeline import open_job, plan_job, try_plan, with_product
from threadline.search import fastest_job, least_limits, whole_jobs
from threadline.search import paced as search_paced
from threadline.search.allowance import Candidate, FastestJob
from threadline.search.deadline import INTERRUPTED, OUT_OF_TIME, Deadline
from threadline.search.fastest import Fastest, Grid, Interval, find_fastest
from threadline.search.feed import fastest_feed
from threadline.search.paced import Question
from threadline.search.shortened_jobs import distinct_parts, moves_in
from threadline.verdict import Verdict, load_spec
from threadline.winding.product import product_of_text

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> Machine:
    return made_machine(tmp_path_factory.mktemp("long"), "X", "A")


def winding_blocks(moves: int) -> list[str]:
    """The function of the tool that writes the benchmark."""
    return list(islice(long_winding.blocks(), moves))


def written(folder: Path, blocks: list[str], machine: Machine) -> Job:
    """Return the blocks as a job."""
    path = folder / "job.nc"
    path.write_text("\n".join(["G21 G90 G94 F6000", *blocks, "M30"]) + "\n")
    return read_job(path, machine)


def test_circuits_are_met_once(tmp_path: Path, machine: Machine) -> None:
    """3800 moves are a hundred circuits; rounding to 0.001 mm and degrees makes no difference.

    The end of the job is new, too, because nothing follows it.
    """
    job = written(tmp_path, winding_blocks(3800), machine)
    parts = distinct_parts(job, machine)
    assert len(parts) == 2
    assert 38 + 4 <= sum(map(moves_in, parts)) < 120
    whole = [item.target for item in job if isinstance(item, Move)]
    first = [item.target for item in parts[0] if isinstance(item, Move)]
    last = [item.target for item in parts[1] if isinstance(item, Move)]
    assert first == whole[: len(first)] and last == whole[-len(last) :]
    assert parts[1].start == whole[-len(last) - 1]


def test_joined_stretches_go_on_as_the_job_does(tmp_path: Path, machine: Machine) -> None:
    """There is no rest between the first move and the last: only whole circuits are left out."""
    job = written(tmp_path, winding_blocks(3800), machine)
    (part,) = distinct_parts(job, machine, joined=True)
    whole, kept = (
        np.array([one.start, *[item.target for item in one if isinstance(item, Move)]])
        for one in (job, part)
    )
    assert 38 + 4 <= moves_in(part) < 160
    left_out = len(whole) - len(kept)
    assert left_out % 38 == 0
    moves, found = np.diff(whole, axis=0), np.diff(kept, axis=0)
    first = (
        int(np.argmax(np.abs(moves[: len(found)] - found).max(axis=1) > 2e-5)) or len(found) // 2
    )
    np.testing.assert_allclose(found[:first], moves[:first], atol=1e-12)
    np.testing.assert_allclose(found[first:], moves[first + left_out :], atol=2e-5)
    linear = [machine.axes[axis].kind == "linear" for axis in job.axes]
    np.testing.assert_allclose(kept[-1, linear], whole[-1, linear], atol=1e-9)


def test_stretches_are_not_joined_round_an_axis_with_ends(tmp_path: Path, machine: Machine) -> None:
    job = written(tmp_path, winding_blocks(3800), machine)
    ends = [f"{sign}9999999 deg exact, assumed: a test" for sign in ("-", "")]
    travel = tuple(parse_machine_quantity(end, ("rad",)) for end in ends)
    ended = replace(machine.axes["A"], endless=False, travel=travel)
    bounded = replace(machine, axes={**machine.axes, "A": ended})
    assert distinct_parts(job, bounded, joined=True) == (job,)


def test_one_move_that_is_new_is_kept_with_what_is_beside_it(
    tmp_path: Path, machine: Machine
) -> None:
    """One move in the middle of a hundred circuits is shorter by a degree."""
    blocks = winding_blocks(3800)
    x, a = blocks[2000].split()[1:]
    blocks[2000] = f"G1 {x} A{float(a[1:]) - 1.0:.3f}"
    job = written(tmp_path, blocks, machine)
    parts = distinct_parts(job, machine)
    assert len(parts) == 3
    lines = [item.source.line for item in parts[1] if isinstance(item, Move)]
    assert lines[0] <= 2002 - 4 and lines[-1] >= 2002 + 4


def test_feeds_and_dwells_tell_moves_apart(tmp_path: Path, machine: Machine) -> None:
    """One circuit has a slower move, and another one a dwell."""
    blocks = winding_blocks(3800)
    blocks[1000] += " F3000"
    blocks[1001] += " F6000"
    blocks.insert(3000, "G4 P0.5")
    parts = distinct_parts(written(tmp_path, blocks, machine), machine)
    assert len(parts) == 4
    assert [type(item).__name__ for item in parts[2]].count("Dwell") == 1


def test_circuits_elsewhere_along_the_mandrel_are_others(tmp_path: Path, machine: Machine) -> None:
    """The second fifty circuits are 50 mm further on, where the radius and the ends may differ.

    Of each fifty one circuit is kept with its surroundings, and so is the end.
    """
    blocks = winding_blocks(3800)
    for at in range(1900, 3800):
        words = blocks[at].split()
        blocks[at] = " ".join(
            f"X{float(word[1:]) + 50.0:.3f}" if word[0] == "X" else word for word in words
        )
    parts = distinct_parts(written(tmp_path, blocks, machine), machine)
    lines = [[item.source.line for item in part if isinstance(item, Move)] for part in parts]
    assert next(part[0] for part in lines) == 2 and lines[1][0] < 1902 < lines[1][-1] < 2100
    assert len(parts) == 3


def test_the_worst_of_the_stretches_is_that_of_the_whole_job(
    tmp_path: Path, machine: Machine
) -> None:
    """One circuit has a step back of 50 degrees, another a quicker move: both count.

    The acceleration of the 1994 controller's chords is proportional to the change of direction.
    """
    file = tmp_path / "spec.toml"
    names = ("acceleration", "velocity", "contour_error")
    file.write_text('name = "any"\n' + "".join(f'[[criteria]]\nname = "{n}"\n' for n in names))
    spec, options = load_spec(file, machine), Options(interpolation="linear")

    def worst(jobs: Sequence[Job], feed: Feed | None = None) -> dict[tuple[str, str], float]:
        found: dict[tuple[str, str], float] = {}
        for job in jobs:
            for result in try_plan(
                plan_job(job, machine, replace(options, feed=feed)), spec
            ).verdict.results:
                if result.measured is not None and result.name in names:
                    key = result.name, result.axis
                    found[key] = max(found.get(key, 0.0), abs(result.measured))
        return found

    even = winding_blocks(700)
    odd = list(even)
    x, a = odd[154].split()[1:]
    odd[154] = f"G1 {x} A{float(a[1:]) - 80.0:.3f}"
    odd[458] += " F9000"
    odd[459] += " F6000"
    job = written(tmp_path, odd, machine)
    parts = distinct_parts(job, machine)
    assert len(parts) > 2 and sum(map(moves_in, parts)) < 350
    found, whole = worst(parts), worst([job])
    plain = worst([written(tmp_path, even, machine)])
    assert found.keys() == whole.keys() and len(found) >= 5
    for key, value in whole.items():
        assert found[key] == pytest.approx(value, rel=1e-3, abs=1e-5), key
    # The verdict on a feed covers all stretches, row by row.
    at = worst(parts, Feed(FeedMode.FASTEST_AXIS, 0.1))
    found_by_parts = fastest_feed(
        Question(job=job, machine=machine, spec=spec, options=options, low=0.09, high=0.1),
        Grid(near=0, points=2),
        parts=parts,
    )
    assert found_by_parts.best == 0.1
    rows = {
        (r.name, r.axis): r.measured
        for r in found_by_parts.verdict.results
        if r.measured is not None
    }
    assert {key: rows[key] for key in at} == at
    # Without these two places the job needs less acceleration: the search must not miss them.
    assert whole["acceleration", "A"] > 1.2 * plain["acceleration", "A"]
    assert whole["velocity", "X"] > 1.2 * plain["velocity", "X"]


def test_only_the_shortest_failing_stretch_is_judged(
    tmp_path: Path, machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One failing stretch rejects a feed, and the shortest costs least."""
    asked, parts = list[int](), list[Job]()
    for count in (60, 12, 30):
        folder = tmp_path / str(count)
        folder.mkdir()
        parts.append(written(folder, winding_blocks(count), machine))

    def failing(plan: Plan, *_: object, **__: object) -> SimpleNamespace:
        asked.append(moves_in(plan.job))
        return SimpleNamespace(verdict=verdict(2.0))

    monkeypatch.setattr(search_paced, "try_plan", failing)
    file = tmp_path / "spec.toml"
    file.write_text('name = "any"\n[[criteria]]\nname = "contour_error"\n')
    spec, options = load_spec(file, machine), Options(interpolation="linear")
    found_by_parts = fastest_feed(
        Question(job=parts[0], machine=machine, spec=spec, options=options, low=0.05, high=0.1),
        Grid(near=0, points=3),
        parts=parts,
    )
    assert found_by_parts.best is None and asked == [moves_in(parts[1])] * 3 and asked[0] < 20


def test_a_job_that_repeats_nothing_is_one_part(tmp_path: Path, machine: Machine) -> None:
    rng = np.random.default_rng(5)
    blocks = [f"G1 X{x:.3f} A{a:.3f}" for x, a in rng.uniform(0.0, 300.0, (200, 2))]
    job = written(tmp_path, blocks, machine)
    assert distinct_parts(job, machine) == (job,)


@pytest.mark.long(shown_by="test_the_worst_of_the_stretches_is_that_of_the_whole_job")
def test_the_answer_is_of_the_whole_job(tmp_path: Path, machine: Machine) -> None:
    """Trials judge parts alone; the final verdict covers every move of the job."""
    job = written(tmp_path, winding_blocks(400), machine)
    spec_file = tmp_path / "spec.toml"
    spec_file.write_text(
        'name = "any"\n[[criteria]]\nname = "contour_error"\nlimit = "1 mm"\nrequired = true\n'
    )
    spec = load_spec(spec_file, machine)
    found = fastest_job(
        Question(
            job=job,
            machine=machine,
            spec=spec,
            options=Options(interpolation="linear"),
            low=0.02,
            high=0.04,
        )
    )
    assert found.whole and found.moves == 400 and found.judged_moves < 130
    assert found.best.duration_s is not None and found.best.found.verdict.passed
    parts = distinct_parts(job, machine)
    assert found.parts == len(parts)


def test_time_that_is_over_gives_the_best_so_far() -> None:
    until = Deadline()

    def judged(feed: float) -> Verdict:
        if feed < 0.5:
            until.ended = OUT_OF_TIME
        return verdict_at(feed)

    found = find_fastest(judged, 0.1, 10.0, Grid(points=9, near=4), until=until)
    # From above: the highest passing feed of the scan is known long before the slow feeds are
    # tried.
    assert not found.complete and found.best == pytest.approx(0.1 * 10.0**0.75, rel=2e-3)
    assert found.intervals[0].high == found.best and found.intervals[0].low > 0.1


def test_an_interrupt_gives_the_best_so_far_and_another_signal_does_not() -> None:
    class OtherError(KeyboardInterrupt):
        pass

    for signal_, answers in ((KeyboardInterrupt, True), (OtherError, False)):

        def judged(feed: float, raised: type[KeyboardInterrupt] = signal_) -> Verdict:
            if feed < 0.5:
                raise raised
            return verdict_at(feed)

        until = Deadline()
        if answers:
            found = find_fastest(judged, 0.1, 10.0, Grid(points=9), until=until)
            assert not found.complete and found.best is not None and found.best > 0.5
            assert until.ended == INTERRUPTED
        else:
            with pytest.raises(OtherError):
                find_fastest(judged, 0.1, 10.0, Grid(points=9), until=until)
    with pytest.raises(KeyboardInterrupt):
        find_fastest(
            lambda feed: (_ for _ in ()).throw(KeyboardInterrupt()), 0.1, 1.0, until=Deadline()
        )


def verdict_at(feed: float) -> Verdict:
    """A verdict that passes if its argument is below 1."""
    return verdict(0.5 if feed < 1.0 else 2.0)


def test_no_time_at_all_is_refused(
    tmp_path: Path, machine: Machine, capsys: pytest.CaptureFixture[str]
) -> None:
    job = written(tmp_path, winding_blocks(60), machine)
    spec = tmp_path / "spec.toml"
    spec.write_text('name = "any"\n[[criteria]]\nname = "contour_error"\n')
    for text, message in (
        ("1 ns", "no plan could be judged"),
        ("0 s", "--within '0 s' must be greater than 0. Give how long the search may take"),
        ("-5 s", "--within '-5 s' must be greater than 0. Give how long the search may take"),
        ("5", "unit"),
    ):
        with pytest.raises(SystemExit) as end:
            main(["fastest", job.file, "-m", str(machine.file), "-s", str(spec), "--within", text])
        assert end.value.code == 2
        assert message in capsys.readouterr().err


def test_settings_are_in_the_words_of_the_controller(tmp_path: Path, machine: Machine) -> None:
    """A quarter of the limits: 5 m/s^2 of X and 200 rad/s^2 of A, in grbl's units."""
    best = Interval(low=0.1, high=0.5)
    found = Fastest(intervals=(best,), limited_by="x", verdict=verdict_at(0.5), tried=3)
    grbl = GrblPlanner(
        kind="grbl", junction_deviation=parse_machine_quantity("0.01 mm exact, assumed", ("m",))
    )
    candidate = Candidate(share=0.25, found=found, duration_s=1.0)
    job = written(tmp_path, winding_blocks(3), machine)
    result = FastestJob(best=candidate, candidates=(candidate, candidate))
    notes = list(settings_words(job, replace(machine, planner=grbl), result))
    x, a = (machine.axes[name].acceleration.si * 0.25 for name in "XA")
    assert notes[0].startswith("to set: F 30000, ")
    assert f"$120={1e3 * x:.3f} (X, mm/s^2)" in notes[1]
    assert f"$123={math.degrees(a):.3f} (A, deg/s^2)" in notes[1]


def test_coverage_and_tie_are_judged_on_the_whole_winding(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The parts of a winding begin where the fibre is not tied, and leave gaps."""
    vessel = ROOT / "src/threadline/cli/projects/winding/vessel.wind.toml"
    machine = load_machine("lathe-winder")
    options = options_of(interpolation="linear", product=own_product(vessel))
    job = open_job(vessel, machine, options)
    spec = with_product(load_spec(None, machine), machine, options)
    of_parts: list[Question] = []
    of_whole: list[Question] = []

    def searched(asked: Question, _grid: object, parts: tuple[Any, ...], _seen: object) -> Any:
        assert parts != (job,)
        of_parts.append(asked)
        interval = Interval(low=0.05, high=0.05)
        return Fastest(intervals=(interval,), limited_by="x", verdict=verdict_at(0.05), tried=1)

    def whole(asked: Question, _plan: object) -> Verdict:
        of_whole.append(asked)
        return verdict_at(0.05)

    def planned(*_: object) -> SimpleNamespace:
        return SimpleNamespace(duration_s=10.0, tick_s=1e-3)

    monkeypatch.setattr(least_limits, "fastest_feed", searched)
    monkeypatch.setattr(Question, "judged", whole)
    monkeypatch.setattr(least_limits, "with_searched_best", lambda best, *_: best)
    monkeypatch.setattr(least_limits, "planned_at", planned)
    monkeypatch.setattr(whole_jobs, "planned_at", planned)
    fastest_job(Question(job=job, machine=machine, spec=spec, options=options))

    coverage = {"coverage_gap", "planned_coverage_gap"}
    assert of_parts and len(of_whole) == 1
    for asked in of_parts:
        assert asked.options.product is not None
        assert product_of_text(asked.options.product).tied is None
        names = {one.name for one in asked.spec.criteria}
        assert not coverage & names and "slip_tendency" in names
    (asked,) = of_whole
    assert asked.options.product is not None
    assert product_of_text(asked.options.product).tied is not None
    assert coverage <= {one.name for one in asked.spec.criteria}
