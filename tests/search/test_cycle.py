"""The shortest cycle of the letter placer: the command finds it, and proves it again."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import threadline as tl
from tests.search.test_switched_commands import SCAN_S
from threadline.cli.main import main
from threadline.commands.intents import Scheduled
from threadline.commands.plan import Plan
from threadline.errors import OptionError, PlanError
from threadline.face.answers import FastestResult
from threadline.jobs import read_job
from threadline.jobs.operations import Move
from threadline.machine import Machine, load_machine
from threadline.machine.vary import off_tolerance
from threadline.proof.options import Options
from threadline.proof.pipeline import NOMINAL, plan_job, prove, prove_plan
from threadline.search import by_pace
from threadline.search.cycle import FastestCycle, fastest_cycle
from threadline.search.move_list import move_list, overlapped
from threadline.search.paced import Question
from threadline.verdict import load_spec
from threadline.verdict.types import Level

CYCLE = Path(__file__).parents[2] / "examples" / "letter-cycle.toml"
PLACER = "letter-placer+whole-scans+own-damping"


def run(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as ended:
        main([str(word) for word in words])
    out, err = capsys.readouterr()
    return int(ended.value.code or 0), out, err


@pytest.fixture(scope="module")
def best(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    """Return the answer of ``fastest --json``, and the move list that it wrote."""
    from contextlib import redirect_stdout
    from io import StringIO

    file = tmp_path_factory.mktemp("cycle") / "best.toml"
    stream = StringIO()
    with redirect_stdout(stream), pytest.raises(SystemExit) as ended:
        main(["fastest", str(CYCLE), "-m", PLACER, "-o", str(file), "--json"])
    assert ended.value.code == 0
    return json.loads(stream.getvalue()), file


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
    """No command is more than two scans longer than the time-optimal command without ringing.

    It may be shorter, because ringing up to the limit of the specification is allowed.
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
    # The list waits for a contact at three places, and each may come a scan sooner or later.
    assert found["best"] - found["unshaped_overlapped_s"] == pytest.approx(saved, abs=0.031)
    assert found["time_optimal_moves_s"] == pytest.approx(
        sum(m["time_optimal_s"] for m in found["moves"])
    )


def test_written_cycle_proves_with_the_same_figures(
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
    """Return the cycle that is found for the machine of the file."""
    machine = load_machine("letter-placer")
    return fastest_cycle(
        Question(job=read_job(CYCLE, machine), machine=machine, spec=load_spec(None, machine))
    )


@pytest.mark.long(shown_by="test_the_fastest_is_in_spec_and_shorter_than_every_shaper")
def test_cycle_for_another_machine_uses_commands_planned_for_the_file(typed: FastestCycle) -> None:
    """With stiffer springs the cycle for the file fails, and the cycle for this machine passes.

    Both are proved anew, in one run each, on the machine whose springs are at their upper ends.
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
    assert passes(fastest_cycle(Question(job=job, machine=machine, spec=spec, actual=stiff)))


def test_the_command_searches_over_tolerances(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    typed: FastestCycle,
) -> None:
    """Nine machines run the cycles; the plans are made for the machine of the file.

    The cycle for the machine of the file is known, and is not searched a second time.
    """
    machine = load_machine("letter-placer")
    ran: list[Machine] = []

    def canned(asked: Question) -> FastestCycle:
        assert (asked.machine, asked.trials) == (machine, NOMINAL)
        if asked.actual is None:
            return typed
        ran.append(asked.actual)
        return typed if len(ran) != 5 else replace(typed, job=None)

    monkeypatch.setattr(by_pace, "fastest_cycle", canned)
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
    assert "--out" in err and "the feed is searched" in err


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
    ("line", "message"),
    [
        ('levels = "1 for 490 ms"', "by 208.51 mm, and its move is 200.00 mm"),
        ('levels = "1 for 475 ms"', "475 ms is no whole number of scans of 10 ms"),
        ('levels = "full for 470 ms"', "'full for 470 ms' is not a level with its time"),
        ('levels = "1 for 10 ms, 0 for 10 ms, 1 for 460 ms"', "would switch again after 10 ms"),
        ('levels = "0.8 for 200 ms, 1 for 310 ms"', "make the level 0.8000"),
        ('shaper = "zzv"', "unknown shaper 'zzv'"),
    ],
)
def test_levels_that_no_valve_makes_are_refused_with_their_line(
    line: str, message: str, tmp_path: Path
) -> None:
    file = tmp_path / "a.toml"
    file.write_text(
        '[[operation]]\nvalve = "main_air"\n\n[[operation]]\nmove = { X = "200 mm" }\n' + line,
        encoding="utf-8",
    )
    machine = load_machine(PLACER)
    with pytest.raises(PlanError) as refused:
        plan_job(read_job(file, machine), machine, Options())
    assert message in str(refused.value)
    assert "a.toml:4" in str(refused.value)


def test_a_shaper_of_a_move_is_that_of_its_cylinder(tmp_path: Path) -> None:
    """Written in the list or given for the cylinder, the shaper has the same switchings."""
    machine = load_machine(PLACER)
    text = '[[operation]]\nvalve = "main_air"\n\n[[operation]]\nmove = { X = "200 mm" }\n'
    plain, own = tmp_path / "a.toml", tmp_path / "b.toml"
    plain.write_text(text, encoding="utf-8")
    own.write_text(f'{text}shaper = "zv"\n', encoding="utf-8")
    given = plan_job(read_job(plain, machine), machine, Options(shaper="X=zv, Z=none")).commands
    written = plan_job(read_job(own, machine), machine, Options(shaper="um-zv")).commands
    assert np.array_equal(given.ticks, written.ticks)
    assert np.array_equal(given.levels, written.levels)


@pytest.mark.long(shown_by="test_the_fastest_is_in_spec_and_shorter_than_every_shaper")
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
    assert "overlapping moves, as the list allows, save 0." in out
    listed = tmp_path / "listed.toml"
    text = CYCLE.read_text(encoding="utf-8")
    listed.write_text(text.replace("\nmove =", "\noverlap = false\nmove ="), encoding="utf-8")
    code, out, _ = run(capsys, "fastest", listed, "-m", PLACER, "-s", spec, "--nominal")
    assert code == 0
    assert "fastest: a cycle of 8.010 s; 1 cycles tried on the twin" in out
    again = f"To prove it: threadline prove {listed} -m {PLACER} -s {spec} --nominal"
    assert out.splitlines()[-1] == again


def test_only_what_a_switch_guards_overlaps() -> None:
    """The moves after the lift and the first return move overlap; the others start at rest.

    The rest is cut at the instant at which the piston passes its switch: dead time, then an
    exponential over speed times lag. Here it is computed by hand for the lift, 6 mm before its end.
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


def test_a_vacuum_is_drawn_while_its_cylinder_comes_to_rest() -> None:
    """The vacuum is on at the switch of the descent, 0.25 s sooner; the knife waits for the rest.

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


TO_AND_FRO = """name = "to and fro"
[[operation]]
valve = "main_air"
[[operation]]
move = { X = "200 mm" }
[[operation]]
move = { X = "0 mm" }
"""


def _rows(plan: Plan) -> str:
    return plan.commands.rows_sha256()


def test_python_proves_the_cycle_by_the_file_that_it_writes(tmp_path: Path) -> None:
    """Each move has a command of its own, and no option of ``prove`` gives that."""
    job = tmp_path / "to and fro.toml"
    job.write_text(TO_AND_FRO)
    found = tl.fastest(job, "letter-placer", level="nominal")
    assert found.best_options is None and found.move_list is not None
    assert 'no options describe it; .prove("best.toml") writes its move list' in repr(found)
    with pytest.raises(OptionError, match=r'there is no file for it. Give one: \.prove\("best'):
        found.prove()
    with pytest.raises(OptionError, match="is the move list that was searched"):
        found.prove(job)
    assert job.read_text() == TO_AND_FRO
    proof = found.prove(tmp_path / "best.toml")
    assert proof.passed and proof.verdict.level is Level.NOMINAL
    assert proof.verdict.result("cycle_time").measured == found.best
    assert _rows(proof.plan) == _rows(found.of.proof.plan)
    again = tl.prove(found.write(tmp_path / "again.toml"), "letter-placer", level="nominal")
    assert _rows(again.plan) == _rows(proof.plan)
    file = tmp_path / "by line.toml"
    with pytest.raises(SystemExit):
        main(["fastest", str(job), "-m", "letter-placer", "--nominal", "-o", str(file)])
    assert file.read_text() == found.move_list


def test_options_describe_a_cycle_only_if_they_plan_it(tmp_path: Path) -> None:
    """Commands that a list gives for a move are not replaced by an option."""
    spec = tmp_path / "slow.toml"
    spec.write_text('name = "slow"\n[[criteria]]\nname = "cycle_time"\nlimit = "9 s"\n')
    words = {"spec": spec, "level": "nominal"}
    plain, shaped = tmp_path / "plain.toml", tmp_path / "shaped.toml"
    plain.write_text(TO_AND_FRO)
    shaped.write_text(TO_AND_FRO.replace('"200 mm" }', '"200 mm" }\nshaper = "um-zvd"'))
    by_options = tl.fastest(plain, "letter-placer", **words)  # type: ignore[arg-type]
    assert by_options.best_options == {}
    assert _rows(by_options.prove().plan) == _rows(by_options.of.proof.plan)
    by_file = tl.fastest(shaped, "letter-placer", **words)  # type: ignore[arg-type]
    assert by_file.best_options is None and by_file.best == by_options.best
    typed = tl.prove(shaped, "letter-placer", **words)  # type: ignore[arg-type]
    assert _rows(typed.plan) != _rows(by_file.of.proof.plan)
    assert _rows(by_file.prove(tmp_path / "best.toml").plan) == _rows(by_file.of.proof.plan)


def test_a_file_is_for_move_lists_alone() -> None:
    found = FastestResult(
        best=0.02, unit="m/s", limited_by="a", of=None, best_options={}, _asked=lambda *_: None
    )
    with pytest.raises(OptionError, match="the best plan has options, and no file"):
        found.prove("best.toml")
