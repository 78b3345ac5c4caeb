"""The speed of the shaft at each stitch: a quick study, a brute-force sum, and the twin."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
import pystitch
import pytest

from tests.conftest import NO_SAMPLES, SHARED_SAMPLES
from threadline.base.arrays import FloatArray
from threadline.commands import stitch_pace
from threadline.commands.stitch_pace import Moves, Pace
from threadline.commands.stitch_search import FastestTurns, fastest_turns
from threadline.commands.stitch_speeds import Speeds, TurnMoves
from threadline.commands.stitched import stitch
from threadline.commands.turns import Stitched
from threadline.errors import OptionError, PlanError
from threadline.files import Stream
from threadline.jobs import read_job
from threadline.jobs.operations import MoveRun
from threadline.machine import load_machine
from threadline.motion.laws import law
from threadline.motion.shaping import FlexibleMode
from threadline.motion.shaping.law_residual import lasting_windows_s, residual_m, ringing
from threadline.motion.shaping.mode_law import Demand, made_law, usual_jerk_m_s3
from threadline.proof.option_words import parse_feed
from threadline.proof.options import Options, options_of
from threadline.proof.pipeline import REPEATED, open_job, plan_job, prove
from threadline.report.lines import stitch_rows
from threadline.report.stitched import threads_figure
from threadline.verdict import load_spec

MACHINE = load_machine("schiffli-frame")
SAMPLES = SHARED_SAMPLES / "embroidery"
EXAMPLES = Path(__file__).parents[2] / "examples"
SINE = law("modified-sine")


@cache
def rosette(tolerance_m: float) -> tuple[Stitched, float]:
    """Return the planned stitches of the rosette, and the processor time of the plan, s."""
    begun = process_time()
    job = read_job(EXAMPLES / "rosette.dst", MACHINE)
    return stitch(job, MACHINE, SINE, tolerance_m, None), process_time() - begun


def unlimited(tolerance_m: float = 5e-5) -> Pace:
    return Pace(MACHINE, SINE, tolerance_m)


def test_windows_of_all_lengths_are_those_of_each_alone() -> None:
    """One scan for all lengths finds the windows of a search for each length by itself."""
    mode = FlexibleMode(12.0, 0.02)
    lengths = np.array([0.0, 3e-5, 1e-4, 6.8e-3, 1.65e-2])
    found = lasting_windows_s(SINE, mode, lengths, 5e-5)
    assert found[:2].tolist() == [0.0, 0.0]
    for length, window in zip(lengths[2:], found[2:], strict=True):
        single = ringing(SINE, mode, length, 0.05, residual=5e-5).window_s
        assert single is not None
        assert window == pytest.approx(single, rel=2e-3)
        longer = np.linspace(window, 1.0, 4001)
        assert residual_m(SINE, mode, length, longer).max() <= 5e-5 * 1.001


@pytest.mark.long(but="tree.dst-481-685")
@pytest.mark.skipif(not SAMPLES.is_dir(), reason=NO_SAMPLES)
@pytest.mark.parametrize(
    ("name", "schedule_s", "constant_s"),
    [("tree.dst", 481, 685), ("peace.dst", 489, 900), ("Star.DST", 1661, 2199)],
)
def test_times_are_those_of_a_quick_study(name: str, schedule_s: float, constant_s: float) -> None:
    """0.05 mm, a spindle without inertia, each stitch alone; within 3 %, as it rounded."""
    pace = unlimited()
    stitched = stitch(read_job(SAMPLES / name, MACHINE), MACHINE, SINE, 5e-5, None)
    moves = stitched.turns.moves
    with_thread = stitched.frame_moves == 1
    moves = Moves(units=moves.units[with_thread], needle=moves.needle[with_thread])
    turns = pace.needed_turns_s(moves)
    assert turns.sum() == pytest.approx(schedule_s, rel=0.03)
    assert turns.max() * len(turns) == pytest.approx(constant_s, rel=0.03)
    # Left out in that study: the swing of a stitch is still there when the next needle enters.
    assert pace.swings_m(moves, turns).max() > 1.5 * 5e-5
    assert stitched.pace.most_swings_m(stitched.turns.moves, stitched.turns.turn_s).max() <= 5e-5


def random_moves(count: int) -> Moves:
    random = np.random.default_rng(8)
    units = random.integers(-165, 166, (count, 2)) // random.integers(1, 40, (count, 1))
    return Moves(units=units, needle=(random.uniform(size=count) < 0.9).astype(np.int64))


def test_the_swing_of_many_moves_is_their_sum() -> None:
    """Each move's own swing from its own end, summed as complex numbers in plain Python."""
    moves = random_moves(40)
    pace = unlimited()
    turns = np.random.default_rng(1).uniform(0.4, 1.3, 40)
    found = pace.swings_m(moves, turns)
    speed = 1.0 / turns
    w = 2 * np.pi * 12.0
    pole = w * (0.02 + 1j * np.sqrt(1 - 0.02**2))
    begin = np.zeros(41)
    for k in range(40):
        later = speed[min(k + 1, 39)]
        begin[k + 1] = begin[k] + turns[k] / 3 + (2 / 3) / (0.5 * (speed[k] + later))
    for k in range(40):
        worst = 0.0
        for axis in (0, 1):
            total = 0j
            for j in range(k + 1):
                u = np.linspace(0.0, 1.0, 4001)
                rise = moves.units[j, axis] * 1e-4 * SINE(u, 2) / (turns[j] / 3)
                end = begin[j] + turns[j] / 3
                left = begin[k] + turns[k] / 3 - end + (1.0 - u) * turns[j] / 3
                total += np.trapezoid(rise * np.exp(-pole * left), u) / pole.imag
            worst = max(worst, abs(total))
        expected = worst if moves.needle[k] else 0.0
        assert found[k] == pytest.approx(expected, rel=2e-3, abs=1e-8)


@pytest.mark.long(shown_by="test_long_stitches_are_slowed_and_never_refused")
def test_the_spindle_is_asked_for_no_more_than_it_can() -> None:
    """The square of the speed over the angle between two windows; every turn as long as needed."""
    moves = random_moves(500)
    pace = unlimited(1e-4)
    turns = pace.scheduled(moves).turn_s
    speed = 2 * np.pi / turns
    angle = 2 * np.pi * 2 / 3
    assert np.abs(np.diff(speed**2) / (2 * angle)).max() <= 3.0 * (1 + 1e-9)
    assert np.all(turns >= 0.36 * (1 - 1e-12))
    assert pace.swings_m(moves, turns).max() <= 1e-4
    assert np.all(turns / 3 >= pace.rigid_windows_s(moves) * (1 - 1e-12))


def test_the_forecast_is_what_the_twin_does(examples: Path) -> None:
    """The twin's servo lags and is sampled, so that it swings a little less: 6 % at most."""
    spec = load_spec(None, MACHINE)
    proof = prove(examples / "rosette.dst", MACHINE, spec, Options())
    assert proof.verdict.passed
    measured = max(proof.verdict.result("stitch_residual", axis).measured for axis in "XY")
    stitched = proof.plan.stitched
    forecast = stitched.pace.swings_m(stitched.turns.moves, stitched.turns.turn_s).max()
    assert 0.94 * forecast < measured <= forecast * 1.005


@pytest.mark.parametrize("machine", ["schiffli-frame", "table-embroiderer"])
def test_a_plan_for_the_limit_is_in_spec_on_any_day(machine: str, examples: Path) -> None:
    """Twenty runs, damping drawn from 0.7 to 1.3; some swing more than the usual one."""
    frame = load_machine(machine)
    proof = prove(
        examples / "rosette.dst", frame, load_spec(None, frame), Options(), trials=REPEATED
    )
    assert proof.verdict.passed
    stitched = proof.plan.stitched
    moves, turns = stitched.turns.moves, stitched.turns.turn_s
    most, usual = (of(moves, turns) for of in (stitched.pace.most_swings_m, stitched.pace.swings_m))
    assert (most > 1.05 * usual)[usual > 0.5e-4].any()
    # Planned for a twentieth of the tolerances, too: the limit is used at their ends.
    assert stitched.pace.robust_share == 0.05
    assert stitched.pace.robust_swings_m(moves, turns).max() == pytest.approx(1e-4, rel=0.03)
    assert proof.verdict.result("stitch_residual", "X").measured > 0.85e-4


def test_a_design_that_is_planned_again_is_not_searched_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Machine and design are read anew, and equal; another design or tolerance is searched."""
    searches = []

    def counted(*asked: Any) -> FastestTurns:
        searches.append(asked)
        return fastest_turns(*asked)

    monkeypatch.setattr(stitch_pace, "fastest_turns", counted)
    moves = np.random.default_rng(6).integers(-80, 81, (2, 12, 2)).astype(np.int8)
    for name, way in zip("ab", moves, strict=True):
        (tmp_path / f"{name}.exp").write_bytes(way.tobytes())

    def turns(name: str, tolerance_m: float) -> FloatArray:
        machine = load_machine("schiffli-frame")
        job = read_job(tmp_path / f"{name}.exp", machine)
        return stitch(job, machine, SINE, tolerance_m, None).turns.turn_s

    first = turns("a", 1.1e-4)
    counts = [len(searches)]
    for name, tolerance_m in (("a", 1.1e-4), ("b", 1.1e-4), ("a", 1.2e-4)):
        again = turns(name, tolerance_m)
        counts.append(len(searches))
        assert np.array_equal(again, first) is (len(counts) == 2)
    assert 0 < counts[0] == counts[1] < counts[2] < counts[3]


@pytest.mark.long(shown_by="test_a_plan_for_the_limit_is_in_spec_on_any_day")
def test_a_law_made_for_the_mode_is_sewn_at_its_own_speed(examples: Path) -> None:
    """Slowed it would swing more: at one speed every stitch has the window of its own law.

    With a speed for each stitch it takes even less time.
    """
    mode = FlexibleMode(12.0, 0.02)
    made = made_law(
        Demand(
            mode=mode, band=0.1, move_m=0.0165, residual_m=5e-5, acceleration_m_s2=6.334,
            jerk_m_s3=usual_jerk_m_s3(0.0165, 6.334),
        )
    )  # fmt: skip
    job = read_job(examples / "rosette.dst", MACHINE)
    one_speed = load_machine("schiffli-frame+one-speed")
    notch = stitch(read_job(examples / "rosette.dst", one_speed), one_speed, made.law, 1e-4, None)
    sine, _ = rosette(1e-4)
    assert np.ptp(notch.turns.turn_s) == 0.0
    assert np.ptp(sine.turns.turn_s) > 0.1
    assert notch.duration_s < 0.95 * sine.duration_s
    assert stitch(job, MACHINE, made.law, 1e-4, None).duration_s < 0.8 * sine.duration_s
    window = notch.turns.turn_s[:1] / 3.0
    assert 0.8 * made.window_s < window[0] < 1.25 * made.window_s
    for ratio in (0.95, 1.0, 1.05):
        aside = FlexibleMode(12.0 * ratio, 0.02)
        assert residual_m(made.law, aside, 0.0165, window)[0] <= 1e-4
    swings = notch.pace.most_swings_m(notch.turns.moves, notch.turns.turn_s)
    assert swings.max() <= 1e-4


@pytest.mark.long(shown_by="test_long_stitches_are_slowed_and_never_refused")
def test_a_tolerance_that_no_speed_keeps_slows_as_far_as_the_shaft_can() -> None:
    """A hundredth of a micrometre, and no endless search for a window."""
    plan, taken_s = rosette(1e-8)
    assert taken_s < 20.0
    assert plan.turns.turn_s.max() == pytest.approx(6.0)


@pytest.mark.long(shown_by="test_speeds_that_keep_no_tolerance_are_said_to_be_none")
def test_a_plan_that_keeps_no_tolerance_says_so() -> None:
    """A hundredth of a micrometre: the number of failing stitches, the worst one, and a remedy."""
    (warning,) = rosette(1e-8)[0].warnings
    assert re.search(r"within 1e-05 mm: \d+ of 185 stitches .* at block \d, stitch \d+", warning)
    assert "larger --tolerance" in warning


def test_speeds_that_keep_no_tolerance_are_said_to_be_none(examples: Path) -> None:
    job = read_job(examples / "rosette.dst", MACHINE)
    assert rosette(1e-4)[0].warnings == ()
    one_speed = load_machine("schiffli-frame+one-speed")
    (warning,) = stitch(
        read_job(examples / "rosette.dst", one_speed), one_speed, SINE, 1e-8, None
    ).warnings
    assert "no speeds of the shaft were found" in warning
    given = stitch(job, MACHINE, SINE, 1e-8, 0.4)
    assert given.warnings == ()


@pytest.mark.parametrize("seed", range(4))
def test_schedules_of_random_moves_end_within_the_tolerance(seed: int) -> None:
    """Stitches of up to 16.5 mm in any order: the forecast of any day is within 0.1 mm."""
    random = np.random.default_rng(seed)
    units = np.rint(random.uniform(-1.0, 1.0, (150, 2)) ** 3 * 165).astype(np.int64)
    moves = Moves(units=units, needle=np.ones(150, dtype=np.int64))
    pace = unlimited(1e-4)
    schedule = pace.scheduled(moves)
    assert pace.most_swings_m(moves, schedule.turn_s).max() <= 1e-4 * (1 + 1e-6)
    needed_s = float(pace.needed_turns_s(moves).sum())
    assert schedule.bound_s <= schedule.turn_s.sum() < 1.1 * needed_s


@pytest.mark.long(shown_by="test_schedules_of_random_moves_end_within_the_tolerance")
def test_the_beam_finds_the_fastest_of_all_schedules() -> None:
    """Every sequence of speeds of a small grid, tried in plain Python, for six moves."""
    random = np.random.default_rng(5)
    pace = unlimited(1e-4)
    for _ in range(5):
        units = random.integers(-60, 61, (6, 2))
        moves = Moves(units=units, needle=np.ones(6, dtype=np.int64))
        shortest_s = np.maximum(
            pace.rigid_windows_s(moves) / pace.share, pace.loading_turns_s(moves)
        )
        grid = Speeds.between((0.36, 0.85, 0.85), 0.12, pace.share, 0.6366)
        found = fastest_turns(
            grid,
            pace.swings_of(grid),
            TurnMoves(travels_m=units * 1e-4, needle=moves.needle, shortest_s=shortest_s),
            1e-4,
            pace.share,
        )
        tried = np.array(list(product(grid.turn_s.tolist(), repeat=6)))
        steps = np.abs(np.diff(tried**-2.0, axis=1)).max(axis=1)
        tried = tried[(steps <= 0.6366) & (tried >= shortest_s).all(axis=1)]
        times_s = [float((pace.share * turns + pace.rests_s(turns)).sum()) for turns in tried]
        # In the order of their times, the first one that leaves little enough is the quickest.
        best = next(
            (
                times_s[k]
                for k in np.argsort(times_s)
                if pace.most_swings_m(moves, tried[k]).max() <= 1e-4
            ),
            np.inf,
        )
        time_s = float((pace.share * found.turn_s + pace.rests_s(found.turn_s)).sum())
        if np.isfinite(best):
            assert not found.missed.any()
            assert time_s == pytest.approx(best, rel=1e-9)
            assert found.bound_s <= best * (1 + 1e-9)
        else:
            assert found.missed.any()


@pytest.mark.long(but="tree.dst-255.9")
@pytest.mark.skipif(not SAMPLES.is_dir(), reason=NO_SAMPLES)
@pytest.mark.parametrize(("name", "other_s"), [("tree.dst", 255.9), ("peace.dst", 325.0)])
def test_schedules_are_as_fast_as_another_search_finds_them(name: str, other_s: float) -> None:
    """An independent beam search, same law, limits, spindle and dampings: at most 5 % above."""
    plan = stitch(read_job(SAMPLES / name, MACHINE), MACHINE, SINE, 1e-4, None)
    assert plan.duration_s <= 1.05 * other_s
    assert plan.bound_s is not None and plan.bound_s <= plan.duration_s
    assert plan.warnings == ()


def robust_schedule(design: Path) -> Stitched:
    """Prove +-5 % of the mode by the forecast at 81 frequencies, and by the twin at its ends."""
    proof = prove(
        design, MACHINE, load_spec(None, MACHINE), options_of(robust="25 %"),
        trials=replace(REPEATED, ends=0.25),
    )  # fmt: skip
    assert proof.verdict.passed
    stitched = proof.plan.stitched
    assert stitched is not None
    moves, turns = stitched.turns.moves, stitched.turns.turn_s
    for factor in np.linspace(0.952, 1.05, 81).tolist():
        modes = {axis: (FlexibleMode(12.0 * factor, 0.02),) for axis in "XY"}
        assert stitched.pace.swings_m(moves, turns, modes).max() <= 1.01e-4
    return stitched


def test_a_robust_schedule_of_six_stitches_holds_all_over_the_tolerances(tmp_path: Path) -> None:
    moves = np.random.default_rng(4).integers(5, 81, (6, 2)) * np.array([1, -1])
    design = tmp_path / "six.exp"
    design.write_bytes(moves.astype(np.int8).tobytes())
    stitched = robust_schedule(design)
    job = read_job(design, MACHINE)
    exact = stitch(job, MACHINE, SINE, 1e-4, None)
    off = {axis: (FlexibleMode(12.0 * 0.952, 0.02),) for axis in "XY"}
    assert exact.pace.swings_m(exact.turns.moves, exact.turns.turn_s, off).max() > 1.01e-4
    assert exact.duration_s < stitched.duration_s


@pytest.mark.long(shown_by="test_a_robust_schedule_of_six_stitches_holds_all_over_the_tolerances")
def test_a_robust_schedule_holds_all_over_the_tolerances(examples: Path) -> None:
    """With masses off by 10 %."""
    stitched = robust_schedule(examples / "rosette.dst")
    moves = stitched.turns.moves
    exact, _ = rosette(1e-4)
    off = {axis: (FlexibleMode(12.0 * 0.952, 0.02),) for axis in "XY"}
    assert exact.pace.swings_m(moves, exact.turns.turn_s, off).max() > 1.5e-4
    assert exact.duration_s < stitched.duration_s < 1.3 * exact.duration_s


def test_long_stitches_are_slowed_and_never_refused(examples: Path) -> None:
    """At the printed speed the frame swings ten times too far; slowed it does not."""
    options = Options()
    spec = load_spec(None, MACHINE)
    fast = replace(options, feed=parse_feed("166.666 stitch/min"))
    at_once = prove(examples / "rosette.dst", MACHINE, spec, fast)
    assert not at_once.verdict.passed
    found = at_once.verdict.result("stitch_residual")
    assert found.measured > 5e-4
    assert "stitch" in found.note and found.job_line
    slowed = prove(examples / "rosette.dst", MACHINE, spec, options)
    assert slowed.verdict.passed
    assert slowed.plan.duration_s < slowed.plan.stitched.slowest_s


def test_a_shaft_that_cannot_vary_takes_the_highest_speed_that_is_still_enough(
    examples: Path,
) -> None:
    """In spec in twenty runs at that one speed, and out of spec if each turn is 3 % shorter."""
    machine = load_machine("schiffli-frame+one-speed")
    spec = load_spec(None, machine)
    proof = prove(examples / "rosette.dst", machine, spec, Options(), trials=REPEATED)
    assert proof.verdict.passed
    stitched = proof.plan.stitched
    assert stitched.constant and proof.plan.commands.counted_by == "time"
    turn_s = stitched.turns.turn_s[0]
    assert set(stitched.turns.turn_s.tolist()) == {turn_s}
    assert 0.4 < turn_s < stitched.slowest_s / len(stitched.turns) * 1.1
    faster = np.full(len(stitched.turns), turn_s / 1.03)
    assert stitched.pace.most_swings_m(stitched.turns.moves, faster).max() > 1e-4
    speed_text = dict(stitch_rows(proof.plan))["Speed"]
    assert speed_text.startswith("one for the whole design, which the spindle cannot vary")


def test_printed_speed_limit_holds_for_a_plan_at_one_speed(examples: Path) -> None:
    """The slowest stitch alone is no bound of one speed: 16.5 mm, still in every longer window."""
    job = read_job(examples / "rosette.dst", MACHINE)
    given = replace(Options(), feed=parse_feed("150 stitch/min"))
    rows = dict(stitch_rows(plan_job(job, MACHINE, given)))
    assert rows["Speed"] == "one for the whole design, as was given"
    pace = Pace(MACHINE, SINE, 1e-4)
    slowest = float(rows["Slowest stitch"].split(" stitches a minute")[0].split()[-1])
    longest = lasting_windows_s(SINE, FlexibleMode(12.0, 0.02), np.array([0.0165]), 1e-4)[0]
    assert slowest == pytest.approx(60.0 * pace.share / longest, rel=2e-3)
    assert "every lower speed" in rows["Slowest stitch"]
    assert "not a plan" in rows["Each stitch alone"]
    assert "At one speed" not in rows


def test_the_thread_of_a_design_is_the_length_of_its_stitches(examples: Path) -> None:
    """As the holes that pystitch reads lie apart; a thread change ends a thread."""
    read = pystitch.read(str(examples / "rosette.dst")).stitches
    threads: list[list[tuple[float, float]]] = [[]]
    for x, y, command in read:
        if command & 0xFF == pystitch.COLOR_CHANGE:
            threads.append([])
        if command & 0xFF == pystitch.STITCH:
            threads[-1].append((x, y))
    lengths = [1e-4 * sum(map(math.dist, holes, holes[1:])) for holes in threads if holes]
    assert len(lengths) == 2
    job = read_job(examples / "rosette.dst", MACHINE)
    plan = plan_job(job, MACHINE, replace(Options(), feed=parse_feed("150 stitch/min")))
    sewn = plan.stitched.sewn
    assert [one.thread_m for one in sewn] == pytest.approx(lengths, rel=1e-6)
    assert sum(one.duration_s for one in sewn) == pytest.approx(plan.duration_s, rel=1e-6)
    assert [one.stitches for one in sewn] == [len(holes) for holes in threads if holes]
    rows = dict(stitch_rows(plan))
    assert f"{sum(lengths):.4g} m on the upper side" in rows["Thread"]
    assert f"2 of unknown colour, {lengths[1]:.4g} m" in rows["Threads"]


@pytest.mark.parametrize("feed", ["200 stitch/min", "9 stitch/min"])
def test_a_speed_that_the_shaft_has_not_is_refused(feed: str, examples: Path) -> None:
    options = replace(Options(), feed=parse_feed(feed))
    with pytest.raises(PlanError, match=r"makes 10 to 166\.667"):
        plan_job(open_job(examples / "rosette.dst", MACHINE, options), MACHINE, options)


@pytest.mark.parametrize(
    "changed",
    [{"shaper": "zv:12Hz"}, {"interpolation": "linear"}, {"feed": parse_feed("10 mm/s")}],
)
def test_options_that_mean_nothing_are_refused(changed: dict, examples: Path) -> None:
    options = replace(Options(), **changed)
    with pytest.raises(OptionError, match="schiffli-frame"):
        open_job(examples / "rosette.dst", MACHINE, options)


def test_a_stitch_between_two_units_is_named_by_its_own_line(examples: Path) -> None:
    """The second of a run, a quarter of a unit off where the machine moves in whole ones."""
    job = read_job(examples / "rosette.dst", MACHINE)
    runs = list(job.runs())
    at, run = next((k, run) for k, run in enumerate(runs) if isinstance(run, MoveRun))
    targets, unit_m = run.targets.copy(), 1e-4
    x_m, y_m = targets[1] = targets[1] + [0.0, 0.25 * unit_m]
    runs[at] = replace(run, targets=targets, line=np.arange(4, 4 + len(run)))
    message = rf"a stitch at {x_m * 1e3:g}, {y_m * 1e3:g} mm is between the units of 0\.1 mm"
    with pytest.raises(PlanError, match=message) as caught:
        stitch(replace(job, operations=Stream.of(runs)), MACHINE, SINE, 5e-5, None)
    assert "rosette.dst:5:" in str(caught.value)


def test_a_thread_change_behind_the_last_stitch_sews_nothing(tmp_path: Path) -> None:
    """The frame travels on, as in files that end where they began; the picture has one thread."""
    pattern = pystitch.EmbPattern()
    for x, y in ((0, 0), (30, 0), (30, 30)):
        pattern.add_stitch_absolute(pystitch.STITCH, x, y)
    pattern.add_command(pystitch.COLOR_CHANGE)
    pattern.add_stitch_absolute(pystitch.JUMP, 60, 60)
    pattern.end()
    file = tmp_path / "a.exp"
    pystitch.write(pattern, str(file))
    options = replace(Options(), feed=parse_feed("60 stitch/min"))
    plan = plan_job(read_job(file, MACHINE), MACHINE, options)
    assert plan.stitched.turns.block.max() == 2
    assert [one.block for one in plan.stitched.sewn] == [1]
    (drawn,) = threads_figure(plan).axes[0].collections
    assert len(drawn.get_segments()) == plan.stitched.frame_moves.sum()
