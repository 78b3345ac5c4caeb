"""Only proved commands move the machine, and a run is judged as its proof was."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.live.bench import Bench, table_of_counts, there_and_back, winder
from tests.made import read_once
from threadline import machine as machine_package
from threadline.cli import report_, run_
from threadline.cli.main import main
from threadline.errors import CommandError, LimitError, OptionError, PlanError, ProofError
from threadline.files import Stream, TickBlock, tick_table
from threadline.files.formats import read_recording
from threadline.live.supervised import check_halts, check_override, check_runnable
from threadline.machine import load_machine
from threadline.proof import proof_file
from threadline.proof.options import Options
from threadline.proof.pipeline import Proof, open_job, plan_job, prove_plan
from threadline.proof.proof_file import write_proof
from threadline.verdict import load_spec

LIBRARY = Path(machine_package.__file__).parent / "library"
EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture(scope="module")
def proof() -> Proof:
    options = Options(interpolation="linear")
    plan = plan_job(open_job(EXAMPLES / "x-180.prg", winder(), options), winder(), options)
    return prove_plan(plan, load_spec(None, winder()))


@pytest.fixture
def written(proof: Proof, tmp_path: Path) -> Path:
    write_proof(proof, tmp_path / "a.proof.json")
    return tmp_path / "a.proof.json"


def _changed(block: TickBlock, row: int) -> Iterator[TickBlock]:
    counts = block.counts.copy()
    counts[row, 1] += 1
    yield replace(block, counts=counts)


def test_one_changed_row_is_refused(proof: Proof, written: Path) -> None:
    assert check_runnable(written, proof.plan, proof.spec, None).passed
    table = tick_table(proof.plan.commands)
    (block,) = table
    for row in (0, 700, len(block) - 1):
        other = replace(table, blocks=Stream(_changed, block, row))
        plan = replace(proof.plan, commands=other)
        with pytest.raises(ProofError, match="commands 'ticks' has the sha256"):
            check_runnable(written, plan, proof.spec, None)


def test_another_job_machine_spec_or_version_is_refused(
    proof: Proof, written: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = load_machine("lathe-winder+physical")
    for plan, spec, what in (
        (replace(proof.plan, job=replace(proof.plan.job, sha256="0" * 64)), proof.spec, "job"),
        (replace(proof.plan, machine=other), proof.spec, "machine"),
        (proof.plan, replace(proof.spec, lag_s=0.5), "spec"),
    ):
        with pytest.raises(ProofError, match=f"{what} '"):
            check_runnable(written, plan, spec, "all the same")
    monkeypatch.setattr(proof_file, "__version__", "0.0.1")
    with pytest.raises(ProofError, match=r"threadline is version 0\.0\.1"):
        check_runnable(written, proof.plan, proof.spec, None)


def test_out_of_specification_takes_a_reason(proof: Proof, tmp_path: Path) -> None:
    spec = proof.spec
    tight = replace(
        spec,
        criteria=tuple(
            replace(c, limit=1e-9) if c.name == "contour_error" else c for c in spec.criteria
        ),
    )
    file = tmp_path / "tight.proof.json"
    write_proof(prove_plan(proof.plan, tight), file)
    with pytest.raises(ProofError, match=r"out of specification: contour_error.*--override"):
        check_runnable(file, proof.plan, tight, None)
    assert check_runnable(file, proof.plan, tight, "test of the brake")


@pytest.mark.parametrize("override", ["", "  ", "\u200b\u202e", "\x00\x1b", "...", "-"])
def test_an_override_without_a_word_gives_no_reason(override: str) -> None:
    with pytest.raises(OptionError, match="gives no reason"):
        check_override(override)


@pytest.mark.parametrize("override", [None, "scrap", "7", "Versuch", "\u8bd5\u9a8c"])
def test_an_override_with_a_word_is_taken(override: str | None) -> None:
    check_override(override)


def test_the_remedy_is_of_the_kind_of_work(tmp_path: Path) -> None:
    """Cylinders have neither a feed nor a needle that could be slower."""
    placer, file = load_machine("letter-placer"), tmp_path / "cycle.proof.json"
    job = open_job(EXAMPLES / "letter-cycle.toml", placer, Options())
    found = prove_plan(plan_job(job, placer, Options()), load_spec(None, placer))
    write_proof(found, file)
    remedies = {
        "switchings": r"Shape its moves \(--shaper\), or let it rest longer \(threadline fastest",
        "needle": "Lower the speed of the needle",
        "shaft": "Lower the speed of the shaft",
        "feed": "Lower the feed",
    }
    for pace, remedy in remedies.items():
        plan = replace(found.plan, job=replace(job, paced_by=pace))
        with pytest.raises(ProofError, match=f"residual_vibration Z. {remedy}"):
            check_runnable(file, plan, found.spec, None)


def test_there_must_be_something_to_override(proof: Proof, written: Path) -> None:
    with pytest.raises(OptionError, match="nothing to override"):
        check_runnable(written, proof.plan, proof.spec, "I feel like it")


def test_a_stop_that_nobody_answers_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "stop.prg"
    file.write_text("%\nO 1;\nN 10 G01 F 2160;\nG91;\nX 5;\nM00;\nX -5;\nM30;\n%\n", "utf-8")
    options = Options(interpolation="linear")
    plan = plan_job(open_job(file, winder(), options), winder(), options)
    with pytest.raises(PlanError, match=r"stop.prg:5: the program stops after this.*--pass-stops"):
        check_halts(plan, answered=False)
    check_halts(plan, answered=True)

    for passed in (True, False):
        bench = Bench().ready()
        bench.executor.start(tick_table(plan.commands), pass_stops=passed)
        bench.go_on(1500 if not passed else None)
        assert bench.executor.state == ("idle" if passed else "holding")


def test_rows_beyond_travel_or_speed_are_never_sent() -> None:
    """The executor checks each row itself, whatever its origin."""
    start = np.array([0, 27000, 0])  # 12 mm before the end of X
    bench = Bench(start=start).ready()
    rows = np.zeros((400, 3), np.int64)
    rows[:, 1] = 4
    table = table_of_counts(rows, start=start)
    bench.executor.start(table)
    bench.go_on()
    assert bench.executor.state == "fault"
    assert "beyond its travel, which ends at 0.5" in bench.executor.ended[1]
    assert 27000 < bench.commanded()[-1, 1] <= 0.5 * winder().counts_per_unit[1] + 2

    rows = np.zeros((400, 3), np.int64)
    rows[:, 2] = 400
    bench = Bench().ready()
    with pytest.raises(LimitError, match="400 counts in a tick, the limit is 311"):
        bench.executor.start(table_of_counts(rows))
    assert bench.executor.state == "idle"
    assert not [message for message in bench.wire.sent if message.kind == "refill"]


def test_another_machine_or_start_is_refused() -> None:
    with pytest.raises(CommandError, match="the plan is for lathe-winder"):
        Bench(other=load_machine("lathe-winder+physical"))
    bench = Bench(start=np.array([0, 55, 0])).ready()
    with pytest.raises(CommandError, match=r"axis X stands at 0\.99353 mm, the run begins at 0 mm"):
        bench.executor.start(table_of_counts(there_and_back()))
    assert bench.executor.state == "idle"


def test_the_command_runs_what_it_proves(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The machine runs in its own process; a run and a proof record the same to the bit."""
    job, proof = EXAMPLES / "x-180.prg", tmp_path / "p.json"
    how = ("-m", "lathe-winder", "--interpolation", "linear")
    proved, ran = tmp_path / "proved.npz", tmp_path / "ran.npz"
    with pytest.raises(SystemExit) as ended:
        main(["prove", str(job), *how, "--nominal", "--recording", str(proved), "--proof",
              str(proof)])  # fmt: skip
    assert ended.value.code in (None, 0)
    capsys.readouterr()
    with pytest.raises(SystemExit) as ended:
        main(["run", str(job), *how, "--link", "sim", "--speed", "0", "--json", "--store",
              str(tmp_path / "runs"), "--proof", str(proof), "--recording", str(ran)])  # fmt: skip
    assert ended.value.code in (None, 0)
    content = json.loads(capsys.readouterr().out)
    assert content["passed"]
    assert (content["ended"], content["link"], content["late_ticks"]) == ("completed", "sim", 0)
    (folder,) = (path for path in (tmp_path / "runs").iterdir() if path.is_dir())
    assert (folder.name, str(folder / "trace.mcap")) == (content["run"], content["trace"])
    csv = tmp_path / "out.csv"
    for command in (("runs",), ("report", "last", "--csv", str(csv))):
        with pytest.raises(SystemExit) as ended:
            main([*command, "--store", str(tmp_path / "runs"), "--json"])
        assert ended.value.code in (None, 0)
        answer = json.loads(capsys.readouterr().out)
        answer = answer[0] if isinstance(answer, list) else answer
        assert (answer["run"], answer["passed"]) == (folder.name, True)
    assert read_recording(csv).job_sha256 == content["job_sha256"]
    assert (folder / "report" / "report.html").stat().st_size > 1000
    first, second = read_once(read_recording(proved)), read_once(read_recording(ran))
    assert first.channels == second.channels
    for channel in first.channels:
        assert np.array_equal(first.samples(channel.name), second.samples(channel.name))
    assert second.origin["link"] == "sim"
    assert second.simulated


def answer_of(capsys: pytest.CaptureFixture[str], *words: str | Path) -> tuple[object, str, str]:
    with pytest.raises(SystemExit) as ended:
        main([str(word) for word in words])
    captured = capsys.readouterr()
    return ended.value.code or 0, captured.out, captured.err


@pytest.mark.usefixtures("forked_machine")
def test_a_run_is_judged_again_by_what_it_was_proved_by(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The turning point is missed by 3 mm, out of spec by the machine's own specification."""
    # Nobody looks at these reports; the test above draws one.
    monkeypatch.setattr(report_, "write_report", lambda _, folder: folder / "report.html")
    spec, store = tmp_path / "coarse.toml", tmp_path / "runs"
    spec.write_text(
        'name = "coarse"\nlag = "100 ms"\n'
        '[[criteria]]\nname = "turning_point_error"\nlimit = "6 mm"\nrequired = true\n',
        encoding="utf-8",
    )
    job = tmp_path / "x-180.prg"
    job.write_bytes((EXAMPLES / "x-180.prg").read_bytes())
    how = (job, "-m", "lathe-winder", "--interpolation", "linear")
    fast = (*how, "--feed", "60 count/tick", "--nominal", "--speed", "0", "--store", store)
    code, out, err = answer_of(capsys, "run", *fast, "-s", spec)
    assert (code, "IN SPEC" in out) == (0, True), (out, err)
    again = ("report", "last", "--store", store)
    code, out, _ = answer_of(capsys, *again)
    assert (code, "IN SPEC" in out) == (0, True), out
    assert answer_of(capsys, *again, "-s", LIBRARY / "lathe-winder.spec.toml")[0] == 1
    (folder,) = (path for path in store.iterdir() if path.is_dir())
    assert (folder / "inputs" / "coarse.toml").read_bytes() == spec.read_bytes()
    assert (folder / "inputs" / "x-180.prg").is_file()
    assert answer_of(capsys, "verify", folder / "proof.json")[0] == 0
    spec.write_text(spec.read_text(encoding="utf-8").replace("6 mm", "2 mm"), encoding="utf-8")
    code, out, err = answer_of(capsys, *again)
    assert (code, out, "'coarse', has changed since" in err) == (2, "", True)
    job.write_bytes(job.read_bytes() + b"\n")
    code, out, err = answer_of(capsys, *again)
    assert (code, out, "from another version of x-180.prg" in err) == (2, "", True)
    assert f"{folder / 'inputs'} has a copy of each input" in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("x-180.prg", "-m", "lathe-winder", "--link", "hal"), "unknown link 'hal'"),
        (("x-180.prg", "-m", "lathe-winder", "--speed", "-1"), "--speed -1 is not between 0"),
        (("x-180.prg", "-m", "lathe-winder", "--speed", "1e-300"), "slower than the link can wait"),
        (("x-180.prg", "-m", "lathe-winder", "--proof", "none.json"), "none.json"),
        (("x-180.prg", "-m", "lathe-winder", "--override", ""), "gives no reason"),
    ],
)
def test_wrong_input_is_one_line(
    arguments: tuple[str, ...], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["run", str(EXAMPLES / arguments[0]), *arguments[1:], "--store", str(tmp_path / "r")])
    assert not (tmp_path / "r").exists()
    assert ended.value.code == 2
    captured = capsys.readouterr()
    assert message in captured.err
    assert len(captured.err.strip().splitlines()) == 1
    assert captured.out == ""


def test_a_proof_that_is_not_there_is_told_before_anything_is_planned(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def planned(*_: object) -> None:
        raise AssertionError("the job was planned")

    monkeypatch.setattr(run_, "plan_job", planned)
    arguments = ("-m", "lathe-winder", "--proof", "none.json")
    with pytest.raises(SystemExit) as ended:
        main(["run", str(EXAMPLES / "x-180.prg"), *arguments])
    assert ended.value.code == 2
    assert "none.json" in capsys.readouterr().err
