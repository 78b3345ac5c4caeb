"""``threadline learn`` in a shell, on the simulated machine and over its link."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import threadline as tl
from threadline.cli.main import main
from threadline.errors import OptionError
from threadline.files.formats import read_table
from threadline.proof import worst_search
from threadline.report.learn import table_name

EXAMPLES = Path(__file__).parents[2] / "examples"
SEAM = """
[stitching]
stitch_length = "0.1 in"
needle_speed = "60 stitch/s"
motion = "discrete"
[[contour]]
unit = "in"
points = [[0, 0], [1, 0], [1, 1]]
"""
SOFT = """
base = "stitcher"
name = "soft"
title = "the stitcher with loads and belts at the ends of their tolerances"
[bodies.x_head]
inertia = "122.1 kg exact, assumed"
[bodies.y_head]
inertia = "77 kg exact, assumed"
[links.x_belt]
stiffness = "4.992e5 N/m exact, assumed"
[links.y_belt]
stiffness = "8e5 N/m exact, assumed"
"""


def run(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> tuple[int, str, str]:
    """Run the program in this process; returns exit status, output and errors."""
    with pytest.raises(SystemExit) as stopped:
        main([str(a) for a in arguments])
    captured = capsys.readouterr()
    code = stopped.value.code
    return (0 if code is None else int(code)), captured.out, captured.err


@pytest.fixture
def asked(tmp_path: Path) -> list[str | Path]:
    """Return job, machine and specification as typed; soft.toml lies beside the job."""
    (tmp_path / "short.seam.toml").write_text(SEAM)
    (tmp_path / "soft.toml").write_text(SOFT)
    return [
        tmp_path / "short.seam.toml", "-m", "stitcher",
        "-s", EXAMPLES / "stitcher-place.spec.toml",
    ]  # fmt: skip


def test_repeats_are_printed_and_the_table_is_written(
    asked: list[str | Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    more = ("--feed-forward", "--nominal", "--actual", tmp_path / "soft.toml", "--repeats", "2")
    table, report = tmp_path / "learned.npz", tmp_path / "report"
    code, out, _ = run(capsys, "learn", *asked, *more, "-o", table, "--report", report, "--json")
    content = json.loads(out)
    (machine,) = content["machines"]
    assert code == 0
    assert content["passed"]
    assert content["level"] == "nominal"
    repeats = machine["repeats"]
    assert [repeats[0]["passed"], repeats[2]["passed"]] == [False, True]
    assert machine["within"] <= 2
    assert repeats[2]["error_rms_m"] < 0.2 * repeats[0]["error_rms_m"]
    assert read_table(table).began_sha256
    assert "learned on soft" not in out
    page = (report / "learning.html").read_text()
    assert "learning filter Y" in page
    assert (report / "learning-learning.png").stat().st_size > 10_000
    code, out, _ = run(capsys, "prove", *asked, *more[:4], "--table", table)
    assert code == 0
    code, _, output = run(capsys, "prove", *asked, "--nominal", "--table", table)
    assert code == 2
    assert "learned from another plan of this job" in output


def test_other_machines_are_judged_by_both_doors_alike(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(worst_search, "SEARCHED", 12)
    job = tmp_path / "turn.prg"
    job.write_text("G91\nG1 X2 F1000\nM30\n")
    words = ("learn", job, "-m", "lathe-winder", "--tolerances", "--repeats", "1", "--json")
    code, out, output = run(capsys, *words)
    assert code == 0, output
    found = tl.learn(job, "lathe-winder", level="over tolerances", repeats=1)
    typed = json.loads(out)
    assert typed == json.loads(json.dumps(found.content()))
    assert typed["level"] == "over tolerances"
    assert typed["machines"][0]["verdict"]["tolerances"]["drawn"] == 200
    recording = tmp_path / "x.npz"
    tl.prove(job, "lathe-winder", level="nominal").record(recording)
    code, _, output = run(capsys, *words[:5], "--from", recording)
    assert code == 2 and "Leave --tolerances out" in output
    with pytest.raises(OptionError, match=r'runs= judges .* Leave level="over tolerances" out'):
        tl.learn(job, "lathe-winder", level="over tolerances", runs=[recording])


@pytest.mark.long(
    shown_by="tests/search/test_learn.py::test_runs_of_a_machine_are_learned_from_one_after_the_other"
)
def test_run_learn_run_over_the_link(
    asked: list[str | Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The machine at the far end differs from the file; its runs are out of spec, then in spec."""
    store, table = tmp_path / "runs", tmp_path / "next.npz"
    more: list[str | Path] = [
        "--feed-forward", "--nominal", "--actual", tmp_path / "soft.toml", "--speed", "0",
        "--store", store, "--json",
    ]  # fmt: skip
    # The plan passes for the file's machine by its proof, or the machine would not move.
    code, out, _ = run(capsys, "run", *asked, *more)
    answer = json.loads(out)
    assert code == 1
    assert answer["simulated"].endswith("soft.toml")
    runs = [answer["run"]]
    for _ in range(2):
        named = [part for name in runs for part in ("--from", name)]
        learned = (*asked, *named, "--store", store, "-o", table)
        run(capsys, "learn", *learned)
        code, out, output = run(
            capsys, "run", *asked, *more, "--table", table, "--override", "it learns"
        )
        runs.append(json.loads(out)["run"])
    assert code == 0, output


@pytest.mark.parametrize(
    ("words", "refusal"),
    [
        (["-o", "table.txt"], "ends in .npz or .csv"),
        (["--from", "none"], "there is no run 'none'"),
        (["--from", "none", "--ends", "100 %"], "--ends asks for simulated machines"),
        (["--table", "none.npz"], "cannot read"),
        (["--from", "x.npz", "--table", "x.npz"], "names the table that it played"),
        (["--gain", "0"], "must be above 0"),
        (["--ends", "100 %", "-o", "two.npz"], "Leave --ends out"),
    ],
)
def test_learn_refuses_an_impossible_request_in_one_line(
    asked: list[str | Path],
    tmp_path: Path,
    words: list[str],
    refusal: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    kept = EXAMPLES / "x-180.prg"
    if "x.npz" in words:
        run(capsys, "prove", kept, "-m", "lathe-winder", "--nominal", "--recording", "x.npz")
    code, out, output = run(capsys, "learn", *asked, "--feed-forward", *words)
    assert (code, out) == (2, "")
    assert refusal in output
    assert not [*tmp_path.glob("two.npz"), *tmp_path.glob("table*")]


def test_another_machine_is_simulated_by_the_simulated_link_alone(
    asked: list[str | Path], capsys: pytest.CaptureFixture[str]
) -> None:
    code, _, output = run(
        capsys, "run", *asked, "--actual", "stitcher+backlash", "--link", "hal:loopback"
    )
    assert code == 2
    assert "--actual is simulated" in output


def test_the_row_called_plan_is_called_plan_below_the_table_too() -> None:
    assert table_name(0) == "table of the plan, unchanged"
    assert table_name(2) == "table of run 2"
