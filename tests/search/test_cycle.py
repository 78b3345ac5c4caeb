"""The shortest cycle of the letter placer, and the closed form that leads to it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from threadline.cli import fastest_cycle as of_command
from threadline.cli.main import main
from threadline.errors import PlanError
from threadline.jobs import Job, read_job
from threadline.jobs.operations import Move
from threadline.machine import Machine, load_machine
from threadline.machine.vary import off_tolerance
from threadline.options import Options
from threadline.pipeline import NOMINAL, plan_job, prove, prove_plan, write
from threadline.search import mismatch
from threadline.search.cycle import FastestCycle, fastest_cycle
from threadline.search.levels import gapped, left_ringing, stepped, time_optimal_s
from threadline.search.move_list import move_list, overlapped
from threadline.targets.schedule import Scheduled
from threadline.targets.schedule_moves import AT_ONCE
from threadline.verdict import Spec, Status, load_spec

CYCLE = Path(__file__).parents[2] / "examples" / "letter-cycle.toml"
PLACER = "letter-placer+whole-scans+own-damping"
SCAN_S = 0.01
POLE = -0.15 + 18.3j
TURN = complex(np.exp(POLE * SCAN_S))


def run(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as ended:
        main([str(word) for word in words])
    out, err = capsys.readouterr()
    return int(ended.value.code or 0), out, err


def integrated(ticks: tuple[int, ...], levels: tuple[float, ...]) -> float:
    """Return the amplitude behind a command by DOP853, over that of one step.

    q'' - 2 Re(p) q' + |p|^2 q = |p|^2 u: q rests at u, and a step leaves an envelope of its own
    that the same equation gives; both envelopes are taken from q - u and its rate.
    """

    def rates(u: float) -> Any:
        return lambda _, x: [x[1], abs(POLE) ** 2 * (u - x[0]) + 2.0 * POLE.real * x[1]]

    def envelope(state: np.ndarray, u: float) -> float:
        away, rate = state[0] - u, state[1]
        return float(np.hypot(away, (rate - POLE.real * away) / POLE.imag))

    state = np.zeros(2)
    for begin, end, level in zip(ticks, ticks[1:], levels, strict=False):
        span = (0.0, (end - begin) * SCAN_S)
        done = solve_ivp(rates(level), span, state, "DOP853", rtol=1e-11, atol=1e-13)
        state = done.y[:, -1]
    return envelope(state, levels[-1]) / envelope(np.zeros(2), 1.0)


@pytest.mark.parametrize(
    ("ticks", "levels"),
    [
        ((0, 47), (1.0, 0.0)),
        ((0, 11, 15, 42, 48, 57), (1.0, 0.0, 1.0, 0.0, 1.0, 0.0)),
        ((0, 14, 50, 64), (0.63, 1.0, 0.37, 0.0)),
    ],
)
def test_closed_form_is_what_an_integrator_finds(
    ticks: tuple[int, ...], levels: tuple[float, ...]
) -> None:
    assert abs(left_ringing(ticks, levels, TURN, AT_ONCE)) == pytest.approx(
        integrated(ticks, levels), abs=1e-8
    )


def test_candidates_cover_the_distance_and_keep_the_dwell() -> None:
    made = [
        *gapped(47, 2, TURN, 0.1, 10, AT_ONCE),
        *stepped(47, 2, TURN, 0.1, [(0.507, 0.493)], AT_ONCE),
    ]
    assert {c.levels[0] for c in made} == {1.0, 0.507}
    for command in made:
        spans = np.diff(command.ticks)
        assert spans.min() >= 2
        assert float(spans @ command.levels[:-1]) == pytest.approx(47.0, abs=1e-9)
        assert abs(command.left) <= 0.1
        assert command.left == pytest.approx(
            left_ringing(command.ticks, command.levels, TURN, AT_ONCE), abs=1e-12
        )


def symmetric(on_s: float, omega: float) -> float:
    """Return the shortest duration of on, gap, on, gap, on that leaves an undamped mode at rest.

    About the middle the ringing has one quadrature: sin(w T/2) - sin(w (b/2 + g)) + sin(w b/2) = 0
    with b the middle stretch and g a gap, T = on + 2 g. Every b is tried, with its first root g.
    """
    best = np.inf
    for b in np.linspace(0.02, 0.98, 400) * on_s:
        g = np.linspace(0.0, 0.5 * np.pi / omega, 4000)
        left = np.sin(0.5 * omega * on_s + omega * g) - np.sin(omega * (0.5 * b + g))
        left += np.sin(0.5 * omega * b)
        crossed = np.flatnonzero(np.diff(np.sign(left)) != 0)
        if len(crossed):
            best = min(best, on_s + 2.0 * float(g[crossed[0]]))
    return best


def test_time_optimal_commands() -> None:
    """Excited for whole periods an undamped mode is at rest behind: nothing is faster.

    Else the optimum switches, symmetric about its middle as undamped optima are; found here by
    its own equation. The grid of the program is 1/800 of the duration: 2 ms with margin.
    """
    omega = 18.3
    period_s = 2.0 * np.pi / omega
    assert time_optimal_s(2.0 * period_s, omega * 1j) == pytest.approx(2.0 * period_s, abs=1e-9)
    for on_s in (0.47, 0.5, 1.5 * period_s):
        assert time_optimal_s(on_s, omega * 1j) == pytest.approx(symmetric(on_s, omega), abs=2e-3)


@pytest.fixture(scope="module")
def best(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    """Return what ``fastest --json`` says and the move list that it wrote."""
    from contextlib import redirect_stdout
    from io import StringIO

    file = tmp_path_factory.mktemp("cycle") / "best.toml"
    said = StringIO()
    with redirect_stdout(said), pytest.raises(SystemExit) as ended:
        main(["fastest", str(CYCLE), "-m", PLACER, "-o", str(file), "--json"])
    assert ended.value.code == 0
    return json.loads(said.getvalue()), file


def test_the_fastest_is_in_spec_and_shorter_than_every_shaper(
    best: tuple[dict[str, Any], Path],
) -> None:
    found, _ = best
    machine = load_machine(PLACER)
    spec = load_spec(None, machine)
    in_spec = []
    for shaper in ("zv", "um-zv", "um-zvd"):
        proof = prove(CYCLE, machine, spec, Options(shaper=shaper))
        if proof.verdict.passed:
            in_spec.append(proof.verdict.result("cycle_time").measured)
    assert found["unit"] == "s"
    assert found["verdict"]["passed"]
    assert found["unshaped_overlapped_s"] < found["unshaped_s"] - 0.4
    assert found["unshaped_overlapped_s"] < found["best"] < min(filter(None, in_spec)) - 0.3
    assert not found["unshaped_passed"]
    assert found["intervals"] == [[found["best"], found["best"]]]
    assert found["limited_by"] == "residual_vibration"


def test_move_by_move_it_is_near_the_time_optimum(best: tuple[dict[str, Any], Path]) -> None:
    """No command of whole scans that leaves little is more than two scans over the optimum.

    It may be below: up to the limit of the specification may ring.
    """
    found, _ = best
    assert [(m["step"], m["axis"]) for m in found["moves"]] == [
        ("descend", "Z"), ("lift", "Z"), ("across", "X"),
        ("leave", "Z"), ("return", "Z"), ("return", "X"),
    ]  # fmt: skip
    for move in found["moves"]:
        assert move["unshaped_s"] < move["time_optimal_s"]
        assert move["command_s"] + move["wait_s"] < move["time_optimal_s"] + 2.0 * SCAN_S
    saved = sum(m["command_s"] + m["wait_s"] - m["unshaped_s"] for m in found["moves"])
    # A contact that is waited for may come a scan sooner or later, at three places.
    assert found["best"] - found["unshaped_overlapped_s"] == pytest.approx(saved, abs=0.031)
    assert found["time_optimal_moves_s"] == pytest.approx(
        sum(m["time_optimal_s"] for m in found["moves"])
    )


def test_what_it_wrote_proves_the_same(
    best: tuple[dict[str, Any], Path], capsys: pytest.CaptureFixture[str]
) -> None:
    found, file = best
    assert found["command"].startswith(f"threadline prove {file}")
    code, out, _ = run(capsys, "prove", file, "-m", PLACER, "--json")
    proved = json.loads(out)
    assert code == 0

    def figures(criteria: list[dict[str, Any]]) -> list[tuple[Any, ...]]:
        return [(c["name"], c["axis"], c.get("step"), c["measured"]) for c in criteria]

    assert figures(proved["criteria"]) == figures(found["verdict"]["criteria"])


@pytest.fixture(scope="module")
def typed() -> FastestCycle:
    """Return what is found for the machine as its file says."""
    machine = load_machine("letter-placer")
    return fastest_cycle(read_job(CYCLE, machine), machine, load_spec(None, machine))


def test_off_its_file_the_cycle_is_found_with_commands_for_the_file(typed: FastestCycle) -> None:
    """Springs at their upper ends: the cycle for the file fails there, the one found passes.

    Both are proved anew, one run each, on the machine that is off its file.
    """
    machine = load_machine("letter-placer")
    spec = load_spec(None, machine)
    stiff = off_tolerance(machine, stiffness=1.0)
    job = read_job(CYCLE, machine)

    def passes(found: FastestCycle) -> bool:
        assert found.job is not None
        plan = plan_job(found.job, machine, Options())
        return prove_plan(plan, spec, actual=stiff).verdict.passed

    assert not passes(typed)
    assert passes(fastest_cycle(job, machine, spec, actual=stiff))


def test_the_command_searches_over_tolerances(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    typed: FastestCycle,
) -> None:
    """Nine machines run the cycles, and the plans are made for the file's.

    What the command finds for the file itself is known: it is not searched a second time.
    """
    machine = load_machine("letter-placer")
    ran: list[Machine] = []

    def known(_job: Job, planned: Machine, _spec: Spec, **asked: Any) -> FastestCycle:
        assert (planned, asked["actual"], asked["trials"]) == (machine, None, NOMINAL)
        return typed

    def canned(_job: Job, planned: Machine, _spec: Spec, *, actual: Machine) -> FastestCycle:
        assert planned == machine
        ran.append(actual)
        return typed if len(ran) != 5 else replace(typed, job=None)

    monkeypatch.setattr(of_command, "fastest_cycle", known)
    monkeypatch.setattr(mismatch, "fastest_cycle", canned)
    words = ["fastest", CYCLE, "-m", "letter-placer", "--nominal", "--mismatch", "--json"]
    code, out, err = run(capsys, *words, "--report", tmp_path / "r")
    cells = json.loads(out)["mismatch"]
    assert (code, err, len(cells)) == (0, "", 9)
    assert ran == [
        off_tolerance(machine, mass=m, stiffness=k) for m in (-1, 0, 1) for k in (-1, 0, 1)
    ]
    assert cells[0]["best"] == pytest.approx(typed.cycle_s)
    assert (cells[4]["best"], cells[4]["intervals"]) == (None, [])
    drawn = (tmp_path / "r" / "tolerances.svg").read_text(encoding="utf-8")
    assert "shortest in spec, s" in drawn


def test_options_of_feeds_are_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    for words in (["--low", "1 mm/s"], ["--feed-forward"], ["--interpolation", "linear"]):
        code, out, err = run(capsys, "fastest", CYCLE, "-m", PLACER, *words)
        assert (code, out, err.count("\n")) == (2, "", 1)
    job = CYCLE.parent / "x-180.prg"
    code, _, err = run(capsys, "fastest", job, "-m", "lathe-winder", "-o", tmp_path / "x.toml")
    assert code == 2
    assert "--out" in err and "of which the feed is searched" in err


def test_a_move_list_reads_back_as_itself(tmp_path: Path) -> None:
    machine = load_machine(PLACER)
    job = read_job(CYCLE, machine)
    copy = tmp_path / "copy.toml"
    copy.write_text(move_list(job, machine), encoding="utf-8")
    again = read_job(copy, machine)
    ours, theirs = (plan_job(j, machine, Options(shaper="zv")).commands for j in (job, again))
    assert np.array_equal(ours.ticks, theirs.ticks)
    assert np.array_equal(ours.levels, theirs.levels)
    assert [e.name for e in ours.events] == [e.name for e in theirs.events]
    assert again.name == job.name


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ('levels = "1 for 490 ms"', "move the piston by 208.51 mm of 200.00 mm"),
        ('levels = "1 for 475 ms"', "475 ms is no whole number of scans of 10 ms"),
        ('levels = "full for 470 ms"', "'full for 470 ms' is no level for a time"),
        ('levels = "1 for 10 ms, 0 for 10 ms, 1 for 460 ms"', "would switch again after 10 ms"),
        ('levels = "0.8 for 200 ms, 1 for 310 ms"', "make the level 0.8000"),
        ('shaper = "zzv"', "unknown shaper 'zzv'"),
    ],
)
def test_levels_that_no_valve_makes_are_refused_with_their_line(
    line: str, said: str, tmp_path: Path
) -> None:
    file = tmp_path / "a.toml"
    file.write_text(
        '[[operation]]\nvalve = "main_air"\n\n[[operation]]\nmove = { X = "200 mm" }\n' + line,
        encoding="utf-8",
    )
    machine = load_machine(PLACER)
    with pytest.raises(PlanError) as refused:
        plan_job(read_job(file, machine), machine, Options())
    assert said in str(refused.value)
    assert "a.toml:4" in str(refused.value)


def test_a_shaper_of_a_move_is_that_of_its_cylinder(tmp_path: Path) -> None:
    """Written in the list or given for the cylinder: the same switchings."""
    machine = load_machine(PLACER)
    text = '[[operation]]\nvalve = "main_air"\n\n[[operation]]\nmove = { X = "200 mm" }\n'
    plain, own = tmp_path / "a.toml", tmp_path / "b.toml"
    plain.write_text(text, encoding="utf-8")
    own.write_text(f'{text}shaper = "zv"\n', encoding="utf-8")
    given = plan_job(read_job(plain, machine), machine, Options(shaper="X=zv, Z=none")).commands
    written = plan_job(read_job(own, machine), machine, Options(shaper="um-zv")).commands
    assert np.array_equal(given.ticks, written.ticks)
    assert np.array_equal(given.levels, written.levels)


def test_a_specification_that_asks_little_keeps_the_cycle_as_it_is(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    spec = tmp_path / "loose.spec.toml"
    spec.write_text(
        'name = "loose"\n[[criteria]]\nname = "residual_vibration"\nlimit = "3 mm"\n',
        encoding="utf-8",
    )
    code, out, _ = run(capsys, "fastest", CYCLE, "-m", PLACER, "-s", spec)
    assert code == 0
    assert "1 cycles tried on the twin; unshaped it takes 8.010 s and is in spec (repeated)" in out
    assert "what the list lets overlap saves 0." in out
    listed = tmp_path / "listed.toml"
    text = CYCLE.read_text(encoding="utf-8")
    listed.write_text(text.replace("\nmove =", "\noverlap = false\nmove ="), encoding="utf-8")
    code, out, _ = run(capsys, "fastest", listed, "-m", PLACER, "-s", spec, "--nominal")
    assert code == 0
    assert "fastest: a cycle of 8.010 s; 1 cycles tried on the twin" in out
    again = f"To prove it: threadline prove {listed} -m {PLACER} -s {spec} --nominal"
    assert out.splitlines()[-1] == again


def test_only_what_a_switch_guards_overlaps() -> None:
    """Behind lift, across and the first of the return; a tool, letting go and the end come at rest.

    The rest is cut to when the piston passes its switch: dead time, then speed times lag to go as
    an exponential, here by hand for the lift, 6 mm before its end.
    """
    machine = load_machine(PLACER)
    job = overlapped(read_job(CYCLE, machine), machine)
    rests = [o.tags.get("rest") for o in job if isinstance(o, Move)]
    lift = 0.1 + 0.06 * np.log(0.2 * 0.06 / 0.006)
    assert [rest is not None for rest in rests] == [True, True, True, False, True, False]
    assert rests[1] == pytest.approx(lift, abs=1e-5)
    again = [o.tags.get("rest") for o in overlapped(job, machine) if isinstance(o, Move)]
    assert again == rests


def test_a_rest_that_a_list_writes_is_the_one_that_passes(tmp_path: Path) -> None:
    machine = load_machine(PLACER)
    spans = []
    for rest in ("", 'rest = "0 s"\n', 'rest = "2 s"\n'):
        file = tmp_path / "a.toml"
        file.write_text(
            '[[operation]]\nvalve = "main_air"\n\n[[operation]]\n'
            f'move = {{ Z = "100 mm" }}\n{rest}\n[[operation]]\ndwell = "10 ms"\n',
            encoding="utf-8",
        )
        job = read_job(file, machine)
        scheduled = plan_job(job, machine, Options()).scheduled
        spans.append(scheduled.commands.duration_ticks - scheduled.moves[0].last_tick)
        file.write_text(move_list(job, machine), encoding="utf-8")
        assert next(o for o in read_job(file, machine) if isinstance(o, Move)).tags == (
            next(o for o in job if isinstance(o, Move)).tags
        )
    assert spans == [34 + 1, 1 + 1, 200 + 1]


def test_every_tenth_scan_of_a_quick_controller_is_looked_at() -> None:
    """The same commands as on a scan ten times as long, ten times as many scans each."""
    coarse = gapped(47, 2, TURN, 0.1, 10, AT_ONCE)
    fine = gapped(470, 20, TURN**0.1, 0.1, 100, AT_ONCE, step=10)
    assert [tuple(10 * t for t in c.ticks) for c in coarse] == [c.ticks for c in fine]
    assert coarse


def test_a_vacuum_is_drawn_while_its_cylinder_comes_to_rest() -> None:
    """At the switch behind the descent: 0.25 s sooner, and the knife no sooner than at rest.

    By hand: dead time and the exponential to 6 mm before the end, and four lags for the rest.
    """
    machine = load_machine("letter-placer")
    job = read_job(CYCLE, machine)
    free = overlapped(job, machine)
    listed, cut = (plan_job(one, machine, Options()).scheduled for one in (job, free))

    def on(scheduled: Scheduled, output: str) -> int:
        column = scheduled.commands.outputs.index(output)
        return int(scheduled.commands.ticks[scheduled.commands.levels[:, column] > 0][0])

    down = [next(m.last_tick for m in s.moves if m.step == "descend") for s in (listed, cut)]
    switch = 0.1 + 0.06 * np.log(0.2 * 0.06 / 0.006)
    assert on(listed, "venturi") - down[0] == 34 + 1
    assert on(cut, "venturi") - down[1] == np.ceil(100 * switch) + 1 == 15 + 1
    assert on(listed, "knife") - down[0] == 34 + 2
    assert on(cut, "knife") - down[1] == pytest.approx(34, abs=1)
    assert on(cut, "knife") - down[1] >= 34
    assert list(overlapped(free, machine)) == list(free), "once is enough"


TOGETHER = """
[[operation]]
step = "start"
valve = "main_air"

[[operation]]
step = "out"
move = { X = "200 mm", Z = "100 mm" }

[[operation]]
step = "back"
move = { Z = "0 mm" }

[[operation]]
move = { X = "0 mm" }
"""


def unlocked() -> Machine:
    """Return the letter placer as one whose slide may move with the lift anywhere."""
    machine = load_machine("letter-placer")
    slide = replace(machine.cylinders["X"], needs=())
    return replace(machine, cylinders={**machine.cylinders, "X": slide})


@pytest.fixture(scope="module")
def together(tmp_path_factory: pytest.TempPathFactory) -> tuple[Job, FastestCycle]:
    machine = unlocked()
    file = tmp_path_factory.mktemp("together") / "both.toml"
    file.write_text(TOGETHER, encoding="utf-8")
    job = read_job(file, machine)
    return job, fastest_cycle(job, machine, load_spec(None, machine))


def test_cylinders_that_set_out_together_have_a_command_each(
    together: tuple[Job, FastestCycle], tmp_path: Path
) -> None:
    """In spec on the twin, both from the same scan on, and the list that is written says so."""
    machine = unlocked()
    _, found = together
    assert found.job is not None
    assert found.proof.verdict.passed
    x, z, *_ = found.proof.plan.scheduled.moves
    assert (x.axis, z.axis) == ("X", "Z")
    assert x.operation == z.operation
    assert x.first_tick == z.first_tick
    assert x.levels.levels != (1.0, 0.0) or z.levels.levels != (1.0, 0.0), "unshaped it rings"
    file = tmp_path / "written.toml"
    file.write_text(move_list(found.job, machine), encoding="utf-8")
    assert "levels = { X = " in file.read_text(encoding="utf-8")
    again = plan_job(read_job(file, machine), machine, Options())
    assert again.scheduled.commands.ticks.tolist() == (
        found.proof.plan.scheduled.commands.ticks.tolist()
    )
    out = tmp_path / "written.st"
    write(again, "st", out)
    assert out.exists()


def test_together_is_as_short_as_the_longer_of_both(together: tuple[Job, FastestCycle]) -> None:
    """And shorter than one after the other, by the whole of the shorter stroke with its rest."""
    machine = unlocked()
    job, found = together
    apart = read_job_text(TOGETHER.replace('X = "200 mm", Z', "Z"), machine, job)
    alone = fastest_cycle(apart, machine, load_spec(None, machine))
    assert alone.job is not None
    saved = 0.5 + machine.cylinders["Z"].rest_s(forward=True)
    assert found.cycle_s is not None
    assert alone.cycle_s is not None
    assert alone.cycle_s - found.cycle_s > 0.9 * saved


def read_job_text(text: str, machine: Machine, beside: Job) -> Job:
    """Return a job of text, with the slide sent out behind the lift."""
    file = Path(beside.file).with_name("apart.toml")
    after = text.replace(
        'move = { Z = "100 mm" }',
        'move = { Z = "100 mm" }\n\n[[operation]]\nmove = { X = "200 mm" }',
    )
    file.write_text(after, encoding="utf-8")
    return read_job(file, machine)


@pytest.mark.parametrize(
    ("levels", "words"),
    [
        ('{ X = "1 for 470 ms", Y = "1 for 500 ms" }', "levels are given for 'Y', which this"),
        ('{ X = "1 for 470 ms", Z = 7 }', "levels of Z: 7 is no text of levels"),
        ('{ X = "1 for 470 ms", Z = "1 for 100 ms" }', "move the piston by 20.00 mm of 100.00 mm"),
        ("[1, 2]", "levels = [1, 2] is no text"),
    ],
)
def test_levels_of_each_that_are_wrong_are_refused(
    levels: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "both.toml"
    both = 'move = { X = "200 mm", Z = "100 mm" }'
    file.write_text(TOGETHER.replace(both, f"{both}\nlevels = {levels}"), encoding="utf-8")
    code, out, err = run(capsys, "prove", file, "-m", "letter-placer")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert words in err
    assert "both.toml:" in err


AT_ONCE_BACK = """
[[operation]]
step = "start"
valve = "main_air"

[[operation]]
step = "out"
move = { X = "200 mm" }

[[operation]]
wait = "x_is_right"

[[operation]]
step = "back"
move = { X = "0 mm" }
"""


def test_a_cycle_is_found_where_a_cylinder_goes_back_at_once(tmp_path: Path) -> None:
    """What rings after the first stroke is measured, and learned from: every step is in spec."""
    machine = load_machine("letter-placer")
    file = tmp_path / "back.toml"
    file.write_text(AT_ONCE_BACK, encoding="utf-8")
    found = fastest_cycle(read_job(file, machine), machine, load_spec(None, machine))
    assert found.job is not None
    told = [r for r in found.proof.verdict.results if r.name == "residual_vibration"]
    assert {r.step for r in told} == {"start", "out", "back"}
    assert all(r.status is Status.PASSED for r in told)
