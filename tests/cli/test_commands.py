"""The commands in a shell: output, exit status, and no half-written file."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.blank_pictures import blank_pictures
from threadline.cli.main import main
from threadline.face import compile as compile_job
from threadline.files.formats import read_recording
from threadline.machine import load_machine
from threadline.proof.pipeline import target_names
from threadline.search.paced import Effort, searching_with

pytestmark = pytest.mark.usefixtures("coarse_search")


def run(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> tuple[int, str, str]:
    """Run the program in this process; returns exit status, output and errors."""
    with pytest.raises(SystemExit) as stopped:
        main([str(a) for a in arguments])
    captured = capsys.readouterr()
    code = stopped.value.code
    return (0 if code is None else int(code)), captured.out, captured.err


def test_prove_json_has_the_promised_keys(
    examples: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    job = examples / "x-180.prg"
    code, out, _ = run(
        capsys, "prove", job, "-m", "lathe-winder", "--interpolation", "linear", "--json"
    )
    content = json.loads(out)

    assert code == 0
    assert content["passed"] is True
    # Fourteen moves of 25.714 mm at 36 mm/s take 142.9 ticks of 5 ms each, in whole ticks.
    assert content["ticks"] == 14 * 143
    assert content["duration_s"] == pytest.approx(14 * 143 * 0.005, rel=1e-9)
    expected = {"job", "machine", "interpolation", "criteria", "job_sha256", "threadline"}
    assert expected <= content.keys()
    assert content["machine_sha256"] == load_machine("lathe-winder").sha256
    for criterion in content["criteria"]:
        assert {
            "name",
            "axis",
            "measured",
            "limit",
            "unit",
            "status",
            "time_s",
            "job_line",
        } <= criterion.keys()
    turning = next(
        c for c in content["criteria"] if (c["name"], c["axis"]) == ("turning_point_error", "X")
    )
    # The facts sheet's independent model stops 0.47 mm short at 36 mm/s.
    assert turning["measured"] == pytest.approx(0.47e-3, abs=0.03e-3)
    assert turning["job_line"] == 12


def test_prove_exits_with_one_out_of_spec(
    examples: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, _ = run(
        capsys,
        "prove",
        examples / "x-180.prg",
        "-m",
        "lathe-winder",
        "--interpolation",
        "linear",
        "--feed",
        "80 count/tick",
    )
    assert code == 1
    assert "OUT OF SPEC" in out
    assert "failed" in out


def test_the_table_of_a_shaped_motion_is_what_was_proved(
    examples: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The written counts add up to the commanded positions of the simulated machine."""
    common = [examples / "x-180.prg", "-m", "lathe-winder", "--interpolation", "parabolic"]
    shaped = ["--shaper", "zv:12Hz:0.02"]
    table, trace = tmp_path / "table.csv", tmp_path / "run.npz"
    run(capsys, "prove", *common, *shaped, "--recording", trace)
    code, _, _ = run(capsys, "compile", *common, *shaped, "--target", "csv", "-o", table)
    assert code == 0
    plain = tmp_path / "plain.csv"
    run(capsys, "compile", *common, "--target", "csv", "-o", plain)
    counts, unshaped = (
        np.array([int(x) for x in re.findall(r"^\d+,-?\d+,(-?\d+),", f.read_text(), re.M)])
        for f in (table, plain)
    )
    commanded = read_recording(trace).samples("X.commanded")[1] * 55.358e3
    np.testing.assert_allclose(np.cumsum(counts), commanded[1 : len(counts) + 1], atol=1e-6)
    assert len(counts) > len(unshaped)


def test_fastest_prints_the_command_that_proves_its_answer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Typed unchanged, it gives the same verdict; the search ends at --high, and says so."""
    monkeypatch.chdir(tmp_path)
    job = tmp_path / "a job.prg"
    job.write_text("G91\nG1 X10 F1200\nG1 X10\nG1 X-20\nM30\n")
    words = ["fastest", job.name, "-m", "lathe-winder", "--interpolation", "cubic"]
    words += ["--low", "20 mm/s", "--high", "21.1 mm/s"]
    code, out, _ = run(capsys, *words)
    assert code == 0
    assert "limited by the end of the search (--high)" in out
    assert re.search(r"tried in steps of 0\.\d+ %, about the edges of the fastest of 0\.\d+ %", out)
    (command,) = re.findall(r"To prove it: threadline (.*)", out)
    # All shares of the limits give the same job here: one row.
    assert len(re.findall(r"100 % to [0-9.]+ %\s+20\s+21\.1\s", out)) == 1

    blank_pictures(monkeypatch)
    _, found, _ = run(capsys, *words, "--json", "--report", tmp_path / "report")
    assert (tmp_path / "report" / "report.html").is_file()
    code, again, _ = run(capsys, *shlex.split(command), "--json")
    assert code == 0
    assert json.loads(again)["criteria"] == json.loads(found)["verdict"]["criteria"]
    assert json.loads(found)["command"] == f"threadline {command}"
    assert json.loads(found)["limited_by"] == "range"


@pytest.fixture
def few_plans(coarse_search: None) -> Iterator[None]:
    """Make a search over the choices of a plan try three careful places, and two more."""
    with searching_with(Effort(steps=3, least_plans=2, most_plans=2)):
        yield


@pytest.mark.long(but="extra1")
@pytest.mark.usefixtures("few_plans")
@pytest.mark.parametrize("extra", [["--contour", "0.4 mm"], ["--feed-forward"]])
def test_the_fastest_of_optimal_is_a_plan_that_prove_makes_again(
    examples: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str], extra: list[str],
) -> None:  # fmt: skip
    """No feed is searched; only the limits are printed, and the report shows the plan.

    It is drawn in the first case. Given options stay as they are, and the search chooses the rest.
    """
    if extra == ["--feed-forward"]:
        blank_pictures(monkeypatch)
    words = ["fastest", examples / "x-180.prg", "-m", "lathe-winder", "--interpolation", "optimal"]
    code, out, _ = run(capsys, *words, *extra, "--json", "--report", tmp_path)
    found = json.loads(out)
    assert code == 0
    assert (tmp_path / "report-limits.svg").exists()
    assert 0.1 < found["binds"]["voltage"] < 1.0
    assert ("lag" in found["binds"]) == ("--contour" in extra)
    assert found["tried"] >= 1
    assert ("contour_m" in found) and ("--contour" not in extra or found["contour_m"] == 4e-4)
    own, driven, anywhere = (bound["duration_s"] for bound in found["bounds"])
    assert own < driven < found["duration_s"] > anywhere

    code, again, _ = run(capsys, *shlex.split(found["command"])[1:], "--json")
    assert code == 0
    assert json.loads(again)["duration_s"] == found["duration_s"]
    assert json.loads(again)["criteria"] == found["verdict"]["criteria"]


@pytest.mark.long(shown_by="test_fastest_prints_the_command_that_proves_its_answer")
def test_a_margin_is_kept_free_of_every_limit_of_the_specification(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The whole range is in spec; with a fifth kept free it ends at 4/5 of the error's limit."""
    job = tmp_path / "turn.prg"
    job.write_text("G91\nG1 X25.714 F2160\nG1 X-25.714\nM30\n")
    words = ["fastest", job, "-m", "lathe-winder", "--interpolation", "linear"]
    words += ["--low", "29 mm/s", "--high", "33 mm/s", "--json"]
    _, out, _ = run(capsys, *words)
    assert json.loads(out)["limited_by"] == "range"
    code, out, _ = run(capsys, *words, "--margin", "20 %")
    found = json.loads(out)
    assert (code, found["margin"], found["limited_by"]) == (0, 0.2, "contour_error")

    for factor, within in ((1.0, True), (1.03, False)):
        feed = f"{factor * found['best']!r} m/s"
        _, out, _ = run(capsys, "prove", *words[1:6], "--feed", feed, "--json")
        proof = json.loads(out)
        worst = {c["name"]: c for c in proof["criteria"]}["contour_error"]
        assert proof["passed"]
        assert worst["limit"] == 0.5e-3
        assert (worst["measured"] <= 0.8 * worst["limit"]) is within


def test_prove_says_how_many_points_auto_added(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A square's three sides have two corners, each with one point on either side."""
    job = tmp_path / "corners.prg"
    job.write_text("O1\nG91 G1 X50 F600\nY50\nX-50\nM30\n")
    _, out, _ = run(capsys, "prove", job, "-m", "lathe-winder")
    assert re.search(r"^Points added: +4 \(", out, re.MULTILINE)
    _, out, _ = run(capsys, "prove", job, "-m", "lathe-winder", "--interpolation", "linear")
    assert "Points added" not in out


def test_prove_names_the_plan_that_keeps_the_loops_on_the_path(
    examples: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["prove", examples / "x-180.prg", "-m", "lathe-winder", "--feed", "80 count/tick"]
    code, out, _ = run(capsys, *words, "--nominal")
    assert code == 1
    assert re.search(
        r"^Out of the path: .*--interpolation optimal plans a motion", out, re.MULTILINE
    )
    code, out, _ = run(capsys, *words, "--nominal", "--interpolation", "optimal")
    assert code == 0
    assert "Out of the path" not in out


@pytest.mark.parametrize(
    ("mode", "length_mm"),
    [
        (None, 100.0),  # for the fastest axis: 1 rad of A at 100 mm
        ("fastest-axis", 100.0),
        ("base-axes:A", 100.0),  # CADFIL's mode 1
        ("base-axes:A,X", np.hypot(100.0, 50.0)),  # CADFIL's mode 2
        ("base-axes:X", 50.0),
        ("path", np.hypot(50.0, 20.0)),
    ],
)
def test_feed_mode_sets_the_length_over_which_f_is_the_speed(
    mode: str | None, length_mm: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A move takes its length, counted by the mode, over F: docs/part-programs.md."""
    job, trace = tmp_path / "wind.prg", tmp_path / "wind.npz"
    job.write_text("O1\nG91 G1 A57.29577951 X50 Y20 F600\nM30\n")
    chosen = [] if mode is None else ["--feed-mode", mode]
    common = ["-m", "lathe-winder", "--interpolation", "linear", "--json"]
    _, first, _ = run(capsys, "prove", job, *common, *chosen, "--nominal", "--recording", trace)
    _, second, _ = run(capsys, "judge", trace, "--json")

    # 600 mm/min is 10 mm/s; linear takes whole ticks of 5 ms.
    assert json.loads(first)["duration_s"] == pytest.approx(length_mm / 10.0, abs=0.0051)
    assert json.loads(second)["criteria"] == json.loads(first)["criteria"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--feed-mode", "cadfill"], "F cannot be read as 'cadfill'"),
        (["--feed-mode", "base-axes"], "base axes go with the feed mode base-axes"),
        (["--feed-mode", "base-axes:Q"], "the base axis 'Q' is not one of"),
        (["--feed-mode", "path", "--feed", "10 mm/s"], "--feed '10 mm/s' replaces every F"),
    ],
)
def test_a_meaning_that_f_cannot_have_is_refused(
    options: list[str], message: str, examples: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, err = run(capsys, "prove", examples / "x-180.prg", "-m", "lathe-winder", *options)
    assert (code, out) == (2, "")
    assert message in err


def test_report_and_table_files(
    examples: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, _ = run(
        capsys,
        "prove",
        examples / "x-180.prg",
        "-m",
        "lathe-winder",
        "--interpolation",
        "linear",
        "--report",
        tmp_path / "report",
    )
    assert code == 0
    page = (tmp_path / "report" / "report.html").read_text(encoding="utf-8")
    assert "IN SPEC" in page
    assert page.count("<svg") == 2  # the profile of X and the errors: nothing else has a shape
    assert "src=" not in page  # self-contained
    assert load_machine("lathe-winder").sha256 in page
    assert (tmp_path / "report" / "report.pdf").read_bytes().startswith(b"%PDF")
    assert (tmp_path / "report" / "report-profile-X.png").stat().st_size > 10_000
    assert [p.name for p in tmp_path.iterdir()] == ["report"]
    assert "report.html" in out


def test_help_has_an_example(capsys: pytest.CaptureFixture[str]) -> None:
    for command in ("prove", "compare", "fastest", "compile", "judge"):
        code, out, _ = run(capsys, command, "--help")
        assert code == 0
        assert f"Example: threadline {command}" in " ".join(out.split())


def test_help_and_face_name_every_target(capsys: pytest.CaptureFixture[str]) -> None:
    """Every kind of machine is checked: nobody uses a target that is not listed."""
    _, out, _ = run(capsys, "compile", "--help")
    for message in (out, str(compile_job.__doc__)):
        assert set(target_names()) <= set(re.findall(r"\w+", message))
